// Calls by hand: who does not wait for the answer any more leaves nothing behind.
#include <gtest/gtest.h>
#include <malloc.h>

#include <optional>

#include "served_host.hpp"

namespace fiona::conformance {
namespace {

class CallsByHand : public testing::TestWithParam<Transport> {
 protected:
  void SetUp() override { console.load("answerer", host.place()); }
  /// Of one that is never answered.
  static control::Request call(TestConsole& by, const std::string& arguments) {
    auto request = by.request();
    *request.mutable_call()->mutable_target() = port_name("answerer.echo");
    add_arguments(arguments, *request.mutable_call()->mutable_arguments());
    request.mutable_call()->set_within_ms(3'600'000);
    return request;
  }
  std::uint64_t read(const std::string& probe) {
    auto look = console.request();
    *look.mutable_read()->mutable_probe() = port_name(probe);
    probe::Integer value;
    value.ParseFromString(console.ask(look).sample().object());
    return static_cast<std::uint64_t>(value.value());
  }

  ServedHost host{GetParam()};
  TestConsole console{host};
};

TEST_P(CallsByHand, AreTakenBackWhereTheyWereMadeOnceNobodyWaits) {
  std::optional<TestConsole> other(std::in_place, host);
  const auto first = call(*other, "manner=never");
  other->send(first);
  other->send(call(*other, "manner=never"));
  console.eventually("both are kept", [&] { return read("answerer.open") == 2; });
  EXPECT_EQ(read("answerer.abandoned"), 0U);
  auto stop = other->request();
  stop.mutable_unwatch()->set_watch(first.id());
  EXPECT_TRUE(other->ask(stop).has_done());
  console.eventually("the one that was given up is known to be", [&] { return read("answerer.abandoned") == 1; });
  other.reset();
  console.eventually("so is that of the console that has gone", [&] { return read("answerer.abandoned") == 2; });
}

FIONA_OVER_EVERY_TRANSPORT(CallsByHand);

/// In this process.
TEST(AnsweredCallsByHand, LeaveNothingThatWaitsForTheirDeadlines) {
  constexpr int kCalls = 1000;
  RunningSystem system;
  system.load_in("main", "answerer", "answerer");
  const auto make = [&system](int calls) {
    for (int i = 0; i < calls; ++i) ASSERT_EQ(system.call("answerer.echo", "number=1", 3'600'000).outcome(), "ok");
  };
  make(kCalls / 10);
  const std::size_t before = ::mallinfo2().uordblks;
  make(kCalls);
  const std::size_t after = ::mallinfo2().uordblks;
  EXPECT_LT(after, before + kCalls * 64) << "bytes";
}

}  // namespace
}  // namespace fiona::conformance
