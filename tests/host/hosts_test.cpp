// Several hosts over tcp: who is let in, who leads, and what a cut, a death and a return do.
#include <arpa/inet.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <poll.h>
#include <signal.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <unistd.h>

#include <fmt/format.h>

#include <array>
#include <atomic>
#include <cstring>
#include <deque>
#include <fstream>
#include <memory>
#include <set>
#include <sstream>
#include <thread>

#include "cable.hpp"
#include "evidence.hpp"
#include "fiona/error.hpp"
#include "fiona/result.hpp"
#include "fiona/trust/host_keys.hpp"
#include "link_message.hpp"
#include "os/unix_socket.hpp"
#include "system_fixture.hpp"
#include "uninterrupted.hpp"

namespace fiona::host {
namespace {

using namespace std::chrono_literals;
using conformance::Cable;
using conformance::OtherHost;
using conformance::RunningSystem;
using conformance::TemporaryDirectory;
using conformance::Transport;
using testing::HasSubstr;
using testing::Not;
using Steady = std::chrono::steady_clock;

template <class F>
Error error_of(F request) {
  try {
    request();
  } catch (const Error& error) {
    return error;
  }
  return Error(ErrorCode::Failed, "no error");
}

double ms_since(Steady::time_point begin) {
  return std::chrono::duration<double, std::milli>(Steady::now() - begin).count();
}

/// Of the host's groups, the first; 0: it has none.
pid_t group_of(pid_t host) {
  const std::string id = std::to_string(host);
  std::ifstream children("/proc/" + id + "/task/" + id + "/children");
  for (pid_t one = 0; children >> one;) {
    if (conformance::content_of("/proc/" + std::to_string(one) + "/cmdline").find("--endpoint") != std::string::npos)
      return one;
  }
  return 0;
}

/// The tcp sockets of a process that listen.
std::size_t listening(pid_t process) {
  std::set<std::string> inodes;
  for (const auto& entry : std::filesystem::directory_iterator("/proc/" + std::to_string(process) + "/fd")) {
    std::error_code ignored;
    const std::string target = std::filesystem::read_symlink(entry.path(), ignored).string();
    if (target.starts_with("socket:[")) inodes.insert(target.substr(8, target.size() - 9));
  }
  std::size_t found = 0;
  for (const std::string table : {"tcp", "tcp6"}) {
    std::ifstream file("/proc/" + std::to_string(process) + "/net/" + table);
    for (std::string line; std::getline(file, line);) {
      std::istringstream words(line);
      std::array<std::string, 10> column;
      for (auto& one : column) words >> one;
      if (column[3] == "0A" && inodes.contains(column[9])) ++found;
    }
  }
  return found;
}

class Hosts : public testing::Test {
 protected:
  /// The source on this host puts every 5 ms; the sink on the other receives each.
  static void wire_source_to_sink(RunningSystem& system) {
    system.load_in("", "source", "source", "neutral period_ms=5");
    system.load_in("far", "sink", "sink");
    system.wire("sink.each", "source.newest");
    system.state("source", "active");
    system.eventually("messages come", [&] { return system.port("sink.each").messages() > 10; });
  }
  /// What was put before this moment has come, or has been counted as lost.
  static void expect_nothing_lost_silently(RunningSystem& system) {
    system.state("source", "neutral");
    const auto put = system.port("source.newest").messages();
    system.eventually("each message is accounted for", [&] {
      const auto sink = system.port("sink.each");
      return sink.messages() + sink.dropped() == put;
    });
  }
  TemporaryDirectory directory;
};

TEST_F(Hosts, NoTcpSocketListensUnlessItIsAskedFor) {
  RunningSystem closed(Transport::Ipc);
  closed.load_client("sink", "sink");
  EXPECT_EQ(listening(::getpid()), 0U);
  const OtherHost open(directory.path, "far");
  EXPECT_EQ(listening(open.process()), 1U) << "so that the count means something";
}

TEST_F(Hosts, TcpWithoutKeysIsRefusedInASentenceThatSaysHow) {
  const Error error = error_of([&] {
    RunningSystem system(HostOptions{directory.path / "none", "tcp://127.0.0.1:0", {}});
  });
  EXPECT_EQ(error.text().what, "tcp needs keys, and this user has none");
  EXPECT_EQ(error.text().next, "fiona keys make");
}

TEST_F(Hosts, HostThatLeadsIsNotLed) {
  OtherHost other(directory.path, "far");
  HostOptions both = other.led_from(directory.path / "test");
  both.listen = "tcp://127.0.0.1:0";
  EXPECT_THAT(error_of([&] { RunningSystem system(both); }).text().what,
              HasSubstr("--peer and --listen do not go together"));
}

TEST_F(Hosts, UnknownKeyIsRefusedCountedAndToldHowToBeLetIn) {
  OtherHost other(directory.path, "far");
  HostOptions stranger = other.led_from(directory.path / "known");
  stranger.keys = directory.path / "stranger";
  const std::string key = trust::KeyDirectory(stranger.keys).make().open.text();
  RunningSystem system(stranger);
  system.eventually("refused", [&] { return system.host("far").state() == "refused"; });
  EXPECT_THAT(system.host("far").reason(), HasSubstr("fiona keys allow NAME " + key));
  system.eventually("told on the other side", [&] {
    return other.said().find("refused a host at 127.0.0.1, 1 times so far") != std::string::npos;
  });
  EXPECT_EQ(error_of([&] { system.load_in("far", "sink", "sink"); }).code(), ErrorCode::Unreachable);
}

TEST_F(Hosts, KeyThatIsAllowedLaterIsLetInWithoutARestart) {
  OtherHost other(directory.path, "far");
  HostOptions stranger = other.led_from(directory.path / "known");
  stranger.keys = directory.path / "stranger";
  const std::string key = trust::KeyDirectory(stranger.keys).make().open.text();
  RunningSystem system(stranger);
  system.eventually("refused", [&] { return system.host("far").state() == "refused"; });
  trust::KeyDirectory(other.keys()).allow("stranger", key);
  system.join("far");
}

TEST_F(Hosts, ForgottenKeyLosesItsSession) {
  OtherHost other(directory.path, "far");
  RunningSystem system(other.led_from(directory.path / "test"));
  system.join("far");
  trust::KeyDirectory(other.keys()).forget("test");
  system.eventually("out", [&] { return system.host("far").state() != "joined"; });
}

TEST_F(Hosts, ReplacedKeyLosesItsSessionThoughItsNameIsAllowed) {
  OtherHost other(directory.path, "far");
  RunningSystem system(other.led_from(directory.path / "test"));
  system.join("far");
  const std::string next = trust::KeyDirectory(directory.path / "next").make().open.text();
  trust::KeyDirectory(other.keys()).forget("test");
  trust::KeyDirectory(other.keys()).allow("test", next);
  system.eventually("out", [&] { return system.host("far").state() != "joined"; });
}

TEST_F(Hosts, HostWithAnotherKeyThanThePeerOptionSaysGetsNothing) {
  OtherHost other(directory.path, "far");
  HostOptions options = other.led_from(directory.path / "test");
  options.peers[0].key = trust::KeyDirectory(directory.path / "impostor").make().open;
  RunningSystem system(options);
  system.eventually("noticed", [&] { return !system.host("far").reason().empty(); });
  EXPECT_NE(system.host("far").state(), "joined");
  EXPECT_THAT(system.host("far").reason(), HasSubstr("its key is not the one that --peer names"));
}

TEST_F(Hosts, SecondLeaderIsRefusedNamesTheFirstAndTakesOverWhenThatHasGone) {
  OtherHost other(directory.path, "far");
  auto first = std::make_unique<RunningSystem>(other.led_from(directory.path / "first"));
  first->join("far");
  first->load_in("far", "sink", "sink");
  RunningSystem second(other.led_from(directory.path / "second"));
  second.eventually("refused", [&] { return second.host("far").state() == "refused"; });
  EXPECT_EQ(second.host("far").reason(), "host 'far' is led by 'first': one host leads at a time");
  first.reset();
  second.eventually(
      "leads", [&] { return second.host("far").state() == "joined"; }, 20s);
  second.load_in("far", "sink", "sink");
  EXPECT_EQ(second.instance("sink").mode(), "active") << "what the first had left is gone";
}

TEST_F(Hosts, LibraryThatIsInNoPackageIsTakenOnlyFromTheDirectoryOfTheOtherHost) {
  OtherHost other(directory.path, "far", {.plugins = false});
  RunningSystem system(other.led_from(directory.path / "test"));
  system.join("far");
  const Error error = error_of([&] { system.load_in("far", "sink", "sink"); });
  EXPECT_EQ(error.text().what,
            "local/test-components is in no package, and host 'far' takes only what is installed on it");
  EXPECT_EQ(error.code(), ErrorCode::NotAllowed);
}

TEST_F(Hosts, UnknownHostIsNamedWithThoseThatThereAre) {
  OtherHost other(directory.path, "far");
  RunningSystem system(other.led_from(directory.path / "test"));
  system.join("far");
  const Error error = error_of([&] { system.load_in("fra/group", "sink", "sink"); });
  EXPECT_EQ(error.text().what, "there is no host 'fra'");
  EXPECT_EQ(error.text().expected, "one of far");
}

TEST_F(Hosts, WiresOfGroupsArePassedOnByTheirHostsInBothDirections) {
  OtherHost other(directory.path, "far");
  RunningSystem system(other.led_from(directory.path / "test"));
  system.join("far");
  system.load_in("near", "source", "here", "neutral period_ms=1 count=200");
  system.load_in("far/deep", "sink", "there");
  system.load_in("far/deep", "answerer", "answerer");
  system.load_in("near", "asker", "asker", "neutral count=50 period_ms=1 payload=1000");
  const auto report = system.watch("there.report");
  const auto outcome = system.watch("asker.outcome");
  system.wire("there.each", "here.newest");
  system.wire("asker.echo", "answerer.echo");
  EXPECT_EQ(system.port("there.each").transport(), "tcp");
  system.state("here", "active");
  EXPECT_EQ(system.wait_for(report, [](const auto& s) { return s.number() == 200; }).value(), 200 * 201 / 2);
  system.state("asker", "active");
  system.wait_for(outcome,
                  [](const auto& s) { return s.value() == static_cast<double>(Outcome::Ok) && s.payload() == "1000"; });
}

TEST_F(Hosts, PushToSeveralGroupsOfAnotherHostCrossesOnceInChunksAndArrivesWhole) {
  constexpr std::size_t kPayload = 1'000'000;
  constexpr int kCount = 20;
  OtherHost other(directory.path, "far");
  RunningSystem system(other.led_from(directory.path / "test"));
  system.join("far");
  system.load_in("near", "source", "source",
                 fmt::format("neutral period_ms=100 count={} payload={}", kCount, kPayload));
  for (const std::string name : {"a", "b"}) system.load_in("far/deep", "sink", name);
  system.load_in("far", "sink", "c");
  const auto report = system.watch("a.report");
  for (const std::string name : {"a", "b", "c"}) system.wire(name + ".each", "source.newest");
  system.state("source", "active");
  EXPECT_EQ(system.wait_for(report, [](const auto& s) { return s.number() > 0; }).payload(), std::to_string(kPayload));
  for (const std::string name : {"a", "b", "c"}) {
    system.eventually("each message is accounted for", [&] {
      const auto sink = system.port(name + ".each");
      return sink.messages() + sink.dropped() == kCount;
    });
  }
  EXPECT_EQ(system.group("main").links().sent_bytes() / (kPayload * kCount), 1U) << "one crossing for the three";
  EXPECT_EQ(system.group("main").links().garbled() + system.group("main").links().not_granted(), 0U);
}

TEST_F(Hosts, EachQuestionHasAnOutcomeWhenMoreIsAskedThanRelaysHold) {
  OtherHost other(directory.path, "far");
  RunningSystem system(other.led_from(directory.path / "test"));
  system.join("far");
  system.load_in("far/deep", "answerer", "answerer");
  system.load_in("near", "asker", "asker", "neutral count=50 period_ms=1 payload=1000000");
  system.wire("asker.echo", "answerer.echo");
  system.state("asker", "active");
  system.eventually("each has ended", [&] { return system.port("asker.outcome").messages() == 50; });
  EXPECT_EQ(system.host("far").state(), "joined");
}

TEST_F(Hosts, GroupThatDiesOnTheOtherHostIsToldAndTheHostStaysJoined) {
  OtherHost other(directory.path, "far");
  RunningSystem system(other.led_from(directory.path / "test"));
  system.join("far");
  system.load_in("far/deep", "sink", "sink");
  system.load_in("", "source", "source", "period_ms=5");
  system.wire("sink.each", "source.newest");
  const pid_t group = group_of(other.process());
  ASSERT_GT(group, 0);
  ::kill(group, SIGKILL);
  system.eventually("told",
                    [&] { return system.instance("sink").reason().find("killed by signal 9") != std::string::npos; });
  EXPECT_EQ(system.instance("sink").mode(), "failed");
  EXPECT_EQ(system.host("far").state(), "joined");
  system.unload("sink");
  system.load_in("far/deep", "sink", "sink");
  system.wire("sink.each", "source.newest");
  system.eventually("flows again", [&] { return system.port("sink.each").messages() > 0; });
}

/// A host that is led, in the test's own process: what it does when is the test's to say.
class HostInTheTest : public Hosts {
 protected:
  HostInTheTest() {
    keys.make();
    os::require_private_directory(directory.path / "far");
    far = std::make_unique<System>(
        System::Options{.name = "far",
                        .store = directory.path / "far" / "store",
                        .directory = directory.path / "far",
                        .threads = 2,
                        .hosts = {keys.path(), "tcp://127.0.0.1:0", {}},
                        .plugins = std::filesystem::path(TEST_COMPONENTS_LIBRARY).parent_path(),
                        .ends_hung_groups = false,
                        .restarts_groups = false,
                        .tries_libraries = false},
        [](const wire::GroupMessage&) {});
    const trust::KeyDirectory own(directory.path / "test");
    own.make();
    keys.allow("test", own.pair().open.text());
    const std::string address = far->listens().substr(std::string("tcp://").size());
    leader = std::make_unique<RunningSystem>(
        HostOptions{own.path(), "", {PeerAddress::from_text("far=" + address + "=" + keys.pair().open.text())}});
    serve_far_while([&] {
      leader->join("far");
      for (const std::string name : {"a", "b", "c"}) leader->load_in("far/deep", "sink", name);
    });
    group = far->child_groups().front()->process();
  }
  void serve_far_while(const std::function<void()>& work) {
    std::atomic<bool> done{false};
    std::thread working([&] {
      work();
      done = true;
    });
    while (!done) {
      far->serve_hosts();
      for (auto* one : far->child_groups()) far->serve_group(*one);
      std::this_thread::sleep_for(1ms);
    }
    working.join();
  }
  /// `also`: what it does beside hearing its leader.
  void expect_it_becomes_empty(const std::function<void()>& also = [] {}) {
    const auto begin = Steady::now();
    while (!far->model().names().empty() && ms_since(begin) < 30'000) {
      far->serve_hosts();
      also();
      std::this_thread::sleep_for(1ms);
    }
    EXPECT_TRUE(far->model().names().empty());
  }
  const trust::KeyDirectory keys{directory.path / "far-keys"};
  std::unique_ptr<System> far;
  std::unique_ptr<RunningSystem> leader;
  pid_t group = 0;
};

TEST_F(HostInTheTest, GroupThatDiesWithItsLeaderHurtsNobodyElse) {
  leader.reset();
  ::kill(group, SIGKILL);
  expect_it_becomes_empty();  // which finds the end of the group by itself
}

TEST_F(HostInTheTest, WhatDoesNotEndWithItsLeaderEndsLater) {
  ::kill(group, SIGSTOP);
  leader.reset();
  const auto begin = Steady::now();
  testing::internal::CaptureStderr();
  std::string said;
  while (said.empty() && ms_since(begin) < 30'000) {
    far->serve_hosts();
    said = testing::internal::GetCapturedStderr();
    testing::internal::CaptureStderr();
  }
  testing::internal::GetCapturedStderr();
  EXPECT_THAT(said, HasSubstr("a: "));
  EXPECT_THAT(said, HasSubstr("group 'deep' does not answer"));
  EXPECT_THAT(said, Not(HasSubstr("b: "))) << "it is not waited for again";
  ::kill(group, SIGCONT);
  expect_it_becomes_empty([&] { far->watch_groups(); });
}

TEST_F(Hosts, GroupOfAnotherHostEndsOnceTheLastInstanceHasLeftItAndStartsAnewWhenItIsNamedAgain) {
  OtherHost other(directory.path, "far");
  RunningSystem system(other.led_from(directory.path / "test"));
  system.join("far");
  const auto group = [&] { return group_of(other.process()); };
  system.load_in("", "source", "source", "period_ms=5");
  system.load_in("far/deep", "sink", "sink");
  const pid_t first = group();
  ASSERT_GT(first, 0);
  system.unload("sink");
  system.eventually("it ends", [&] { return group() == 0; });
  system.load_in("far/deep", "sink", "sink");
  system.wire("sink.each", "source.newest");
  system.eventually("messages come", [&] { return system.port("sink.each").messages() > 10; });
  EXPECT_NE(group(), first);
}

TEST_F(Hosts, DeathOfAHostIsNoticedAndEndsItsWires) {
  OtherHost other(directory.path, "far");
  RunningSystem system(other.led_from(directory.path / "test"));
  system.join("far");
  system.load_in("far", "source", "source", "period_ms=5");
  system.load_in("", "sink", "sink");
  system.wire("sink.each", "source.newest");
  system.eventually("messages come", [&] { return system.port("sink.each").messages() > 10; });
  ::kill(other.process(), SIGKILL);
  const auto begin = Steady::now();
  system.eventually("lost", [&] { return system.port("sink.each").connection() == control::LOST; });
  const double noticed_ms = ms_since(begin);
  RecordProperty("noticed_ms", static_cast<int>(noticed_ms));
  std::cout << "death of a host noticed after " << noticed_ms << " ms\n";
  EXPECT_EQ(system.port("sink.each").reason(), "the connection to host 'far' has ended");
  system.eventually("failed", [&] { return system.instance("source").mode() == "failed"; });
  other.restart();
  system.join("far");
  EXPECT_EQ(system.instance("source").reason(), "host 'far' was started anew");
  system.unload("source");
  system.load_in("far", "source", "source", "period_ms=5");
  system.wire("sink.each", "source.newest");
  system.eventually("flows again", [&] { return system.port("sink.each").connection() == control::CONNECTED; });
}

TEST_F(Hosts, HostThatFallsSilentAndComesBackGoesOnAndWhatWasMissedIsCounted) {
  OtherHost other(directory.path, "far");
  RunningSystem system(other.led_from(directory.path / "test"));
  system.join("far");
  wire_source_to_sink(system);
  ::kill(other.process(), SIGSTOP);
  system.eventually("silent", [&] { return system.host("far").state() == "silent"; });
  EXPECT_EQ(system.port("sink.each").connection(), control::LOST);
  ::kill(other.process(), SIGCONT);
  const auto begin = Steady::now();
  system.eventually("back", [&] { return system.port("sink.each").connection() == control::CONNECTED; });
  std::cout << "back after " << ms_since(begin) << " ms\n";
  expect_nothing_lost_silently(system);
  EXPECT_EQ(system.instance("sink").mode(), "active") << "it went on";
}

/// A machine that is suspended, or a virtual one whose processors are taken away.
TEST_F(Hosts, MachineThatStandsStillTakesNobodyForDeadWhenItGoesOn) {
  OtherHost other(directory.path, "far");
  RunningSystem system(other.led_from(directory.path / "test"));
  system.join("far");
  const pid_t all[] = {::getpid(), other.process()};
  const pid_t stopper = ::fork();
  if (stopper == 0) {
    for (const pid_t one : all) ::kill(one, SIGSTOP);
    ::usleep(2'000'000);
    for (const pid_t one : all) ::usleep(100'000), ::kill(one, SIGCONT);
    ::_exit(0);
  }
  ASSERT_EQ(::waitpid(stopper, nullptr, 0), stopper);
  const auto begun = Steady::now();
  system.eventually("it would have been noticed", [&] { return Steady::now() - begun > 1500ms; });
  EXPECT_EQ(system.host("far").state(), "joined");
  EXPECT_GT(system.host("far").since_s(), 3) << "it was lost meanwhile";
  EXPECT_THAT(other.said(), Not(HasSubstr("silent")));
}

TEST_F(Hosts, WhatIsUnloadedWhileItsHostIsSilentIsGoneWhenThatIsBack) {
  OtherHost other(directory.path, "far");
  RunningSystem system(other.led_from(directory.path / "test"));
  system.join("far");
  wire_source_to_sink(system);
  ::kill(other.process(), SIGSTOP);
  system.eventually("silent", [&] { return system.host("far").state() == "silent"; });
  system.unload("sink");
  ::kill(other.process(), SIGCONT);
  system.join("far");
  system.load_in("far", "sink", "sink");
  EXPECT_EQ(system.instance("sink").mode(), "active") << "the name is free again";
}

/// By hand: it does what it is asked for, and may fall silent, or be held up.
class HostByHand {
 public:
  explicit HostByHand(const std::filesystem::path& directory)
      : keys_(directory / "by-hand"), socket_(context_, zmq::socket_type::router) {
    keys_.make();
    socket_.set(zmq::sockopt::linger, 0);
    socket_.set(zmq::sockopt::curve_server, true);
    socket_.set(zmq::sockopt::curve_secretkey, keys_.pair().secret.bytes());
    socket_.bind("tcp://127.0.0.1:*");
    address_ = socket_.get(zmq::sockopt::last_endpoint);
    thread_ = std::thread([this] { serve(); });
  }
  ~HostByHand() {
    ends_ = true;
    thread_.join();
  }
  HostOptions led_from(const std::filesystem::path& keys) const {
    trust::KeyDirectory(keys).make();
    return {keys, "", {{"far", address_, keys_.pair().open}}};
  }

  /// Events, as from what it has.
  void tell(std::vector<wire::GroupMessage> events) {
    const std::lock_guard lock(mutex_);
    events_ = std::move(events);
  }

  /// What it was asked to set last.
  wire::SetParameters set() {
    const std::lock_guard lock(mutex_);
    return set_;
  }

  std::size_t open_taps() {
    const std::lock_guard lock(mutex_);
    return taps_.size();
  }

  std::atomic<bool> is_silent{false};
  std::atomic<bool> is_busy{false};     ///< it does nothing of what it is asked for until it is not
  std::atomic<bool> is_held_up{false};  ///< until it has been asked for its status, and has not answered

 private:
  void serve() {
    while (!ends_) {
      std::array<zmq::pollitem_t, 1> waits{{{socket_.handle(), 0, ZMQ_POLLIN, 0}}};
      zmq::poll(waits, 50ms);
      for (zmq::message_t identity, record; received(socket_, identity) && received(socket_, record);) {
        if (!is_silent) hear(identity.to_string(), record.to_string());
      }
      for (; !is_busy && !asked_.empty(); asked_.pop_front()) obey(asked_.front());
      wire::HostFrame frame;
      frame.mutable_beat();
      if (!is_silent) say(frame);
      const std::lock_guard lock(mutex_);
      for (const auto& event : std::exchange(events_, {})) {
        *frame.mutable_message() = event;
        say(frame);
      }
    }
  }
  void hear(const std::string& who, std::string_view records) {
    while (records.size() >= kRecordHead) {
      const auto length = [&](std::size_t at) {
        std::uint32_t bytes = 0;
        std::memcpy(&bytes, records.data() + at, sizeof bytes);
        return bytes;
      };
      const std::size_t frame_size = length(0);
      const std::size_t object_size = length(4);
      wire::Frame frame;
      frame.ParseFromArray(records.data() + kRecordHead, static_cast<int>(frame_size));
      wire::HostFrame host = frame.host();
      if (object_size > 0)
        host.ParseFromArray(records.data() + kRecordHead + frame_size, static_cast<int>(object_size));
      records.remove_prefix(kRecordHead + frame_size + object_size);
      if (host.has_hello()) welcome(who);
      if (host.has_request()) asked_.push_back(host.request().request());
    }
  }
  void welcome(const std::string& who) {
    leader_ = who;
    wire::HostFrame frame;
    frame.mutable_welcome()->set_run(1);
    say(frame);
  }
  void obey(const wire::GroupRequest& request) {
    const std::lock_guard lock(mutex_);
    if (request.has_create()) instances_.insert(request.create().instance());
    if (request.has_set_parameters()) set_ = request.set_parameters();
    if (request.has_tap()) taps_.insert(request.tap().tap());
    if (request.has_untap()) taps_.erase(request.untap().tap());
    wire::HostFrame frame;
    auto& reply = *frame.mutable_message();
    reply.set_id(request.id());
    reply.mutable_done();
    if (request.has_status() || request.has_inventory()) {
      if (is_held_up.exchange(false)) return;
      auto& status = request.has_status() ? *reply.mutable_status() : *reply.mutable_adopted()->mutable_status();
      for (const auto& name : instances_) {
        auto& one = *status.add_instances();
        if (set_.instance() == name) *one.mutable_set_parameters() = set_.parameters();
        one.set_name(name);
        one.set_mode("active");
      }
    }
    say(frame);
  }
  void say(const wire::HostFrame& what) {
    wire::Frame frame;
    *frame.mutable_host() = what;
    const Block record = make_record(frame, nullptr, 0);
    sent(socket_, zmq::buffer(leader_), zmq::send_flags::sndmore);
    sent(socket_, zmq::buffer(record.data(), record.size()));
  }

  trust::KeyDirectory keys_;
  zmq::context_t context_;
  zmq::socket_t socket_;
  std::string address_;
  std::string leader_;
  std::deque<wire::GroupRequest> asked_;
  std::set<std::string> instances_;
  wire::SetParameters set_;
  std::set<std::uint64_t> taps_;
  std::mutex mutex_;
  std::vector<wire::GroupMessage> events_;
  std::atomic<bool> ends_{false};
  std::thread thread_;
};

TEST_F(Hosts, InstancesOfAHostThatIsBackAndHeldUpAreThereOnceItSaysSo) {
  HostByHand other(directory.path);
  RunningSystem system(other.led_from(directory.path / "test"));
  system.join("far");
  system.load_in("far", "sink", "sink");
  other.is_silent = true;
  system.eventually("silent", [&] { return system.host("far").state() == "silent"; });
  other.is_held_up = true;
  other.is_silent = false;
  system.eventually("it is asked what it has", [&] { return !other.is_held_up; });
  system.eventually("its instance is back", [&] { return system.instance("sink").mode() == "active"; });
}

TEST_F(Hosts, WhatALeaderHasGivenUpAndWasDoneLaterIsTakenBack) {
  HostByHand other(directory.path);
  RunningSystem system(other.led_from(directory.path / "test"));
  system.join("far");
  system.load_in("far", "source", "source", "period_ms=5");
  other.is_busy = true;
  EXPECT_EQ(error_of([&] { system.set("source", "period_ms=7"); }).code(), ErrorCode::Unreachable);
  other.is_busy = false;
  system.eventually("it is done", [&] { return other.set().parameters_size() > 0; });
  EXPECT_EQ(other.set().parameters(0).value().integer(), 7);
  system.eventually("it is as it was", [&] { return other.set().parameters(0).value().number() == 5; });
}

TEST_F(Hosts, LeaderLooksAfterItsOwnGroupsWhileItWaitsForAHostThatIsBusy) {
  HostByHand other(directory.path);
  RunningSystem system(other.led_from(directory.path / "test"));
  system.join("far");
  system.load_in("far", "source", "source");
  system.load_in("near", "sink", "sink");
  const pid_t near = system.group("near").process();
  other.is_busy = true;
  ::kill(near, SIGKILL);
  EXPECT_EQ(error_of([&] { system.set("source", "period_ms=7"); }).code(), ErrorCode::Unreachable);
  EXPECT_EQ(::kill(near, 0), -1) << "its end has been noted";
}

TEST_F(Hosts, WhatNobodyWaitsForHoldsUpNobodyWhileAHostIsBusy) {
  HostByHand other(directory.path);
  RunningSystem system(other.led_from(directory.path / "test"));
  system.join("far");
  system.load_in("far", "source", "source");
  std::vector<std::uint64_t> taps;
  for (int i = 0; i < 3; ++i) taps.push_back(system.watch("source.newest"));
  other.is_busy = true;
  const auto begin = Steady::now();
  EXPECT_EQ(error_of([&] { system.set("source", "period_ms=7"); }).code(), ErrorCode::Unreachable);
  const double waited_ms = ms_since(begin);
  const auto told = Steady::now();
  for (const auto tap : taps) system.system().untap(tap);
  EXPECT_LT(ms_since(told), waited_ms);
  EXPECT_EQ(other.open_taps(), 3U);
  other.is_busy = false;
  system.eventually("it comes to it", [&] { return other.open_taps() == 0; });
}

/// The way between a leader and a host that it leads, on which answers get lost.
class Way {
 public:
  explicit Way(const std::string& address) : host_(address_of(address.substr(address.find(':') + 1))) {
    listener_ = ::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
    sockaddr_in own = address_of("0");
    socklen_t size = sizeof own;
    if (::bind(listener_, reinterpret_cast<sockaddr*>(&own), size) != 0 || ::listen(listener_, 8) != 0 ||
        ::getsockname(listener_, reinterpret_cast<sockaddr*>(&own), &size) != 0)
      throw Error(ErrorCode::Failed, "no way");
    address_ = "tcp://127.0.0.1:" + std::to_string(ntohs(own.sin_port));
    thread_ = std::thread([this] { serve(); });
  }
  ~Way() {
    ends_ = true;
    thread_.join();
    close_all();
    ::close(listener_);
  }
  const std::string& address() const { return address_; }
  /// What the host says from now on is lost.
  void lose_answers() { loses_answers_ = true; }
  void cut() { state_ = State::Cut; }
  /// What comes from now on goes both ways: by connections that are made anew.
  void mend() { state_ = State::Mended; }

 private:
  enum class State { Whole, Cut, Mended };
  static sockaddr_in address_of(const std::string& port) {
    sockaddr_in address{};
    address.sin_family = AF_INET;
    address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    address.sin_port = htons(static_cast<std::uint16_t>(std::stoi(port)));
    return address;
  }
  void close_all() {
    for (const auto& [leader, host] : ends_of_) ::close(leader), ::close(host);
    ends_of_.clear();
  }
  void accept() {
    const int leader = ::accept4(listener_, nullptr, nullptr, SOCK_CLOEXEC);
    const int host = ::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
    const bool connected = ::connect(host, reinterpret_cast<const sockaddr*>(&host_), sizeof host_) == 0;
    if (connected && state_ != State::Cut) {
      ends_of_.emplace_back(leader, host);
    } else {
      ::close(leader), ::close(host);
    }
  }
  bool pass_on(int from, int to, bool loses) {
    char bytes[65536];
    const ssize_t count = ::recv(from, bytes, sizeof bytes, MSG_DONTWAIT);
    if (count < 0) return errno == EAGAIN;
    return count > 0 && (loses || ::send(to, bytes, static_cast<std::size_t>(count), MSG_NOSIGNAL) == count);
  }
  void serve() {
    while (!ends_) {
      if (state_ != State::Whole) close_all();
      if (State mended = State::Mended; state_.compare_exchange_strong(mended, State::Whole)) loses_answers_ = false;
      std::vector<pollfd> waits{{listener_, POLLIN, 0}};
      for (const auto& [leader, host] : ends_of_) waits.insert(waits.end(), {{leader, POLLIN, 0}, {host, POLLIN, 0}});
      ::poll(waits.data(), waits.size(), 20);
      std::erase_if(ends_of_, [this](const auto& one) {
        const auto& [leader, host] = one;
        const bool goes_on = pass_on(leader, host, false) && pass_on(host, leader, loses_answers_);
        if (!goes_on) ::close(leader), ::close(host);
        return !goes_on;
      });
      if (waits[0].revents != 0) accept();
    }
  }

  const sockaddr_in host_;
  int listener_ = -1;
  std::string address_;
  std::vector<std::pair<int, int>> ends_of_;
  std::atomic<bool> loses_answers_{false};
  std::atomic<State> state_{State::Whole};
  std::atomic<bool> ends_{false};
  std::thread thread_;
};

/// Two sources of one sink, in one group of the other host.
class LostAnswers : public Hosts {
 protected:
  void SetUp() override {
    system.join("far");
    system.load_in("far/deep", "source", "first", "period_ms=5");
    system.load_in("far/deep", "source", "second", "neutral period_ms=5");
    system.load_in("far/deep", "sink", "sink");
    system.wire("sink.each", "first.newest");
  }
  /// It was done there, and nobody is told.
  template <class F>
  void lose_the_answer_to(F request) {
    way.lose_answers();
    EXPECT_EQ(error_of(request).code(), ErrorCode::Unreachable);
    way.mend();
    system.join("far");
  }
  HostOptions by_the_way() {
    HostOptions options = other.led_from(directory.path / "test");
    options.peers[0].address = way.address();
    return options;
  }
  std::string period_of_first() {
    std::string period;
    const auto first = system.instance("first");
    for (const auto& one : first.parameters()) {
      if (one.name() == "period_ms") period = one.value();
    }
    return period;
  }
  void expect_messages() {
    const auto so_far = system.port("sink.each").messages();
    system.eventually("messages come", [&] { return system.port("sink.each").messages() > so_far + 10; });
  }
  OtherHost other{directory.path, "far"};
  Way way{other.address()};
  RunningSystem system{by_the_way(), RunningSystem::RestartsGroups{}};
};

TEST_F(LostAnswers, ParametersAreAsTheyWere) {
  const std::string before = period_of_first();
  lose_the_answer_to([&] { system.set("first", "period_ms=7"); });
  system.eventually("as it was", [&] { return period_of_first() == before; });
  EXPECT_FALSE(before.empty());
}

TEST_F(LostAnswers, ModeIsAsItWas) {
  lose_the_answer_to([&] { system.begin_state("first", "neutral"); });
  system.eventually("as it was", [&] { return system.instance("first").mode() == "active"; });
  system.state("first", "neutral");
  EXPECT_EQ(system.instance("first").mode(), "neutral") << "what is asked for and answered stays";
}

TEST_F(LostAnswers, WhatIsDeactivatedStaysSo) {
  system.state("first", "deactivated");
  control::State noted;
  noted.set_instance("first");
  noted.set_mode("deactivated");
  system.system().note_state(noted);
  lose_the_answer_to([&] { system.set("second", "period_ms=7"); });
  system.let_pass(std::chrono::seconds(3));
  EXPECT_EQ(system.instance("first").mode(), "deactivated");
}

TEST_F(LostAnswers, WhatFailsWhileTheConnectionIsCutIsToldWhenItJoinsAgain) {
  control::WaitMode failed;
  failed.set_instance("first");
  failed.set_mode("failed");
  failed.set_within_ms(60'000);
  const auto told = std::make_shared<conformance::LaterAnswer>();
  system.system().waits().wait_mode(7, 1, failed, [told](control::Reply reply) {
    told->reply = std::move(reply);
    told->ended = true;
  });
  lose_the_answer_to([&] { system.set("first", "fail_with=broken"); });
  system.eventually("it is told", [&] { return told->ended.load(); });
  EXPECT_TRUE(told->reply.has_met()) << told->reply.ShortDebugString();
  EXPECT_NE(system.port("sink.each").connection(), control::CONNECTED);
  EXPECT_THAT(system.port("sink.each").reason(), HasSubstr("has failed"));
}

TEST_F(LostAnswers, WireIsAsItWas) {
  lose_the_answer_to([&] { system.wire("sink.each", "second.newest"); });
  expect_messages();
}

TEST_F(LostAnswers, WireThatWasNoneIsNone) {
  system.unwire("sink.each");
  lose_the_answer_to([&] { system.wire("sink.each", "first.newest"); });
  system.eventually("as it was", [&] { return system.port("sink.each").connection() == control::UNWIRED; });
}

TEST_F(LostAnswers, GroupThatEndsWhileTheConnectionIsCutIsStartedAgain) {
  way.cut();
  system.eventually("cut", [&] { return system.host("far").state() == "silent"; });
  ::kill(group_of(other.process()), SIGKILL);
  system.eventually("it has ended", [&] { return group_of(other.process()) == 0; });
  way.mend();
  system.join("far");
  system.eventually("it is back", [&] { return system.instance("sink").mode() == "active"; });
  expect_messages();
}

/// What it says of what others have.
std::vector<wire::GroupMessage> forged_events() {
  std::vector<wire::GroupMessage> events(8);
  events[0].mutable_mode_changed()->set_instance("source");
  events[0].mutable_mode_changed()->set_mode("failed");
  events[1].mutable_run_ended()->set_instance("source");
  events[2].mutable_logged()->set_instance("source");
  events[3].mutable_asked()->set_instance("source");
  events[4].mutable_tapped()->set_tap(1);
  events[5].mutable_tap_ended()->set_tap(1);
  events[6].mutable_wire_lost()->set_wire(1);
  events[7].mutable_mode_set()->set_change(1);
  events.emplace_back().mutable_call_ended()->set_run(1);
  return events;
}

TEST_F(Hosts, HostThatIsLedIsBelievedOfWhatItHasAndOfNothingElse) {
  HostByHand other(directory.path);
  std::mutex mutex;
  std::vector<wire::GroupMessage> heard;
  os::require_private_directory(directory.path / "leader");
  System leader({.name = "leader",
                 .store = directory.path / "leader" / "store",
                 .directory = directory.path / "leader",
                 .threads = 2,
                 .hosts = other.led_from(directory.path / "test"),
                 .restarts_groups = false,
                 .tries_libraries = false},
                [&](const wire::GroupMessage& event) {
                  const std::lock_guard lock(mutex);
                  heard.push_back(event);
                });
  const auto eventually = [&](const auto& fits) {
    const auto begin = Steady::now();
    while (!fits() && ms_since(begin) < 20'000) {
      leader.serve_hosts();
      std::this_thread::sleep_for(1ms);
    }
    EXPECT_TRUE(fits());
  };
  const auto load = [&](const std::string& component, const std::string& group) {
    control::Change change;
    change.mutable_load()->set_plugin(std::string(TEST_COMPONENTS_LIBRARY) + "/" + component);
    change.mutable_load()->set_instance(component);
    change.mutable_load()->set_group(group);
    change.mutable_load()->set_mode("neutral");
    leader.perform(change);
  };
  eventually([&] { return leader.snapshot().hosts(0).state() == "joined"; });
  load("source", "");
  load("sink", "far");
  control::Watch watch;
  *watch.mutable_port() = conformance::port_name("source.newest");
  leader.tap(leader.new_tap(), watch);
  {
    const std::lock_guard lock(mutex);
    heard.clear();
  }
  testing::internal::CaptureStderr();
  auto events = forged_events();
  events.emplace_back().mutable_logged()->set_instance("sink");
  other.tell(events);
  std::vector<wire::GroupMessage> believed;
  eventually([&] {
    const std::lock_guard lock(mutex);
    for (auto& event : std::exchange(heard, {})) believed.push_back(std::move(event));
    return !believed.empty() && believed.back().logged().instance() == "sink";
  });
  EXPECT_EQ(believed.size(), 1U) << believed.front().ShortDebugString();
  EXPECT_THAT(testing::internal::GetCapturedStderr(),
              HasSubstr("host 'far' has spoken of what it does not have, and was not asked for (mode_changed): "
                        "that is not believed; so far: 1"));
}

TEST_F(Hosts, ForeignBytesOnThePortChangeNothing) {
  OtherHost other(directory.path, "far");
  RunningSystem system(other.led_from(directory.path / "test"));
  system.join("far");
  wire_source_to_sink(system);
  const std::string zmtp_null("\xff\0\0\0\0\0\0\0\1\x7f\3\0NULL", 16);
  for (const std::string& bytes :
       {std::string("GET / HTTP/1.1\r\n\r\n"), std::string(100'000, '\xff'), std::string(5000, '\0'),
        zmtp_null + std::string(48, '\0') + std::string(3000, 'x')}) {
    const int client = ::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
    sockaddr_in address{};
    address.sin_family = AF_INET;
    address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    address.sin_port =
        htons(static_cast<std::uint16_t>(std::stoi(other.address().substr(other.address().find(':') + 1))));
    ASSERT_EQ(::connect(client, reinterpret_cast<sockaddr*>(&address), sizeof address), 0);
    static_cast<void>(::send(client, bytes.data(), bytes.size(), MSG_NOSIGNAL));
    ::close(client);
  }
  const auto so_far = system.port("sink.each").messages();
  system.eventually("messages go on", [&] { return system.port("sink.each").messages() > so_far + 100; });
  EXPECT_EQ(system.host("far").state(), "joined");
  expect_nothing_lost_silently(system);
  EXPECT_EQ(system.port("sink.each").dropped(), 0U);
}

/// A socket that takes connections and closes them: a host that is there and no host of ours.
TEST_F(Hosts, HostsThatCannotJoinTryAgainAtMostSoOften) {
  constexpr int kPeers = 50;
  const int server = ::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0);
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  socklen_t size = sizeof address;
  ASSERT_EQ(::bind(server, reinterpret_cast<sockaddr*>(&address), size), 0);
  ASSERT_EQ(::listen(server, 512), 0);
  ASSERT_EQ(::getsockname(server, reinterpret_cast<sockaddr*>(&address), &size), 0);
  HostOptions options{directory.path / "keys", "", {}};
  const std::string key = trust::KeyDirectory(options.keys).make().open.text();
  for (int i = 0; i < kPeers; ++i) {
    options.peers.push_back(PeerAddress::from_text(
        "p" + std::to_string(i) + "=127.0.0.1:" + std::to_string(ntohs(address.sin_port)) + "=" + key));
  }
  RunningSystem system(options);
  const auto begin = Steady::now();
  int late = 0;
  system.eventually(
      "20 s pass",
      [&] {
        for (int one = 0; (one = ::accept(server, nullptr, nullptr)) >= 0; ::close(one))
          late += ms_since(begin) > 2'000;
        return ms_since(begin) > 20'000;
      },
      30s);
  ::close(server);
  std::cout << late / 18.0 << " attempts a second of " << kPeers << " hosts\n";
  EXPECT_GT(late, 0);
  EXPECT_LE(late / 18.0, 50.0 * kPeers / 200) << "200 hosts together at most 50 a second";
}

// ---- partitions -----------------------------------------------------------------------------------------------

TEST(Peer, IsNamedWithAddressAndKey) {
  const auto peer = PeerAddress::from_text("kitchen=10.0.0.2:7001=" + std::string(64, 'a'));
  EXPECT_EQ(peer.name, "kitchen");
  EXPECT_EQ(peer.address, "tcp://10.0.0.2:7001");
  for (const std::string wrong :
       {"kitchen", "kitchen=10.0.0.2:7001", "=10.0.0.2:7001=", "main=h:1=", "k=h=", "k=h:="}) {
    const std::string text = wrong.ends_with('=') ? wrong + std::string(64, 'a') : wrong;
    EXPECT_EQ(error_of([&] { PeerAddress::from_text(text); }).code(), ErrorCode::Usage) << text;
  }
}

/// How soon is for the campaign, which has the machine for itself.
class Partitions : public Hosts, public testing::WithParamInterface<std::chrono::seconds> {};

TEST_P(Partitions, BothSidesShowTheFaultAndAreBackWithNothingLostSilently) {
  Cable cable;
  if (!cable.missing().empty()) GTEST_SKIP() << cable.missing();
  OtherHost other(directory.path, "far", {.listen = cable.there() + ":0", .network = cable.network()});
  RunningSystem system(other.led_from(directory.path / "test"));
  system.join("far");
  wire_source_to_sink(system);
  cable.pull();
  const auto pulled = Steady::now();
  system.eventually("noticed", [&] { return system.host("far").state() == "silent"; });
  std::cout << "noticed after " << ms_since(pulled) << " ms\n";
  EXPECT_EQ(system.port("sink.each").connection(), control::LOST);
  system.eventually(
      "the outage ends", [&] { return Steady::now() - pulled > GetParam(); }, 20s);
  cable.plug();
  const auto plugged = Steady::now();
  system.eventually("the other side has shown it",
                    [&] { return other.said().find("which leads, has been silent for 1") != std::string::npos; });
  system.eventually("this side as well, and is back", [&] {
    const auto port = system.port("sink.each");
    return port.connection() == control::CONNECTED && port.dropped() > 0;
  });
  std::cout << "an outage of " << GetParam().count() << " s: back after " << ms_since(plugged) << " ms\n";
  expect_nothing_lost_silently(system);
}

INSTANTIATE_TEST_SUITE_P(Of, Partitions, testing::Values(2s, 10s),
                         [](const auto& one) { return std::to_string(one.param.count()) + "Seconds"; });

}  // namespace
}  // namespace fiona::host
