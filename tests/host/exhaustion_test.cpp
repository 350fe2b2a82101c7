// Promise R22: a host whose descriptors somebody uses up lives, waits without turning round and round, and is well
// again once they have gone. FIONA_CROWD_S sets for how long they stay.
#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <netinet/in.h>
#include <sys/resource.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <zmq.hpp>

#include <cstring>
#include <iostream>

#include "campaign.hpp"
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

sockaddr_in loopback(std::uint16_t port) {
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_port = htons(port);
  address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  return address;
}

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
    const sockaddr_in address = loopback(tcp_port);
    fill(AF_INET, reinterpret_cast<const sockaddr*>(&address), sizeof address);
  }
  std::size_t size() const { return members_.size(); }

 private:
  void fill(int family, const sockaddr* address, socklen_t length) {
    for (const auto end = Steady::now() + 5s; members_.size() < most_ && Steady::now() < end;) {
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

/// Whether a console with these keys is let in there.
bool is_served(const std::string& address, const trust::KeyPair& its, const trust::KeyPair& ours) {
  zmq::context_t context;
  zmq::socket_t socket(context, zmq::socket_type::dealer);
  socket.set(zmq::sockopt::curve_serverkey, its.open.bytes());
  socket.set(zmq::sockopt::curve_publickey, ours.open.bytes());
  socket.set(zmq::sockopt::curve_secretkey, ours.secret.bytes());
  socket.set(zmq::sockopt::rcvtimeo, 10'000);
  socket.set(zmq::sockopt::linger, 0);
  socket.connect(address);
  control::Carried hello;
  hello.mutable_hello()->set_version(1);
  socket.send(zmq::buffer(hello.SerializeAsString()), zmq::send_flags::none);
  zmq::message_t answer;
  control::Carried carried;
  return socket.recv(answer) && carried.ParseFromArray(answer.data(), static_cast<int>(answer.size())) &&
         carried.has_welcome();
}

/// Whether a page comes from there.
bool serves_page(std::uint16_t port) {
  const os::Descriptor socket(::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0));
  const sockaddr_in address = loopback(port);
  if (::connect(socket.get(), reinterpret_cast<const sockaddr*>(&address), sizeof address) != 0) return false;
  const std::string asked = fmt::format("GET / HTTP/1.1\r\nHost: 127.0.0.1:{}\r\n\r\n", port);
  char answer[12];
  return ::send(socket.get(), asked.data(), asked.size(), MSG_NOSIGNAL) == static_cast<ssize_t>(asked.size()) &&
         ::recv(socket.get(), answer, sizeof answer, MSG_WAITALL) == sizeof answer &&
         std::string_view(answer, sizeof answer) == "HTTP/1.1 200";
}

/// One that nobody has just now.
std::uint16_t free_port() {
  const os::Descriptor socket(::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0));
  sockaddr_in address = loopback(0);
  socklen_t size = sizeof address;
  if (::bind(socket.get(), reinterpret_cast<const sockaddr*>(&address), size) != 0) return 0;
  ::getsockname(socket.get(), reinterpret_cast<sockaddr*>(&address), &size);
  return ntohs(address.sin_port);
}

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
  static std::uint64_t heard(TestConsole& console, const std::string& instance = "listener") {
    const auto listener = console.instance(instance);
    for (const auto& port : listener.ports()) {
      if (port.name() == "samples") return port.messages();
    }
    return 0;
  }
  /// Whoever listens, the host or that process, lives and is heard as before, at next to no cost; once they have gone
  /// it answers.
  void expect_well(SupervisedHost& host, TestConsole& console, const std::function<std::unique_ptr<Crowd>()>& come,
                   const std::function<bool()>& answers, pid_t listener = 0) {
    const pid_t process = host.host();
    const auto share = [watched = listener != 0 ? listener : process, this] {
      return share_of_cpu(watched, std::chrono::seconds(kStays_s));
    };
    const double calm = share();  // 200 messages a second take their part, too
    auto crowd = come();
    EXPECT_GT(crowd->size(), kFew) << "more than it could take";
    const std::uint64_t before = heard(console);
    expect_share(share() - calm, allowed(kShare, kInFull));
    EXPECT_GT(heard(console), before + 50 * kStays_s) << "the wire goes on";
    crowd.reset();
    expect_answer(answers);
    EXPECT_EQ(host.host(), process) << host.said();
    console.load("sink", "late", "sink");
    EXPECT_EQ(console.instance("sink").mode(), "active");
  }
  static void expect_share(double share, double bound) {
    std::cout << fmt::format("{:.1f} % of a core for the crowd (bound {:.0f} %)\n", 100 * share, 100 * kShare);
    EXPECT_LE(share, bound) << "of one core";
  }
  static void expect_answer(const std::function<bool()>& answers) {
    const auto gone = Steady::now();
    while (!answers() && Steady::now() - gone < 10s) std::this_thread::sleep_for(2ms);
    const double back_s = std::chrono::duration<double>(Steady::now() - gone).count();
    std::cout << fmt::format("answers {:.0f} ms after they have gone (bound {:.0f})\n", 1000 * back_s, 1000 * kBack_s);
    EXPECT_LE(back_s, allowed(kBack_s, kInFull)) << "until it answers again";
  }
  static bool answers(const SupervisedHost& host) {
    try {
      TestConsole(host.socket()).snapshot();
      return true;
    } catch (const std::runtime_error&) {
      return false;
    }
  }
  /// Whether it can be made again, in a group of its own.
  static bool loads(TestConsole& console, const std::string& component) {
    try {
      console.load(component, "other", "other");
      return true;
    } catch (const Error&) {  // the crowd's descriptors have not been closed yet
      return false;
    }
  }
  /// The tcp port that the host has named after these words.
  static std::uint16_t port_said(const std::string& said, const std::string& words) {
    const auto begin = said.find(words);
    if (begin == std::string::npos) throw std::runtime_error("it has not said '" + words + "': " + said);
    const std::string address = said.substr(begin, said.find('\n', begin) - begin);
    return static_cast<std::uint16_t>(std::stoi(address.substr(address.rfind(':') + 1)));
  }
  static std::filesystem::path link_of(const SupervisedHost& host, const std::string& group) {
    for (const auto& file : std::filesystem::recursive_directory_iterator(host.socket().parent_path() / "links")) {
      if (file.is_socket() && file.path().string().find("/kept." + group + ".") != std::string::npos)
        return file.path();
    }
    throw std::runtime_error("no link of " + group);
  }

  static constexpr double kShare = 0.10;
  static constexpr double kBack_s = 2;
  const int kStays_s = number_from("FIONA_CROWD_S", 2);
  static inline const bool kInFull = number_from("FIONA_CROWD_S", 0) > 0;
  static constexpr rlim_t kFew = 128;
  static constexpr rlim_t kLeast = 69;  ///< of a host
  static constexpr int kGroups = 3;
  static constexpr rlim_t kOfGroups = 73;  ///< so many need more: reserve, links, and what a host has open
};

TEST_F(Exhaustion, ByConsolesHurtsNobodyElse) {
  const auto started = start(kFew);
  SupervisedHost& host = *started;
  const auto console = host.console();
  load_pair(*console);
  expect_well(
      host, *console, [&] { return std::make_unique<Crowd>(host.socket()); }, [&] { return answers(host); });
}

TEST_F(Exhaustion, ByPeersOfItsLinksHurtsNobodyElse) {
  const auto started = start(kFew);
  SupervisedHost& host = *started;
  const auto console = host.console();
  load_pair(*console);
  expect_well(
      host, *console, [&] { return std::make_unique<Crowd>(link_of(host, "main")); },
      [&] {
        if (!loads(*console, "source")) return false;  // whose process connects to that link
        console->change(TestConsole::wire_of("listener.samples", "other.newest"));
        const auto before = heard(*console);
        console->eventually("it is heard", [&] { return heard(*console) > before; });
        return true;
      });
}

TEST_F(Exhaustion, ByPeersOfAGroupsLinksHurtsNobodyElse) {
  const auto started = start(kFew);
  SupervisedHost& host = *started;
  const auto console = host.console();
  load_pair(*console);
  expect_well(
      host, *console, [&] { return std::make_unique<Crowd>(link_of(host, "there")); },
      [&] {
        if (!loads(*console, "listener")) return false;
        console->change(TestConsole::wire_of("other.samples", "source.newest"));
        console->eventually("it hears", [&] { return heard(*console, "other") > 0; });
        return true;
      },
      console->process_of("there"));
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
  const std::uint16_t port = port_said(host.said_ready(), "tcp://");
  std::unique_ptr<RunningSystem> leader;
  expect_well(
      host, *console, [&] { return std::make_unique<Crowd>(port); },
      [&] {
        leader = std::make_unique<RunningSystem>(host::HostOptions{
            ours.path(),
            "",
            {host::PeerAddress::from_text(fmt::format("kept=127.0.0.1:{}={}", port, its.pair().open.text()))}});
        leader->join("kept");
        return true;
      });
}

/// The same of consoles on other machines.
TEST_F(Exhaustion, ByWhoeverConnectsWhereConsolesAreServedHurtsNobodyElse) {
  const TemporaryDirectory keys;
  const trust::KeyDirectory its(keys.path / "its"), ours(keys.path / "ours");
  its.make();
  its.allow_console("test", ours.make().open.text(), trust::Access::Observe);
  const auto started = start(kFew, {"--keys", its.path().string(), "--serve", "tcp://127.0.0.1:0"});
  SupervisedHost& host = *started;
  const auto console = host.console();
  load_pair(*console);
  const std::uint16_t port = port_said(host.said(), "serves consoles at ");
  expect_well(
      host, *console, [&] { return std::make_unique<Crowd>(port); },
      [&] { return is_served(fmt::format("tcp://127.0.0.1:{}", port), its.pair(), ours.pair()); });
}

/// The page, which has a process of its own.
TEST_F(Exhaustion, ByWhoeverConnectsToThePageHurtsNobodyElse) {
  if (!std::filesystem::exists(WEB_INTERFACE)) GTEST_SKIP() << "the page was not built (it takes npm)";
  const TemporaryDirectory directory;
  const auto started = start(kFew);
  SupervisedHost& host = *started;
  const auto console = host.console();
  load_pair(*console);
  const std::uint16_t port = free_port();
  control::Change load;
  load.mutable_load()->set_plugin(WEB_INTERFACE);
  load.mutable_load()->set_instance("page");
  load.mutable_load()->set_group("web");
  add_arguments(fmt::format("port={} database={}", port, (directory.path / "web.db").string()),
                *load.mutable_load()->mutable_parameters());
  console->change(load);
  ASSERT_TRUE(serves_page(port));
  expect_well(
      host, *console, [&] { return std::make_unique<Crowd>(port); }, [&] { return serves_page(port); },
      console->process_of("web"));
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
  expect_share(share_of_cpu(process, 1s), kShare);
  EXPECT_EQ(console->snapshot().instances_size(), loaded) << "who is in stays";
  crowd.reset();
  expect_answer([&] { return answers(host); });
  EXPECT_EQ(host.host(), process) << host.said();
}

INSTANTIATE_TEST_SUITE_P(From64To1024, SweepOfLimits,
                         testing::Values(64, 68, 69, 72, 80, 96, 112, 128, 160, 192, 256, 384, 512, 768, 1024));

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
