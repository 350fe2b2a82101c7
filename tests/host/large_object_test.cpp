// Objects that are too large for the way to the host, and to a console: what looks at them is told, and nothing ends.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "fiona/error.hpp"
#include "served_host.hpp"

namespace fiona::host {
namespace {

using conformance::ServedHost;
using conformance::TestConsole;
using testing::AllOf;
using testing::HasSubstr;

class LargeForTheHost : public testing::TestWithParam<std::string> {
 protected:
  control::Request watch(const std::string& port) {
    auto watch = console.request();
    *watch.mutable_watch()->mutable_port() = conformance::port_name(port);
    return watch;
  }
  Error refusal_of(const control::Request& request) {
    try {
      while (console.ask(request).has_sample()) continue;
    } catch (const Error& error) {
      return error;
    }
    throw std::runtime_error("it was not refused");
  }

  ServedHost host;
  TestConsole console{host};
};

TEST_P(LargeForTheHost, ThatIsWatchedEndsTheWatchWithASentenceAndNothingElse) {
  console.load("source", GetParam(), "source", "period_ms=20 payload=20971520");
  const pid_t process = console.process_of(GetParam());
  const Error refused = refusal_of(watch("source.newest"));
  EXPECT_THAT(refused.text().what, AllOf(HasSubstr("source.newest"), HasSubstr("too large to be watched")));
  EXPECT_EQ(refused.text().expected, "at most 15728640 bytes");
  EXPECT_THAT(refused.text().found, HasSubstr("209715"));
  EXPECT_EQ(console.process_of(GetParam()), process);
  EXPECT_EQ(console.instance("source").mode(), "active");
}

TEST_P(LargeForTheHost, ThatIsAnsweredRejectsTheCallWithASentence) {
  console.load("answerer", GetParam(), "answerer");
  const pid_t process = console.process_of(GetParam());
  auto call = console.request();
  *call.mutable_call()->mutable_target() = conformance::port_name("answerer.echo");
  conformance::add_arguments("manner=large", *call.mutable_call()->mutable_arguments());
  const auto called = console.ask(call).called();
  EXPECT_EQ(called.outcome(), "rejected");
  EXPECT_THAT(called.reason(), HasSubstr("is too large: 209715"));
  EXPECT_THAT(called.reason(), HasSubstr("bytes, of at most 15728640"));
  EXPECT_EQ(console.process_of(GetParam()), process);
}

/// More than the socket between them takes at once.
TEST_P(LargeForTheHost, ThatFitsComesAndGoes) {
  constexpr std::size_t kBytes = 8U << 20U;
  console.load("answerer", GetParam(), "answerer");
  auto call = console.request();
  *call.mutable_call()->mutable_target() = conformance::port_name("answerer.echo");
  auto& payload = *call.mutable_call()->add_arguments();
  payload.set_name("payload");
  payload.mutable_value()->set_text(std::string(kBytes, 'x'));
  const auto called = console.ask(call).called();
  EXPECT_EQ(called.outcome(), "ok") << called.reason();
  EXPECT_GT(called.result().object().size(), kBytes);
}

/// Of several watches at once, more than the socket may hold.
TEST_P(LargeForTheHost, OfWhichManyAreWatchedEndNothing) {
  console.load("source", GetParam(), "source", "period_ms=10 payload=14000000");
  const pid_t process = console.process_of(GetParam());
  for (int i = 0; i < 4; ++i) console.send(watch("source.newest"));
  for (int i = 0; i < 12; ++i) EXPECT_TRUE(console.receive().has_sample());
  EXPECT_EQ(TestConsole(host).process_of(GetParam()), process);
}

INSTANTIATE_TEST_SUITE_P(In, LargeForTheHost, testing::Values("main", "far"),
                         [](const auto& one) { return one.param; });

}  // namespace
}  // namespace fiona::host
