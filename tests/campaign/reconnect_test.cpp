// Promise R20: a crowd that has lost its server, and strangers that are refused, do not hammer it. Clients and servers
// are the host's own ends of links. FIONA_STORM_S sets for how long the server is away; then there are 200 clients.
// FIONA_SEED sets their pauses.
#include <arpa/inet.h>
#include <gtest/gtest.h>
#include <sys/resource.h>
#include <sys/socket.h>
#include <sys/syscall.h>

#include <algorithm>
#include <functional>
#include <iostream>
#include <map>
#include <random>
#include <thread>

#include <fmt/format.h>

#include "campaign.hpp"
#include "fiona/clock.hpp"
#include "host_links.hpp"
#include "link_keys.hpp"

namespace {

struct Attempt {
  std::int64_t at_ns;
  std::uint32_t address;
};
std::mutex attempts_mutex;
std::vector<Attempt> attempts;

}  // namespace

/// In the place of the C library's, also for libzmq: it notes who goes to 127.1.0.0/16, where the servers of this test
/// are.
extern "C" int connect(int socket, const sockaddr* address, socklen_t size) {
  if (address->sa_family == AF_INET) {
    const std::uint32_t to = ntohl(reinterpret_cast<const sockaddr_in*>(address)->sin_addr.s_addr);
    if (to >> 16 == (127U << 8 | 1U)) {
      const std::lock_guard lock(attempts_mutex);
      attempts.push_back({fiona::conformance::now_ns(), to});
    }
  }
  return static_cast<int>(::syscall(SYS_connect, socket, address, size));
}

namespace fiona::conformance {
namespace {

/// Of 200 clients, as long as their server is away: the first attempts, which make a short outage short, come all at
/// once.
constexpr double kMostAttempts_hz = 50;
constexpr double kRefused_ms = 5000;
constexpr double kWorse_ms = 5;
constexpr int kCrowd = 200;
constexpr std::chrono::seconds kCalm{5};

std::string address_of(int client) { return fmt::format("127.1.{}.{}", client / 200, client % 200 + 1); }

/// What has been tried since, by address, in the order of time.
std::map<std::uint32_t, std::vector<std::int64_t>> attempts_since(std::int64_t begun_ns) {
  std::map<std::uint32_t, std::vector<std::int64_t>> by_address;
  const std::lock_guard lock(attempts_mutex);
  for (const auto& one : attempts) {
    if (one.at_ns >= begun_ns) by_address[one.address].push_back(one.at_ns);
  }
  return by_address;
}

int attempts_between(std::int64_t begin_ns, std::int64_t end_ns) {
  const std::lock_guard lock(attempts_mutex);
  return static_cast<int>(std::count_if(attempts.begin(), attempts.end(),
                                        [&](const auto& one) { return one.at_ns >= begin_ns && one.at_ns < end_ns; }));
}

/// The most in any second between.
int most_in_a_second(std::int64_t begin_ns, std::int64_t end_ns) {
  int most = 0;
  for (std::int64_t at = begin_ns; at < end_ns; at += 100'000'000)
    most = std::max(most, attempts_between(at, at + 1'000'000'000));
  return most;
}

/// A host's share in a connection, without the host: threads, clock, and links on which nothing goes.
struct Side {
  Side(const std::filesystem::path& directory, const std::string& name, unsigned seed)
      : random(seed),
        links(pool, clock, "ipc://" + (directory / (name + ".ipc")).string(), {host::random_bytes(host::kKeyBytes)},
              [](std::uint64_t, const std::string&) {}) {
    context.set(zmq::ctxopt::max_sockets, 4000);
  }
  host::HostSurroundings around(const std::string& name, const trust::KeyPair& keys) {
    return {name,
            random(),
            keys,
            pool,
            clock,
            links,
            context,
            [](const wire::GroupMessage&) {},
            [](const host::HostChange&) {}};
  }
  std::mt19937_64 random;  ///< of the runs, of which the pauses follow
  SystemClock clock;
  Pool pool{2};
  host::Links links;
  zmq::context_t context;
};

/// Calls it every 50 ms, as a host's own thread does.
class Ticking {
 public:
  explicit Ticking(std::function<void(Steady::time_point)> tick)
      : thread_([this, tick = std::move(tick)] {
          for (; !stopping_; std::this_thread::sleep_for(std::chrono::milliseconds(50))) tick(Steady::now());
        }) {}
  ~Ticking() {
    stopping_ = true;
    thread_.join();
  }

 private:
  std::atomic<bool> stopping_{false};
  std::thread thread_;
};

/// Hosts that lead, each with a key of its own, and each with its own server, that is: its own address.
class Crowd {
 public:
  Crowd(Side& side, const std::filesystem::path& directory, int first, int count, const std::string& port,
        const trust::Key& server) {
    for (int i = first; i < first + count; ++i) {
      const std::string name = fmt::format("client{}", i);
      keys_.push_back(trust::KeyDirectory(directory / name).make());
      arounds_.push_back(std::make_unique<host::HostSurroundings>(side.around(name, keys_.back())));
      links_.push_back(std::make_unique<host::PeerLink>(
          *arounds_.back(),
          host::PeerAddress{fmt::format("server{}", i), "tcp://" + address_of(i) + ":" + port, server}));
    }
  }
  ~Crowd() { ticking_.reset(); }
  void let_in(const trust::KeyDirectory& where) const {
    for (std::size_t i = 0; i < keys_.size(); ++i) where.allow(arounds_[i]->name, keys_[i].open.text());
  }
  void begin() {
    ticking_ = std::make_unique<Ticking>([this](Steady::time_point) {
      for (auto& link : links_) link->tick(Steady::now());
    });
  }
  std::size_t joined() const {
    return static_cast<std::size_t>(
        std::count_if(links_.begin(), links_.end(), [](const auto& link) { return link->joined(); }));
  }
  std::size_t refused() const {
    return static_cast<std::size_t>(std::count_if(
        links_.begin(), links_.end(), [](const auto& link) { return link->status().state() == "refused"; }));
  }

 private:
  std::vector<trust::KeyPair> keys_;
  std::vector<std::unique_ptr<host::HostSurroundings>> arounds_;
  std::vector<std::unique_ptr<host::PeerLink>> links_;
  std::unique_ptr<Ticking> ticking_;
};

/// As many ends that are led, for as many leaders, that go and come back together.
class Servers {
 public:
  Servers(Side& side, const std::filesystem::path& directory)
      : side_(side),
        keys_(directory),
        pair_(keys_.make()),
        around_(side_.around("server", pair_)),
        zap_(side_.context, host::Zap::hosts(keys_), [](const std::string&) {}) {
    ticking_ = std::make_unique<Ticking>([this](Steady::time_point now) {
      zap_.serve();
      const std::lock_guard lock(mutex_);
      for (auto& link : links_) link->tick(now);
    });
  }
  ~Servers() {
    go();
    ticking_.reset();
  }
  const trust::Key& key() const { return pair_.open; }
  const trust::KeyDirectory& keys() const { return keys_; }
  void come(int count, const std::string& port) {
    const std::lock_guard lock(mutex_);
    for (int i = 0; i < count; ++i)
      links_.push_back(std::make_unique<host::LeaderLink>(around_, keys_, "tcp://" + address_of(i) + ":" + port));
  }
  void go() {
    const std::lock_guard lock(mutex_);
    links_.clear();
  }

 private:
  Side& side_;
  const trust::KeyDirectory keys_;
  const trust::KeyPair pair_;
  const host::HostSurroundings around_;
  host::Zap zap_;
  std::mutex mutex_;
  std::vector<std::unique_ptr<host::LeaderLink>> links_;
  std::unique_ptr<Ticking> ticking_;
};

class Storm : public testing::Test {
 protected:
  Storm() {
    std::cout << "seed " << seed << "\n";
    const std::lock_guard lock(attempts_mutex);
    attempts.clear();
  }
  /// Room for the descriptors of so many clients; why not, if there is none.
  static std::string missing_descriptors(int count) {
    rlimit limit{};
    ::getrlimit(RLIMIT_NOFILE, &limit);
    const auto needed = static_cast<rlim_t>(count * 14 + 200);
    if (limit.rlim_cur >= needed) return "";
    const rlim_t before = std::exchange(limit.rlim_cur, std::min(limit.rlim_max, needed));
    ::setrlimit(RLIMIT_NOFILE, &limit);
    return limit.rlim_cur >= needed
               ? ""
               : fmt::format("this test needs {} descriptors, and may have {} of at first {}: ulimit -n", needed,
                             limit.rlim_max, before);
  }
  /// Of all that the stopwatch has had since this was asked last; it begins anew. In milliseconds.
  static double take_p99_ms(RunningSystem& system, std::uint64_t watch) {
    system.take(watch);
    system.set("stopwatch", "count=1");  // it tells of all that it has with the next one
    const double p99_ns = static_cast<double>(system.wait_for(watch, [](const auto&) { return true; }).sent_ns());
    system.set("stopwatch", kNeverTells);
    return p99_ns / 1e6;
  }
  static constexpr const char* kNeverTells = "count=100000000";
  const unsigned seed =
      static_cast<unsigned>(number_from("FIONA_SEED", static_cast<int>(std::random_device{}() % 1'000'000)));
  const int away_s = number_from("FIONA_STORM_S", 8);
  const bool full = number_from("FIONA_STORM_S", 0) > 0;
  const int crowd = full ? kCrowd : 40;
  TemporaryDirectory directory;
};

TEST_F(Storm, OfRefusedClientsIsNoHammeringAndOtherTrafficGoesOn) {
  if (const auto missing = missing_descriptors(crowd); !missing.empty()) GTEST_SKIP() << missing;
  OtherHost other(directory.path, "far", {.listen = "0.0.0.0:0"});
  const std::string port = other.address().substr(other.address().find(':') + 1);
  RunningSystem system(other.led_from(directory.path / "test"));
  system.join("far");
  system.load_in("far", "pacer", "pacer", "neutral period_ms=5 count=100000000 payload=64");
  system.load_in("far/beside", "stopwatch", "stopwatch", kNeverTells);
  system.wire("stopwatch.samples", "pacer.samples");
  const auto watch = system.watch("stopwatch.report");
  system.state("pacer", "active");
  take_p99_ms(system, watch);
  let_be(system, kCalm);
  const double calm_ms = take_p99_ms(system, watch);

  Side side(directory.path, "crowd", seed);
  const trust::Key server = trust::KeyDirectory(other.keys()).pair().open;
  Crowd strangers(side, directory.path, 0, crowd / 2, port, server);
  Crowd latecomers(side, directory.path, crowd / 2, crowd - crowd / 2, port, server);
  latecomers.let_in(trust::KeyDirectory(other.keys()));
  const Pulse pulse;
  const std::int64_t begun_ns = now_ns();
  strangers.begin();
  latecomers.begin();
  system.eventually(
      "all are refused", [&] { return strangers.refused() + latecomers.refused() == static_cast<std::size_t>(crowd); },
      std::chrono::seconds(30));
  system.eventually(
      "for a while", [&] { return now_ns() - begun_ns > (away_s + 4) * 1'000'000'000LL; },
      std::chrono::seconds(away_s + 60));
  const std::int64_t ended_ns = now_ns();
  const double storm_ms = take_p99_ms(system, watch);

  double shortest_ms = 1e9;
  for (const auto& [address, times] : attempts_since(begun_ns)) {
    for (std::size_t i = 1; i < times.size(); ++i)
      shortest_ms = std::min(shortest_ms, static_cast<double>(times[i] - times[i - 1]) / 1e6);
  }
  // All begin at once; a short form sees little else.
  const std::int64_t from_ns = full ? begun_ns : begun_ns + 2'000'000'000;
  const double seconds = static_cast<double>(ended_ns - from_ns) / 1e9;
  const double rate_hz = attempts_between(from_ns, ended_ns) / seconds;
  std::cout << fmt::format(
      "{} refused clients, {} of them unknown, in {:.0f} s: {:.1f} attempts/s (bound {:.1f}), the most in a second {}; "
      "shortest pause of one "
      "{:.0f} ms (bound {:.0f}); p99 of other traffic {:.2f} ms, in calm {:.2f} ms (bound +{:.0f}); the machine stood "
      "still for up to {:.1f} ms\n",
      crowd, crowd / 2, seconds, rate_hz, kMostAttempts_hz * crowd / kCrowd, most_in_a_second(begun_ns, ended_ns),
      shortest_ms, kRefused_ms, storm_ms, calm_ms, kWorse_ms, pulse.longest_ms());
  EXPECT_GT(rate_hz, 0);
  EXPECT_LE(rate_hz, kMostAttempts_hz * crowd / kCrowd);
  EXPECT_GE(shortest_ms, kRefused_ms);
  EXPECT_LE(storm_ms, calm_ms + allowed(kWorse_ms, full) + pulse.longest_ms());
  EXPECT_EQ(system.host("far").state(), "joined");
}

TEST_F(Storm, OfClientsThatHaveLostTheirServerBacksOffAndIsOverSoonAfterItsReturn) {
  if (const auto missing = missing_descriptors(2 * crowd); !missing.empty()) GTEST_SKIP() << missing;
  const std::string port =
      std::to_string(20'000 + std::random_device{}() % 12'000);  // below those that connections are given
  Side theirs(directory.path, "servers", seed + 1);
  Side ours(directory.path, "clients", seed);
  Servers servers(theirs, directory.path / "server");
  servers.come(crowd, port);
  // The last of them is a system that goes on without its server, and must not notice the others.
  Crowd clients(ours, directory.path, 0, crowd - 1, port, servers.key());
  clients.let_in(servers.keys());
  const trust::KeyPair pair = trust::KeyDirectory(directory.path / "test").make();
  servers.keys().allow("test", pair.open.text());
  clients.begin();
  RunningSystem system(
      host::HostOptions{.keys = directory.path / "test",
                        .listen = "",
                        .peers = {{"server", "tcp://" + address_of(crowd - 1) + ":" + port, servers.key()}}});
  system.load_in("", "pacer", "pacer", "neutral period_ms=5 count=100000000 payload=64");
  system.load_in("beside", "stopwatch", "stopwatch", kNeverTells);
  system.wire("stopwatch.samples", "pacer.samples");
  const auto watch = system.watch("stopwatch.report");
  system.state("pacer", "active");
  const auto joined = [&] { return clients.joined() + (system.host("server").state() == "joined" ? 1 : 0); };
  const auto all = static_cast<std::size_t>(crowd);
  system.eventually(
      "all have joined", [&] { return joined() == all; }, std::chrono::seconds(60));
  take_p99_ms(system, watch);
  let_be(system, kCalm);
  const double calm_ms = take_p99_ms(system, watch);

  const Pulse pulse;
  servers.go();
  const std::int64_t gone_ns = now_ns();
  system.eventually("noticed", [&] { return joined() == 0; });
  system.eventually(
      "for a while", [&] { return now_ns() - gone_ns > away_s * 1'000'000'000LL; }, std::chrono::seconds(away_s + 60));
  const double storm_ms = take_p99_ms(system, watch);
  const std::int64_t back_ns = now_ns();
  servers.come(crowd, port);
  system.eventually(
      "all have joined again", [&] { return joined() == all; }, std::chrono::seconds(60));
  const double joined_ms = static_cast<double>(now_ns() - back_ns) / 1e6;

  // The first tries, which make a short outage short, are soon over; a short form sees little else.
  const std::int64_t from_ns = full ? gone_ns : gone_ns + 2'000'000'000;
  const double rate_hz = attempts_between(from_ns, back_ns) * 1e9 / static_cast<double>(back_ns - from_ns);
  std::cout << fmt::format(
      "{} clients, their server away for {} s: {:.1f} attempts/s on average (bound {:.1f}); the most in a second {}, "
      "after 10 s {}; all joined {:.0f} ms after its return (bound 5000); p99 of what one of them does meanwhile "
      "{:.2f} ms, in calm {:.2f} ms (bound +{:.0f}); the machine stood still for up to {:.1f} ms\n",
      crowd, away_s, rate_hz, kMostAttempts_hz * crowd / kCrowd, most_in_a_second(gone_ns, back_ns),
      most_in_a_second(gone_ns + 10'000'000'000, back_ns), joined_ms, storm_ms, calm_ms, kWorse_ms, pulse.longest_ms());
  EXPECT_GT(rate_hz, 0);
  EXPECT_LE(rate_hz, allowed(kMostAttempts_hz * crowd / kCrowd, full));  // a short form's first seconds weigh more
  EXPECT_LE(joined_ms, allowed(5000, full));
  EXPECT_LE(storm_ms, calm_ms + allowed(kWorse_ms, full) + pulse.longest_ms());
}

}  // namespace
}  // namespace fiona::conformance
