#include "system_fixture.hpp"

#include <fcntl.h>
#include <poll.h>
#include <unistd.h>

#include <algorithm>
#include <cstdlib>
#include <fstream>
#include <sstream>

#include "../polling.hpp"
#include "failure.hpp"
#include "fiona/error.hpp"
#include "fiona/probe.pb.h"
#include "os/unix_socket.hpp"

namespace fiona::conformance {
control::PortName port_name(const std::string& text) {
  control::PortName name;
  name.set_instance(text.substr(0, text.find('.')));
  name.set_port(text.substr(text.find('.') + 1));
  return name;
}

void add_arguments(const std::string& text, google::protobuf::RepeatedPtrField<control::Argument>& list) {
  std::istringstream words(text);
  for (std::string word; words >> word;) {
    if (word.find('=') == std::string::npos) continue;
    auto& argument = *list.Add();
    argument.set_name(word.substr(0, word.find('=')));
    const std::string value = word.substr(word.find('=') + 1);
    char* end = nullptr;
    const double number = std::strtod(value.c_str(), &end);
    if (!value.empty() && *end == '\0') {
      if (number == static_cast<double>(static_cast<std::int64_t>(number))) {
        argument.mutable_value()->set_integer(static_cast<std::int64_t>(number));
      } else {
        argument.mutable_value()->set_number(number);
      }
    } else if (value == "true" || value == "false") {
      argument.mutable_value()->set_flag(value == "true");
    } else {
      argument.mutable_value()->set_text(value);
    }
  }
}

std::string to_string(Transport transport) {
  return transport == Transport::Process ? "Process" : transport == Transport::Ipc ? "Ipc" : "Tcp";
}
void PrintTo(Transport transport, std::ostream* out) { *out << to_string(transport); }

SeenSample::SeenSample(const google::protobuf::Message& sample) : has_value(true) {
  if (const auto* number = dynamic_cast<const probe::Number*>(&sample)) {
    value_ = number->value();
  } else if (const auto* integer = dynamic_cast<const probe::Integer*>(&sample)) {
    value_ = static_cast<double>(integer->value());
  } else if (const auto* flag = dynamic_cast<const probe::Flag*>(&sample)) {
    value_ = flag->value() ? 1 : 0;
  } else if (const auto* text = dynamic_cast<const probe::Text*>(&sample)) {
    payload_ = text->value();
  } else {
    const auto& type = *sample.GetDescriptor();
    const auto& reflect = *sample.GetReflection();
    number_ = reflect.GetUInt64(sample, type.FindFieldByName("number"));
    sent_ns_ = reflect.GetInt64(sample, type.FindFieldByName("sent_ns"));
    value_ = reflect.GetDouble(sample, type.FindFieldByName("value"));
    payload_ = reflect.GetString(sample, type.FindFieldByName("payload"));
  }
}

OtherHost::OtherHost(const std::filesystem::path& directory, const std::string& name, Choice choice)
    : directory_(directory / name), name_(name), choice_(std::move(choice)), keys_(directory_ / "keys") {
  os::require_private_directory(directory_);
  trust::KeyDirectory(keys_).make();
  start();
}

void OtherHost::start() {
  int ends[2];
  if (::pipe2(ends, O_CLOEXEC) != 0) throw Error(ErrorCode::Failed, "no pipe");
  const os::Descriptor ready(ends[0]);
  os::Descriptor theirs(ends[1]);
  const int output = ::open((directory_ / "said").c_str(), O_WRONLY | O_CREAT | O_APPEND | O_CLOEXEC, 0600);
  const os::Descriptor log(output);
  std::filesystem::path program = os::program_directory() / "fiona-host";
  std::vector<std::string> words;
  if (!choice_.network.empty()) {
    words = {"netns", "exec", choice_.network, program.string()};
    program = "/usr/sbin/ip";
  }
  const std::vector<std::string> own{"--name",     name_,
                                     "--socket",   (directory_ / "host.sock").string(),
                                     "--store",    (directory_ / "store").string(),
                                     "--keys",     keys_.string(),
                                     "--listen",   "tcp://" + choice_.listen,
                                     "--threads",  "2",
                                     "--ready-fd", "3"};
  words.insert(words.end(), own.begin(), own.end());
  if (!choice_.registry.empty()) words.insert(words.end(), {"--registry", choice_.registry});
  if (choice_.plugins)
    words.insert(words.end(), {"--plugins", std::filesystem::path(TEST_COMPONENTS_LIBRARY).parent_path().string()});
  process_ = std::make_unique<os::ChildProcess>(program, words,
                                                std::vector<std::pair<int, int>>{{log.get(), 2}, {theirs.get(), 3}});
  theirs.reset();
  std::string told;
  char chunk[256];
  for (ssize_t count = 0; (count = ::read(ready.get(), chunk, sizeof chunk)) > 0;)
    told.append(chunk, static_cast<std::size_t>(count));
  if (!told.starts_with("READY\ntcp://"))
    throw Error(ErrorCode::Failed, "the other host did not start: " + told + said());
  address_ = told.substr(std::string("READY\ntcp://").size());
}

void OtherHost::restart() {
  Choice same = choice_;
  same.listen = address_;
  restart(std::move(same));
}

void OtherHost::restart(Choice choice) {
  process_.reset();
  choice_ = std::move(choice);
  start();
}

std::string OtherHost::said() const {
  std::stringstream text;
  text << std::ifstream(directory_ / "said").rdbuf();
  return text.str();
}

host::HostOptions OtherHost::led_from(const std::filesystem::path& keys) const {
  const trust::KeyDirectory ours(keys);
  if (!ours.has_pair()) ours.make();
  const auto allowed = trust::KeyDirectory(keys_).allowed();
  const auto known = [&](const trust::AllowedHost& one) { return one.key == ours.pair().open; };
  if (std::none_of(allowed.begin(), allowed.end(), known)) {
    trust::KeyDirectory(keys_).allow(keys.filename().string(), ours.pair().open.text());
  }
  return {keys,
          "",
          {host::PeerAddress::from_text(name_ + "=" + address_ + "=" + trust::KeyDirectory(keys_).pair().open.text())}};
}

RunningSystem::RunningSystem(Transport transport)
    : RunningSystem(transport, transport == Transport::Tcp ? "far" : "",
                    {.threads = 2, .ends_hung_groups = false, .restarts_groups = false, .tries_libraries = false}) {}

RunningSystem::RunningSystem(std::size_t threads, std::chrono::milliseconds standstill)
    : RunningSystem(
          Transport::Process, "",
          {.threads = threads, .standstill = standstill, .restarts_groups = false, .tries_libraries = false}) {}

RunningSystem::RunningSystem(const host::HostOptions& hosts)
    : RunningSystem(Transport::Process, "",
                    {.threads = 2,
                     .hosts = hosts,
                     .ends_hung_groups = false,
                     .restarts_groups = false,
                     .tries_libraries = false}) {}

RunningSystem::RunningSystem(const host::HostOptions& hosts, EndsHungGroups)
    : RunningSystem(Transport::Process, "", {.threads = 2, .hosts = hosts, .restarts_groups = false}) {}

RunningSystem::RunningSystem(EndsHungGroups, os::Limits limits)
    : RunningSystem(Transport::Process, "", {.threads = 2, .restarts_groups = false, .group_limits = limits}) {}

RunningSystem::RunningSystem(RestartsGroups) : RunningSystem(Transport::Process, "", {.threads = 2}) {}

RunningSystem::RunningSystem(const host::HostOptions& hosts, RestartsGroups)
    : RunningSystem(Transport::Process, "", {.threads = 2, .hosts = hosts, .ends_hung_groups = false}) {}

RunningSystem::RunningSystem(Transport transport, const std::string& other, host::System::Options options)
    : transport_(transport),
      other_(other.empty() ? nullptr : std::make_unique<OtherHost>(directory_.path, other)),
      system_(completed(std::move(options)), [this](const wire::GroupMessage& event) { keep(event); }) {
  if (other_) join(other);
}

namespace {

bool shares_template = false;

/// One that a test has killed is followed by another.
std::weak_ptr<os::ProcessTemplate> shared_template() {
  static std::shared_ptr<os::ProcessTemplate> one;
  if (!one || !one->lives()) one = std::make_shared<os::ProcessTemplate>(os::program_directory() / host::kGroupProgram);
  return one;
}

}  // namespace

void share_group_template() { shares_template = os::kCopiesProcesses; }

host::System::Options RunningSystem::completed(host::System::Options options) const {
  options.name = "test";
  options.store = directory_.path / "store";
  options.directory = directory_.path;
  options.patience = std::chrono::seconds(10);  // how busy the machine is, no test is about
  if (other_) options.hosts = other_->led_from(directory_.path / "test");
  if (shares_template && transport_ == Transport::Ipc) options.group_template = shared_template();
  return options;
}

SeenSample RunningSystem::seen(const wire::Tapped& tapped) {
  SeenSample sample;
  if (const auto object = system_.types().make(tapped.type())) {
    object->ParseFromString(tapped.object());
    sample = SeenSample(*object);
  }
  sample.unit = tapped.unit();
  sample.sequence = tapped.sequence();
  sample.opening = tapped.opening();
  sample.counted = tapped.number();
  sample.skipped = tapped.skipped();
  return sample;
}

void RunningSystem::keep(const wire::GroupMessage& event) {
  const std::lock_guard lock(mutex_);
  if (event.has_tap_ended()) ended_[event.tap_ended().tap()] = event.tap_ended().failure();
  if (event.has_logged()) log_.emplace_back(event.logged().instance(), event.logged().text());
  if (event.has_tapped()) seen_[event.tapped().tap()].push_back(seen(event.tapped()));
}

std::string RunningSystem::logged(const std::string& name, const std::string& begin) {
  const std::lock_guard lock(mutex_);
  for (auto line = log_.rbegin(); line != log_.rend(); ++line) {
    if (line->first == name && line->second.starts_with(begin)) return line->second;
  }
  return "";
}

SeenSample RunningSystem::read(const std::string& name) { return seen(system_.read(port_name(name))); }

control::Failure RunningSystem::end_of(std::uint64_t id) {
  eventually("the end of the tap", [&] {
    const std::lock_guard lock(mutex_);
    return ended_.contains(id);
  });
  const std::lock_guard lock(mutex_);
  return ended_[id];
}

control::Load RunningSystem::load_of(const std::string& group, const std::string& component, const std::string& name,
                                     const std::string& parameters) {
  control::Load request;
  request.set_plugin(std::string(TEST_COMPONENTS_LIBRARY) + "/" + component);
  request.set_instance(name);
  request.set_group(group);
  if (parameters.starts_with("neutral")) request.set_mode("neutral");
  add_arguments(parameters, *request.mutable_parameters());
  return request;
}

void RunningSystem::load_in(const std::string& group, const std::string& component, const std::string& name,
                            const std::string& parameters) {
  control::Change change;
  *change.mutable_load() = load_of(group, component, name, parameters);
  system_.perform(change);
}

std::shared_ptr<LaterAnswer> RunningSystem::begin_load_client(const std::string& component, const std::string& name,
                                                              const std::string& parameters) {
  auto answer = std::make_shared<LaterAnswer>();
  system_.begin_load(load_of(clients_group(), component, name, parameters), [answer](control::Reply reply) {
    answer->reply = std::move(reply);
    answer->ended = true;
  });
  return answer;
}

control::Reply RunningSystem::let_pass(std::chrono::milliseconds time) {
  system_.settle();
  control::Sleep request;
  request.set_duration_ms(static_cast<double>(time.count()));
  auto answer = std::make_shared<LaterAnswer>();
  system_.waits().sleep(1, 1, request, [answer](control::Reply reply) {
    answer->reply = std::move(reply);
    answer->ended = true;
  });
  eventually(
      "the end of the time",
      [&] {
        system_.watch_time();
        return answer->ended.load();
      },
      std::chrono::seconds(60));
  return answer->reply;
}

void RunningSystem::load_provider(const std::string& component, const std::string& name,
                                  const std::string& parameters) {
  load_in(providers_group(), component, name, parameters);
}

void RunningSystem::load_client(const std::string& component, const std::string& name, const std::string& parameters) {
  load_in(clients_group(), component, name, parameters);
}

control::Done RunningSystem::wire(const std::string& client, const std::string& provider, std::uint32_t every) {
  control::Change change;
  control::Wire& request = *change.mutable_wire();
  *request.mutable_client() = port_name(client);
  *request.mutable_provider() = port_name(provider);
  request.set_prescale(every);
  return system_.perform(change);
}

control::Done RunningSystem::wire_to_several(const std::string& client, const std::vector<std::string>& providers,
                                             double hold_ms, std::uint32_t every) {
  control::Change change;
  control::Wire& request = *change.mutable_wire();
  *request.mutable_client() = port_name(client);
  *request.mutable_provider() = port_name(providers.front());
  for (std::size_t i = 1; i < providers.size(); ++i) *request.add_alternatives() = port_name(providers[i]);
  request.set_prescale(every);
  if (hold_ms >= 0) request.set_hold_ms(hold_ms);
  return system_.perform(change);
}

void RunningSystem::unwire(const std::string& client) {
  control::Change change;
  control::Unwire& request = *change.mutable_unwire();
  *request.mutable_client() = port_name(client);
  system_.perform(change);
}

void RunningSystem::set(const std::string& instance_name, const std::string& parameters) {
  control::Change change;
  control::Set& request = *change.mutable_set();
  request.set_instance(instance_name);
  add_arguments(parameters, *request.mutable_parameters());
  system_.perform(change);
}

std::shared_ptr<LaterAnswer> RunningSystem::begin_state(const std::string& instance_name, const std::string& mode,
                                                        double within_ms) {
  control::State request;
  request.set_within_ms(within_ms);
  request.set_instance(instance_name);
  request.set_mode(mode);
  auto answer = std::make_shared<LaterAnswer>();
  system_.state(1, 1, request, [answer](control::Reply reply) {
    answer->reply = std::move(reply);
    answer->ended = true;
  });
  return answer;
}

void RunningSystem::state(const std::string& instance_name, const std::string& mode) {
  const auto answer = begin_state(instance_name, mode);
  eventually(
      "the change to " + mode, [&] { return answer->ended.load(); }, std::chrono::seconds(15));
  if (answer->reply.has_failure()) host::throw_failure(answer->reply.failure());
}

std::shared_ptr<LaterAnswer> RunningSystem::begin_call(const std::string& target, const std::string& arguments,
                                                       double within_ms) {
  control::Call request;
  *request.mutable_target() = port_name(target);
  add_arguments(arguments, *request.mutable_arguments());
  request.set_within_ms(within_ms);
  auto answer = std::make_shared<LaterAnswer>();
  system_.call(1, 1, request, [answer](control::Reply reply) {
    answer->reply = std::move(reply);
    answer->ended = true;
  });
  return answer;
}

control::Called RunningSystem::call(const std::string& target, const std::string& arguments, double within_ms) {
  const auto answer = begin_call(target, arguments, within_ms);
  eventually("the end of the call", [&] { return answer->ended.load(); });
  return answer->reply.called();
}

void RunningSystem::unload(const std::string& instance_name) {
  control::Change change;
  control::Unload& request = *change.mutable_unload();
  request.set_instance(instance_name);
  system_.perform(change);
}

std::uint64_t RunningSystem::watch(const std::string& name, control::Watch terms) {
  *terms.mutable_port() = port_name(name);
  const std::uint64_t tap = system_.new_tap();
  system_.tap(tap, terms);
  return tap;
}

void RunningSystem::serve_groups(std::chrono::milliseconds most) {
  const auto children = system_.child_groups();
  std::vector<pollfd> waits;
  for (auto* child : children) waits.push_back({child->descriptor(), POLLIN, 0});
  waits.push_back({system_.hosts_descriptor(), POLLIN, 0});
  ::poll(waits.data(), waits.size(), static_cast<int>(most.count()));
  system_.serve_hosts();
  for (std::size_t i = 0; i < children.size(); ++i) {
    if (waits[i].revents != 0) system_.serve_group(*children[i]);
  }
  system_.watch_groups();
}

void RunningSystem::eventually(const std::string& what, const std::function<bool()>& fits,
                               std::chrono::milliseconds deadline) {
  const tests::Polling polling(deadline);
  while (!fits()) {
    if (polling.over()) throw Error(ErrorCode::Unreachable, "never happened: " + what);
    serve_groups(polling.pause());
  }
}

SeenSample RunningSystem::wait_for(std::uint64_t id, const std::function<bool(const SeenSample&)>& fits,
                                   std::chrono::milliseconds deadline) {
  SeenSample found;
  eventually(
      "a sample that fits",
      [&] {
        const std::lock_guard lock(mutex_);
        for (auto& next = passed_[id]; next < seen_[id].size();) {
          found = seen_[id][next++];
          if (fits(found)) return true;
        }
        return false;
      },
      deadline);
  return found;
}

std::vector<SeenSample> RunningSystem::take(std::uint64_t id) {
  serve_groups(std::chrono::milliseconds(0));
  const std::lock_guard lock(mutex_);
  const auto& all = seen_[id];
  std::vector<SeenSample> rest(all.begin() + static_cast<std::ptrdiff_t>(passed_[id]), all.end());
  passed_[id] = all.size();
  return rest;
}

control::InstanceStatus RunningSystem::instance(const std::string& name) {
  const auto snapshot = system_.snapshot();
  for (const auto& one : snapshot.instances()) {
    if (one.name() == name) return one;
  }
  throw Error(ErrorCode::NotFound, "no instance " + name);
}

control::HostStatus RunningSystem::host(const std::string& name) {
  const auto snapshot = system_.snapshot();
  for (const auto& one : snapshot.hosts()) {
    if (one.name() == name) return one;
  }
  throw Error(ErrorCode::NotFound, "no host " + name);
}

void RunningSystem::join(const std::string& name) {
  eventually("host " + name + " joins", [&] { return host(name).state() == "joined"; });
  serve_groups(std::chrono::milliseconds(0));
}

control::GroupStatus RunningSystem::group(const std::string& name) {
  const auto snapshot = system_.snapshot();
  for (const auto& one : snapshot.groups()) {
    if (one.name() == name) return one;
  }
  throw Error(ErrorCode::NotFound, "no group " + name);
}

pid_t RunningSystem::far_process() { return other_ ? other_->process() : group("far").process(); }

control::PortStatus RunningSystem::port(const std::string& name) {
  const auto wanted = port_name(name);
  const auto owner = instance(wanted.instance());
  for (const auto& one : owner.ports()) {
    if (one.name() == wanted.port()) return one;
  }
  throw Error(ErrorCode::NotFound, "no port " + name);
}

}  // namespace fiona::conformance
