// The limit of age that a port of a push may have (docs/patterns.md, Push newest).
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>

#include "fiona/push.hpp"
#include "fiona/result.hpp"
#include "fiona/sdk_test/objects.fiona.hpp"
#include "fiona/testing/bench.hpp"
#include "support.hpp"

namespace fiona::sdk_test {
namespace {

using namespace std::chrono_literals;
using ::testing::ElementsAre;

/// Takes 300 ms for each number that it hears.
class Slow final : public Component {
 public:
  using Component::Component;
  Async<> on_number(const Number& number) {
    passed_.put(number);
    static_cast<void>(co_await never_.wait_update(300ms));
  }

 private:
  Provides<Numbers> passed_{*this, "passed"};
  Requires<Numbers> each_{*this, "each", &Slow::on_number, {.max_age = 500ms}};
  Requires<Numbers> latest_{*this, "latest", {.max_age = 500ms}};
  Requires<Numbers> never_{*this, "never"};
};

Requires<Numbers>& port(testing::Bench<Slow>& bench, std::string_view name) {
  const auto& all = bench.hull().ports();
  return dynamic_cast<Requires<Numbers>&>(
      **std::find_if(all.begin(), all.end(), [name](const Port* one) { return one->name() == name; }));
}

TEST(Age, WhatHasBecomeTooOldWhileItWaitedReachesNoHandlerAndIsCountedAsDropped) {
  testing::Bench<Slow> bench;
  bench.start();
  for (std::uint64_t i = 1; i <= 4; ++i) bench.put<Numbers>("each", numbered(i));
  bench.advance(2s);
  std::vector<std::uint64_t> passed;
  for (const auto& one : bench.take<Numbers>("passed")) passed.push_back(one->value());
  EXPECT_THAT(passed, ElementsAre(1, 2)) << "the third had waited for 600 ms";
  EXPECT_EQ(port(bench, "each").counters().dropped, 2U);
}

TEST(Age, ValueThatIsTooOldIsNotTheLatest) {
  testing::Bench<Slow> bench;
  bench.start();
  bench.put<Numbers>("latest", numbered(7));
  bench.advance(499ms);
  EXPECT_EQ((*port(bench, "latest").latest())->value(), 7U);
  bench.advance(2ms);
  EXPECT_EQ(port(bench, "latest").latest().outcome(), Outcome::NoData);
}

}  // namespace
}  // namespace fiona::sdk_test
