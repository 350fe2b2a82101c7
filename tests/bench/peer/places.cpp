#include "places.hpp"

#include <fcntl.h>
#include <poll.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <fstream>
#include <sstream>
#include <stdexcept>

#include "fiona/error.hpp"
#include "hand_over.hpp"
#include "os/unix_socket.hpp"

/// The program `fiona-group`, built once more under this name.
int fiona_group_main(int argc, char** argv);

namespace fiona::peer {
namespace {

using namespace std::chrono_literals;

constexpr auto kPatience = 10s;

control::PortName port_name(const std::string& text) {
  control::PortName name;
  name.set_instance(text.substr(0, text.find('.')));
  name.set_port(text.substr(text.find('.') + 1));
  return name;
}

/// Tells the harness' own process that this one is there, and where.
void announce(const std::string& text) {
  const auto file = run_directory() / own_place();
  std::ofstream(file.string() + ".new") << text;
  std::filesystem::rename(file.string() + ".new", file.string() + ".place");
}

/// What the others have told: name and text.
std::vector<std::pair<std::string, std::string>> announced(std::size_t processes) {
  std::vector<std::pair<std::string, std::string>> all;
  for (const auto end = std::chrono::steady_clock::now() + kPatience; all.size() < processes;) {
    if (std::chrono::steady_clock::now() > end) throw std::runtime_error("the harness' other processes did not start");
    std::this_thread::sleep_for(1ms);
    all.clear();
    for (const auto& entry : std::filesystem::directory_iterator(run_directory())) {
      if (entry.path().extension() != ".place") continue;
      std::stringstream text;
      text << std::ifstream(entry.path()).rdbuf();
      all.emplace_back(entry.path().stem().string(), text.str());
    }
  }
  return all;
}

host::System::Options options(const std::string& name) {
  const auto directory = run_directory() / (name + ".run");
  os::require_private_directory(directory);
  return {.name = name,
          .store = directory / "store",
          .directory = directory,
          .plugins = std::filesystem::path(PEER_COMPONENTS_LIBRARY).parent_path(),
          .ends_hung_groups = false,  // strands are lent to the harness' loops
          .restarts_groups = false,
          .tries_libraries = false};
}

std::filesystem::path keys_of(const std::string& name) { return run_directory() / (name + ".keys"); }

trust::KeyDirectory make_keys(const std::string& name) {
  const trust::KeyDirectory keys(keys_of(name));
  keys.make();
  return keys;
}

}  // namespace

const std::filesystem::path& run_directory() {
  static const std::filesystem::path directory = [] {
    std::string name = (std::filesystem::temp_directory_path() / "fiona-peer-XXXXXX").string();
    if (!::mkdtemp(name.data())) throw std::runtime_error("no directory " + name);
    return std::filesystem::path(name);
  }();
  return directory;
}

void reserve_group_descriptors() {
  while (::open("/dev/null", O_RDONLY | O_CLOEXEC) < kLastGroupDescriptor) {
  }
}

std::string own_place() { return "p" + std::to_string(::getpid()); }

ServedSystem::ServedSystem(host::System::Options options)
    : system_(std::move(options), [](const wire::GroupMessage&) {}), thread_([this] { serve(); }) {}

ServedSystem::~ServedSystem() {
  ends_ = true;
  thread_.join();
}

void ServedSystem::serve() {
  while (!ends_) {
    std::vector<pollfd> waits;
    {
      const std::lock_guard lock(mutex_);
      for (const auto* child : system_.child_groups()) waits.push_back({child->descriptor(), POLLIN, 0});
      if (system_.hosts_descriptor() >= 0) waits.push_back({system_.hosts_descriptor(), POLLIN, 0});
    }
    if (::poll(waits.data(), waits.size(), 20) <= 0) continue;
    const std::lock_guard lock(mutex_);
    system_.serve_hosts();
    for (auto* child : system_.child_groups()) system_.serve_group(*child);
  }
}

void ServedSystem::load(const std::string& component, const std::string& name, const std::string& group,
                        std::uint32_t index) {
  control::Change change;
  auto& request = *change.mutable_load();
  request.set_plugin(std::string(PEER_COMPONENTS_LIBRARY) + "/" + component);
  request.set_instance(name);
  request.set_group(group);
  if (component == "consumer") {
    auto& argument = *request.add_parameters();
    argument.set_name("index");
    argument.mutable_value()->set_integer(index);
  }
  const std::lock_guard lock(mutex_);
  system_.perform(change);
}

void ServedSystem::wire(const std::string& client, const std::string& provider) {
  control::Change change;
  *change.mutable_wire()->mutable_client() = port_name(client);
  *change.mutable_wire()->mutable_provider() = port_name(provider);
  const std::lock_guard lock(mutex_);
  system_.perform(change);
}

void ServedSystem::unwire(const std::string& client) {
  control::Change change;
  *change.mutable_unwire()->mutable_client() = port_name(client);
  const std::lock_guard lock(mutex_);
  system_.perform(change);
}

void ServedSystem::await(const std::string& what, const std::function<bool(const control::System&)>& holds) {
  for (const auto end = std::chrono::steady_clock::now() + kPatience; std::chrono::steady_clock::now() < end;) {
    {
      const std::lock_guard lock(mutex_);
      if (holds(system_.snapshot())) return;
    }
    std::this_thread::sleep_for(1ms);
  }
  throw Error(ErrorCode::Unreachable, "never happened: " + what);
}

void ServedSystem::await_connected(const std::string& port) {
  const auto wanted = port_name(port);
  await(port + " is connected", [&wanted](const control::System& system) {
    for (const auto& instance : system.instances()) {
      for (const auto& one : instance.ports()) {
        if (instance.name() == wanted.instance() && one.name() == wanted.port())
          return one.connection() == control::CONNECTED;
      }
    }
    return false;
  });
}

void ServedSystem::await_joined(const std::string& host) {
  await(host + " joins", [&host](const control::System& system) {
    return std::any_of(system.hosts().begin(), system.hosts().end(),
                       [&host](const auto& one) { return one.name() == host && one.state() == "joined"; });
  });
}

std::unique_ptr<std::thread> become_group() {
  auto listener = std::make_unique<os::UnixListener>(run_directory() / (own_place() + ".sock"));
  announce("");
  return std::make_unique<std::thread>([listener = std::move(listener)] {
    pollfd wait{listener->descriptor(), POLLIN, 0};
    if (::poll(&wait, 1, std::chrono::milliseconds(kPatience).count()) <= 0) return;
    const os::Descriptor from = listener->accept();
    std::vector<std::string> words = receive_hand_over(from.get());
    if (words.empty()) return;
    // A group closes what it is not given: the stand-in waits at the place of the adoption, which there is none of.
    ::dup3(from.get(), kLastGroupDescriptor, O_CLOEXEC);
    std::vector<char*> arguments;
    for (auto& word : words) arguments.push_back(word.data());
    fiona_group_main(static_cast<int>(arguments.size()), arguments.data());
  });
}

std::unique_ptr<ServedSystem> become_led_host() {
  const std::string name = own_place();
  const auto keys = make_keys(name);
  keys.allow("main", trust::KeyDirectory(keys_of("main")).pair().open.text());
  auto with = options(name);
  with.hosts = {keys.path(), "tcp://127.0.0.1:0", {}};
  auto made = std::make_unique<ServedSystem>(std::move(with));
  announce(made->listens() + " " + keys.pair().open.text());
  return made;
}

void make_leader_keys() { make_keys("main"); }

std::unique_ptr<ServedSystem> make_host(const std::string& transport, std::size_t processes,
                                        std::vector<std::string>& places) {
  auto with = options("main");
  const auto others = announced(processes);
  for (const auto& [name, text] : others) {
    places.push_back(name);
    if (transport != "tcp") continue;
    const std::string address =
        text.substr(std::string("tcp://").size(), text.find(' ') - std::string("tcp://").size());
    with.hosts.keys = keys_of("main");
    with.hosts.peers.push_back(
        host::PeerAddress::from_text(name + "=" + address + "=" + text.substr(text.find(' ') + 1)));
  }
  auto made = std::make_unique<ServedSystem>(std::move(with));
  for (const auto& place : places) {
    if (transport == "tcp") made->await_joined(place);
  }
  return made;
}

}  // namespace fiona::peer
