// What is delivered on a virtual clock, in a file.
#include "delivery_log.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <chrono>
#include <memory>

namespace fiona::host {
namespace {

using namespace std::chrono_literals;
using testing::HasSubstr;

constexpr const char* kFull = "/dev/full";

TEST(DeliveryLog, ThatHasNoRoomSaysSoOnceTheInstantIsOver) {
  DeliveryLog log(kFull);
  log.delivered(TimePoint(1s), "sink.each", 1, "taken");
  EXPECT_EQ(log.failure(), "");
  log.round(TimePoint(2s));
  EXPECT_EQ(log.failure(), "No space left on device");
}

TEST(DeliveryLog, ThatHasNoRoomForItsLastInstantSaysSoAtItsEnd) {
  auto log = std::make_unique<DeliveryLog>(kFull);
  log->delivered(TimePoint(1s), "sink.each", 1, "taken");
  testing::internal::CaptureStderr();
  log.reset();
  EXPECT_THAT(testing::internal::GetCapturedStderr(),
              HasSubstr("the delivery log /dev/full cannot be written: No space left on device; it is not whole"));
}

TEST(DeliveryLog, SaysOnceThatItHasNoRoom) {
  auto log = std::make_unique<DeliveryLog>(kFull);
  log->delivered(TimePoint(1s), "sink.each", 1, "taken");
  log->round(TimePoint(2s));
  EXPECT_EQ(log->failure(), "No space left on device");
  testing::internal::CaptureStderr();
  log.reset();
  EXPECT_EQ(testing::internal::GetCapturedStderr(), "");
}

}  // namespace
}  // namespace fiona::host
