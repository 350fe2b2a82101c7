// A group whose process does not answer: nobody else waits for it, it is shown as what it is, and what it was not asked
// in time it does not do later.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <signal.h>

#include "fiona/error.hpp"
#include "served_host.hpp"

namespace fiona::host {
namespace {

using conformance::ServedHost;
using conformance::TestConsole;
using testing::HasSubstr;
using testing::StartsWith;
using namespace std::chrono_literals;

using Steady = std::chrono::steady_clock;

class GroupThatIsSilent : public testing::Test {
 protected:
  GroupThatIsSilent() {
    console.load("source", "far");
    console.load("sink", "main");
    process = console.process_of("far");
  }
  ~GroupThatIsSilent() override { ::kill(process, SIGCONT); }

  control::InstanceStatus source() {
    const auto system = console.snapshot();
    return system.instances(0);
  }
  static control::Change set_period(std::int64_t period_ms) {
    control::Change change;
    change.mutable_set()->set_instance("source");
    auto& argument = *change.mutable_set()->add_parameters();
    argument.set_name("period_ms");
    argument.mutable_value()->set_integer(period_ms);
    return change;
  }
  Error refusal_of(control::Change change) {
    try {
      console.change(std::move(change));
    } catch (const Error& error) {
      return error;
    }
    throw std::runtime_error("it was taken");
  }
  void stop() { ASSERT_EQ(::kill(process, SIGSTOP), 0); }
  void let_go_on() {
    ASSERT_EQ(::kill(process, SIGCONT), 0);
    const auto end = Steady::now() + 20s;
    while (source().silent_s() > 0) {
      if (Steady::now() > end) throw std::runtime_error("it stays silent");
    }
  }

  ServedHost host;
  TestConsole console{host};
  pid_t process = 0;
};

TEST_F(GroupThatIsSilent, IsShownWithSinceWhenAndWithWhatWasAskedForAndTheOthersAsTheyAre) {
  console.change(set_period(7));
  stop();
  const auto system = console.snapshot();
  const auto& silent = system.instances(0);
  EXPECT_EQ(silent.name(), "source");
  EXPECT_GT(silent.silent_s(), 0.2);
  EXPECT_THAT(silent.reason(), StartsWith("its process does not answer, since 0."));
  EXPECT_EQ(silent.mode(), "active");
  EXPECT_EQ(silent.group(), "far");
  EXPECT_EQ(silent.set_parameters(0).value().number(), 7);
  EXPECT_EQ(system.instances(1).silent_s(), 0);
  EXPECT_GT(system.instances(1).tasks_size(), 0) << "the other instance is asked itself";
  let_go_on();
  EXPECT_EQ(source().reason(), "");
}

TEST_F(GroupThatIsSilent, HoldsUpEachConsoleOnceAndNotLongerThanTheHostsPatience) {
  stop();
  TestConsole other(host);
  const auto begun = Steady::now();
  auto look = console.request();
  look.mutable_snapshot();
  console.send(look);
  other.snapshot();
  EXPECT_LT(Steady::now() - begun, 2500ms) << "300 ms, on an idle machine";
  EXPECT_EQ(console.receive().system().instances_size(), 2);
  const auto again = Steady::now();
  for (int i = 0; i < 20; ++i) other.snapshot();
  EXPECT_LT(Steady::now() - again, 20 * 300ms) << "one that is known to be silent is not waited for again";
}

TEST_F(GroupThatIsSilent, RefusesAChangeWithWhatCanBeDoneAndChangesNothing) {
  stop();
  const auto begun = Steady::now();
  const Error first = refusal_of(set_period(9));
  EXPECT_LT(Steady::now() - begun, 6s) << "three seconds, on an idle machine";
  EXPECT_EQ(first.code(), ErrorCode::Unreachable);
  EXPECT_EQ(first.text().what, "group 'far' does not answer");
  EXPECT_THAT(first.text().found, StartsWith("silent for "));
  EXPECT_EQ(first.text().next, "wait for it, or end its process: kill -KILL " + std::to_string(process));
  const auto again = Steady::now();
  EXPECT_EQ(refusal_of(set_period(11)).code(), ErrorCode::Unreachable);
  EXPECT_LT(Steady::now() - again, 2500ms) << "refused at once";
  EXPECT_EQ(source().set_parameters_size(), 0);
}

TEST_F(GroupThatIsSilent, DoesNotDoLaterWhatWasRefusedMeanwhile) {
  stop();
  refusal_of(set_period(9));
  control::Change unload;
  unload.mutable_unload()->set_instance("source");
  EXPECT_EQ(refusal_of(unload).code(), ErrorCode::Unreachable);
  let_go_on();
  const auto status = source();
  EXPECT_EQ(status.name(), "source");
  EXPECT_EQ(status.mode(), "active");
  EXPECT_EQ(status.set_parameters_size(), 0);
  console.change(set_period(9));
  EXPECT_EQ(source().set_parameters(0).value().number(), 9);
}

TEST_F(GroupThatIsSilent, IsUnwiredWithoutItAndTheWireIsGoneWhenItGoesOn) {
  console.change(TestConsole::wire_of("sink.each", "source.newest"));
  stop();
  control::Change unload;
  unload.mutable_unload()->set_instance("sink");
  EXPECT_THAT(console.change(unload).note(), HasSubstr("unloaded sink"));
  let_go_on();
  const auto status = source();
  for (const auto& port : status.ports()) EXPECT_EQ(port.clients_size(), 0) << port.name();
}

TEST_F(GroupThatIsSilent, IsWaitedForByAWaitForAModeWhichEndsInItsOwnTime) {
  stop();
  auto wait = console.request();
  wait.mutable_wait_mode()->set_instance("source");
  wait.mutable_wait_mode()->set_mode("neutral");
  wait.mutable_wait_mode()->set_within_ms(50);
  console.send(wait);
  try {
    console.receive();
    FAIL() << "it reached the mode";
  } catch (const Error& error) {
    EXPECT_EQ(error.text().what, "'source' did not reach mode neutral within 50 ms");
  }
}

TEST_F(GroupThatIsSilent, IsLostWithItsReasonWhenItIsKilledMeanwhile) {
  stop();
  refusal_of(set_period(9));
  ::kill(process, SIGKILL);
  const auto end = Steady::now() + 20s;
  while (source().mode() != "failed" && Steady::now() < end) continue;
  EXPECT_EQ(source().reason(), "group 'far' killed by signal 9 (Killed)");
  EXPECT_EQ(source().silent_s(), 0);
  control::Change unload;
  unload.mutable_unload()->set_instance("source");
  console.change(unload);
  EXPECT_EQ(console.snapshot().instances_size(), 1);
}

}  // namespace
}  // namespace fiona::host
