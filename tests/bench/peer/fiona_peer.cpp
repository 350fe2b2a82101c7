// FIONA under the peers' harness: --transport main (all in one process), ipc (groups), tcp (hosts, with CURVE).
// Provider and consumer are plugins, loaded and wired by a host in the harness' own process.
#include <sys/wait.h>

#include <cstdlib>
#include <cstring>

#include "bench.hpp"
#include "os/process.hpp"
#include "places.hpp"
#include "switchboard.hpp"

extern "C" fiona::peer::Switchboard* fiona_peer_switchboard() {
  static fiona::peer::Switchboard one;
  return &one;
}

namespace fiona::peer {
namespace {

Switchboard& switchboard() { return *fiona_peer_switchboard(); }

Ear::OnData as_data(bench::OnMessage on_message) {
  return [on_message = std::move(on_message)](std::string_view data) {
    on_message(reinterpret_cast<const std::uint8_t*>(data.data()), data.size());
  };
}

class Pub final : public bench::Pub {
 public:
  Pub(Publisher& publisher, std::size_t size) : publisher_(publisher), size_(size) {}
  void prepare() override { publisher_.prepare({reinterpret_cast<const char*>(bench::source(size_)), size_}); }
  void send(const bench::Header& header) override {
    publisher_.send({reinterpret_cast<const char*>(&header), sizeof header});
  }

 private:
  Publisher& publisher_;
  const std::size_t size_;
};

class Client final : public bench::Client {
 public:
  Client(Asker& asker, std::size_t size) : asker_(asker), size_(size) {}
  void call() override { asker_.call({reinterpret_cast<const char*>(bench::source(size_)), size_}); }

 private:
  Asker& asker_;
  const std::size_t size_;
};

/// A wire, for as long as it lives: the instances stay when a subscriber goes.
class Sub final : public bench::Sub {
 public:
  Sub(ServedSystem& system, std::string port, const std::string& provider) : system_(system), port_(std::move(port)) {
    system_.wire(port_, provider);
  }
  ~Sub() override { system_.unwire(port_); }

 private:
  ServedSystem& system_;
  const std::string port_;
};

/// The harness' own process: the host. What its other processes shall be is loaded there before they are asked for it.
class Leading final : public bench::Peer {
 public:
  explicit Leading(const bench::Options& options) : scenario_(options.scenario) {
    const std::size_t others = options.procs == 1                       ? 0
                               : scenario_ == "ow" || scenario_ == "tp" ? static_cast<std::size_t>(options.subs)
                                                                        : 1;
    system_ = make_host(options.transport, others, places_);
    for (const auto& place : places_) {
      if (scenario_ == "rt") system_->load("answerer", "answerer", place);
      if (scenario_ == "connect") system_->load("provider", "provider", place);
      if (scenario_ == "ow" || scenario_ == "tp") load_consumer("consumer-" + place, place);
    }
  }
  std::unique_ptr<bench::Pub> make_pub(const std::string&, std::size_t size) override {
    system_->load("keeper", "keeper", "");
    system_->load("provider", "provider", "");
    for (const auto& consumer : consumers_) wire_consumer(consumer);
    return std::make_unique<Pub>(switchboard().publisher("provider"), size);
  }
  std::unique_ptr<bench::Sub> make_sub(const std::string&, std::size_t, bench::OnMessage on_message) override {
    if (scenario_ == "connect") {
      if (consumers_.empty()) load_consumer("consumer", "");
      switchboard().ear("consumer").set(as_data(std::move(on_message)));
      return std::make_unique<Sub>(*system_, "consumer.blobs", "provider.blobs");
    }
    const std::string name = "consumer" + std::to_string(consumers_.size());
    load_consumer(name, "");
    switchboard().ear(name).set(as_data(std::move(on_message)));
    wire_consumer(name);
    return std::make_unique<bench::Sub>();
  }
  std::unique_ptr<bench::Server> make_server(const std::string&, std::size_t) override {
    system_->load("answerer", "answerer", "");
    return std::make_unique<bench::Server>();
  }
  std::unique_ptr<bench::Client> make_client(const std::string&, std::size_t size) override {
    system_->load("questioner", "questioner", "");
    system_->wire("questioner.echo", "answerer.echo");
    system_->await_connected("questioner.echo");
    return std::make_unique<Client>(switchboard().asker("questioner"), size);
  }

 private:
  void load_consumer(const std::string& name, const std::string& place) {
    system_->load("consumer", name, place, static_cast<std::uint32_t>(consumers_.size()));
    consumers_.push_back(name);
  }
  void wire_consumer(const std::string& name) {
    system_->wire(name + ".progress", "keeper.progress");
    system_->await_connected(name + ".progress");
    system_->wire(name + ".blobs", "provider.blobs");
    system_->await_connected(name + ".blobs");
  }

  const std::string scenario_;
  std::vector<std::string> places_;
  std::vector<std::string> consumers_;
  std::unique_ptr<ServedSystem> system_;
};

/// A process that the harness has forked: a group, or a host that is led. It is told what to load, and waits for that.
class Led final : public bench::Peer {
 public:
  explicit Led(const std::string& transport) {
    if (transport == "tcp") {
      system_ = become_led_host();
    } else {
      group_ = become_group();
    }
  }
  std::unique_ptr<bench::Pub> make_pub(const std::string&, std::size_t size) override {
    return std::make_unique<Pub>(switchboard().publisher("provider"), size);
  }
  std::unique_ptr<bench::Sub> make_sub(const std::string&, std::size_t, bench::OnMessage on_message) override {
    const std::string name = "consumer-" + own_place();
    switchboard().ear(name).set(as_data(std::move(on_message)));
    switchboard().await(name);
    return std::make_unique<bench::Sub>();
  }
  std::unique_ptr<bench::Server> make_server(const std::string&, std::size_t) override {
    switchboard().await("answerer");
    return std::make_unique<bench::Server>();
  }

 private:
  std::unique_ptr<ServedSystem> system_;
  std::unique_ptr<std::thread> group_;
};

int run_harness(int argc, char** argv) {
  make_leader_keys();
  const pid_t leader = ::getpid();
  return bench::run(argc, argv, "fiona", [leader](const bench::Options& options) -> std::unique_ptr<bench::Peer> {
    if (::getpid() == leader) return std::make_unique<Leading>(options);
    return std::make_unique<Led>(options.transport);
  });
}

}  // namespace
}  // namespace fiona::peer

/// The harness ends its processes without destroying anything, so that another one has to clear up.
int main(int argc, char** argv) {
  using namespace fiona;
  os::keep_freed_memory();
  ::setenv("FIONA_PEER_RUN", peer::run_directory().c_str(), 1);
  peer::reserve_group_descriptors();
  const pid_t harness = ::fork();
  if (harness == 0) {
    try {
      return peer::run_harness(argc, argv);
    } catch (const std::exception& error) {
      std::fprintf(stderr, "%s\n", error.what());
      std::_Exit(1);
    }
  }
  int status = 1;
  ::waitpid(harness, &status, 0);
  std::error_code ignored;
  std::filesystem::remove_all(peer::run_directory(), ignored);
  return WIFEXITED(status) ? WEXITSTATUS(status) : 1;
}
