#include <cstdlib>
#include <fstream>
#include <mutex>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "fiona/options.pb.h"
#include "fiona/probe.pb.h"
#include "fiona/sensors.pb.h"
#include "saved_system.hpp"
#include "script.hpp"
#include "scripted_host.hpp"
#include "watch_list.hpp"
#include "white_spots.hpp"

namespace fiona::console {
namespace {

using namespace std::chrono_literals;
using testing::HasSubstr;

control::Reply done(const std::string& note = "") {
  control::Reply reply;
  reply.mutable_done()->set_note(note);
  return reply;
}

control::Reply failure(ErrorCode code, const std::string& what, const std::string& where = "") {
  control::Reply reply;
  reply.mutable_failure()->set_code(static_cast<std::uint32_t>(code));
  reply.mutable_failure()->set_what(what);
  reply.mutable_failure()->set_where(where);
  return reply;
}

/// walk provides `imu`; nav requires it, and is not wired.
control::System small_system() {
  control::System system;
  system.set_host("main");
  system.set_clock("virtual");
  auto* walk = system.add_instances();
  walk->set_name("walk");
  walk->set_plugin("fiona/trace-player");
  walk->set_component("trace-player");
  walk->set_group("main");
  walk->set_mode("active");
  auto* trace = walk->add_set_parameters();
  trace->set_name("trace");
  trace->mutable_value()->set_text("a b");
  auto* imu = walk->add_ports();
  imu->set_name("imu");
  imu->set_direction(fiona::PROVIDES);
  imu->set_service("fiona.sensors.GetIMUService");
  imu->set_rate_hz(50);
  auto* nav = system.add_instances();
  nav->set_name("nav");
  nav->set_plugin("fiona/tools");
  nav->set_component("step-heading");
  nav->set_group("fast");
  nav->set_mode("neutral");
  auto* need = nav->add_ports();
  need->set_name("imu");
  need->set_direction(fiona::REQUIRES);
  need->set_service("fiona.sensors.GetIMUService");
  return system;
}

control::System wired_system() {
  control::System system = small_system();
  auto* need = system.mutable_instances(1)->mutable_ports(0);
  need->set_connection(control::CONNECTED);
  need->mutable_peer()->set_instance("walk");
  need->mutable_peer()->set_port("imu");
  need->set_prescale(5);
  return system;
}

/// A console whose host answers by `script`, and what it said.
class ConsoleTest : public ::testing::Test {
 private:
  // The host's thread uses these, so they outlive it.
  std::mutex mutex_;
  std::vector<control::Request> seen_;

 protected:
  // No marketplace but those that a test makes.
  void SetUp() override { ::setenv("FIONA_MARKET", "/nonexistent", 1); }

  std::vector<control::Request> requests() {
    const std::lock_guard lock(mutex_);
    return seen_;
  }

  std::vector<control::Reply> answer(const control::Request& request) {
    // By which a watch knows that it has not been refused.
    if (request.has_unwatch() && request.unwatch().watch() == 0) return {done()};
    const std::lock_guard lock(mutex_);
    seen_.push_back(request);
    return script ? script(request) : std::vector<control::Reply>{done()};
  }

  std::string error_of(const std::string& line) {
    try {
      session().run(split_line(line));
    } catch (const Error& error) {
      code = error.code();
      return error.what();
    }
    return "no error";
  }

  Session& session() {
    if (!session_) {
      Options options;
      options.at = "unix:" + host.socket().string();
      options.timeout = 10s;  // a loaded machine is slow; what must time out says so itself
      options.store = directory.path / "store";
      session_ = std::make_unique<Session>(reactor, output, options);
    }
    return *session_;
  }

  std::filesystem::path file(const std::string& name, const std::string& text) {
    std::ofstream(directory.path / name) << text;
    return directory.path / name;
  }

  ScriptedHost::Script script;
  TemporaryDirectory directory;
  ScriptedHost host{[this](const control::Request& request) { return answer(request); }};
  Reactor reactor;
  std::string out;
  std::string err;
  Output output{[this](Stream stream, std::string_view lines) { (stream == Stream::Out ? out : err) += lines; }};
  ErrorCode code{};

 private:
  std::unique_ptr<Session> session_;
};

std::vector<control::Reply> system_reply(const control::System& system) {
  control::Reply reply;
  *reply.mutable_system() = system;
  return {reply};
}

TEST_F(ConsoleTest, ALoadLineIsALoadRequest) {
  session().run(split_line("load trace-player as walk in fast at neutral trace=\"a b\" rate=5Hz"));
  ASSERT_EQ(requests().size(), 1U);
  const control::Load load = requests()[0].transact().changes(0).load();
  EXPECT_EQ(load.plugin(), "trace-player");
  EXPECT_EQ(load.instance(), "walk");
  EXPECT_EQ(load.group(), "fast");
  EXPECT_EQ(load.mode(), "neutral");
  EXPECT_EQ(load.parameters(1).value().unit(), "Hz");
  EXPECT_EQ(requests()[0].author(), "console");
  EXPECT_EQ(out, "loaded walk\n");
}

TEST_F(ConsoleTest, AWireLineIsAWireRequest) {
  session().run(split_line("wire nav.imu to walk.imu every 5"));
  const control::Wire wire = requests()[0].transact().changes(0).wire();
  EXPECT_EQ(wire.client().instance(), "nav");
  EXPECT_EQ(wire.provider().port(), "imu");
  EXPECT_EQ(wire.prescale(), 5U);
}

TEST_F(ConsoleTest, LinesBetweenBeginAndCommitAreOneTransaction) {
  run_script(session(),
             read_script(file("a.fiona", "begin\nload a\nwire b.x to a.x\nset a rate=5\nstate a neutral\ncommit\n")));
  ASSERT_EQ(requests().size(), 1U);
  ASSERT_EQ(requests()[0].transact().changes_size(), 4);
  EXPECT_TRUE(requests()[0].transact().changes(1).has_wire());
  EXPECT_FALSE(requests()[0].transact().whole());
}

TEST_F(ConsoleTest, ARefusedChangeOfATransactionIsToldAtItsLine) {
  script = [](const control::Request&) {
    auto refused = failure(ErrorCode::NotFound, "there is no instance 'b'");
    refused.mutable_failure()->set_change(2);
    return std::vector{refused};
  };
  const auto path = file("a.fiona", "begin\nload a\nwire b.x to a.x\ncommit\n");
  try {
    run_script(session(), read_script(path));
    FAIL() << "it ran to the end";
  } catch (const LineError& error) {
    EXPECT_EQ(error.text().where, path.string() + ":3:1");
    EXPECT_EQ(error.text().what, "there is no instance 'b'");
  }
  EXPECT_FALSE(session().batch);
}

TEST_F(ConsoleTest, AFileThatEndsWithinATransactionChangesNothing) {
  const auto path = file("a.fiona", "begin\nload a\n");
  try {
    run_script(session(), read_script(path));
    FAIL() << "it ran to the end";
  } catch (const LineError& error) {
    EXPECT_EQ(error.text().what, "this transaction is not committed: nothing of it was done");
    EXPECT_EQ(error.text().where, path.string() + ":1:1");
  }
  EXPECT_TRUE(requests().empty());
  EXPECT_FALSE(session().batch);
}

TEST_F(ConsoleTest, WhatWaitsCannotStandInATransaction) {
  try {
    run_script(session(), read_script(file("a.fiona", "begin\nsleep 1s\ncommit\n")));
    FAIL() << "it ran to the end";
  } catch (const LineError& error) {
    EXPECT_EQ(error.text().what, "'sleep' cannot stand in a transaction");
  }
  EXPECT_TRUE(requests().empty());
}

TEST_F(ConsoleTest, PlanAsksForTheStepsAndChangesNothing) {
  script = [](const control::Request&) {
    control::Reply reply;
    control::Change& step = *reply.mutable_planned()->add_steps();
    step.mutable_unload()->set_instance("walk");
    control::Load& back = *reply.mutable_planned()->add_reverse()->mutable_load();
    back.set_plugin("fiona/trace-player");
    back.set_instance("walk");
    reply.mutable_planned()->add_warnings("what 'walk' knows is lost");
    return std::vector{reply};
  };
  session().run(split_line("plan unload walk"));
  EXPECT_TRUE(requests()[0].transact().dry_run());
  EXPECT_EQ(out, "unload walk\ntaken back by\n  load fiona/trace-player as walk\nwhat 'walk' knows is lost\n");
}

TEST_F(ConsoleTest, ApplySendsTheWholeSystemAndPassesOverWhatOnlyLooks) {
  const auto path = file("a.fiona", "load a\nspots\nls\nwire b.x to a.x\n");
  session().run(split_line("apply " + path.string()));
  ASSERT_EQ(requests().size(), 1U);
  EXPECT_TRUE(requests()[0].transact().whole());
  EXPECT_EQ(requests()[0].transact().changes_size(), 2);
}

TEST_F(ConsoleTest, ApplyRefusesAFileThatDoesMoreThanCompose) {
  const auto path = file("a.fiona", "load a\nexpect a.x.y > 3\n");
  try {
    session().run(split_line("apply " + path.string()));
    FAIL() << "it was applied";
  } catch (const LineError& error) {
    EXPECT_EQ(error.text().what, "'expect' tells nothing of what a system consists of");
    EXPECT_EQ(error.text().where, path.string() + ":2:1");
  }
  EXPECT_TRUE(requests().empty());
}

TEST_F(ConsoleTest, TheHostsOwnNoteIsTold) {
  script = [](const auto&) { return std::vector{done("switched 1 wire, gap 3 ms, lost 0")}; };
  session().run(split_line("wire nav.imu to walk.imu"));
  EXPECT_EQ(out, "switched 1 wire, gap 3 ms, lost 0\n");
}

TEST_F(ConsoleTest, ARefusalKeepsItsCodeAndItsWords) {
  script = [](const auto&) { return std::vector{failure(ErrorCode::WiringInvalid, "they do not fit", "nav.imu")}; };
  EXPECT_EQ(error_of("wire nav.imu to walk.imu"), "nav.imu: they do not fit");
  EXPECT_EQ(code, ErrorCode::WiringInvalid);
}

TEST_F(ConsoleTest, ARefusalCannotForgeLinesOrActOnTheTerminal) {
  script = [](const auto&) { return std::vector{failure(ErrorCode::Failed, "x\nerror: \x1b[2J")}; };
  EXPECT_EQ(error_of("unload a"), "x\n    error: \\u{1b}[2J");
}

TEST_F(ConsoleTest, ARefusalThatQuotesAnotherErrorKeepsItsLines) {
  script = [](const auto&) {
    auto reply =
        failure(ErrorCode::Failed, "'b' cannot be made: the map is garbled\n  expected: a map\n\n  found: b\n", "b");
    reply.mutable_failure()->set_next("copy it again\n  or learn it");
    return std::vector{reply};
  };
  EXPECT_EQ(error_of("unload a"),
            "b: 'b' cannot be made: the map is garbled\n    expected: a map\n    found: b\n"
            "  next: copy it again\n    or learn it");
}

TEST_F(ConsoleTest, ASilentHostIsUnreachableAfterTheTimeout) {
  script = [](const auto&) { return std::vector<control::Reply>{}; };
  EXPECT_NE(error_of("ls --timeout 100ms").find("the host does not answer in time"), std::string::npos);
  EXPECT_EQ(code, ErrorCode::Unreachable);
}

TEST_F(ConsoleTest, AChangeThatASilentHostWasAskedForMayStillBeMade) {
  script = [](const auto&) { return std::vector<control::Reply>{}; };
  EXPECT_THAT(error_of("unload a --timeout 100ms"),
              AllOf(HasSubstr("the change may still be made"), HasSubstr("journal")));
  EXPECT_EQ(code, ErrorCode::Unreachable);
}

TEST_F(ConsoleTest, AHostThatHangsUpIsUnreachableAtOnce) {
  script = [](const auto&) { return std::vector<control::Reply>{}; };
  host.hang_up = true;
  EXPECT_NE(error_of("unload a").find("the host has gone"), std::string::npos);
}

TEST_F(ConsoleTest, AHostThatAnnouncesTooMuchIsNotBelieved) {
  host.raw_first = std::string("\xff\xff\xff\x7f", 4);
  EXPECT_EQ(error_of("unload a"),
            "the host's answer is too large\n  expected: at most 16 MiB\n  found: 2147483647 bytes");
}

TEST_F(ConsoleTest, BytesThatAreNoReplyAreRefused) {
  host.raw_first = framed("\xff\xff\xff");
  EXPECT_NE(error_of("unload a").find("the host's answer cannot be read"), std::string::npos);
}

TEST_F(ConsoleTest, AnAnswerToAnotherRequestIsLeftAlone) {
  script = [](const control::Request& request) {
    control::Reply other = failure(ErrorCode::Failed, "of somebody else");
    other.set_id(request.id() + 1000);
    return std::vector{other, done("mine")};
  };
  session().run(split_line("unload a"));
  EXPECT_EQ(out, "mine\n");
}

TEST_F(ConsoleTest, LsShowsOneLineAnInstance) {
  script = [](const auto&) { return system_reply(wired_system()); };
  session().run(split_line("ls"));
  EXPECT_EQ(out,
            "instance  plugin        mode     health  wires  rate   group\n"
            "walk      trace-player  active   ok      -      50 Hz  main\n"
            "nav       tools         neutral  ok      1/1    -      fast\n");
}

TEST_F(ConsoleTest, LsForProgramsHasNumbers) {
  script = [](const auto&) { return system_reply(small_system()); };
  session().run(split_line("ls --json"));
  EXPECT_TRUE(
      out.starts_with("{\"fiona\":1,\"group\":\"main\",\"health\":\"ok\",\"instance\":\"walk\",\"mode\":\"active\","
                      "\"plugin\":\"trace-player\",\"rate\":50.0,\"wires\":\"-\"}\n"))
      << out;
  EXPECT_FALSE(output.manner.json) << "--json is of one line";
}

TEST_F(ConsoleTest, GetNamesTheNearestParameter) {
  script = [](const auto&) {
    control::System system = small_system();
    system.mutable_instances(0)->add_parameters()->set_name("trace");
    return system_reply(system);
  };
  EXPECT_EQ(error_of("get walk trac"),
            "column 10: walk has no parameter 'trac'\n  did you mean: trace\n  next: get walk");
  EXPECT_EQ(error_of("get wlak"), "column 5: there is no instance 'wlak'\n  did you mean: walk\n  next: ls");
  EXPECT_EQ(code, ErrorCode::NotFound);
}

TEST_F(ConsoleTest, SpotsSayWhoCouldAndWhatToType) {
  script = [](const auto&) { return system_reply(small_system()); };
  session().run(split_line("spots"));
  EXPECT_EQ(out,
            "required, nobody serves it\n"
            "port     service        state    who could          type\n"
            "nav.imu  GetIMUService  unwired  running: walk.imu  wire nav.imu to walk.imu\n"
            "provided, nobody uses it\n"
            "port      service        state   who could         type\n"
            "walk.imu  GetIMUService  unused  running: nav.imu  wire nav.imu to walk.imu\n");
}

TEST_F(ConsoleTest, ExpectIsSentWithFieldComparisonAndValue) {
  script = [](const auto&) {
    control::Reply reply;
    reply.mutable_met()->set_seen("x is 2");
    reply.mutable_met()->set_after_ms(40);
    return std::vector{reply};
  };
  session().run(split_line("expect nav.location.position.x >= 1.5m for 2s"));
  const control::Expect expect = requests()[0].expect();
  EXPECT_EQ(expect.port().port(), "location");
  EXPECT_EQ(expect.field(), "position.x");
  EXPECT_EQ(expect.comparison(), control::GREATER_OR_EQUAL);
  EXPECT_DOUBLE_EQ(expect.value().number(), 1.5);
  EXPECT_DOUBLE_EQ(expect.within_ms(), 2000);
  EXPECT_EQ(out, "x is 2 after 40 ms\n");
}

TEST_F(ConsoleTest, OneEqualsSignIsExplained) {
  EXPECT_NE(error_of("expect a.b.c = 5").find("next: equality is =="), std::string::npos);
}

TEST_F(ConsoleTest, QuitTakesAnExitCodeUpTo255) {
  EXPECT_NE(error_of("quit 256").find("expected: 0 .. 255"), std::string::npos);
  session().run(split_line("quit 3"));
  EXPECT_EQ(requests().back().quit().exit_code(), 3);
  EXPECT_EQ(session().finished, 3);
}

control::Reply imu_sample(std::uint64_t sequence, bool with_files) {
  sensors::GetIMU object;
  control::Reply reply;
  reply.mutable_sample()->set_type(object.GetDescriptor()->full_name());
  reply.mutable_sample()->set_object(object.SerializeAsString());
  reply.mutable_sample()->set_sequence(sequence);
  reply.mutable_sample()->set_time_s(1.5);
  if (with_files) object.GetDescriptor()->file()->CopyTo(reply.mutable_sample()->mutable_files()->add_file());
  return reply;
}

TEST_F(ConsoleTest, WatchPrintsAnyTypeByItsDescriptorsUntilTheHostEndsIt) {
  script = [](const control::Request&) {
    control::Reply end = failure(ErrorCode::NotFound, "walk was unloaded");
    return std::vector{imu_sample(1, true), imu_sample(2, false), end};
  };
  EXPECT_EQ(error_of("watch walk.imu every 20ms"), "walk was unloaded");
  EXPECT_DOUBLE_EQ(requests()[0].watch().min_period_ms(), 20);
  EXPECT_TRUE(out.starts_with("walk.imu  1.500 s  ")) << out;
}

control::Reply probe_sample(double value, std::uint64_t skipped) {
  fiona::probe::Number object;
  object.set_value(value);
  control::Reply reply;
  reply.mutable_sample()->set_type(object.GetDescriptor()->full_name());
  reply.mutable_sample()->set_object(object.SerializeAsString());
  reply.mutable_sample()->set_unit("m");
  reply.mutable_sample()->set_skipped(skipped);
  reply.mutable_sample()->set_time_s(1.5);
  return reply;
}

TEST_F(ConsoleTest, WatchPrintsAProbeWithItsUnitAndWhatWasLost) {
  script = [](const control::Request&) {
    control::Reply none;
    none.mutable_sample()->set_time_s(1);
    return std::vector{none, probe_sample(2.5, 0), probe_sample(3.5, 4),
                       failure(ErrorCode::NotFound, "'nav' was unloaded")};
  };
  EXPECT_EQ(error_of("watch nav.spread when above 2"), "column 7: 'nav' was unloaded");
  EXPECT_EQ(
      out,
      "nav.spread  1.000 s  no value yet\nnav.spread  1.500 s  2.5 m\nnav.spread  1.500 s  3.5 m, 4 lost before it\n");
}

TEST_F(ConsoleTest, AWatchGoesOnWhenWhatItLooksAtIsBackAndEndsOnceItIsUnloaded) {
  int asked = 0;
  script = [&asked](const control::Request&) {
    switch (++asked) {
      case 1: return std::vector{probe_sample(2.5, 0), failure(ErrorCode::Unreachable, "group 'left' ended")};
      case 2: return std::vector{failure(ErrorCode::Unreachable, "'nav' is lost: it is started again")};
      default: return std::vector{probe_sample(3.5, 0), failure(ErrorCode::NotFound, "'nav' was unloaded")};
    }
  };
  EXPECT_EQ(error_of("watch nav.spread"), "column 7: 'nav' was unloaded");
  EXPECT_EQ(out, "nav.spread  1.500 s  2.5 m\nnav.spread  1.500 s  3.5 m\n");
  EXPECT_EQ(requests().size(), 3u);
}

TEST_F(ConsoleTest, ExpectTakesAProbe) {
  script = [](const control::Request&) {
    control::Reply reply;
    reply.mutable_met()->set_seen("2");
    return std::vector{reply};
  };
  session().run(split_line("expect nav.spread < 3m"));
  EXPECT_EQ(requests()[0].expect().port().port(), "spread");
  EXPECT_EQ(requests()[0].expect().field(), "");
}

TEST_F(ConsoleTest, WatchForATimeEndsByItself) {
  script = [](const control::Request&) { return std::vector<control::Reply>{}; };
  session().run(split_line("watch walk.imu for 10ms"));
  EXPECT_TRUE(session().watches().empty());
}

TEST_F(ConsoleTest, WatchingAFieldThatIsNotThereNamesThoseThatAre) {
  script = [](const control::Request& request) {
    return request.has_watch() ? std::vector{imu_sample(1, true)} : std::vector{done()};
  };
  EXPECT_NE(
      error_of("watch walk.imu nonsense for 5s").find("walk.imu: there is no field 'nonsense' in GetIMU\n  expected: "),
      std::string::npos);
  EXPECT_EQ(code, ErrorCode::NotFound);
}

TEST_F(ConsoleTest, AWatchInAScriptGoesOnBesideTheLines) {
  script = [](const control::Request& request) {
    return request.has_watch() ? std::vector{imu_sample(1, true)} : std::vector{done()};
  };
  run_script(session(), read_script(file("a.fiona", "watch walk.imu\nunload a\n")));
  EXPECT_EQ(session().watches().ports(), std::vector<std::string>{"walk.imu"});
  EXPECT_NE(out.find("walk.imu  1.500 s"), std::string::npos);
  EXPECT_NE(out.find("unloaded a"), std::string::npos);
}

TEST_F(ConsoleTest, AScriptStopsAtTheFirstLineThatFailsAndSaysWhere) {
  script = [](const control::Request& request) {
    return std::vector{request.transact().changes(0).has_unload()
                           ? failure(ErrorCode::NotFound, "there is no instance 'bb'")
                           : done()};
  };
  const auto path = file("a.fiona", "load x\n  unload bb\nload y\n");
  try {
    run_script(session(), read_script(path));
    FAIL() << "it ran to the end";
  } catch (const LineError& error) {
    EXPECT_EQ(error.what(), path.string() + ":2:10: there is no instance 'bb'");
    EXPECT_EQ(error.caret(), "  unload bb\n         ^");
    EXPECT_EQ(error.code(), ErrorCode::NotFound);
  }
  EXPECT_EQ(requests().size(), 2U);
}

TEST_F(ConsoleTest, AMistakeInTheLastLineIsToldBeforeTheFirstOneRuns) {
  EXPECT_THROW(read_script(file("a.fiona", "load x\nlod y\n")), LineError);
  EXPECT_TRUE(requests().empty());
}

TEST_F(ConsoleTest, SourceIsRelativeToItsFile) {
  file("inner.fiona", "unload a\n");
  run_script(session(), read_script(file("outer.fiona", "source inner.fiona\n")));
  EXPECT_EQ(requests().size(), 1U);
}

TEST_F(ConsoleTest, WhatIsSourcedStandsInThePlaceOfItsLineAndKeepsItsOwn) {
  file("inner.fiona", "unload b\nunload c\n");
  const auto lines = read_script(file("outer.fiona", "unload a\nsource inner.fiona\nunload d\n"));
  ASSERT_EQ(lines.size(), 4U);
  EXPECT_EQ(lines[2].positional[0].text, "c");
  EXPECT_THAT(lines[2].error(lines[2].verb, {.what = "no"}).what(), HasSubstr("inner.fiona:2:1: no"));
  EXPECT_EQ(lines[3].positional[0].text, "d");
}

TEST_F(ConsoleTest, FilesThatSourceEachOtherInACircleAreRefusedBeforeALineRuns) {
  file("one.fiona", "unload a\nsource two.fiona\n");
  const auto two = file("two.fiona", "source one.fiona\n");
  EXPECT_THAT(error_of("source " + two.string()), HasSubstr("one.fiona:2:8: files source each other in a circle"));
  EXPECT_TRUE(requests().empty());
}

TEST_F(ConsoleTest, FilesThatSourceEachOtherTwiceHaveABound) {
  file("0.fiona", "unload a\nunload a\n");
  std::filesystem::path last;
  for (int i = 1; i <= 20; ++i) {
    const std::string inner = "source " + std::to_string(i - 1) + ".fiona\n";
    last = file(std::to_string(i) + ".fiona", inner + inner);
  }
  EXPECT_THAT(error_of("source " + last.string()), HasSubstr("more than 1000 files are sourced"));
}

TEST_F(ConsoleTest, AMissingFileIsNotFound) {
  EXPECT_NE(error_of("source nowhere.fiona").find("nowhere.fiona: there is no such file"), std::string::npos);
  EXPECT_EQ(code, ErrorCode::NotFound);
}

TEST_F(ConsoleTest, SaveReplacesTheFileByTheSystem) {
  script = [](const auto&) { return system_reply(wired_system()); };
  const auto path = file("old.fiona", "old");
  session().run(split_line("save " + path.string()));
  std::ifstream in(path);
  const std::string text{std::istreambuf_iterator<char>(in), {}};
  EXPECT_EQ(text,
            "set host clock=virtual speed=0\n"
            "load fiona/trace-player as walk trace=\"a b\"\n"
            "load fiona/tools/step-heading as nav in fast\n"
            "wire nav.imu to walk.imu every 5\n"
            "state nav neutral\n");
  EXPECT_EQ(std::distance(std::filesystem::directory_iterator(directory.path), {}), 1);
}

TEST_F(ConsoleTest, SaveThatCannotWriteLeavesNothingBehind) {
  script = [](const auto&) { return system_reply(wired_system()); };
  EXPECT_NE(error_of("save " + (directory.path / "no" / "x.fiona").string())
                .find("the file cannot be written: No such file or directory"),
            std::string::npos);
}

TEST_F(ConsoleTest, TheHostIsChosenOnlyWhenTheConsoleStarts) {
  session().setting = Setting::Script;
  EXPECT_NE(error_of("ls --host other").find("--host chooses the host when `fiona` starts"), std::string::npos);
}

TEST_F(ConsoleTest, ShowExplainsAPlatformTypeWithItsUnits) {
  script = [](const control::Request& request) {
    return request.has_snapshot() ? system_reply(small_system()) : std::vector{failure(ErrorCode::NotFound, "no")};
  };
  session().run(split_line("show GetIMU"));
  EXPECT_TRUE(out.starts_with("fiona.sensors.GetIMU\nfield ")) << out;
  EXPECT_NE(out.find("unit"), std::string::npos);
}

TEST_F(ConsoleTest, ShowOfNothingNamesWhatIsNear) {
  script = [](const control::Request& request) {
    return request.has_snapshot() ? system_reply(small_system()) : std::vector{failure(ErrorCode::NotFound, "no")};
  };
  EXPECT_NE(error_of("show wlak").find("did you mean: walk"), std::string::npos);
}

/// nav takes fusion's, while walk is silent.
control::System system_with_alternatives() {
  control::System system = wired_system();
  auto* need = system.mutable_instances(1)->mutable_ports(0);
  need->mutable_peer()->set_instance("fusion");
  for (const char* name : {"walk", "fusion", "gps"}) {
    auto* provider = need->add_providers();
    provider->mutable_provider()->set_instance(name);
    provider->mutable_provider()->set_port("imu");
  }
  need->mutable_providers(0)->set_connection(control::LOST);
  need->mutable_providers(0)->set_reason("walk.imu has been silent for 300 ms");
  need->mutable_providers(1)->set_connection(control::CONNECTED);
  need->mutable_providers(1)->set_fit(true);
  need->mutable_providers(1)->set_serves(true);
  need->mutable_providers(2)->set_connection(control::WAITING);
  need->mutable_providers(2)->set_reason("gps.imu: there is no instance 'gps' yet");
  need->set_hold_ms(1500);
  need->set_flaps(2);
  return system;
}

TEST_F(ConsoleTest, AWireMayNameAlternativesInTheirOrder) {
  session().run(split_line("wire nav.imu to walk.imu else fusion.imu else gps.imu every 5 hold=1500ms"));
  const control::Wire wire = requests()[0].transact().changes(0).wire();
  EXPECT_EQ(wire.provider().instance(), "walk");
  ASSERT_EQ(wire.alternatives_size(), 2);
  EXPECT_EQ(wire.alternatives(0).instance(), "fusion");
  EXPECT_EQ(wire.alternatives(1).instance(), "gps");
  EXPECT_EQ(wire.prescale(), 5U);
  EXPECT_EQ(wire.hold_ms(), 1500);
}

TEST_F(ConsoleTest, ListsWhoServesAPortAndHowItsAlternativesAre) {
  script = [](const auto&) { return system_reply(system_with_alternatives()); };
  session().run(split_line("ls wires --json"));
  EXPECT_NE(out.find("\"alternatives\":\"walk.imu has been silent for 300 ms; fusion.imu serves; gps.imu: there is no "
                     "instance 'gps' yet\""),
            std::string::npos)
      << out;
  EXPECT_NE(out.find("\"flaps\":2"), std::string::npos) << out;
  EXPECT_NE(out.find("\"provider\":\"fusion.imu\""), std::string::npos) << out;
}

TEST_F(ConsoleTest, ShowsEachProviderOfAPortWithTheHoldTimeAndTheFlaps) {
  script = [](const auto&) { return system_reply(system_with_alternatives()); };
  session().run(split_line("show nav.imu"));
  EXPECT_NE(out.find("provider    fusion.imu serves\n"), std::string::npos) << out;
  EXPECT_NE(out.find("hold        1.5 s\n"), std::string::npos) << out;
  EXPECT_NE(out.find("flaps       2\n"), std::string::npos) << out;
}

TEST(SavedSystem, KeepsTheOrderOfAlternativesWhoeverServes) {
  EXPECT_NE(saved_system(system_with_alternatives())
                .find("wire nav.imu to walk.imu else fusion.imu else gps.imu every 5 hold=1.5s\n"),
            std::string::npos);
}

TEST(WhiteSpots, NameTheAlternativesThatAreMissing) {
  const TemporaryDirectory directory;
  const auto spots = white_spots(system_with_alternatives(), Catalogue(directory.path));
  std::vector<std::string> missing;
  for (const auto& spot : spots) {
    if (spot.reason == "served, an alternative is missing") missing.push_back(spot.fillers.at(0).what);
  }
  EXPECT_EQ(missing, (std::vector<std::string>{"walk.imu has been silent for 300 ms",
                                               "gps.imu: there is no instance 'gps' yet"}));
}

TEST(WhiteSpots, AreNotFilledByTheirOwnInstance) {
  const TemporaryDirectory directory;
  control::System system = small_system();
  auto* const own = system.mutable_instances(1)->add_ports();
  *own = system.instances(0).ports(0);
  own->set_name("smoothed");
  const auto spots = white_spots(system, Catalogue(directory.path));
  std::vector<std::string> offers;
  for (const auto& spot : spots) {
    for (const auto& filler : spot.fillers) {
      if (filler.from == "running") offers.push_back(spot.port + " by " + filler.what);
    }
  }
  EXPECT_EQ(offers, (std::vector<std::string>{"nav.imu by walk.imu", "walk.imu by nav.imu"}));
}

TEST(SavedSystem, IsTheSameTextForTheSameSystem) {
  EXPECT_EQ(saved_system(wired_system()), saved_system(wired_system()));
}

TEST(WhiteSpots, StrictRefusesRequiredPortsThatAreNotOptional) {
  control::System system = small_system();
  EXPECT_EQ(strict_spots(system), std::vector<std::string>{"nav.imu"});
  system.mutable_instances(1)->mutable_ports(0)->set_optional(true);
  EXPECT_TRUE(strict_spots(system).empty());
}

TEST(WhiteSpots, StrictTakesWhoIsThereAndSaysNothingYet) {
  control::System system = small_system();
  auto& port = *system.mutable_instances(1)->mutable_ports(0);
  port.mutable_peer()->set_instance(system.instances(0).name());
  port.mutable_peer()->set_port("imu");
  port.set_connection(control::LOST);
  EXPECT_TRUE(strict_spots(system).empty());
  system.mutable_instances(0)->set_silent_s(3);
  EXPECT_EQ(strict_spots(system), std::vector<std::string>{"nav.imu"});
  system.mutable_instances(0)->set_silent_s(0);
  system.mutable_instances(0)->set_mode("failed");
  EXPECT_EQ(strict_spots(system), std::vector<std::string>{"nav.imu"});
}

TEST(Endpoint, NobodyListeningIsUnreachableWithTheNextStep) {
  const TemporaryDirectory directory;
  Reactor reactor;
  try {
    const ControlClient client(reactor, Endpoint{directory.path / "main.sock"}, 100ms);
    FAIL() << "it connected";
  } catch (const Error& error) {
    EXPECT_EQ(error.code(), ErrorCode::Unreachable);
    EXPECT_NE(std::string(error.what()).find("next: start one: fiona run FILE"), std::string::npos);
  }
}

}  // namespace
}  // namespace fiona::console
