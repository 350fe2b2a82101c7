// What rings a fixed time after it was set.
#include <gtest/gtest.h>

#include <atomic>
#include <chrono>
#include <thread>

#include "alarm.hpp"
#include "fiona/pool.hpp"

namespace fiona::host {
namespace {

using namespace std::chrono_literals;
using Steady = std::chrono::steady_clock;

bool becomes(const std::atomic<int>& count, int wanted) {
  for (const auto end = Steady::now() + 20s; count != wanted && Steady::now() < end;) std::this_thread::sleep_for(1ms);
  return count == wanted;
}

TEST(Alarm, RingsOnceHoweverOftenItIsSetMeanwhileAndNotBeforeItsTime) {
  Pool pool{2};
  std::atomic<int> rung{0};
  std::atomic<Steady::time_point> last{};
  Alarm alarm(pool, 50ms, [&] {
    last = Steady::now();
    ++rung;
  });
  const auto set = Steady::now();
  for (int i = 0; i < 10; ++i) alarm.set();
  EXPECT_TRUE(becomes(rung, 1));
  EXPECT_GE(last.load() - set, 50ms);
  std::this_thread::sleep_for(120ms);
  EXPECT_EQ(rung, 1) << "it was not set again";
  alarm.set();
  EXPECT_TRUE(becomes(rung, 2));
}

TEST(Alarm, MayBeSetAgainWhileItRings) {
  Pool pool{2};
  std::atomic<int> rung{0};
  Alarm* again = nullptr;
  Alarm alarm(pool, 1ms, [&] {
    if (++rung < 5) again->set();
  });
  again = &alarm;
  alarm.set();
  EXPECT_TRUE(becomes(rung, 5));
}

TEST(Alarm, ItsEndWaitsForTheCallAndNoneComesAfterIt) {
  Pool pool{2};
  std::atomic<int> rung{0};
  for (int i = 0; i < 50; ++i) {
    int alive = 1;
    {
      Alarm alarm(pool, 100us, [&] { rung += alive; });
      alarm.set();
      std::this_thread::sleep_for(std::chrono::microseconds(40 * (i % 5)));
    }
    alive = 1000;
  }
  EXPECT_LE(rung, 50);
}

}  // namespace
}  // namespace fiona::host
