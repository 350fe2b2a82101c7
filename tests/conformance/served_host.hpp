#pragma once

#include <fcntl.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

#include <cstring>
#include <functional>
#include <stdexcept>
#include <string>
#include <thread>

#include "../polling.hpp"
#include "control_server.hpp"
#include "failure.hpp"
#include "fiona/error.hpp"
#include "fiona/probe.pb.h"
#include "system_fixture.hpp"

namespace fiona::conformance {

/// A host that serves the control protocol, on a thread of the test's process. What a test is about lives at `place`:
/// in `main`, in a group, or on another host that this one leads.
class ServedHost {
 public:
  /// `serves`: consoles over tcp too, those in the list of `keys()`.
  explicit ServedHost(Transport transport = Transport::Process, bool serves = false)
      : transport_(transport),
        serves_(serves),
        other_(transport == Transport::Tcp ? std::make_unique<OtherHost>(directory_.path, "far") : nullptr),
        server_(socket(), options()) {
    if (::pipe2(lifeline_, O_CLOEXEC) != 0) throw std::runtime_error("no pipe");
    serving_ = std::thread([this] { server_.serve(lifeline_[0], -1); });
  }
  ~ServedHost() {
    ::close(lifeline_[1]);
    serving_.join();
    ::close(lifeline_[0]);
  }
  ServedHost(const ServedHost&) = delete;
  ServedHost& operator=(const ServedHost&) = delete;

  std::filesystem::path socket() const { return directory_.path / "private" / "served.sock"; }
  std::string place() const { return transport_ == Transport::Process ? "main" : "far"; }
  bool has_other() const { return other_ != nullptr; }
  OtherHost& other() { return *other_; }
  trust::KeyDirectory keys() const { return trust::KeyDirectory(directory_.path / "served-keys"); }
  /// "tcp://127.0.0.1:41234"
  std::string serves() const { return server_.serves(); }

 private:
  host::System::Options options() const {
    host::System::Options options{
        .name = "served", .store = directory_.path / "store", .directory = directory_.path, .threads = 2};
    options.ends_hung_groups = false;  // those that a test has stopped go on
    options.restarts_groups = false;
    options.tries_libraries = false;
    if (other_) options.hosts = other_->led_from(directory_.path / "test");
    if (!serves_) return options;
    keys().make();
    options.hosts.keys = keys().path();
    options.hosts.serve = "tcp://127.0.0.1:0";
    return options;
  }

  const TemporaryDirectory directory_;
  const Transport transport_;
  const bool serves_;
  const std::unique_ptr<OtherHost> other_;
  host::ControlServer server_;
  int lifeline_[2] = {-1, -1};
  std::thread serving_;
};

inline os::Descriptor connected(const std::filesystem::path& path) {
  sockaddr_un address{};
  address.sun_family = AF_UNIX;
  std::strncpy(address.sun_path, path.c_str(), sizeof address.sun_path - 1);
  os::Descriptor socket(::socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0));
  if (::connect(socket.get(), reinterpret_cast<const sockaddr*>(&address), sizeof address) != 0)
    throw std::runtime_error("no host");
  return socket;
}

/// A connection to it. What the host refuses is thrown as fiona::Error.
class TestConsole {
 public:
  explicit TestConsole(const std::filesystem::path& socket) : stream_(connected(socket)) {}
  explicit TestConsole(const ServedHost& host) : TestConsole(host.socket()) {
    if (!host.has_other()) return;
    eventually("the other host joins", [this] { return snapshot().hosts(0).state() == "joined"; });
  }

  control::Request request() {
    control::Request next;
    next.set_id(++sent_);
    next.set_author("test");
    return next;
  }
  void send(const control::Request& request) {
    if (!stream_.send(request) || !stream_.flush_all()) throw std::runtime_error("the host has gone");
  }
  /// Without waiting.
  bool has_answer() { return stream_.wait_readable(std::chrono::steady_clock::now()); }
  control::Reply receive() {
    control::Reply reply;
    const auto end = std::chrono::steady_clock::now() + std::chrono::seconds(40);
    for (bool open = true; !stream_.next(reply);) {
      if (!open) throw std::runtime_error(stream_.closed() ? "the host has gone" : "no answer within 40 s");
      open = stream_.wait_readable(end) && stream_.receive();  // the last words may come with the end
    }
    if (reply.has_failure()) host::throw_failure(reply.failure());
    return reply;
  }
  control::Reply ask(const control::Request& request) {
    send(request);
    return receive();
  }
  /// Sent, and not waited for.
  void begin(control::Change change) {
    auto asked = request();
    *asked.mutable_transact()->add_changes() = std::move(change);
    send(asked);
  }
  control::Done change(control::Change change) {
    begin(std::move(change));
    return receive().done();
  }

  static control::Change load_of(const std::string& component, const std::string& group, const std::string& name = "",
                                 const std::string& parameters = "") {
    control::Change change;
    control::Load& load = *change.mutable_load();
    load.set_plugin(std::string(TEST_COMPONENTS_LIBRARY) + "/" + component);
    load.set_group(group);
    load.set_instance(name);
    add_arguments(parameters, *load.mutable_parameters());
    return change;
  }
  static control::Change wire_of(const std::string& client, const std::string& provider) {
    control::Change change;
    *change.mutable_wire()->mutable_client() = port_name(client);
    *change.mutable_wire()->mutable_provider() = port_name(provider);
    return change;
  }
  static control::Change set_of(const std::string& instance, const std::string& parameters) {
    control::Change change;
    change.mutable_set()->set_instance(instance);
    add_arguments(parameters, *change.mutable_set()->mutable_parameters());
    return change;
  }
  static control::Change swap_of(const std::string& old, const std::string& next, double watch_ms = 0) {
    control::Change change;
    change.mutable_replace()->set_old(old);
    change.mutable_replace()->set_next(next);
    change.mutable_replace()->set_watch_ms(watch_ms);
    return change;
  }
  void load(const std::string& component, const std::string& group, const std::string& name = "",
            const std::string& parameters = "") {
    change(load_of(component, group, name, parameters));
  }
  void set(const std::string& instance, const std::string& parameters) { change(set_of(instance, parameters)); }
  void state(const std::string& instance, const std::string& mode) {
    control::Change one;
    one.mutable_state()->set_instance(instance);
    one.mutable_state()->set_mode(mode);
    change(std::move(one));
  }
  void unload(const std::string& instance) {
    control::Change one;
    one.mutable_unload()->set_instance(instance);
    change(std::move(one));
  }
  control::Done undo() {
    auto undo = request();
    undo.mutable_undo();
    return ask(undo).done();
  }
  control::JournalEntry last_entry() {
    auto look = request();
    look.mutable_journal()->set_last(1);
    return ask(look).journal().entries(0);
  }
  control::System snapshot() {
    auto look = request();
    look.mutable_snapshot();
    return ask(look).system();
  }
  /// Throws where there is none of this name.
  control::InstanceStatus instance(const std::string& name) {
    const control::System system = snapshot();
    for (const auto& one : system.instances()) {
      if (one.name() == name) return one;
    }
    throw std::runtime_error("no instance " + name);
  }
  /// Who provides a required port; empty: nobody.
  std::string peer_of(const std::string& client) {
    const auto wanted = port_name(client);
    const control::InstanceStatus owner = instance(wanted.instance());
    for (const auto& port : owner.ports()) {
      if (port.name() == wanted.port()) return port.peer().instance();
    }
    throw std::runtime_error("no port " + client);
  }
  pid_t process_of(const std::string& group) {
    const control::System system = snapshot();
    for (const auto& one : system.groups()) {
      if (one.name() == group) return one.process();
    }
    throw std::runtime_error("no group " + group);
  }
  /// A probe that is a text; empty where it has none yet.
  std::string read(const std::string& name) {
    auto look = request();
    *look.mutable_read()->mutable_probe() = port_name(name);
    probe::Text text;
    text.ParseFromString(ask(look).sample().object());
    return text.value();
  }
  void eventually(const std::string& what, const std::function<bool()>& fits) {
    const tests::Polling polling(std::chrono::seconds(20));
    while (!fits()) {
      if (polling.over()) throw std::runtime_error("never happened: " + what);
      std::this_thread::sleep_for(polling.pause());
    }
  }

 private:
  os::MessageStream stream_;
  std::uint64_t sent_ = 0;
};

}  // namespace fiona::conformance
