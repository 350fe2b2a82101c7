// A host whose descriptors somebody uses up: it lives, waits without turning round and round, and is well again once
// they have gone.
#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <netinet/in.h>
#include <sys/resource.h>
#include <sys/socket.h>
#include <sys/un.h>

#include <cstring>

#include "fiona/error.hpp"
#include "os/limits.hpp"
#include "supervised_host.hpp"

namespace fiona::conformance {
namespace {

using namespace std::chrono_literals;
using testing::HasSubstr;
using testing::Not;

/// What is started while it is there may open so many.
class LimitOfDescriptors {
 public:
  explicit LimitOfDescriptors(rlim_t most) {
    ::getrlimit(RLIMIT_NOFILE, &before_);
    const rlimit small{most, before_.rlim_max};
    ::setrlimit(RLIMIT_NOFILE, &small);
  }
  ~LimitOfDescriptors() { ::setrlimit(RLIMIT_NOFILE, &before_); }
  LimitOfDescriptors(const LimitOfDescriptors&) = delete;
  LimitOfDescriptors& operator=(const LimitOfDescriptors&) = delete;

 private:
  rlimit before_{};
};

/// Connects as often as it is let in, and stays.
class Crowd {
 public:
  explicit Crowd(const std::filesystem::path& unix_socket, std::size_t most = 300) : most_(most) {
    sockaddr_un address{};
    address.sun_family = AF_UNIX;
    std::strncpy(address.sun_path, unix_socket.c_str(), sizeof address.sun_path - 1);
    fill(AF_UNIX, reinterpret_cast<const sockaddr*>(&address), sizeof address);
  }
  explicit Crowd(std::uint16_t tcp_port) {
    sockaddr_in address{};
    address.sin_family = AF_INET;
    address.sin_port = htons(tcp_port);
    address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    fill(AF_INET, reinterpret_cast<const sockaddr*>(&address), sizeof address);
  }
  std::size_t size() const { return members_.size(); }

 private:
  void fill(int family, const sockaddr* address, socklen_t length) {
    for (std::size_t tries = 0; tries < 4 * most_ && members_.size() < most_; ++tries) {
      os::Descriptor one(::socket(family, SOCK_STREAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0));
      if (!one) return;
      const bool waits = ::connect(one.get(), address, length) != 0 && errno != EINPROGRESS;
      if (waits) std::this_thread::sleep_for(2ms);
      if (!waits) members_.push_back(std::move(one));
    }
  }
  const std::size_t most_ = 300;
  std::vector<os::Descriptor> members_;
};

/// Of one core.
double share_of_cpu(pid_t process, std::chrono::seconds time) {
  const auto used = [process] {
    std::ifstream file("/proc/" + std::to_string(process) + "/stat");
    std::string line;
    std::getline(file, line);
    std::istringstream fields(line.substr(line.rfind(')') + 2));
    const std::vector<std::string> words{std::istream_iterator<std::string>(fields), {}};
    return static_cast<double>(std::stol(words.at(11)) + std::stol(words.at(12))) /
           static_cast<double>(::sysconf(_SC_CLK_TCK));
  };
  const double before = used();
  std::this_thread::sleep_for(time);
  return (used() - before) / static_cast<double>(time.count());
}

class Exhaustion : public testing::Test {
 protected:
  void SetUp() override {
    if (!os::kLimitsMemory)
      GTEST_SKIP()
          << "a sanitizer asks by a pipe whether memory may be read, and takes it for damaged without a descriptor";
  }
  static std::unique_ptr<SupervisedHost> start(rlim_t most, const std::vector<std::string>& arguments = {}) {
    const LimitOfDescriptors few(most);
    return std::make_unique<SupervisedHost>(arguments);
  }
  /// Puts in a group, listens in `main`: the wire crosses.
  void load_pair(TestConsole& console) const {
    console.load("source", "there", "source", "period_ms=5");
    console.load("listener", "main", "listener");
    console.change(TestConsole::wire_of("listener.samples", "source.newest"));
  }
  static std::uint64_t heard(TestConsole& console) {
    const auto listener = console.instance("listener");
    for (const auto& port : listener.ports()) {
      if (port.name() == "samples") return port.messages();
    }
    return 0;
  }
  /// The host lives and hears what it heard before, at next to no cost; afterwards it answers.
  void expect_well(SupervisedHost& host, TestConsole& console, std::unique_ptr<Crowd> crowd) {
    const pid_t process = host.host();
    EXPECT_GT(crowd->size(), kFew) << "more than it could take";
    const std::uint64_t before = heard(console);
    EXPECT_LT(share_of_cpu(process, 2s), 0.25) << "of one core, with 200 messages a second on it";
    EXPECT_GT(heard(console), before + 100) << "the wire goes on";
    crowd.reset();
    EXPECT_NO_THROW(host.console()->snapshot());
    EXPECT_EQ(host.host(), process) << host.said();
    console.load("sink", "late", "sink");
    EXPECT_EQ(console.instance("sink").mode(), "active");
  }

  static constexpr rlim_t kFew = 128;
  static constexpr rlim_t kLeast = 67;  ///< of a host
  static constexpr int kGroups = 3;
  static constexpr rlim_t kOfGroups = 73;  ///< so many need more: reserve, links, and what a host has open
};

TEST_F(Exhaustion, ByConsolesHurtsNobodyElse) {
  const auto started = start(kFew);
  SupervisedHost& host = *started;
  const auto console = host.console();
  load_pair(*console);
  expect_well(host, *console, std::make_unique<Crowd>(host.socket()));
}

TEST_F(Exhaustion, ByPeersOfItsLinksHurtsNobodyElse) {
  const auto started = start(kFew);
  SupervisedHost& host = *started;
  const auto console = host.console();
  load_pair(*console);
  std::filesystem::path listener;
  for (const auto& file : std::filesystem::recursive_directory_iterator(host.socket().parent_path())) {
    if (file.is_socket() && file.path() != host.socket() && file.path().filename() == "kept.main.ipc")
      listener = file.path();
  }
  ASSERT_FALSE(listener.empty());
  expect_well(host, *console, std::make_unique<Crowd>(listener));
}

/// They need no key to connect; who has one is let in once they have gone.
TEST_F(Exhaustion, ByWhoeverConnectsOverTcpHurtsNobodyElse) {
  const TemporaryDirectory keys;
  const trust::KeyDirectory its(keys.path / "its"), ours(keys.path / "ours");
  its.make();
  its.allow("test", ours.make().open.text());
  const auto started = start(kFew, {"--keys", its.path().string(), "--listen", "tcp://127.0.0.1:0"});
  SupervisedHost& host = *started;
  const auto console = host.console();
  load_pair(*console);
  const std::string scheme = "tcp://", said = host.said_ready();
  ASSERT_THAT(said, HasSubstr(scheme));
  const std::string address = said.substr(said.find(scheme) + scheme.size(),
                                          said.find('\n', said.find(scheme)) - said.find(scheme) - scheme.size());
  const auto port = static_cast<std::uint16_t>(std::stoi(address.substr(address.rfind(':') + 1)));
  expect_well(host, *console, std::make_unique<Crowd>(port));
  RunningSystem leader(host::HostOptions{
      ours.path(), "", {host::PeerAddress::from_text("kept=" + address + "=" + its.pair().open.text())}});
  EXPECT_NO_THROW(leader.join("kept"));
}

/// From fewer than a host can live with to as many as people have: it says so and does not start, or refuses what would
/// bring it to the end of them, or lives with a crowd that wants more than there are.
class SweepOfLimits : public Exhaustion, public testing::WithParamInterface<int> {
 protected:
  static std::unique_ptr<TestConsole> console_of(SupervisedHost& host) {
    if (!host.said_ready().starts_with("READY")) return nullptr;
    return host.console();
  }
};

TEST_P(SweepOfLimits, NoneEndsAHostOrGoesUnsaid) {
  const auto limit = static_cast<rlim_t>(GetParam());
  const auto started = start(limit);
  SupervisedHost& host = *started;
  const auto console = console_of(host);
  if (!console) {
    EXPECT_LT(limit, kLeast);
    EXPECT_THAT(host.said_ready(), HasSubstr("a host cannot live with so few descriptors"));
    EXPECT_THAT(host.said_ready(), HasSubstr("a limit of " + std::to_string(limit)));
    host.wait_for_end();
    return;
  }
  EXPECT_GE(limit, kLeast);
  const pid_t process = host.host();
  int loaded = 0;
  try {
    for (; loaded < kGroups; ++loaded)
      console->load("source", fmt::format("there{}", loaded), fmt::format("s{}", loaded));
  } catch (const Error& error) {
    EXPECT_EQ(error.text().what, "another group would bring the host to the end of its descriptors");
    EXPECT_THAT(error.text().found, HasSubstr("a limit of " + std::to_string(limit)));
  }
  if (limit < kOfGroups) {
    EXPECT_LT(loaded, kGroups);
  }
  if (limit >= kFew) {
    EXPECT_EQ(loaded, kGroups);
  }
  auto crowd = std::make_unique<Crowd>(host.socket(), static_cast<std::size_t>(limit) + 64);
  EXPECT_GT(crowd->size(), limit);
  EXPECT_LT(share_of_cpu(process, 1s), 0.25) << "of one core";
  EXPECT_EQ(console->snapshot().instances_size(), loaded) << "who is in stays";
  crowd.reset();
  EXPECT_NO_THROW(host.console()->snapshot());
  EXPECT_EQ(host.host(), process) << host.said();
}

INSTANTIATE_TEST_SUITE_P(From64To1024, SweepOfLimits,
                         testing::Values(64, 66, 67, 72, 80, 96, 112, 128, 160, 192, 256, 384, 512, 768, 1024));

TEST_F(Exhaustion, ByAHostThatIsGivenTooFewIsRefusedInASentence) {
  const auto started = start(48);
  SupervisedHost& host = *started;
  host.wait_for_end();
  EXPECT_THAT(host.said_ready() + host.said(), HasSubstr("a host cannot live with so few descriptors"));
  EXPECT_THAT(host.said_ready() + host.said(), HasSubstr("a limit of 48"));
  EXPECT_THAT(host.said_ready() + host.said(), HasSubstr("ulimit -n 1024"));
}

}  // namespace
}  // namespace fiona::conformance
