#include "console_rewire.hpp"

#include <google/protobuf/io/coded_stream.h>

#include <chrono>
#include <memory>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "control_client.hpp"
#include "fiona/trust/host_keys.hpp"
#include "host_process.hpp"
#include "os/process.hpp"

namespace fiona::bench {
namespace {

/// The first field of a Sample: of a stopwatch's report, when its message came.
std::int64_t number_of(const std::string& sample) {
  google::protobuf::io::CodedInputStream in(reinterpret_cast<const std::uint8_t*>(sample.data()),
                                            static_cast<int>(sample.size()));
  std::uint64_t number = 0;
  constexpr std::uint32_t kNumber = 1U << 3U;
  return in.ExpectTag(kNumber) && in.ReadVarint64(&number) ? static_cast<std::int64_t>(number) : 0;
}

/// A system as `fiona run` has it, and one console. Where what is loaded lives is as in a RunningSystem.
class ConsoledSystem {
 public:
  explicit ConsoledSystem(Transport transport)
      : transport_(transport),
        other_(transport == Transport::Tcp ? std::make_unique<conformance::OtherHost>(directory_.path, "far")
                                           : nullptr),
        host_(reactor_, launch(), [](const std::string&) {}),
        client_(reactor_, console::Endpoint{.socket = socket()}, std::chrono::seconds(30)) {}

  void load_provider(const std::string& name, const std::string& parameters) {
    load(transport_ == Transport::Ipc ? "near" : "main", "pacer", name, parameters);
  }
  /// The client of all providers, which are wired to it in turns.
  void load_client() {
    load(transport_ == Transport::Process ? "main" : "far", "stopwatch", "stopwatch", "count=1");
    control::Request request;
    *request.mutable_watch()->mutable_port() = conformance::port_name("stopwatch.report");
    client_.begin(request, [this](const control::Reply& reply) {
      const std::int64_t came_ns = number_of(reply.sample().object());
      if (first_ns_ == 0 && came_ns > begun_ns_) first_ns_ = came_ns;
    });
  }
  void wire(const std::string& provider) {
    control::Request request;
    auto& wire = *request.mutable_transact()->add_changes()->mutable_wire();
    *wire.mutable_client() = conformance::port_name("stopwatch.samples");
    *wire.mutable_provider() = conformance::port_name(provider + ".samples");
    client_.call(request);
  }
  /// Until the first message that has come since; in nanoseconds.
  std::int64_t rewire(const std::string& provider) {
    first_ns_ = 0;
    begun_ns_ = steady_ns();
    wire(provider);
    const auto deadline = std::chrono::steady_clock::now() + std::chrono::seconds(10);
    if (!reactor_.run_until([this] { return first_ns_ > 0; }, deadline))
      throw std::runtime_error("no message comes over the new wire");
    return first_ns_ - begun_ns_;
  }

 private:
  std::filesystem::path socket() const { return directory_.path / "host.sock"; }
  console::HostLaunch launch() const {
    console::HostLaunch launch{os::program_directory() / "fiona-host", socket(), "bench", directory_.path / "store"};
    if (!other_) return launch;
    const auto keys = directory_.path / "bench";
    static_cast<void>(other_->led_from(keys));  // lets it in
    launch.limits = {"--keys", keys.string()};
    launch.peers = {"far=" + other_->address() + "=" + trust::KeyDirectory(other_->keys()).pair().open.text()};
    return launch;
  }
  void load(const std::string& group, const std::string& component, const std::string& name,
            const std::string& parameters) {
    control::Request request;
    auto& load = *request.mutable_transact()->add_changes()->mutable_load();
    load.set_plugin(std::string(TEST_COMPONENTS_LIBRARY) + "/" + component);
    load.set_instance(name);
    load.set_group(group);
    conformance::add_arguments(parameters, *load.mutable_parameters());
    client_.call(request);
  }

  const conformance::TemporaryDirectory directory_;
  const Transport transport_;
  const std::unique_ptr<conformance::OtherHost> other_;
  console::Reactor reactor_;
  console::HostProcess host_;
  console::ControlClient client_;
  std::int64_t begun_ns_ = 0;
  std::int64_t first_ns_ = 0;  ///< 0: none has come since it was begun
};

}  // namespace

Latency console_rewire_to_first_message(const Load& load, Transport transport) {
  ConsoledSystem system(transport);
  system.load_client();
  system.load_provider("calm", "period_ms=10000 count=1000000000");
  system.load_provider("pacer", "payload=" + std::to_string(load.bytes) +
                                    " period_ms=" + std::to_string(load.period_ms) + " count=1000000000");
  std::vector<std::int64_t> latencies;
  for (std::size_t i = 0; i <= load.messages; ++i) {
    system.wire("calm");
    const std::int64_t latency_ns = system.rewire("pacer");
    if (i > 0) latencies.push_back(latency_ns);  // the first makes the link
  }
  return summarise(std::move(latencies));
}

}  // namespace fiona::bench
