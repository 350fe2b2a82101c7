// A step of the machine's wall clock (a time server, somebody's hand) changes nothing for instances. An executable of
// its own: its clock_gettime takes the place of the C library's.
#include <gtest/gtest.h>
#include <sys/syscall.h>
#include <time.h>
#include <unistd.h>

#include <atomic>
#include <cstdlib>
#include <future>
#include <string>

#include "fiona/clock.hpp"
#include "fiona/pool.hpp"
#include "fiona/strand.hpp"

namespace {
std::atomic<long> step_s{0};
}

extern "C" int clock_gettime(clockid_t id, timespec* time) noexcept {
  const auto result = static_cast<int>(::syscall(SYS_clock_gettime, id, time));
  if (id == CLOCK_REALTIME) time->tv_sec += step_s;
  return result;
}

namespace fiona {
namespace {

using namespace std::chrono_literals;

class WallClock : public testing::TestWithParam<long> {};

TEST_P(WallClock, ThatStepsChangesNeitherTimeNorPeriods) {
  SystemClock clock;
  Pool pool(2);
  const auto strand = std::make_shared<Strand>("strand", pool, clock);
  const TimePoint before = clock.now();
  const auto wall_before = std::chrono::system_clock::now();
  step_s = GetParam();
  ASSERT_GT(std::chrono::abs(std::chrono::system_clock::now() - wall_before), 30min)
      << "the step is seen by who looks there";
  EXPECT_GE(clock.now(), before);
  EXPECT_LT(clock.now() - before, 10s);
  std::promise<void> fired;
  clock.schedule(before + 50ms, strand, [&fired] { fired.set_value(); });
  EXPECT_EQ(fired.get_future().wait_for(10s), std::future_status::ready);
  EXPECT_GE(clock.now() - before, 50ms);
  clock.stop();
  step_s = 0;
}

constexpr long kHour_s = 3600;
constexpr long kTenYears_s = 10L * 365 * 24 * kHour_s;

INSTANTIATE_TEST_SUITE_P(By, WallClock, testing::Values(kHour_s, -kHour_s, kTenYears_s, -kTenYears_s),
                         [](const auto& one) {
                           return std::string(std::abs(one.param) == kHour_s ? "AnHour" : "TenYears") +
                                  (one.param > 0 ? "Forward" : "Back");
                         });

}  // namespace
}  // namespace fiona
