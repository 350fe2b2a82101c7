// The host's own death, and what is left of the system: groups that go on, a host that finds them, a journal.
// FIONA_KILLS says how often a host is killed while it is changed, FIONA_SEED when.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/resource.h>

#include <fmt/format.h>

#include <algorithm>
#include <atomic>
#include <cstdlib>
#include <iostream>
#include <random>
#include <utility>

#include "campaign.hpp"
#include "fiona/error.hpp"
#include "fiona/result.hpp"
#include "supervised_host.hpp"
#include "versioned_plugin.hpp"

namespace fiona::conformance {
namespace {

using namespace std::chrono_literals;
using testing::HasSubstr;
using testing::Not;
using Steady = std::chrono::steady_clock;

control::Change state_of(const std::string& name, const std::string& mode) {
  control::Change change;
  change.mutable_state()->set_instance(name);
  change.mutable_state()->set_mode(mode);
  return change;
}

void wire(TestConsole& console, const std::string& client, const std::string& provider) {
  console.change(TestConsole::wire_of(client, provider));
}

control::PortStatus port(TestConsole& console, const std::string& name) {
  const auto wanted = port_name(name);
  const auto owner = console.instance(wanted.instance());
  for (const auto& one : owner.ports()) {
    if (one.name() == wanted.port()) return one;
  }
  throw std::runtime_error("no port " + name);
}

std::string probe(TestConsole& console, const std::string& instance, const std::string& name) {
  const auto owner = console.instance(instance);
  for (const auto& one : owner.probes()) {
    if (one.name() == name) return one.value();
  }
  return "";
}

/// It puts nothing until it is told to.
void load_neutral(TestConsole& console, const std::string& group, const std::string& parameters) {
  control::Change change = TestConsole::load_of("source", group, "source", parameters);
  change.mutable_load()->set_mode("neutral");
  console.change(std::move(change));
}

/// A source in one group, who listens to it in another.
void load_pair(TestConsole& console, int count) {
  load_neutral(console, "there", fmt::format("period_ms=1 count={}", count));
  console.load("listener", "far", "listener");
  wire(console, "listener.samples", "source.newest");
}

class Supervised : public testing::Test {
 protected:
  SupervisedHost host;
};

TEST_F(Supervised, GroupsGoOnWithTheWiresBetweenThem) {
  constexpr int kCount = 2000;
  auto console = host.console();
  load_pair(*console, kCount);
  const pid_t there = console->process_of("there"), far = console->process_of("far");
  console->change(state_of("source", "active"));
  console->eventually("some have come", [&] { return port(*console, "listener.samples").messages() > 100; });
  console = host.kill_host();
  EXPECT_EQ(console->process_of("there"), there);
  EXPECT_EQ(console->process_of("far"), far);
  console->eventually("all are put", [&] { return port(*console, "source.newest").messages() == kCount; });
  console->eventually("all have come", [&] { return port(*console, "listener.samples").messages() == kCount; });
  EXPECT_EQ(probe(*console, "listener", "samples_heard"), std::to_string(kCount)) << "nothing lost, nothing doubled";
  EXPECT_EQ(probe(*console, "listener", "disorder"), "");
  EXPECT_EQ(port(*console, "listener.samples").dropped(), 0U);
  EXPECT_EQ(port(*console, "listener.samples").connection(), control::CONNECTED);
}

TEST_F(Supervised, AGroupWithOneThatIsDeactivatedGoesOn) {
  auto console = host.console();
  console->load("source", "there", "source");
  console->change(state_of("source", "deactivated"));
  const pid_t there = console->process_of("there");
  console = host.kill_host();
  EXPECT_EQ(console->process_of("there"), there);
  EXPECT_EQ(console->instance("source").mode(), "deactivated");
}

TEST_F(Supervised, WhatIsInMainIsMadeAgainWithItsWiresParametersAndModes) {
  auto console = host.console();
  load_neutral(*console, "main", "period_ms=1 payload=3");
  console->load("listener", "far", "near_main");
  console->load("source", "far", "afar", "period_ms=1");
  console->load("listener", "main", "listener");
  console->set("source", "payload=9");
  wire(*console, "near_main.samples", "source.newest");
  wire(*console, "listener.samples", "afar.newest");
  console->change(state_of("source", "active"));
  const pid_t far = console->process_of("far");
  console = host.kill_host();
  EXPECT_EQ(console->process_of("far"), far);
  EXPECT_EQ(console->instance("source").mode(), "active");
  ASSERT_EQ(console->instance("source").set_parameters_size(), 2) << "period_ms and payload";
  const auto before = port(*console, "near_main.samples").messages();
  console->eventually("both wires deliver", [&] {
    return port(*console, "near_main.samples").messages() > before && port(*console, "listener.samples").messages() > 0;
  });
}

TEST_F(Supervised, WhatHasEndedTheHostIsInAGroupOfItsOwnFromThenOn) {
  auto console = host.console();
  console->load("source", "main", "source", "period_ms=1");
  control::Change bad;
  bad.mutable_load()->set_plugin(std::string(ZOO_DIRECTORY) + "/libreads-nowhere.so");
  bad.mutable_load()->set_instance("bad");
  bad.mutable_load()->set_mode("neutral");
  console->change(std::move(bad));
  const pid_t first = host.host();
  auto act = console->request();
  *act.mutable_transact()->add_changes() = state_of("bad", "active");
  console->send(act);
  console = host.console(first);
  EXPECT_EQ(console->instance("bad").group(), "bad");
  EXPECT_EQ(console->instance("source").group(), "main");
  EXPECT_EQ(console->instance("source").mode(), "active");
  EXPECT_THAT(host.said(),
              HasSubstr("a host before was ended by signal 11 (Segmentation fault) while 'bad' ran: it is in a "
                        "group of its own now, 'bad'"));
  const pid_t second = host.host();
  console = host.kill_host();
  EXPECT_NE(host.host(), second);
  EXPECT_EQ(console->instance("bad").group(), "bad") << "at the one after that, too";
  console->unload("bad");
  console->load("source", "main", "bad");
  console = host.kill_host();
  EXPECT_EQ(console->instance("bad").group(), "main") << "what has that name now has done nothing";
}

TEST_F(Supervised, ChangesGoOnAfterwardsAndUndoKnowsThoseFromBefore) {
  auto console = host.console();
  load_pair(*console, 0);
  console->set("source", "payload=7");
  console = host.kill_host();
  console->set("source", "payload=8");
  EXPECT_EQ(console->undo().warnings_size(), 0);
  console->undo();
  console->undo();
  EXPECT_EQ(port(*console, "listener.samples").connection(), control::UNWIRED);
  wire(*console, "listener.samples", "source.newest");
  console->unload("source");
  EXPECT_THAT(port(*console, "listener.samples").reason(), HasSubstr("there is no instance 'source'"));
}

TEST_F(Supervised, AlternativesServeAsBefore) {
  auto console = host.console();
  console->load("source", "one", "a", "period_ms=1");
  console->load("source", "two", "b", "period_ms=1");
  console->load("sink", "far", "sink");
  auto change = TestConsole::wire_of("sink.each", "a.newest");
  *change.mutable_wire()->add_alternatives() = port_name("b.newest");
  console->change(change);
  console = host.kill_host();
  EXPECT_EQ(port(*console, "sink.each").providers_size(), 2);
  console->eventually("a serves", [&] { return console->peer_of("sink.each") == "a"; });
  ::kill(console->process_of("one"), SIGKILL);
  console->eventually("b serves", [&] { return console->peer_of("sink.each") == "b"; });
  console->eventually("a is started again", [&] { return console->instance("a").restarts() == 1; });
}

/// Its activity, which a change of its mode waits for.
void load_one_that_holds(TestConsole& console) {
  console.load("mover", "moves", "mover", "work_ms=8000");
  console.load("source", "moves", "silent", "period_ms=10000");
  wire(console, "mover.orders", "silent.newest");
  // Both of its tasks have the same period: one that waits falls behind the other.
  std::uint64_t steers = 0, looks = 0;
  console.eventually("it holds it", [&] {
    const std::uint64_t steered = port(console, "mover.steers").messages();
    const std::uint64_t looked = port(console, "mover.looks").messages();
    if (steered != std::exchange(steers, steered)) looks = looked;
    return looked > looks + 5;
  });
}

TEST_F(Supervised, AGroupThatIsNotAsTheJournalSaysIsStartedAnew) {
  auto console = host.console();
  load_pair(*console, 0);
  load_one_that_holds(*console);
  const pid_t there = console->process_of("there"), far = console->process_of("far");
  const auto payload_is = [](TestConsole& at, std::int64_t wanted) {
    const auto source = at.instance("source");
    return std::any_of(source.set_parameters().begin(), source.set_parameters().end(),
                       [&](const auto& one) { return one.name() == "payload" && one.value().integer() == wanted; });
  };
  TestConsole other(host.socket());
  auto half = other.request();
  *half.mutable_transact()->add_changes() = TestConsole::set_of("source", "payload=77");
  *half.mutable_transact()->add_changes() = state_of("mover", "rest");
  other.send(half);
  console->eventually("half of it is done", [&] { return payload_is(*console, 77); });
  console = host.kill_host();
  EXPECT_FALSE(payload_is(*console, 77)) << "what was under way has not happened";
  EXPECT_EQ(console->instance("mover").mode(), "drive");
  EXPECT_NE(console->process_of("there"), there);
  EXPECT_EQ(console->process_of("far"), far);
  EXPECT_THAT(host.said(),
              HasSubstr("group 'there' was ended: after the host's end 'source' has other parameters there"));
  EXPECT_EQ(port(*console, "listener.samples").connection(), control::CONNECTED);
}

TEST_F(Supervised, WhatWasLoadedAndWiredByAChangeThatWasUnderWayIsEndedAndItsGroupGoesOn) {
  auto console = host.console();
  load_pair(*console, 0);
  load_one_that_holds(*console);
  const pid_t far = console->process_of("far");
  TestConsole other(host.socket());
  auto half = other.request();
  *half.mutable_transact()->add_changes() = TestConsole::load_of("sink", "far", "surplus");
  *half.mutable_transact()->add_changes() = TestConsole::wire_of("surplus.each", "source.newest");
  *half.mutable_transact()->add_changes() = state_of("mover", "rest");
  other.send(half);
  console->eventually("half of it is done", [&] {
    const auto system = console->snapshot();
    return std::any_of(system.instances().begin(), system.instances().end(),
                       [](const auto& one) { return one.name() == "surplus"; }) &&
           port(*console, "surplus.each").connection() == control::CONNECTED;
  });
  console = host.kill_host();
  EXPECT_EQ(console->snapshot().restarts(), 1U);
  EXPECT_EQ(console->process_of("far"), far);
  EXPECT_EQ(port(*console, "listener.samples").connection(), control::CONNECTED);
  EXPECT_THROW(console->instance("surplus"), std::runtime_error);
  EXPECT_THAT(host.said(), HasSubstr("is ended in group 'far', where it is not meant to be"));
}

TEST_F(Supervised, AGroupThatEndsWhileThereIsNoHostIsMadeAgainAndItsReasonTold) {
  auto console = host.console();
  load_pair(*console, 0);
  const pid_t before = host.host(), there = console->process_of("there"), far = console->process_of("far");
  ::kill(before, SIGKILL);
  ::kill(there, SIGKILL);
  console = host.console(before);
  EXPECT_NE(console->process_of("there"), there);
  EXPECT_EQ(console->process_of("far"), far);
  console->eventually("the wire is there",
                      [&] { return port(*console, "listener.samples").connection() == control::CONNECTED; });
  EXPECT_THAT(host.said(), HasSubstr("group 'there' killed by signal 9 (Killed)"));
}

TEST_F(Supervised, WhoUsesWhatFailsWhileThereIsNoHostIsToldThen) {
  const VersionedPlugin plugin;
  plugin.build("version=1 fails_after_ms=1500");
  auto console = host.console();
  console->change(plugin.load_in("cage"));
  console->load("witness", "far", "witness");
  wire(*console, "witness.echo", "x.echo");
  console->set("witness", "asks=true");
  const pid_t before = host.host();
  ::kill(host.supervisor(), SIGSTOP);  // so that there is none for a while
  ::kill(before, SIGKILL);
  std::this_thread::sleep_for(std::chrono::seconds(4));
  ::kill(host.supervisor(), SIGCONT);
  console = host.console(before);
  EXPECT_EQ(console->instance("x").mode(), "failed");
  control::Request request = console->request();
  *request.mutable_call()->mutable_target() = port_name("witness.testify");
  const conformance::Told told(console->ask(request).called().result());
  const auto outcomes = told.seen().numbers("outcomes");
  EXPECT_GT(outcomes.at(static_cast<std::size_t>(Outcome::Ok)), 0U);
  EXPECT_GT(outcomes.at(static_cast<std::size_t>(Outcome::Disconnected)), 100U) << "one each 5 ms, for 2 s";
}

TEST_F(Supervised, AHostThatHasEndedTellsHowOftenAndWhy) {
  auto console = host.console();
  EXPECT_TRUE(console->snapshot().supervised());
  EXPECT_EQ(console->snapshot().restarts(), 0U);
  console = host.kill_host(SIGABRT);
  EXPECT_EQ(console->snapshot().restarts(), 1U);
  EXPECT_THAT(console->snapshot().restart_reason(), HasSubstr("killed by signal 6"));
}

TEST_F(Supervised, OneThatEndsAgainAndAgainIsLeftWithTheReason) {
  auto console = host.console();
  load_pair(*console, 0);
  for (int i = 0; i < 3; ++i) console = host.kill_host();
  console.reset();
  ::kill(host.host(), SIGKILL);
  EXPECT_EQ(host.wait_for_end(), "exited with code 9");
  EXPECT_THAT(host.said(),
              HasSubstr("the host has ended: killed by signal 9 (Killed); it is left, after 3 restarts within 30 s"));
  EXPECT_THAT(host.left(), testing::IsEmpty());
}

TEST(SupervisedEnd, OfALifelineEndsAllInOrder) {
  SupervisedHost host;
  auto console = host.console();
  load_pair(*console, 0);
  console.reset();
  host.let_go();
  EXPECT_EQ(host.wait_for_end(), "exited with code 0");
  EXPECT_THAT(host.left(), testing::IsEmpty());
}

TEST(SupervisedEnd, BySigtermIsMeant) {
  SupervisedHost host;
  load_pair(*host.console(), 0);
  ::kill(host.supervisor(), SIGTERM);
  EXPECT_EQ(host.wait_for_end(), "exited with code 130");
  EXPECT_THAT(host.left(), testing::IsEmpty());
}

TEST(SupervisedEnd, ByQuitIsMeantAndHasItsCode) {
  SupervisedHost host;
  auto console = host.console();
  auto quit = console->request();
  quit.mutable_quit()->set_exit_code(3);
  console->send(quit);
  EXPECT_EQ(host.wait_for_end(), "exited with code 3");
  EXPECT_THAT(host.said(), Not(HasSubstr("started again")));
}

TEST(SupervisedEnd, OfTheSupervisorIsNotTheEndOfTheRunAndLeavesNobody) {
  SupervisedHost host;
  load_pair(*host.console(), 0);
  auto console = host.console();
  auto run = console->request();
  run.mutable_run();
  console->send(run);
  console->snapshot();
  ::kill(host.supervisor(), SIGKILL);
  EXPECT_THAT([&] { console->receive(); }, testing::ThrowsMessage<std::runtime_error>("the host has gone"));
  const auto end = Steady::now() + 20s;
  while (!host.left().empty() && Steady::now() < end) std::this_thread::sleep_for(20ms);
  EXPECT_THAT(host.left(), testing::IsEmpty());
}

TEST(SupervisedEnd, OfSupervisorAndHostTogetherLeavesNobody) {
  SupervisedHost host;
  load_pair(*host.console(), 0);
  ::kill(host.supervisor(), SIGSTOP);  // so that it does not see it
  ::kill(host.host(), SIGKILL);
  ::kill(host.supervisor(), SIGKILL);
  const auto end = Steady::now() + 20s;
  while (!host.left().empty() && Steady::now() < end) std::this_thread::sleep_for(20ms);
  EXPECT_THAT(host.left(), testing::IsEmpty());
}

/// As where `fiona run` was killed, and nobody else has the other end of what it had for its standard error.
TEST(SupervisedEnd, OfWhoReadsWhatIsSaidIsNotThatOfTheHost) {
  std::array<int, 2> said{};
  ASSERT_EQ(::pipe2(said.data(), O_CLOEXEC), 0);
  const os::Descriptor write_end(said[1]);
  ::close(said[0]);
  // It says at its start that its journal is elsewhere.
  SupervisedHost host({"--journal", "/proc/nowhere/kept.journal"}, os::program_directory(), write_end.get());
  EXPECT_THAT(host.said_ready(), testing::StartsWith("READY"));
  load_pair(*host.console(), 0);
  ::kill(host.supervisor(), SIGTERM);
  EXPECT_EQ(host.wait_for_end(), "exited with code 130");
}

/// Whether one of the processes has opened the library.
bool has_opened(const std::vector<pid_t>& processes, const std::string& library) {
  return std::any_of(processes.begin(), processes.end(), [&](pid_t one) {
    return content_of("/proc/" + std::to_string(one) + "/maps").find(library) != std::string::npos;
  });
}

/// Its thread that would see the end of its host waits for a constructor which does not come back.
TEST(SupervisedEnd, OfAGroupWhoseThreadIsStuckFollowsThatOfBoth) {
  const std::string library = std::string(ZOO_DIRECTORY) + "/libblocks-in-constructor.so";
  SupervisedHost host;
  auto console = host.console();
  control::Change change;
  change.mutable_load()->set_plugin(library);
  change.mutable_load()->set_instance("patient");
  change.mutable_load()->set_group("cage");
  console->begin(change);
  const auto begun = Steady::now();
  while (!has_opened(host.left(), library) && Steady::now() < begun + 20s) std::this_thread::sleep_for(5ms);
  ASSERT_TRUE(has_opened(host.left(), library));
  ::kill(host.supervisor(), SIGSTOP);
  ::kill(host.host(), SIGKILL);
  ::kill(host.supervisor(), SIGKILL);
  while (!host.left().empty() && Steady::now() < begun + 30s) std::this_thread::sleep_for(20ms);
  EXPECT_THAT(host.left(), testing::IsEmpty());
}

/// A pipe that is full; what is in it is taken when it is asked for.
class FullPipe {
 public:
  FullPipe() {
    if (::pipe2(ends_, O_CLOEXEC | O_NONBLOCK) != 0) throw std::runtime_error("no pipe");
    const std::string lines(4096, '\n');
    while (::write(ends_[1], lines.data(), lines.size()) > 0) continue;
    ::fcntl(ends_[1], F_SETFL, 0);
  }
  ~FullPipe() {
    for (const int end : ends_) ::close(end);
  }
  FullPipe(const FullPipe&) = delete;
  FullPipe& operator=(const FullPipe&) = delete;
  int write_end() const { return ends_[1]; }
  std::string take() const {
    std::string all;
    std::array<char, 4096> chunk{};
    for (ssize_t got = 0; (got = ::read(ends_[0], chunk.data(), chunk.size())) > 0;)
      all.append(chunk.data(), static_cast<std::size_t>(got));
    return all;
  }

 private:
  int ends_[2] = {-1, -1};
};

TEST(SupervisedWords, ThatNobodyReadsKeepNoHostFromBeingStarted) {
  const FullPipe pipe;
  const SupervisedHost host{{}, os::program_directory(), pipe.write_end()};
  auto console = host.console();
  load_pair(*console, 0);
  const pid_t there = console->process_of("there");
  console = host.kill_host();
  EXPECT_EQ(console->process_of("there"), there);
  pipe.take();
  console = host.kill_host();
  const std::string said = pipe.take();
  EXPECT_THAT(said, HasSubstr("(1 lines are missing here: nobody has read them)\nsupervisor: the host has ended"));
  EXPECT_THAT(said, HasSubstr("group 'there' goes on"));
}

TEST(SupervisedStart, ThatFailsIsNotTriedAgain) {
  SupervisedHost host({"--restore"});
  EXPECT_THAT(host.said_ready(), HasSubstr("there is no journal"));
  EXPECT_EQ(host.wait_for_end(), "exited with code 3");
}

/// How many descriptors a process may have, until the end of this.
class FewDescriptors {
 public:
  FewDescriptors(pid_t process, rlim_t most) : process_(process) {
    ::prlimit(process_, RLIMIT_NOFILE, nullptr, &before_);
    const rlimit small{most, before_.rlim_max};
    ::prlimit(process_, RLIMIT_NOFILE, &small, nullptr);
  }
  ~FewDescriptors() { ::prlimit(process_, RLIMIT_NOFILE, &before_, nullptr); }
  FewDescriptors(const FewDescriptors&) = delete;
  FewDescriptors& operator=(const FewDescriptors&) = delete;

 private:
  const pid_t process_;
  rlimit before_{};
};

/// Of a process, so far.
std::chrono::duration<double> processor_time_of(pid_t process) {
  std::ifstream file("/proc/" + std::to_string(process) + "/stat");
  const std::string line{std::istreambuf_iterator<char>(file), {}};
  std::istringstream numbers(line.substr(line.rfind(')') + 2));
  std::vector<std::string> fields{std::istream_iterator<std::string>(numbers), {}};
  return std::chrono::duration<double>((std::stod(fields.at(11)) + std::stod(fields.at(12))) /
                                       static_cast<double>(::sysconf(_SC_CLK_TCK)));
}

class SupervisedWithoutDescriptors : public Supervised {
 protected:
  void SetUp() override {
    if (!os::kLimitsMemory)
      GTEST_SKIP()
          << "a sanitizer asks by a pipe whether memory may be read, and takes it for damaged without a descriptor";
  }
};

TEST_F(SupervisedWithoutDescriptors, AHostThatCannotBeStartedIsTriedAgain) {
  auto console = host.console();
  load_pair(*console, 0);
  const pid_t there = console->process_of("there"), before = host.host();
  {
    const FewDescriptors none(host.supervisor(), 3);
    ::kill(before, SIGKILL);
    console->eventually("it has been tried",
                        [&] { return host.said().find("could not be started") != std::string::npos; });
  }
  console = host.console(before);
  EXPECT_EQ(console->process_of("there"), there);
  EXPECT_THAT(host.said(), HasSubstr("supervisor: the host could not be started: no pipe can be made: Too many open "
                                     "files; it is started again"));
}

/// One that has been left is not started again, and so stays what it is.
TEST_F(SupervisedWithoutDescriptors, AGroupThatHadEndedBeforeTheHostKeepsTheSupervisorFromNothing) {
  auto console = host.console();
  load_pair(*console, 0);
  for (int deaths = 0; console->instance("source").reason().find("; left, after") == std::string::npos; ++deaths) {
    ::kill(console->process_of("there"), SIGKILL);
    console->eventually("it is again, or left", [&] {
      const auto source = console->instance("source");
      return source.restarts() > static_cast<std::uint64_t>(deaths)
                 ? source.mode() == "active" || source.mode() == "neutral"
                 : source.reason().find("; left") != std::string::npos;
    });
  }
  const pid_t before = host.host();
  const auto busy = processor_time_of(host.supervisor());
  const auto begun = Steady::now();
  {
    const auto open = std::filesystem::directory_iterator("/proc/" + std::to_string(host.supervisor()) + "/fd");
    const FewDescriptors no_more(host.supervisor(), static_cast<rlim_t>(std::distance(begin(open), end(open))));
    ::kill(before, SIGKILL);
    console->eventually("it has been tried twice", [&] {
      const std::string said = host.said();
      return said.find("could not be started") != said.rfind("could not be started");
    });
  }
  const std::chrono::duration<double> took = Steady::now() - begun;
  EXPECT_LT((processor_time_of(host.supervisor()) - busy).count(), 0.2 * took.count()) << "in " << took.count() << " s";
  console = host.console(before);
  EXPECT_THAT(host.said(), Not(HasSubstr("group 'there' was ended")));
  console->eventually("it is made again", [&] { return console->instance("source").mode() == "neutral"; });
}

TEST_F(SupervisedWithoutDescriptors, AHostThatCanNeverBeStartedIsLeftWithTheReason) {
  auto console = host.console();
  const FewDescriptors none(host.supervisor(), 3);
  ::kill(host.host(), SIGKILL);
  EXPECT_EQ(host.wait_for_end(), "exited with code 9");
  EXPECT_THAT(host.said(), HasSubstr("Too many open files; it is left, after 3 restarts within 30 s"));
}

TEST(SupervisedHang, OfTheHostIsSeenAndEnded) {
  SupervisedHost host({"--hang-after-ms", "1500"});
  auto console = host.console();
  load_pair(*console, 0);
  const pid_t far = console->process_of("far");
  console = host.kill_host(SIGSTOP);
  EXPECT_THAT(console->snapshot().restart_reason(), HasSubstr("it did not answer for 1.5 s"));
  EXPECT_EQ(console->process_of("far"), far);
}

TEST(SupervisedHang, OfTooManyThreadsOfMainIsNoEndOfTheRun) {
  SupervisedHost host;
  const pid_t before = host.host();
  auto console = host.console();
  auto run = console->request();
  run.mutable_run();
  console->send(run);
  auto other = host.console();
  control::Change load;
  load.mutable_load()->set_plugin(std::string(ZOO_DIRECTORY) + "/liblocks-itself-out.so");
  for (int i = 0; i < 5; ++i) {
    load.mutable_load()->set_instance(fmt::format("lost{}", i));
    other->change(load);
  }
  EXPECT_THROW(console->receive(), std::runtime_error) << "the connection ends, and no answer comes: the run goes on";
  console = host.console(before);
  EXPECT_THAT(console->snapshot().restart_reason(), HasSubstr("its components have kept 5 threads"));
}

/// A version in the group "cage", somebody else beside it, and who hears both.
class SupervisedUpgrade : public Supervised {
 protected:
  SupervisedUpgrade() {
    console->change(plugin.load_in("cage"));
    control::Change beside = plugin.load_in("cage");
    beside.mutable_load()->set_instance("beside");
    console->change(beside);
    console->load("listener", "far", "listener");
    console->load("witness", "far", "witness");
    wire(*console, "listener.samples", "beside.samples");
    wire(*console, "witness.samples", "x.samples");
    wire(*console, "witness.echo", "x.echo");
  }
  void expect_no_gap_beside() {
    EXPECT_EQ(console->process_of("cage"), cage);
    EXPECT_EQ(probe(*console, "listener", "disorder"), "");
    EXPECT_EQ(port(*console, "listener.samples").dropped(), 0U);
  }
  void expect_x_in(const std::string& group) {
    EXPECT_EQ(console->instance("x").group(), group);
    EXPECT_EQ(console->instance("x").mode(), "active") << console->instance("x").reason();
    EXPECT_EQ(console->instance("x").stands_by(), "");
    for (const std::string name : {"witness.samples", "witness.echo"})
      EXPECT_EQ(port(*console, name).connection(), control::CONNECTED) << name;
    const auto before = port(*console, "witness.samples").messages();
    console->eventually("it is heard", [&] { return port(*console, "witness.samples").messages() > before; });
  }

  VersionedPlugin plugin;
  std::unique_ptr<TestConsole> console = host.console();
  pid_t cage = 0;
};

TEST_F(SupervisedUpgrade, ThatIsDoneStaysDoneAndNothingStandsByAnyMore) {
  cage = console->process_of("cage");
  plugin.build("version=2");
  TestConsole other(host.socket());
  other.begin(VersionedPlugin::upgrade_of(60'000));
  console->eventually("the old one stands by", [&] { return console->instance("x").stands_by() == "0"; });
  const pid_t made = console->process_of("x");
  console = host.kill_host();
  EXPECT_EQ(console->process_of("x"), made);
  expect_no_gap_beside();
  expect_x_in("x");
  EXPECT_THAT(host.said(), HasSubstr("'x' 0 is ended in group 'cage', where it is not meant to be"));
}

TEST_F(SupervisedUpgrade, ThatIsUnderWayHasNotHappened) {
  cage = console->process_of("cage");
  plugin.build("version=2 start_ms=5000");
  TestConsole other(host.socket());
  other.begin(VersionedPlugin::upgrade_of());
  console->eventually("the new one is being made", [&] {
    const auto system = console->snapshot();
    return std::any_of(system.groups().begin(), system.groups().end(),
                       [](const auto& one) { return one.name() == "x"; });
  });
  console = host.kill_host();
  expect_no_gap_beside();
  expect_x_in("cage");
  EXPECT_THROW(console->process_of("x"), std::runtime_error);
  plugin.build("version=3");
  console->change(VersionedPlugin::upgrade_of());
  expect_x_in("x");
}

TEST_F(SupervisedUpgrade, IsUndoneByTheNextHostToo) {
  plugin.build("version=2");
  console->change(VersionedPlugin::upgrade_of());
  console = host.kill_host();
  expect_x_in("x");
  plugin.build("version=1");
  console->undo();
  EXPECT_NE(console->instance("x").group(), "x");
}

TEST_F(Supervised, AJournalOfWhichNothingCanBeReadGivesTheOneBeforeIt) {
  auto console = host.console();
  load_pair(*console, 0);
  std::filesystem::copy_file(host.journal(), host.journal().string() + ".old",
                             std::filesystem::copy_options::overwrite_existing);
  std::filesystem::resize_file(host.journal(), 0);
  console = host.kill_host();
  EXPECT_EQ(console->snapshot().instances_size(), 2);
  EXPECT_THAT(host.said(), HasSubstr("none of its 0 bytes can be read: the system is that of kept.journal.old"));
}

TEST_F(Supervised, WhatCannotBeMadeAgainIsToldAndTheRestComesBack) {
  auto console = host.console();
  load_pair(*console, 0);
  const VersionedPlugin plugin;
  console->change(plugin.load_in("cage"));
  console->load("witness", "far", "witness");
  wire(*console, "witness.samples", "x.samples");
  console->change(state_of("x", "neutral"));
  const pid_t far = console->process_of("far");
  std::filesystem::remove(plugin.library());
  std::filesystem::remove(plugin.directory() / "versioned.interface.textproto");
  console = host.kill_host();
  EXPECT_EQ(console->snapshot().instances_size(), 3);
  EXPECT_EQ(console->process_of("far"), far);
  EXPECT_EQ(port(*console, "listener.samples").connection(), control::CONNECTED);
  EXPECT_EQ(port(*console, "witness.samples").connection(), control::WAITING);
  EXPECT_THAT(host.said(), HasSubstr("'x' is not brought back: there is no library '" + plugin.library().string()));
  plugin.build("version=1");
  console->change(plugin.load_in("cage"));
  console->eventually("it is heard", [&] { return port(*console, "witness.samples").messages() > 0; });
}

TEST_F(Supervised, WhatCouldNotBeMadeAgainAndIsNotWantedAnyMoreIsNotTold) {
  auto console = host.console();
  const VersionedPlugin plugin;
  console->change(plugin.load_in("cage"));
  console->unload("x");
  std::filesystem::remove(plugin.library());
  std::filesystem::remove(plugin.directory() / "versioned.interface.textproto");
  console = host.kill_host();
  EXPECT_THAT(host.said(), Not(HasSubstr("not brought back")));
}

TEST_F(Supervised, ARunOnVirtualTimeIsNotBroughtBack) {
  auto console = host.console();
  console->change(TestConsole::set_of("host", "clock=virtual"));
  console.reset();
  ::kill(host.host(), SIGKILL);
  EXPECT_EQ(host.wait_for_end(), "exited with code 1");
  EXPECT_THAT(host.said(), HasSubstr("a run on virtual time is not brought back"));
}

// ---- killed at random moments ---------------------------------------------------------------------------------

int number_from_environment(const char* variable, int otherwise) {
  const char* text = std::getenv(variable);
  return text ? std::atoi(text) : otherwise;
}

/// One change after the other, each of which is answered before the next; what the system is to be is kept beside it.
class Changer {
 public:
  explicit Changer(unsigned seed) : random_(seed) {}

  /// Until the host has gone. What was asked and not answered may have happened or not.
  void go_on(TestConsole& console) {
    try {
      while (true) {
        asked_ = std::uniform_int_distribution<int>(1, 100'000)(random_);
        console.change(TestConsole::set_of("source", fmt::format("payload={}", *asked_)));
        done_ = *std::exchange(asked_, std::nullopt);
        console.change(TestConsole::wire_of("roamer.each", random_() % 2 == 0 ? "source.newest" : "other.newest"));
        if (random_() % 4 == 0) console.load("sink", "busy", fmt::format("more{}", ++more_));
      }
    } catch (const Error& refused) {
      ADD_FAILURE() << refused.what();
    } catch (const std::runtime_error&) {  // the host has gone
    }
  }
  /// Of "source".
  void check(TestConsole& console) {
    int payload = -1;
    const auto status = console.instance("source");
    for (const auto& one : status.set_parameters()) {
      if (one.name() == "payload") payload = static_cast<int>(one.value().integer());
    }
    EXPECT_TRUE(payload == done_ || payload == asked_) << payload << ", done " << done_;
    done_ = payload;
    asked_.reset();
  }

 private:
  std::mt19937 random_;
  int done_ = -1;
  std::optional<int> asked_;
  int more_ = 0;
};

TEST(SupervisedKills, AtRandomMomentsOfChangesGiveWhatWasTrueBeforeOrAfterAndNoWireAGap) {
  const int kills = number_from_environment("FIONA_KILLS", 6);
  const auto seed = static_cast<unsigned>(number_from_environment("FIONA_SEED", 20));
  std::cout << fmt::format("{} kills, FIONA_SEED={}\n", kills, seed);
  std::mt19937 random(seed);
  Changer changer(seed);
  std::vector<double> back_ms;
  std::optional<SupervisedHost> host;
  std::unique_ptr<TestConsole> console;
  for (int i = 0; i < kills; ++i) {
    if (i % 3 == 0) {  // a supervisor starts three times within 30 s
      console.reset();
      host.emplace();
      changer = Changer(seed + static_cast<unsigned>(i));
      console = host->console();
      console->load("source", "there", "other", "period_ms=1");
      console->load("source", "main", "source", "period_ms=1");
      console->load("listener", "far", "listener");
      console->load("sink", "far", "roamer");
      wire(*console, "listener.samples", "other.newest");
    }
    const pid_t before = host->host();
    std::thread killer([&random, before] {
      std::this_thread::sleep_for(std::chrono::microseconds(std::uniform_int_distribution<int>(0, 120'000)(random)));
      ::kill(before, SIGKILL);
    });
    changer.go_on(*console);
    killer.join();
    const auto killed = Steady::now();
    console = host->console(before);
    console->eventually("all wires", [&] {
      return port(*console, "listener.samples").connection() == control::CONNECTED &&
             console->instance("source").mode() == "active";
    });
    back_ms.push_back(std::chrono::duration<double, std::milli>(Steady::now() - killed).count());
    changer.check(*console);
    EXPECT_EQ(probe(*console, "listener", "disorder"), "");
  }
  std::sort(back_ms.begin(), back_ms.end());
  std::cout << fmt::format(
      "back after p50 {:.0f}, longest {:.0f} ms, of which the supervisor waits 100, 400, 1600 ms\n",
      back_ms[back_ms.size() / 2], back_ms.back());
}

/// Twenty instances in three groups, in two chains that go through all of them: the figures that docs/promises.md has.
TEST(SupervisedKills, TwentyInstancesInThreeGroupsAreBackWithAllTheirWires) {
  SupervisedHost host;
  auto console = host.console();
  const std::array<std::string, 3> groups{"a", "b", "c"};
  std::vector<std::string> listeners;
  for (int i = 0; i < 10; ++i) {
    console->load("source", i == 9 ? "main" : groups[i % 3], fmt::format("source{}", i), "period_ms=5");
    listeners.push_back(fmt::format("listener{}", i));
    console->load("listener", i == 8 ? "main" : groups[(i + 1) % 3], listeners.back());
    wire(*console, listeners.back() + ".samples", fmt::format("source{}.newest", i));
  }
  const auto messages = [&](TestConsole& at) {
    std::map<std::string, std::uint64_t> all;
    const auto system = at.snapshot();
    for (const auto& one : system.instances())
      for (const auto& port : one.ports())
        if (port.name() == "samples") all[one.name()] = port.messages();
    return all;
  };
  console->eventually("all deliver", [&] {
    const auto all = messages(*console);
    return std::all_of(all.begin(), all.end(), [](const auto& one) { return one.second > 10; });
  });
  const auto killed = Steady::now();
  console = host.kill_host();
  const double answers_ms = std::chrono::duration<double, std::milli>(Steady::now() - killed).count();
  const auto first = messages(*console);
  console->eventually("all deliver again", [&] {
    const auto all = messages(*console);
    return all.size() == 10 &&
           std::all_of(all.begin(), all.end(), [&](const auto& one) { return one.second > first.at(one.first); });
  });
  const double all_ms = std::chrono::duration<double, std::milli>(Steady::now() - killed).count();
  // Of the wires between groups: source9 and listener8 are in main.
  double latency_ms = 0;
  for (int i = 0; i < 8; ++i) {
    EXPECT_EQ(probe(*console, listeners[i], "disorder"), "") << listeners[i];
    const auto samples = port(*console, listeners[i] + ".samples");
    EXPECT_EQ(samples.dropped(), 0U) << listeners[i];
    latency_ms = std::max(latency_ms, samples.latency_p99_ms());
  }
  std::cout << fmt::format(
      "killed: the next host answers after {:.0f} ms, all wires deliver after {:.0f} ms; latency between "
      "groups meanwhile, p99: {:.1f} ms\n",
      answers_ms, all_ms, latency_ms);
}

}  // namespace
}  // namespace fiona::conformance
