// Transactions: all or nothing, taken back, planned, and remembered beyond the death of the process.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>

#include "engine.hpp"
#include "fiona/error.hpp"
#include "mailbox.hpp"
#include "system_fixture.hpp"

namespace fiona::host {
namespace {

using conformance::RunningSystem;
using conformance::TemporaryDirectory;
using testing::ElementsAre;
using testing::HasSubstr;

std::string bytes_of(const std::filesystem::path& file) {
  std::ifstream stream(file, std::ios::binary);
  return {std::istreambuf_iterator<char>(stream), {}};
}

control::PortName port_name(const std::string& text) {
  return port_of({text.substr(0, text.find('.')), text.substr(text.find('.') + 1)});
}

control::Change load(const std::string& component, const std::string& name, const std::string& group = "") {
  control::Change change;
  change.mutable_load()->set_plugin(std::string(TEST_COMPONENTS_LIBRARY) + "/" + component);
  change.mutable_load()->set_instance(name);
  change.mutable_load()->set_group(group);
  return change;
}

control::Change unload(const std::string& name) {
  control::Change change;
  change.mutable_unload()->set_instance(name);
  return change;
}

control::Change wire(const std::string& client, const std::string& provider) {
  control::Change change;
  *change.mutable_wire()->mutable_client() = port_name(client);
  *change.mutable_wire()->mutable_provider() = port_name(provider);
  return change;
}

control::Change unwire(const std::string& client) {
  control::Change change;
  *change.mutable_unwire()->mutable_client() = port_name(client);
  return change;
}

control::Change set(const std::string& name, const std::string& parameter, std::int64_t value) {
  control::Change change;
  change.mutable_set()->set_instance(name);
  auto& argument = *change.mutable_set()->add_parameters();
  argument.set_name(parameter);
  argument.mutable_value()->set_integer(value);
  return change;
}

control::Change set_text(const std::string& name, const std::string& parameter, std::string value) {
  control::Change change = set(name, parameter, 0);
  change.mutable_set()->mutable_parameters(0)->mutable_value()->set_text(std::move(value));
  return change;
}

control::Change state(const std::string& name, const std::string& mode) {
  control::Change change;
  change.mutable_state()->set_instance(name);
  change.mutable_state()->set_mode(mode);
  change.mutable_state()->set_within_ms(60'000);  // a journal of some MiB takes its time on a busy machine
  return change;
}

control::Change swap(const std::string& old, const std::string& next) {
  control::Change change;
  change.mutable_replace()->set_old(old);
  change.mutable_replace()->set_next(next);
  return change;
}

/// A step as the tests compare it: "wire sink.each to source.newest".
std::string text(const control::Change& change) {
  if (change.has_load()) return "load " + change.load().instance();
  if (change.has_unload()) return "unload " + change.unload().instance();
  if (change.has_wire()) {
    std::string line = "wire " + text_of(change.wire().client()) + " to " + text_of(change.wire().provider());
    for (const auto& other : change.wire().alternatives()) line += " else " + text_of(other);
    return line;
  }
  if (change.has_unwire()) return "unwire " + text_of(change.unwire().client());
  if (change.has_set()) return "set " + change.set().instance() + " " + change.set().parameters(0).name();
  return "state " + change.state().instance() + " " + change.state().mode();
}

template <class List>
std::vector<std::string> texts(const List& changes) {
  std::vector<std::string> all;
  for (const auto& change : changes) all.push_back(text(change));
  return all;
}

class Transactions : public testing::TestWithParam<conformance::Transport> {
 protected:
  control::Reply transact(const std::vector<control::Change>& changes, bool whole = false, bool dry_run = false) {
    control::Transact request;
    request.mutable_changes()->Add(changes.begin(), changes.end());
    request.set_whole(whole);
    request.set_dry_run(dry_run);
    return answer_of([&](Waits::Answer answer) { engine.transact("test", request, std::move(answer)); });
  }
  control::Reply undo(bool dry_run = false) {
    control::Undo request;
    request.set_dry_run(dry_run);
    return answer_of([&](Waits::Answer answer) { engine.undo("test", request, std::move(answer)); });
  }
  control::Reply answer_of(const std::function<void(Waits::Answer)>& ask) {
    std::optional<control::Reply> answered;
    ask([&answered](const control::Reply& reply) { answered = reply; });
    system.eventually("the answer", [&] {
      for (const auto& job : work.take()) job();
      return answered.has_value();
    });
    return *answered;
  }
  void make(const std::vector<control::Change>& changes) {
    const auto reply = transact(changes);
    ASSERT_TRUE(reply.has_done()) << reply.failure().what();
  }
  /// Begins what is answered later.
  std::shared_ptr<std::optional<control::Reply>> begin(const std::vector<control::Change>& changes) {
    auto answered = std::make_shared<std::optional<control::Reply>>();
    control::Transact request;
    request.mutable_changes()->Add(changes.begin(), changes.end());
    engine.transact("test", request, [answered](const control::Reply& reply) { *answered = reply; });
    return answered;
  }
  void eventually(const std::string& what, const std::function<bool()>& holds) {
    system.eventually(what, [&] {
      for (const auto& job : work.take()) job();
      return holds();
    });
  }
  void await_done(const std::shared_ptr<std::optional<control::Reply>>& answered) {
    eventually("the answer", [&] { return answered->has_value(); });
    EXPECT_TRUE((*answered)->has_done()) << (*answered)->failure().what();
  }
  /// A component that comes to rest when it is let.
  void load_stubborn(const std::string& name) {
    make({load("toiler", name, group())});
    system.set(name, "stubborn=true");
  }
  void let_rest(const std::string& name) { system.set(name, "stubborn=false"); }
  /// What a host that is started after this one was killed would begin with.
  Model restored() {
    Model model;
    for (const auto& change : Journal::read(directory.path / "journal").changes)
      model.make(change, system.system().packages());
    return model;
  }
  /// The steps that would make the running system out of nothing: what it is.
  std::vector<std::string> whole() { return texts(Model::difference(Model(), system.system().model())); }
  std::string group() const { return GetParam() == conformance::Transport::Process ? "" : "far"; }

  TemporaryDirectory directory;
  Mailbox<std::function<void()>> work;  ///< outlives the system, whose threads post to it
  RunningSystem system{GetParam()};
  Engine engine{system.system(), directory.path / "journal",
                [this](std::function<void()> job) { work.push(std::move(job)); }};
};

TEST_P(Transactions, AllChangesAreMadeInTheirOrder) {
  const auto reply =
      transact({load("source", "source"), load("sink", "sink", group()), wire("sink.each", "source.newest"),
                set("source", "payload", 7), state("source", "neutral")});
  ASSERT_TRUE(reply.has_done()) << reply.failure().what();
  EXPECT_EQ(reply.done().note(), "5 changes");
  EXPECT_EQ(system.instance("source").mode(), "neutral");
  EXPECT_EQ(system.port("sink.each").connection(), control::CONNECTED);
}

TEST_P(Transactions, OneThatCannotBeIsRefusedBeforeTheFirstIsMade) {
  const auto reply = transact({load("source", "source"), wire("sink.each", "source.newest")});
  ASSERT_TRUE(reply.has_failure());
  EXPECT_EQ(reply.failure().change(), 2U);
  EXPECT_EQ(reply.failure().what(), "there is no instance 'sink'");
  EXPECT_EQ(system.system().snapshot().instances_size(), 0);
  EXPECT_EQ(engine.journal(0).entries_size(), 0);
}

TEST_P(Transactions, OneThatFailsWhileItIsMadeTakesBackThoseBeforeIt) {
  make({load("source", "one"), load("source", "two"), load("sink", "sink", group()), wire("sink.each", "one.newest")});
  const auto before = whole();
  const auto reply = transact({wire("sink.each", "two.newest"), set("one", "payload", 9), load("source", "three"),
                               state("one", "neutral"), state("two", "no-such-mode")});
  ASSERT_TRUE(reply.has_failure());
  EXPECT_EQ(reply.failure().change(), 5U);
  EXPECT_THAT(reply.failure().what(), HasSubstr("no-such-mode"));
  EXPECT_EQ(whole(), before);
  EXPECT_EQ(system.port("sink.each").peer().instance(), "one");
  EXPECT_EQ(system.instance("one").mode(), "active");
  EXPECT_EQ(system.instance("one").set_parameters_size(), 0);
  EXPECT_EQ(engine.journal(1).entries(0).state(), control::JournalEntry::ROLLED_BACK);
}

TEST_P(Transactions, UndoTakesBackOneAfterTheOther) {
  make({load("source", "source")});
  make({load("sink", "sink", group()), wire("sink.each", "source.newest")});
  make({set("source", "payload", 9)});
  make({unwire("sink.each")});
  EXPECT_TRUE(undo().has_done());
  EXPECT_THAT(whole(), ElementsAre("load source", "load sink", "wire sink.each to source.newest"));
  EXPECT_EQ(system.instance("source").set_parameters_size(), 1);
  EXPECT_TRUE(undo().has_done());
  EXPECT_EQ(system.instance("source").set_parameters_size(), 0);
  EXPECT_TRUE(undo().has_done());
  EXPECT_THAT(whole(), ElementsAre("load source"));
  EXPECT_TRUE(undo().has_done());
  EXPECT_THAT(whole(), ElementsAre());
  EXPECT_EQ(undo().failure().what(), "there is nothing to undo");
}

TEST_P(Transactions, WhatIsTakenBackToAProviderThatHasFailedSinceWaitsForIt) {
  make({load("source", "one"), load("source", "two"), load("sink", "sink", group()), wire("sink.each", "one.newest")});
  make({wire("sink.each", "two.newest")});
  system.set("one", "fail_with=broken");
  eventually("it has failed", [&] { return system.instance("one").mode() == "failed"; });
  EXPECT_EQ(transact({wire("sink.each", "one.newest")}).failure().what(), "'one' has failed: broken");
  EXPECT_EQ(system.port("sink.each").peer().instance(), "two") << "a change that is asked for takes nothing away";
  const auto reply = undo();
  EXPECT_TRUE(reply.has_done()) << reply.failure().what();
  EXPECT_THAT(reply.done().warnings(0), HasSubstr("sink.each waits for one.newest: 'one' has failed: broken"));
  const auto before = whole();
  EXPECT_TRUE(transact({wire("sink.each", "two.newest"), state("two", "no-such-mode")}).has_failure());
  EXPECT_EQ(whole(), before);
  EXPECT_EQ(system.port("sink.each").connection(), control::WAITING);
  make({unload("one"), load("source", "one")});
  EXPECT_EQ(system.port("sink.each").connection(), control::CONNECTED);
}

TEST_P(Transactions, WhatIsTakenBackFromAlternativesToAProviderThatHasFailedSinceWaitsForIt) {
  make({load("source", "one"), load("source", "two"), load("source", "three"), load("sink", "sink", group()),
        wire("sink.each", "one.newest")});
  control::Change several = wire("sink.each", "two.newest");
  *several.mutable_wire()->add_alternatives() = port_name("three.newest");
  make({several});
  system.set("one", "fail_with=broken");
  eventually("it has failed", [&] { return system.instance("one").mode() == "failed"; });
  const auto reply = undo();
  EXPECT_TRUE(reply.has_done()) << reply.failure().what();
  EXPECT_EQ(system.port("sink.each").connection(), control::WAITING);
}

TEST_P(Transactions, UndosThatWaitTakeBackOneEach) {
  make({load("source", "source"), load("sink", "sink", group())});
  make({wire("sink.each", "source.newest")});
  make({set("source", "payload", 9)});
  control::Transact slow;
  *slow.add_changes() = state("source", "neutral");
  *slow.add_changes() = state("source", "active");
  std::vector<control::Reply> answers;
  const auto keep = [&answers](const control::Reply& reply) { answers.push_back(reply); };
  engine.transact("test", slow, keep);
  for (int i = 0; i < 2; ++i) engine.undo("test", {}, keep);
  system.eventually("all answers", [&] {
    for (const auto& job : work.take()) job();
    return answers.size() == 3;
  });
  for (const auto& answer : answers) EXPECT_TRUE(answer.has_done()) << answer.failure().what();
  EXPECT_EQ(system.instance("source").set_parameters_size(), 0);
  EXPECT_EQ(system.port("sink.each").connection(), control::UNWIRED);
}

TEST_P(Transactions, ModeThatIsNotReachedTakesNothingBackThatOthersMadeMeanwhile) {
  make({load("source", "source"), load("sink", "sink", group())});
  std::optional<control::Reply> refused;
  control::Transact change;
  *change.add_changes() = state("source", "no-such-mode");
  engine.transact("test", change, [&refused](const control::Reply& reply) { refused = reply; });
  control::Transact other;
  *other.add_changes() = wire("sink.each", "source.newest");
  engine.transact("test", other, [](const control::Reply& reply) { EXPECT_TRUE(reply.has_done()); });
  system.eventually("the refusal", [&] {
    for (const auto& job : work.take()) job();
    return refused.has_value();
  });
  EXPECT_TRUE(refused->has_failure());
  EXPECT_EQ(system.port("sink.each").connection(), control::CONNECTED);
}

TEST_P(Transactions, ModeThatIsReachedMeanwhileIsNotTakenBackWithWhatFails) {
  make({load("source", "one"), load("source", "two"), load("source", "three", group())});
  std::optional<control::Reply> reached;
  control::Transact aside;
  *aside.add_changes() = state("one", "neutral");
  engine.transact("test", aside, [&reached](const control::Reply& reply) { reached = reply; });
  // Each of these steps is waited for, so that the other has ended long before the last of them.
  std::vector<control::Change> changes{set("two", "payload", 9)};
  for (int i = 0; i < 10; ++i) changes.push_back(state("three", i % 2 == 0 ? "neutral" : "active"));
  changes.push_back(state("two", "no-such-mode"));
  const auto reply = transact(changes);
  EXPECT_TRUE(reply.has_failure());
  ASSERT_TRUE(reached && reached->has_done());
  EXPECT_EQ(system.instance("one").mode(), "neutral");
  EXPECT_EQ(system.instance("two").set_parameters_size(), 0);
}

TEST_P(Transactions, ALoadThatIsUnderWayGoesOnThoughItsLibraryIsTakenAway) {
  const auto copied = [&](const std::string& name) {
    std::filesystem::copy_file(std::filesystem::path(ZOO_DIRECTORY) / name, directory.path / name);
    return directory.path / name;
  };
  const auto description = copied("throws.interface.textproto");
  const auto library = copied("libthrows.so");
  control::Change change = load("", "", group());
  change.mutable_load()->set_plugin(library.string() + "/std-in-stop");  // as who types no name
  const auto answered = begin({change});
  std::filesystem::remove(library);
  std::filesystem::remove(description);
  await_done(answered);
  EXPECT_EQ(system.instance("std-in-stop").mode(), "active");
}

TEST_P(Transactions, AChangeOfModeForWhichNobodyWouldWaitIsRefused) {
  make({load("source", "source", group())});
  control::Change change = state("source", "neutral");
  change.mutable_state()->set_within_ms(3'600'001);
  const auto reply = transact({change});
  EXPECT_EQ(reply.failure().what(), "the time for a change of mode is out of range");
  EXPECT_EQ(reply.failure().expected(), "up to 1h");
  EXPECT_EQ(system.instance("source").mode(), "active");
}

TEST_P(Transactions, UndosOfChangesOfModeTakeBackOneEach) {
  make({load("source", "source", group())});
  make({set("source", "payload", 9)});
  make({state("source", "neutral")});
  std::vector<control::Reply> answers;
  for (int i = 0; i < 2; ++i)
    engine.undo("test", {}, [&answers](const control::Reply& reply) { answers.push_back(reply); });
  eventually("both answers", [&] { return answers.size() == 2; });
  for (const auto& answer : answers) EXPECT_TRUE(answer.has_done()) << answer.failure().what();
  EXPECT_EQ(system.instance("source").mode(), "active");
  EXPECT_EQ(system.instance("source").set_parameters_size(), 0);
}

TEST_P(Transactions, UndoOfAModeGivesBackTheOneBeforeItThoughBothWereAskedForAtOnce) {
  make({load("mover", "mover", group())});
  const auto first = begin({state("mover", "park")});
  const auto second = begin({state("mover", "rest")});
  await_done(first);
  await_done(second);
  EXPECT_TRUE(undo().has_done());
  EXPECT_EQ(system.instance("mover").mode(), "park");
  EXPECT_TRUE(undo().has_done());
  EXPECT_EQ(system.instance("mover").mode(), "drive");
}

TEST_P(Transactions, WholeWithAnotherClockKeepsNothing) {
  make({load("source", "source"), load("sink", "sink", group()), load("source", "spare")});
  control::Change clock = set_text("host", "clock", "virtual");
  const auto reply = transact({clock, load("source", "source"), load("sink", "sink", group())}, true);
  ASSERT_TRUE(reply.has_done()) << reply.failure().what();
  EXPECT_EQ(system.system().snapshot().clock(), "virtual");
  EXPECT_THAT(whole(), ElementsAre("set host clock", "load source", "load sink"));
}

TEST_P(Transactions, UndoOfAnUnloadGivesTheInstanceBackWithItsWiresParametersAndMode) {
  make({load("source", "source"), load("sink", "sink", group()), wire("sink.each", "source.newest"),
        set("source", "payload", 9), state("source", "neutral")});
  make({unload("source")});
  EXPECT_EQ(system.port("sink.each").connection(), control::WAITING);
  EXPECT_TRUE(undo().has_done());
  EXPECT_EQ(system.port("sink.each").connection(), control::CONNECTED);
  EXPECT_EQ(system.instance("source").mode(), "neutral");
  EXPECT_EQ(system.instance("source").set_parameters(0).value().integer(), 9);
}

TEST_P(Transactions, PlanShowsTheStepsAndWhatTakesThemBackAndChangesNothing) {
  make({load("source", "one"), load("source", "two"), load("sink", "sink", group()), wire("sink.each", "one.newest"),
        wire("sink.newest", "one.newest")});
  const auto before = whole();
  const auto reply = transact({swap("one", "two"), unload("one")}, false, true);
  ASSERT_TRUE(reply.has_planned()) << reply.failure().what();
  EXPECT_THAT(texts(reply.planned().steps()),
              ElementsAre("wire sink.each to two.newest", "wire sink.newest to two.newest", "unload one"));
  EXPECT_THAT(texts(reply.planned().reverse()),
              ElementsAre("load one", "wire sink.each to one.newest", "wire sink.newest to one.newest"));
  EXPECT_THAT(reply.planned().warnings(0), HasSubstr("what 'one' knows is lost"));
  EXPECT_EQ(whole(), before);
}

TEST_P(Transactions, ARewireThatFailsLeavesTheSubscriptionAsItWas) {
  make({load("source", "one"), load("source", "two"), load("sink", "sink", group())});
  control::Change several = wire("sink.each", "one.newest");
  *several.mutable_wire()->add_alternatives() = port_name("two.newest");
  make({several});
  system.set("two", "fail_with=broken");
  system.eventually("it has failed", [&] { return system.instance("two").mode() == "failed"; });
  *several.mutable_wire()->add_alternatives() = port_name("three.newest");
  several.mutable_wire()->set_prescale(5);
  EXPECT_TRUE(transact({several}).has_failure());
  const auto came_before = system.port("sink.each").messages();
  const auto put_before = system.port("one.newest").messages();
  system.eventually("more is put", [&] { return system.port("one.newest").messages() > put_before + 50; });
  EXPECT_GE(system.port("sink.each").messages() - came_before, 40U);
}

TEST_P(Transactions, ARewireKeepsTheSubscriptionAsItIs) {
  make({load("source", "one"), load("source", "two"), load("sink", "sink", group())});
  control::Change seldom = wire("sink.each", "one.newest");
  seldom.mutable_wire()->set_prescale(5);
  make({seldom});
  make({wire("sink.each", "two.newest")});
  EXPECT_EQ(system.port("sink.each").peer().instance(), "two");
  EXPECT_EQ(system.port("sink.each").prescale(), 5U);
  const auto came_before = system.port("sink.each").messages();
  const auto put_before = system.port("two.newest").messages();
  system.eventually("more is put", [&] { return system.port("two.newest").messages() > put_before + 50; });
  const auto came = system.port("sink.each").messages() - came_before;
  EXPECT_GT(came, 0U);
  EXPECT_LE(came, (system.port("two.newest").messages() - put_before) / 5 + 1);
  control::Change each = wire("sink.each", "two.newest");
  each.mutable_wire()->set_prescale(1);
  make({each});
  EXPECT_EQ(system.port("sink.each").prescale(), 1U);
  EXPECT_TRUE(undo().has_done());
  EXPECT_EQ(system.port("sink.each").prescale(), 5U);
  EXPECT_TRUE(undo().has_done());
  EXPECT_TRUE(undo().has_done());
  EXPECT_EQ(system.port("sink.each").connection(), control::UNWIRED);
}

TEST_P(Transactions, WhoIsServedIsNotWiredToNobody) {
  make({load("source", "source"), load("sink", "sink", group()), wire("sink.each", "source.newest")});
  const auto before = whole();
  const auto refused = transact({wire("sink.each", "sourse.newest")});
  ASSERT_TRUE(refused.has_failure());
  EXPECT_EQ(refused.failure().what(), "there is no instance 'sourse': sink.each stays wired to source.newest");
  EXPECT_THAT(refused.failure().expected(), HasSubstr("source"));
  EXPECT_EQ(whole(), before);
  EXPECT_EQ(system.port("sink.each").connection(), control::CONNECTED);
  make({wire("sink.each", "sourse.newest"), load("source", "sourse")});
  EXPECT_EQ(system.port("sink.each").peer().instance(), "sourse") << "which comes with the same changes";
  make({unwire("sink.each"), wire("sink.each", "salt.newest")});
  EXPECT_EQ(system.port("sink.each").connection(), control::WAITING);
}

TEST_P(Transactions, SwapMovesAllClientsAndTellsWhatItCost) {
  make({load("source", "one"), load("source", "two"), load("sink", "sink", group()), load("sink", "other"),
        wire("sink.each", "one.newest"), wire("other.each", "one.newest")});
  const auto reply = transact({swap("one", "two")});
  ASSERT_TRUE(reply.has_done()) << reply.failure().what();
  EXPECT_EQ(reply.done().switched(), 2U);
  EXPECT_EQ(reply.done().lost(), 0U);
  EXPECT_EQ(system.port("one.newest").clients_size(), 0);
  EXPECT_EQ(system.port("two.newest").clients_size(), 2);
}

TEST_P(Transactions, UndoGivesAlternativesBackInTheirOrderAndTakesThemAway) {
  make({load("source", "one"), load("source", "two"), load("sink", "sink", group()), wire("sink.each", "one.newest")});
  control::Change several = wire("sink.each", "two.newest");
  *several.mutable_wire()->add_alternatives() = port_name("one.newest");
  *several.mutable_wire()->add_alternatives() = port_name("three.newest");
  several.mutable_wire()->set_hold_ms(500);
  make({several});
  make({unwire("sink.each")});
  EXPECT_THAT(texts(undo(true).planned().steps()),
              ElementsAre("wire sink.each to two.newest else one.newest else three.newest"));
  EXPECT_TRUE(undo().has_done());
  EXPECT_EQ(system.port("sink.each").hold_ms(), 500);
  EXPECT_EQ(system.port("sink.each").providers_size(), 3);
  EXPECT_TRUE(undo().has_done());
  EXPECT_THAT(whole(), ElementsAre("load one", "load two", "load sink", "wire sink.each to one.newest"));
  EXPECT_TRUE(system.port("sink.each").providers().empty());
  EXPECT_EQ(system.port("sink.each").connection(), control::CONNECTED);
}

TEST_P(Transactions, AnAlternativeThatIsUnloadedWaitsAndUndoConnectsIt) {
  make({load("source", "one"), load("source", "two"), load("sink", "sink", group())});
  control::Change several = wire("sink.each", "one.newest");
  *several.mutable_wire()->add_alternatives() = port_name("two.newest");
  make({several});
  make({unload("one")});
  EXPECT_EQ(system.port("sink.each").connection(), control::CONNECTED);
  EXPECT_EQ(system.port("sink.each").providers(0).connection(), control::WAITING);
  EXPECT_EQ(system.port("sink.each").peer().instance(), "two");
  EXPECT_TRUE(undo().has_done());
  EXPECT_EQ(system.port("sink.each").providers(0).connection(), control::CONNECTED);
}

TEST_P(Transactions, SwapPutsTheNewOneInThePlaceOfAnAlternative) {
  make({load("source", "one"), load("source", "two"), load("source", "three"), load("sink", "sink", group())});
  control::Change several = wire("sink.each", "one.newest");
  *several.mutable_wire()->add_alternatives() = port_name("two.newest");
  make({several});
  EXPECT_THAT(texts(transact({swap("two", "three")}, false, true).planned().steps()),
              ElementsAre("wire sink.each to one.newest else three.newest"));
  EXPECT_THAT(texts(transact({swap("one", "two")}, false, true).planned().steps()),
              ElementsAre("wire sink.each to two.newest"));
}

TEST_P(Transactions, AFailureTakesAlternativesBack) {
  make({load("source", "one"), load("source", "two"), load("sink", "sink", group()), wire("sink.each", "one.newest")});
  control::Change several = wire("sink.each", "two.newest");
  *several.mutable_wire()->add_alternatives() = port_name("one.newest");
  EXPECT_TRUE(transact({several, state("one", "nowhere")}).has_failure());
  EXPECT_TRUE(system.port("sink.each").providers().empty());
  EXPECT_EQ(system.port("sink.each").peer().instance(), "one");
  EXPECT_EQ(system.port("sink.each").connection(), control::CONNECTED);
}

TEST_P(Transactions, SwapToWhatDoesNotFitChangesNothingAndSaysWhy) {
  make({load("source", "source"), load("sink", "sink", group()), wire("sink.each", "source.newest"),
        load("asker", "asker")});
  const auto reply = transact({swap("source", "asker")});
  ASSERT_TRUE(reply.has_failure());
  EXPECT_EQ(reply.failure().what(), "'asker' has no port for SampleNewest of source.newest");
  EXPECT_EQ(system.port("sink.each").peer().instance(), "source");
}

TEST_P(Transactions, WholeMakesTheSystemEqualWithTheFewestSteps) {
  const std::vector<control::Change> old = {load("source", "one"), load("source", "two"), load("sink", "sink", group()),
                                            wire("sink.each", "one.newest"), set("one", "payload", 3)};
  make(old);
  const std::vector<control::Change> wanted = {load("source", "one"), load("sink", "sink", group()),
                                               load("sink", "more"), wire("sink.newest", "one.newest"),
                                               wire("more.each", "one.newest")};
  const auto planned = transact(wanted, true, true);
  EXPECT_THAT(texts(planned.planned().steps()),
              ElementsAre("unwire sink.each", "unload two", "load more", "set one payload",
                          "wire more.each to one.newest", "wire sink.newest to one.newest"));
  ASSERT_TRUE(transact(wanted, true).has_done());
  EXPECT_EQ(transact(wanted, true).done().note(), "nothing to change");
  EXPECT_TRUE(undo().has_done());
  EXPECT_EQ(transact(old, true, true).planned().steps_size(), 0);
}

TEST_P(Transactions, ManyAtOnceAreMadeInTheirOrderAndEachIsAnswered) {
  make({load("source", "one"), load("source", "two"), load("sink", "sink", group())});
  std::vector<control::Reply> answers;
  for (int i = 0; i < 20; ++i) {
    control::Transact request;
    *request.add_changes() = wire("sink.each", i % 2 == 0 ? "one.newest" : "two.newest");
    *request.add_changes() = state("one", i % 2 == 0 ? "neutral" : "active");
    engine.transact("test", request, [&](const control::Reply& reply) { answers.push_back(reply); });
  }
  system.eventually("all answers", [&] {
    for (const auto& job : work.take()) job();
    return answers.size() == 20;
  });
  for (const auto& answer : answers) EXPECT_TRUE(answer.has_done()) << answer.failure().what();
  EXPECT_EQ(system.port("sink.each").peer().instance(), "two");
  EXPECT_EQ(system.instance("one").mode(), "active");
}

TEST_P(Transactions, UndoLoadsAgainWhoseNameAWireThatItTakesBackWaitsFor) {
  make({load("source", "source"), load("sink", "sink", group()), load("sink", "other"),
        wire("sink.each", "source.newest")});
  const auto before = whole();
  make({unload("other"), unwire("sink.each"), wire("sink.each", "other.newest")});  // which a sink would not have
  const auto reply = undo();
  EXPECT_TRUE(reply.has_done()) << reply.failure().what();
  EXPECT_EQ(whole(), before);
  EXPECT_EQ(system.port("sink.each").connection(), control::CONNECTED);
}

TEST_P(Transactions, JournalGivesTheSystemBackAfterTheProcessWasKilled) {
  make({load("source", "source"), load("sink", "sink", group()), wire("sink.each", "source.newest"),
        set("source", "payload", 9)});
  make({load("source", "spare")});
  EXPECT_TRUE(undo().has_done());
  // What a killed process leaves is what has been written: read beside the one that lives.
  const auto changes = Journal::read(directory.path / "journal").changes;
  Model restored;
  for (const auto& change : changes) restored.make(change, system.system().packages());
  EXPECT_TRUE(Model::difference(restored, system.system().model()).empty());
  EXPECT_TRUE(Model::difference(system.system().model(), restored).empty());
}

TEST_P(Transactions, AFileOfTheHostsMachineIsNamedAndBroughtBackByWhoMay) {
  const Rights rights{trust::Access::Compose, trust::Access::Compose, "boss"};
  const auto undo_told = [&] {
    return answer_of([&](Waits::Answer answer) { engine.undo("test", {}, std::move(answer), rights); });
  };
  const auto told = [&](const std::vector<control::Change>& changes, bool whole = false) {
    control::Transact request;
    request.mutable_changes()->Add(changes.begin(), changes.end());
    request.set_whole(whole);
    return answer_of(
        [&](Waits::Answer answer) { engine.transact("test", request, std::move(answer), std::nullopt, rights); });
  };
  const auto notes = set_text("sink", "notes", "/home/me/notes");
  control::Change names = load("sink", "sink", group());
  *names.mutable_load()->mutable_parameters() = notes.set().parameters();
  for (const bool whole : {false, true}) {
    EXPECT_EQ(told({names}, whole).failure().what(),
              "load with notes needs the level administer (9), and 'boss' has compose (6)");
  }
  make({load("sink", "sink", group())});
  EXPECT_EQ(told({set("sink", "work_ms", 1), notes}).failure().what(),
            "set sink notes needs the level administer (9), and 'boss' has compose (6)");
  EXPECT_EQ(told({unload("sink"), names}).failure().code(), static_cast<std::uint32_t>(ErrorCode::NotAllowed));
  make({notes});
  EXPECT_TRUE(told({set("sink", "work_ms", 1), notes}).has_done()) << "it is that already";
  EXPECT_TRUE(told({set_text("sink", "notes", "")}).has_done()) << "none";
  EXPECT_EQ(undo_told().failure().what(), "set sink notes needs the level administer (9), and 'boss' has compose (6)");
  EXPECT_TRUE(undo().has_done()) << "what was there before";
}

TEST_P(Transactions, AnUndoTakesWhatItBringsBackAndWhatItTakesBack) {
  const Rights rights{trust::Access::Compose, trust::Access::Compose, "boss"};
  const auto by_boss = [&](bool dry_run) {
    control::Undo request;
    request.set_dry_run(dry_run);
    return answer_of([&](Waits::Answer answer) { engine.undo("test", request, std::move(answer), rights); });
  };
  const std::string refused = "undo of load of a path needs the level administer (9), and 'boss' has compose (6)";
  make({load("source", "source", group())});
  EXPECT_EQ(by_boss(false).failure().what(), refused);
  make({set("source", "payload", 1)});
  EXPECT_TRUE(by_boss(false).has_done());
  make({unload("source")});
  EXPECT_EQ(by_boss(false).failure().what(), refused);
  EXPECT_EQ(by_boss(true).failure().what(), refused) << "to try it would open the file";
  EXPECT_TRUE(undo().has_done());
}

constexpr std::size_t kLargeValue = 1'300'000;  ///< four in a journal, and it is folded

TEST_P(Transactions, JournalThatIsFoldedHasNothingOfAChangeThatIsHalfMade) {
  for (const std::string name : {"aside", "last"}) load_stubborn(name);
  make({load("gauge", "gauge"), set_text("gauge", "word", std::string(kLargeValue, 'a'))});
  const auto aside = begin({state("aside", "rest")});
  const auto half = begin({load("source", "half", group()), set_text("gauge", "word", std::string(kLargeValue, 'b')),
                           state("last", "rest")});
  eventually("half of it is made", [&] {
    const auto* last = system.system().model().find("half");
    return last != nullptr && system.instance("last").has_pending();
  });
  let_rest("aside");
  await_done(aside);
  const Model before = restored();
  EXPECT_EQ(before.find("half"), nullptr);
  EXPECT_EQ(before.instance("aside").mode, "rest");
  EXPECT_NE(before.instance("last").mode, "rest");
  EXPECT_EQ(before.instance("gauge").parameters->ShortDebugString().substr(0, 8), "word: \"a");
  let_rest("last");
  await_done(half);
  EXPECT_LT(std::filesystem::file_size(directory.path / "journal"), 2 * kLargeValue) << "it is folded then";
  const Model after = restored();
  EXPECT_NE(after.find("half"), nullptr);
  EXPECT_EQ(after.instance("last").mode, "rest");
  EXPECT_EQ(after.instance("gauge").parameters->ShortDebugString().substr(0, 8), "word: \"b");
}

TEST_P(Transactions, JournalTellsChangesInTheOrderInWhichTheyWereDone) {
  load_stubborn("aside");
  make({load("gauge", "gauge")});
  const auto aside = begin({state("aside", "rest")});
  for (const char value : {'a', 'b', 'c'}) make({set_text("gauge", "word", std::string(kLargeValue, value))});
  EXPECT_LT(std::filesystem::file_size(directory.path / "journal"), 6 * kLargeValue) << "it is folded";
  let_rest("aside");
  await_done(aside);
  EXPECT_EQ(restored().instance("aside").mode, "rest");
  const auto file = directory.path / "journal";
  const Journal next(file, Journal::read(file));
  EXPECT_EQ(restored().instance("aside").mode, "rest") << "for the host after the next, too";
}

TEST_P(Transactions, WhatTheJournalCouldNotTellIsNotBegun) {
  constexpr std::size_t kHalf = 9'000'000;
  make({load("gauge", "gauge"), set_text("gauge", "word", std::string(kHalf, 'a'))});
  const auto reply = transact({set_text("gauge", "word", std::string(kHalf, 'b'))});
  EXPECT_EQ(reply.failure().what(), "the change is too large for the journal");
  EXPECT_EQ(reply.failure().expected(), "16777216 bytes, with what takes it back");
  EXPECT_EQ(restored().instance("gauge").parameters->ShortDebugString().substr(0, 8), "word: \"a");
  make({load("source", "source")});
  EXPECT_NE(restored().find("source"), nullptr);
}

TEST_P(Transactions, WhatCouldNotBeTakenBackIsInTheJournalAndMayBeUndone) {
  for (const std::string name : {"throws.interface.textproto", "libthrows.so"})
    std::filesystem::copy_file(std::filesystem::path(ZOO_DIRECTORY) / name, directory.path / name);
  control::Change gone = load("", "one", group());
  gone.mutable_load()->set_plugin((directory.path / "libthrows.so").string() + "/std-in-stop");
  make({gone});
  std::filesystem::remove(directory.path / "libthrows.so");
  const auto refused = transact({unload("one"), load("source", "two", group()), state("two", "no-such-mode")});
  ASSERT_TRUE(refused.has_failure());
  EXPECT_THAT(refused.failure().found(), HasSubstr("could not be taken back"));
  EXPECT_THAT(whole(), ElementsAre());
  const auto entries = engine.journal(2);
  EXPECT_EQ(entries.entries(0).state(), control::JournalEntry::ROLLED_BACK);
  EXPECT_EQ(entries.entries(1).state(), control::JournalEntry::DONE);
  EXPECT_THAT(texts(entries.entries(1).steps()), ElementsAre("unload one"));
  make({load("sink", "one", group())});
  EXPECT_EQ(restored().instance("one").component, "sink");
}

TEST_P(Transactions, WhoLooksIsToldThatAChangeOfModeIsUnderWay) {
  load_stubborn("aside");
  EXPECT_TRUE(engine.is_at_rest());
  const auto aside = begin({state("aside", "rest")});
  EXPECT_FALSE(engine.is_at_rest());
  let_rest("aside");
  await_done(aside);
  EXPECT_TRUE(engine.is_at_rest());
}

TEST_P(Transactions, PlanOfAWholeSystemTellsWhatIsLost) {
  make({load("source", "source")});
  const auto reply = transact({load("source", "source", "elsewhere")}, true, true);
  ASSERT_TRUE(reply.has_planned()) << reply.failure().what();
  ASSERT_EQ(reply.planned().warnings_size(), 1);
  EXPECT_THAT(reply.planned().warnings(0), HasSubstr("'source'"));
}

TEST_P(Transactions, JournalThatWasCutOrDamagedAtAnyByteGivesAStateThatWasOnceTrueOrIsRefused) {
  make({load("source", "source")});
  make({load("source", "spare")});
  const std::string whole = bytes_of(directory.path / "journal");
  const auto all = texts(Journal::told_by(whole).changes);
  ASSERT_EQ(all.size(), 2U);
  const auto check = [&](const std::string& bytes, std::size_t first_damaged) {
    std::ofstream(directory.path / "damaged", std::ios::binary) << bytes;
    try {
      const Journal::Told told = Journal::read(directory.path / "damaged");
      const auto changes = texts(told.changes);
      EXPECT_TRUE(std::equal(changes.begin(), changes.end(), all.begin())) << "at " << first_damaged;
      EXPECT_LE(told.bytes, first_damaged);
      EXPECT_EQ(told.bytes + told.damaged, bytes.size());
    } catch (const Error& error) {
      EXPECT_LT(first_damaged, 8U) << error.what();
      EXPECT_EQ(error.text().what,
                "the journal cannot be read: its first record is damaged, and there is none before it");
    }
  };
  for (std::size_t size = 0; size < whole.size(); ++size) check(whole.substr(0, size), size);
  for (std::size_t at = 0; at < whole.size(); ++at) {
    std::string damaged = whole;
    damaged[at] = static_cast<char>(damaged[at] ^ (1 << (at % 8)));
    check(damaged, at);
  }
}

TEST_P(Transactions, JournalOfWhichNothingCanBeReadGivesTheOneBeforeItAndSaysSo) {
  make({load("source", "source")});
  const auto file = directory.path / "journal";
  std::filesystem::copy_file(file, file.string() + ".old");
  std::ofstream(file, std::ios::binary) << "rubbish";
  const Journal::Told told = Journal::read(file);
  EXPECT_TRUE(told.older);
  EXPECT_EQ(told.damaged, 7U);
  EXPECT_EQ(told.changes.size(), 1U);
}

TEST_P(Transactions, JournalGoesOnWhereTheHostBeforeHasEnded) {
  make({load("source", "source")});
  make({load("source", "spare")});
  EXPECT_TRUE(undo().has_done());
  const auto file = directory.path / "journal";
  const auto before = texts(Journal::read(file).changes);
  Mailbox<std::function<void()>> work;
  Engine next(
      system.system(), file, [&](std::function<void()> job) { work.push(std::move(job)); }, Journal::read(file));
  EXPECT_EQ(texts(Journal::read(file).changes), before);
  control::Undo request;
  std::optional<control::Reply> undone;
  next.undo("test", request, [&](const control::Reply& reply) { undone = reply; });
  ASSERT_TRUE(undone && undone->has_done()) << "what was undone then is not undone again, but what came before it";
  EXPECT_EQ(system.system().model().find("source"), nullptr);
}

TEST_P(Transactions, JournalThatBeginsAnewSetsTheOneBeforeAside) {
  make({load("source", "source")});
  const auto file = directory.path / "journal";
  const std::string before = bytes_of(file);
  const Journal next(file);
  EXPECT_EQ(bytes_of(file.string() + ".old"), before);
  EXPECT_TRUE(Journal::read(file).changes.empty());
}

TEST_P(Transactions, JournalThatWasDamagedIsKeptBesideTheOneThatGoesOn) {
  make({load("source", "source")});
  const auto file = directory.path / "journal";
  const std::string damaged = bytes_of(file) + "half a record";
  std::ofstream(file, std::ios::binary) << damaged;
  const Journal next(file, Journal::read(file));
  EXPECT_EQ(bytes_of(file.string() + ".damaged"), damaged);
  EXPECT_EQ(Journal::read(file).damaged, 0U);
  EXPECT_EQ(Journal::read(file).changes.size(), 1U);
}

INSTANTIATE_TEST_SUITE_P(Over, Transactions,
                         testing::Values(conformance::Transport::Process, conformance::Transport::Ipc),
                         [](const auto& tested) { return to_string(tested.param); });

TEST(Engine, AChangeThatEndsAfterManyOthersIsInTheJournal) {
  const TemporaryDirectory directory;
  const auto file = directory.path / "journal";
  Journal journal(file);
  const auto begin = [&journal](const control::Change& step) {
    control::JournalEntry entry;
    *entry.add_steps() = step;
    return journal.begin(std::move(entry));
  };
  const auto slow = begin(state("source", "rest"));
  for (std::size_t i = 0; i <= Journal::kMaxEntries; ++i)
    journal.end(begin(set("source", "payload", 1)), control::JournalEntry::DONE, "", nullptr);
  journal.end(slow, control::JournalEntry::DONE, "", nullptr);
  EXPECT_EQ(journal.entries().size(), Journal::kMaxEntries);
  EXPECT_EQ(text(Journal::read(file).changes.back()), "state source rest");
}

/// An engine for a system with a source, of which one change may be under way.
class EngineBounds : public testing::Test {
 protected:
  void SetUp() override { system.load_provider("source", "source"); }
  control::Transact slow() const {
    control::Transact request;
    *request.add_changes() = state("source", "neutral");
    *request.add_changes() = state("source", "active");
    return request;
  }
  static control::Transact plan_of(std::size_t changes) {
    control::Transact request;
    request.set_dry_run(true);
    for (std::size_t i = 0; i < changes; ++i) *request.add_changes() = set("source", "payload", 1);
    return request;
  }
  /// Why it is not taken.
  std::optional<Error> refusal(const control::Transact& request) {
    try {
      engine.transact("test", request, [](const control::Reply&) {});
    } catch (const Error& error) {
      return error;
    }
    return std::nullopt;
  }
  control::Reply plan(std::size_t changes, trust::Access level) {
    control::Reply told;
    engine.transact("test", plan_of(changes), [&told](const control::Reply& reply) { told = reply; }, std::nullopt,
                    {level, level});
    return told;
  }

  TemporaryDirectory directory;
  Mailbox<std::function<void()>> work;
  RunningSystem system;
  Engine engine{system.system(), directory.path / "journal",
                [this](std::function<void()> job) { work.push(std::move(job)); }};
};

TEST_F(EngineBounds, ChangesThatWaitAreBounded) {
  for (std::size_t i = 0; i <= Engine::kMaxWaiting; ++i) ASSERT_FALSE(refusal(slow()));
  const auto error = refusal(slow());
  ASSERT_TRUE(error);
  EXPECT_EQ(error->code(), ErrorCode::NotAllowed);
  EXPECT_EQ(error->text().what, "256 changes wait already");
}

TEST_F(EngineBounds, PlansThatWaitAreBoundedAndTakeNoPlacesOfChanges) {
  ASSERT_FALSE(refusal(slow()));
  for (std::size_t i = 0; i < Engine::kMaxPlansWaiting; ++i) ASSERT_FALSE(refusal(plan_of(1)));
  const auto error = refusal(plan_of(1));
  ASSERT_TRUE(error);
  EXPECT_EQ(error->text().what, "16 plans wait already");
  for (std::size_t i = 0; i < Engine::kMaxWaiting; ++i) ASSERT_FALSE(refusal(slow())) << i;
  EXPECT_TRUE(refusal(slow()));
}

TEST_F(EngineBounds, WhoCouldNotMakeThemPlansAFewHundredChanges) {
  EXPECT_TRUE(plan(Engine::kMostPlanned, trust::Access::Observe).has_planned());
  const auto refused = plan(Engine::kMostPlanned + 1, trust::Access::Observe);
  EXPECT_EQ(refused.failure().what(),
            "a plan of more than 256 steps needs the level compose (6), and this console has observe (1)");
  EXPECT_TRUE(plan(Engine::kMostPlanned + 1, trust::Access::Compose).has_planned());
}

}  // namespace
}  // namespace fiona::host
