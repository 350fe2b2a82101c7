// Hosts that find each other by a registry, which is the etcd of the distribution.
#include "registry.hpp"

#include <signal.h>

#include <filesystem>
#include <memory>
#include <mutex>
#include <string>
#include <thread>
#include <utility>
#include <vector>
#include <zmq.hpp>

#include "fiona/trust/host_keys.hpp"
#include "hosts_fixture.hpp"
#include "os/process.hpp"

namespace fiona::host {
namespace {

constexpr auto kGoneWithin = Registry::kLease + 10s;  // etcd looks for leases that have ended twice a second

/// One of its own, which keeps what it has in `directory`.
class EtcdServer {
 public:
  explicit EtcdServer(const std::filesystem::path& directory) : directory_(directory) {
    for (std::string* url : {&url_, &peers_}) {
      zmq::context_t context;  // whose end waits for its sockets'
      zmq::socket_t free(context, zmq::socket_type::pull);
      free.bind("tcp://127.0.0.1:*");
      *url = "http://" + free.get(zmq::sockopt::last_endpoint).substr(std::string("tcp://").size());
    }
  }
  static bool is_installed() { return std::filesystem::exists(kProgram); }
  void start() {
    process_ = std::make_unique<os::ChildProcess>(
        kProgram,
        std::vector<std::string>{"--data-dir", (directory_ / "etcd").string(), "--listen-client-urls", url_,
                                 "--advertise-client-urls", url_, "--listen-peer-urls", peers_,
                                 "--initial-advertise-peer-urls", peers_, "--initial-cluster", "default=" + peers_,
                                 "--logger", "zap", "--log-outputs", (directory_ / "etcd.log").string()},
        std::vector<std::pair<int, int>>{});
    for (const auto end = Steady::now() + 30s; !answers(); std::this_thread::sleep_for(50ms)) {
      if (Steady::now() > end)
        throw Error(ErrorCode::Failed, "etcd does not answer: " + (directory_ / "etcd.log").string());
    }
  }
  void end() { process_.reset(); }
  pid_t process() const { return process_->id(); }
  const std::string& url() const { return url_; }

 private:
  bool answers() const {
    try {
      Etcd(url_).all("/");
      return true;
    } catch (const Error&) {
      return false;
    }
  }

  static constexpr const char* kProgram = "/usr/bin/etcd";
  const std::filesystem::path directory_;
  std::string url_, peers_;
  std::unique_ptr<os::ChildProcess> process_;
};

class RegistryTest : public Hosts {
 protected:
  void SetUp() override {
    if (!EtcdServer::is_installed()) GTEST_SKIP() << "needs etcd: apt-get install etcd-server";
    etcd.start();
  }
  OtherHost::Choice listening() const { return {.registry = etcd.url()}; }
  /// To be given to a system that leads it and knows nothing of where it is.
  HostOptions led_by_name(const OtherHost& other) {
    HostOptions options = other.led_from(directory.path / "test");
    options.peers[0].address.clear();
    options.registry = etcd.url();
    return options;
  }
  std::unique_ptr<Registry> member(const std::string& name, const trust::Key& key, const std::string& listens = "") {
    return std::make_unique<Registry>(etcd.url(), name, listens, key, [this](const std::string& text) {
      const std::lock_guard lock(mutex);
      said += text + "\n";
    });
  }
  std::string all_said() {
    const std::lock_guard lock(mutex);
    return said;
  }
  template <class Fits>
  void eventually(const std::string& what, Fits fits, Steady::duration within = 20s) {
    for (const auto end = Steady::now() + within; !fits() && Steady::now() < end;) std::this_thread::sleep_for(20ms);
    EXPECT_TRUE(fits()) << what;
  }
  trust::Key key_of(const std::string& name) const {
    const trust::KeyDirectory keys(directory.path / name);
    if (!keys.has_pair()) keys.make();
    return keys.pair().open;
  }

  EtcdServer etcd{directory.path};
  std::mutex mutex;
  std::string said;
};

TEST_F(RegistryTest, AHostIsFoundByItsName) {
  OtherHost other(directory.path, "far", listening());
  RunningSystem system(led_by_name(other));
  system.join("far");
  EXPECT_EQ(system.host("far").address(), "tcp://" + other.address());
  wire_source_to_sink(system);
}

TEST_F(RegistryTest, OneThatListensAtAllAddressesIsFoundAtTheOneTowardsTheRegistry) {
  OtherHost::Choice choice = listening();
  choice.listen = "0.0.0.0:0";
  OtherHost other(directory.path, "far", choice);
  RunningSystem system(led_by_name(other));
  system.join("far");
  EXPECT_THAT(system.host("far").address(), testing::StartsWith("tcp://127.0.0.1:"));
}

TEST_F(RegistryTest, AHostThatComesBackSomewhereElseIsFoundThere) {
  OtherHost::Choice choice = listening();
  OtherHost other(directory.path, "far", choice);
  RunningSystem system(led_by_name(other));
  system.join("far");
  const std::string before = other.address();
  ::kill(other.process(), SIGKILL);
  system.eventually("its end is noticed", [&] { return system.host("far").state() != "joined"; });
  choice.listen = "127.0.0.2:0";
  other.restart(choice);
  system.join("far");
  EXPECT_EQ(system.host("far").address(), "tcp://" + other.address());
  EXPECT_NE(other.address(), before);
}

TEST_F(RegistryTest, AHostThatIsNotThereIsNamedAndFoundOnceItIs) {
  OtherHost other(directory.path, "far");
  RunningSystem system(led_by_name(other));
  system.eventually("told", [&] { return !system.host("far").reason().empty(); });
  EXPECT_EQ(system.host("far").reason(), "the registry knows no host 'far'");
  EXPECT_EQ(error_of([&] { system.load_in("far", "sink", "sink"); }).text().found, "the registry knows no host 'far'");
  other.restart(listening());
  system.join("far");
}

TEST_F(RegistryTest, WhatTheRegistrySaysOfAnotherKeyIsNotBelieved) {
  OtherHost other(directory.path, "far");
  const auto impostor = member("far", key_of("impostor"), "tcp://" + other.address());
  RunningSystem system(led_by_name(other));
  system.eventually("told", [&] { return !system.host("far").reason().empty(); });
  EXPECT_EQ(system.host("far").reason(), "the registry has host 'far' with another key than --peer has");
  EXPECT_NE(system.host("far").state(), "joined");
}

TEST_F(RegistryTest, ASecondHolderOfANameIsRefusedAndToldWhoHasIt) {
  const auto first = member("far", key_of("first"), "tcp://10.0.0.1:7001");
  const Error error = error_of([&] { member("far", key_of("second")); });
  EXPECT_EQ(error.code(), ErrorCode::NotAllowed);
  EXPECT_EQ(error.text().what, "the registry has the name 'far' for another host");
  EXPECT_EQ(error.text().found, "10.0.0.1:7001, with the key " + key_of("first").text());
  EXPECT_THAT(error_of([&] { OtherHost(directory.path, "far", listening()); }).what(),
              HasSubstr("the registry has the name 'far' for another host"));
}

TEST_F(RegistryTest, TheNameOfOneThatHasEndedIsFreeAtOnceAndThatOfOneThatHasDiedWithItsLease) {
  member("far", key_of("first"));
  auto second = std::make_unique<OtherHost>(directory.path, "far", listening());
  EXPECT_EQ(error_of([&] { member("far", key_of("first")); }).code(), ErrorCode::NotAllowed);
  ::kill(second->process(), SIGKILL);
  std::unique_ptr<Registry> third;
  eventually(
      "it is free",
      [&] {
        try {
          if (!third) third = member("far", key_of("first"));
        } catch (const Error&) {
          return false;
        }
        return true;
      },
      kGoneWithin);
}

TEST_F(RegistryTest, AnotherRunOfAHostTakesItsNameAtOnceWithAGreaterIncarnationAndTheOneBeforeSaysSo) {
  const auto before = member("far", key_of("far"), "tcp://10.0.0.1:7001");
  const auto watcher = member("watcher", key_of("watcher"));
  const auto incarnation = watcher->hosts().at("far").incarnation;
  auto after = member("far", key_of("far"), "tcp://10.0.0.1:7002");
  eventually("it is found", [&] { return watcher->hosts().at("far").address == "10.0.0.1:7002"; });
  EXPECT_GT(watcher->hosts().at("far").incarnation, incarnation);
  eventually("told", [&] {
    return all_said() == "another run of this host has taken the name 'far' in the registry: this one is not found\n";
  });
  std::this_thread::sleep_for(3 * Registry::kLookEvery);
  EXPECT_EQ(watcher->hosts().at("far").address, "10.0.0.1:7002") << "they do not take it from each other";
  after.reset();
  eventually("that of before is found again", [&] {
    const auto hosts = watcher->hosts();
    return hosts.contains("far") && hosts.at("far").address == "10.0.0.1:7001";
  });
}

TEST_F(RegistryTest, ARegistryThatIsAwayChangesNothingBetweenHostsAndHasTheNamesAgainOnceItIsBack) {
  OtherHost other(directory.path, "far", listening());
  RunningSystem system(led_by_name(other));
  system.join("far");
  wire_source_to_sink(system);
  etcd.end();
  system.eventually("told", [&] { return other.said().find("does not answer") != std::string::npos; });
  system.let_pass(Registry::kLease + 2s);
  EXPECT_EQ(system.host("far").state(), "joined");
  EXPECT_GT(system.host("far").since_s(), to_seconds(Registry::kLease));
  expect_nothing_lost_silently(system);
  etcd.start();
  system.eventually("told", [&] { return other.said().find("has this host's name again") != std::string::npos; });
  EXPECT_EQ(member("watcher", key_of("watcher"))->hosts().at("far").address, other.address());
}

TEST_F(RegistryTest, ARegistryThatDoesNotAnswerKeepsNoHostFromStarting) {
  ::kill(etcd.process(), SIGSTOP);
  OtherHost other(directory.path, "far", listening());
  EXPECT_THAT(other.said(), HasSubstr("the registry at " + etcd.url() + " does not answer"));
  RunningSystem system(led_by_name(other));
  system.eventually("told", [&] { return !system.host("far").reason().empty(); });
  EXPECT_THAT(system.host("far").reason(), HasSubstr("does not answer"));
  ::kill(etcd.process(), SIGCONT);
  system.join("far");
}

TEST_F(RegistryTest, WhatOthersPutThereIsNoHostAndHurtsNobody) {
  Etcd client(etcd.url());
  const auto lease = client.grant(60s);
  const std::string key = key_of("far").text();
  const std::vector<std::string> values{"no JSON", "[]", R"({"key":7})",
                                        R"({"key":")" + key + R"(","address":"a b:1"})", std::string("\xff\0", 2)};
  for (const std::string& value : values)
    client.put_first("/fiona/hosts/" + std::to_string(value.size()), value, lease);
  const auto watcher = member("watcher", key_of("watcher"), "tcp://10.0.0.1:7001");
  eventually("it is there", [&] { return watcher->hosts().contains("watcher"); });
  EXPECT_EQ(watcher->hosts().size(), 1U);
  EXPECT_EQ(error_of([&] { member("7", key_of("far")); }).text().found, "something that is no host");
}

TEST(RegistryOptions, ThatDoNotGoTogetherAreRefused) {
  const TemporaryDirectory directory;
  trust::KeyDirectory(directory.path).make();
  const std::string key(64, 'a');
  const auto refused = [&](const HostOptions& options) { return error_of([&] { RunningSystem system(options); }); };
  EXPECT_EQ(refused({directory.path, "", {PeerAddress::from_text("far=" + key)}}).text().what,
            "nothing says where host 'far' is");
  EXPECT_EQ(refused({directory.path, "", {}, "", "http://127.0.0.1:1"}).text().what,
            "a registry is for hosts that work with others");
  for (const std::string url : {"127.0.0.1:2379", "https://127.0.0.1:2379", "http://127.0.0.1", "http://:1",
                                "http://me@there:2379", "http://there:70000", "http://there:2379/v3"}) {
    EXPECT_EQ(error_of([&] { Etcd{url}; }).code(), ErrorCode::Usage) << url;
  }
}

}  // namespace
}  // namespace fiona::host
