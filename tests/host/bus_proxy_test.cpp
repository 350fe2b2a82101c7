// Services on D-Bus that a sandbox was granted, and nobody else there.
#include "bus_proxy.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <sdbus-c++/sdbus-c++.h>
#include <signal.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <sys/wait.h>
#include <unistd.h>

#include <atomic>
#include <chrono>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <memory>
#include <optional>
#include <string>
#include <thread>

#include "bus.hpp"
#include "fiona/error.hpp"
#include "os/descriptor.hpp"
#include "os/process.hpp"
#include "supervised_host.hpp"
#include "system_fixture.hpp"

namespace fiona::host {
namespace {

using conformance::RunningSystem;
using conformance::TemporaryDirectory;
using std::chrono::milliseconds;
using std::chrono::seconds;
using Steady = std::chrono::steady_clock;
using testing::AllOf;
using testing::HasSubstr;
using testing::StartsWith;

/// A bus of the test's own, which this process takes for both, with two services on it.
class Bus {
 public:
  Bus() {
    std::filesystem::remove(path_);
    daemon_ = std::make_unique<os::ChildProcess>(
        os::program_in_path("dbus-daemon"),
        std::vector<std::string>{"--session", "--nofork", "--nopidfile", "--address=" + address()},
        std::vector<std::pair<int, int>>{});
    for (int i = 0; i < 1000 && !takes_connections(); ++i) std::this_thread::sleep_for(milliseconds(10));
    ::setenv("DBUS_SYSTEM_BUS_ADDRESS", address().c_str(), 1);
    ::setenv("DBUS_SESSION_BUS_ADDRESS", address().c_str(), 1);
    open_ = std::make_unique<Service>(address(), "org.fiona.zoo.Open", "open");
    closed_ = std::make_unique<Service>(address(), "org.fiona.zoo.Closed", "closed");
  }
  ~Bus() {
    closed_.reset();
    open_.reset();
    ::unsetenv("DBUS_SYSTEM_BUS_ADDRESS");
    ::unsetenv("DBUS_SESSION_BUS_ADDRESS");
    std::filesystem::remove(path_);
  }
  std::string address() const { return "unix:path=" + path_; }

 private:
  bool takes_connections() const {
    sockaddr_un name{.sun_family = AF_UNIX, .sun_path = {}};
    path_.copy(name.sun_path, sizeof(name.sun_path) - 1);
    const os::Descriptor socket(::socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0));
    return ::connect(socket.get(), reinterpret_cast<const sockaddr*>(&name), sizeof(name)) == 0;
  }
  /// Answers what it is, and says so all the time.
  struct Service {
    Service(const std::string& address, const std::string& name, const std::string& answer)
        : connection(sdbus::createSessionBusConnectionWithAddress(address)) {
      connection->requestName(name);
      object = sdbus::createObject(*connection, "/");
      object->registerMethod("Ask").onInterface("org.fiona.Zoo").implementedAs([answer] { return answer; });
      object->registerSignal("Told").onInterface("org.fiona.Zoo").withParameters<std::string>();
      object->finishRegistration();
      connection->enterEventLoopAsync();
      speaker = std::thread([this, answer] {
        while (!ends) {
          object->emitSignal("Told").onInterface("org.fiona.Zoo").withArguments(answer);
          std::this_thread::sleep_for(milliseconds(20));
        }
      });
    }
    ~Service() {
      ends = true;
      speaker.join();
      connection->leaveEventLoop();
    }
    std::unique_ptr<sdbus::IConnection> connection;
    std::unique_ptr<sdbus::IObject> object;
    std::atomic<bool> ends{false};
    std::thread speaker;
  };
  const std::string path_ = "/var/tmp/fiona-zoo-" + std::to_string(::getpid()) + ".bus";
  std::unique_ptr<os::ChildProcess> daemon_;
  std::unique_ptr<Service> open_, closed_;
};

bool has_programs() {
  return !os::program_in_path("dbus-daemon").empty() && !os::program_in_path(os::kBusProxy).empty();
}

class ToABus : public testing::Test {
 protected:
  void SetUp() override {
    if (!has_programs()) GTEST_SKIP() << "apt-get install dbus-daemon " << os::kBusProxy;
    bus.emplace();
  }
  std::optional<Bus> bus;
};

class BusRight : public ToABus {
 protected:
  std::optional<Error> load(const std::vector<std::string>& rights) {
    control::Change change;
    control::Load& request = *change.mutable_load();
    request.set_plugin(std::string(ZOO_DIRECTORY) + "/libknocks-on-the-bus.so");
    request.set_instance("patient");
    request.set_group("cage");
    request.mutable_rights()->Add(rights.begin(), rights.end());
    try {
      system.system().perform(change);
    } catch (const Error& error) {
      return error;
    }
    return std::nullopt;
  }
  std::string knocks(const std::vector<std::string>& rights) {
    EXPECT_EQ(load(rights), std::nullopt);
    system.eventually("it has knocked", [&] { return system.instance("patient").mode() == "failed"; });
    return system.instance("patient").reason();
  }

  RunningSystem system;
};

TEST_F(BusRight, OpensOneServiceOfTheSystemBusAndNothingElseThere) {
  EXPECT_EQ(knocks({"confined", "system-bus:org.fiona.zoo.Open"}),
            "0 of 15 knocks; DBUS_SYSTEM_BUS_ADDRESS: it says open, and is heard");
}

TEST_F(BusRight, OpensOneOfEachBus) {
  EXPECT_EQ(knocks({"confined", "system-bus:org.fiona.zoo.Open", "session-bus:org.fiona.zoo.Open"}),
            "0 of 30 knocks; DBUS_SYSTEM_BUS_ADDRESS: it says open, and is heard; DBUS_SESSION_BUS_ADDRESS: it says "
            "open, and is heard");
}

/// That nothing was found above is because of the sandbox.
TEST_F(BusRight, IsNoneWhereTheGroupIsNoSandbox) {
  const std::string found = knocks({});
  EXPECT_GE(std::stoi(found), 15) << found;
  for (const std::string sure : {"a call", "names", "a name of its own", "signals", "the bus itself"})
    EXPECT_THAT(found, HasSubstr(", " + sure));
}

TEST_F(BusRight, ThatIsNotGrantedOpensNoBus) { EXPECT_EQ(knocks({"confined"}), "0 of 0 knocks"); }

TEST_F(BusRight, ForWhatIsNoNameOfAServiceIsRefused) {
  for (const std::string name :
       {"org", "", "org.fiona.zoo.*", ":1.5", "org..zoo", "org.1zoo", "org.freedesktop.DBus"}) {
    const auto error = load({"confined", "system-bus:" + name});
    ASSERT_TRUE(error) << name;
    EXPECT_EQ(error->text().what, "there is no right 'system-bus:" + name + "' that could be granted");
    EXPECT_THAT(error->text().expected, HasSubstr("system-bus:NAME"));
  }
}

TEST_F(BusRight, ThatTheManifestDoesNotAskForIsRefused) {
  const auto error = load({"confined", "system-bus:org.fiona.zoo.Closed"});
  ASSERT_TRUE(error);
  EXPECT_EQ(error->text().what,
            "local/knocks-on-the-bus cannot be granted the right 'system-bus:org.fiona.zoo.Closed': its manifest does "
            "not ask for it");
}

TEST_F(BusRight, WithoutTheProgramIsRefused) {
  const std::string path = std::getenv("PATH");
  ::setenv("PATH", "/nowhere", 1);
  const auto error = load({"confined", "system-bus:org.fiona.zoo.Open"});
  ::setenv("PATH", path.c_str(), 1);
  ASSERT_TRUE(error);
  EXPECT_EQ(error->text().what,
            "group 'cage' cannot reach the services on D-Bus that it is granted: there is no xdg-dbus-proxy");
  EXPECT_THAT(error->text().next, HasSubstr("apt-get install xdg-dbus-proxy"));
}

TEST_F(BusRight, LeavesNothingBehind) {
  const auto folder = system.directory() / "buses";
  knocks({"confined", "system-bus:org.fiona.zoo.Open"});
  EXPECT_FALSE(std::filesystem::is_empty(folder));
  system.unload("patient");
  system.eventually("its end", [&] { return std::filesystem::is_empty(folder); });
}

class BusProxyTest : public ToABus {
 protected:
  wire::Confinement confinement() const {
    wire::Confinement granted;
    granted.add_system_bus("org.fiona.zoo.Open");
    granted.set_buses(directory.path / "buses");
    return granted;
  }
  std::string ask() const {
    beacon_server::Bus by_proxy("unix:path=" + (directory.path / "buses/system").string());
    return beacon_server::Reader(
               by_proxy.call(beacon_server::call_of("org.fiona.zoo.Open", "/", "org.fiona.Zoo", "Ask")))
        .text();
  }
  /// Another process, or left.
  static void end(BusProxy& proxy) {
    const pid_t before = proxy.process();
    ::kill(before, SIGKILL);
    const auto until = Steady::now() + seconds(20);
    while (proxy.process() == before && proxy.end().empty() && Steady::now() < until) {
      proxy.watch(Steady::now());
      std::this_thread::sleep_for(milliseconds(5));
    }
  }
  const TemporaryDirectory directory;
};

TEST_F(BusProxyTest, ThatEndsIsStartedAgainAtTheSamePlace) {
  BusProxy proxy("cage", confinement());
  proxy.require_ready(Steady::now() + seconds(20));
  EXPECT_EQ(ask(), "open");
  end(proxy);
  EXPECT_EQ(proxy.end(), "");
  proxy.require_ready(Steady::now() + seconds(20));
  EXPECT_EQ(ask(), "open");
}

TEST_F(BusProxyTest, ThatEndsAgainAndAgainIsLeftWithTheReason) {
  BusProxy proxy("cage", confinement());
  for (std::size_t i = 0; i <= Supervision::kRestarts; ++i) end(proxy);
  EXPECT_EQ(proxy.end(), "xdg-dbus-proxy, its way to D-Bus, killed by signal 9 (Killed) again and again");
}

TEST_F(BusProxyTest, AtAPathThatNoSocketCanHaveIsRefused) {
  wire::Confinement far = confinement();
  far.set_buses(directory.path / std::string(200, 'x'));
  try {
    const BusProxy proxy("cage", far);
    FAIL() << "it listens";
  } catch (const Error& error) {
    EXPECT_EQ(error.text().what, "group 'cage' cannot reach the services on D-Bus that it is granted");
    EXPECT_THAT(error.text().found, HasSubstr(std::string(200, 'x')));
    EXPECT_EQ(error.text().next, "give the group or the host a shorter name");
  }
}

/// Once the host's end of its pipe is closed, however the host has ended.
TEST_F(BusProxyTest, EndsWithItsHost) {
  int told[2];
  ASSERT_EQ(::pipe(told), 0);
  const pid_t host = ::fork();
  if (host == 0) {
    BusProxy proxy("cage", confinement());
    proxy.require_ready(Steady::now() + seconds(20));
    const pid_t process = proxy.process();
    static_cast<void>(::write(told[1], &process, sizeof process));
    ::kill(::getpid(), SIGKILL);
  }
  pid_t process = 0;
  ASSERT_EQ(::read(told[0], &process, sizeof process), static_cast<ssize_t>(sizeof process));
  const auto until = Steady::now() + seconds(20);
  const auto runs = [&] {  // reaped or not
    std::string state;
    std::ifstream stat("/proc/" + std::to_string(process) + "/stat");
    std::getline(stat, state);
    return !state.empty() && state.find(") Z ") == std::string::npos;
  };
  while (runs() && Steady::now() < until) std::this_thread::sleep_for(milliseconds(5));
  EXPECT_FALSE(runs());
  ::waitpid(host, nullptr, 0);
}

/// A host with its supervisor: a group of it goes on when the host is killed.
class SupervisedBus : public ToABus {
 protected:
  /// The process of the proxy, and where it listens; 0: there is none.
  static std::pair<pid_t, std::string> proxy_of(const conformance::SupervisedHost& host) {
    for (const pid_t process : host.left()) {
      std::ifstream file("/proc/" + std::to_string(process) + "/cmdline", std::ios::binary);
      std::vector<std::string> words;
      for (std::string word; std::getline(file, word, '\0');) words.push_back(word);
      if (words.size() > 3 && words[0].ends_with(os::kBusProxy)) return {process, words[3]};
    }
    return {};
  }
};

std::int64_t process_of(conformance::TestConsole& console) {
  const auto system = console.snapshot();
  for (const auto& group : system.groups()) {
    if (group.name() == "cage") return group.process();
  }
  return 0;
}

TEST_F(SupervisedBus, IsReachedAgainByAGroupThatTheNextHostAdopts) {
  conformance::SupervisedHost host;
  auto console = host.console();
  auto change = conformance::TestConsole::load_of("source", "cage", "patient");
  change.mutable_load()->set_plugin(std::string(ZOO_DIRECTORY) + "/libknocks-on-the-bus.so");
  for (const char* right : {"confined", "system-bus:org.fiona.zoo.Open"}) change.mutable_load()->add_rights(right);
  console->change(change);
  const auto [before, socket] = proxy_of(host);
  ASSERT_NE(before, 0);
  const auto group = process_of(*console);
  console = host.kill_host();
  EXPECT_EQ(process_of(*console), group) << host.said();
  const auto after = proxy_of(host);
  EXPECT_NE(after.first, before);
  EXPECT_EQ(after.second, socket) << "the group knows no other";
  host.let_go();
  host.wait_for_end();
  EXPECT_EQ(proxy_of(host).first, 0);
}

/// The program of the proxy, where this process and those that it starts find it.
class ProxyInPath {
 public:
  ProxyInPath() {
    put();
    ::setenv("PATH", directory_.path.c_str(), 1);
  }
  ~ProxyInPath() { ::setenv("PATH", before_.c_str(), 1); }
  ProxyInPath(const ProxyInPath&) = delete;
  ProxyInPath& operator=(const ProxyInPath&) = delete;
  void put() const { std::filesystem::create_symlink(program_, directory_.path / os::kBusProxy); }
  void take_away() const { std::filesystem::remove(directory_.path / os::kBusProxy); }

 private:
  const TemporaryDirectory directory_;
  const std::string before_ = std::getenv("PATH");
  const std::filesystem::path program_ = os::program_in_path(os::kBusProxy);
};

TEST_F(SupervisedBus, ThatCannotBeReachedAgainEndsItsGroupAloneWhichIsMadeAgain) {
  const ProxyInPath program;
  conformance::SupervisedHost host;
  auto console = host.console();
  console->load("source", "far", "source");
  auto change = conformance::TestConsole::load_of("source", "cage", "patient");
  for (const char* right : {"confined", "system-bus:org.fiona.zoo.Open"}) change.mutable_load()->add_rights(right);
  change.mutable_load()->set_plugin(std::string(ZOO_DIRECTORY) + "/libknocks-on-the-bus.so");
  console->change(change);
  const pid_t cage = console->process_of("cage"), far = console->process_of("far");
  program.take_away();
  console = host.kill_host();
  EXPECT_EQ(console->snapshot().restarts(), 1U) << host.said();
  EXPECT_EQ(console->process_of("far"), far);
  EXPECT_THAT(host.said(), HasSubstr("group 'cage' was ended: group 'cage' cannot reach the services on D-Bus that it "
                                     "is granted: there is no xdg-dbus-proxy"));
  console->eventually("its process has ended", [&] { return ::kill(cage, 0) != 0; });
  program.put();
  console->eventually("it is made again", [&] {
    const auto system = console->snapshot();
    return std::any_of(system.groups().begin(), system.groups().end(),
                       [](const auto& one) { return one.name() == "cage" && one.process() != 0; });
  });
}

}  // namespace
}  // namespace fiona::host
