// What a port refuses is kept, and told to the log while that says something new.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <limits>

#include "fiona/sdk_test/objects.fiona.hpp"
#include "fiona/testing/inline_executor.hpp"
#include "support.hpp"

namespace fiona::sdk_test {
namespace {

using namespace std::chrono_literals;
using ::testing::ElementsAre;
using ::testing::SizeIs;

class KeptLog final : public HullEvents {
 public:
  void mode_changed(const std::string&, const std::string&, const std::string&) override {}
  void run_ended(const std::string&, int, const std::string&) override {}
  void logged(const std::string&, LogLevel, std::string_view text) override { lines.emplace_back(text); }
  void asked(const std::string&, std::uint64_t, const control::Request&) override {}
  std::vector<std::string> lines;
};

class Maker final : public Component {
 public:
  using Component::Component;
  Provides<RuledObjects> objects{*this, "objects"};
  Requires<RuledObjects> others{*this, "others"};
};

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
const std::string kNotFinite = "length is nan, not a finite number";
const std::string kAbove = "inner.angle is 100, above 3.2 rad";

class Refusals : public ::testing::Test {
 protected:
  Refusals() { maker.hull.set_mode(kModeActive, kLimit); }
  Outcome put(double length, double angle = 0) {
    Ruled object;
    object.set_length(length);
    object.mutable_inner()->set_angle(angle);
    Outcome outcome = Outcome::Ok;
    maker.hull.strand().call([&] { outcome = maker->objects.put(std::move(object)); }, kLimit);
    return outcome;
  }
  void advance(Duration duration) {
    clock.stop_at(clock.now() + duration, [this] { clock.hold(); });
    clock.release();
    executor.help();
  }
  std::string last() const {
    const auto refusal = maker->objects.counters().last_refusal();
    return refusal ? refusal->reason : "";
  }

  VirtualClock clock;
  testing::InlineExecutor executor;
  KeptLog log;
  Made<Maker> maker{"maker", executor, clock, log};
};

TEST_F(Refusals, TheLastIsKept) {
  EXPECT_EQ(last(), "");
  EXPECT_EQ(put(kNan), Outcome::Rejected);
  EXPECT_EQ(last(), kNotFinite);
  EXPECT_EQ(put(1), Outcome::Ok);
  EXPECT_EQ(put(1, 100), Outcome::Rejected);
  EXPECT_EQ(last(), kAbove);
  EXPECT_EQ(maker->objects.counters().refused, 2U);
}

TEST_F(Refusals, TheLogIsToldOfEachThatIsAnother) {
  put(kNan);
  advance(11s);
  put(kNan);
  put(1, 100);
  EXPECT_THAT(log.lines,
              ElementsAre("maker.objects refused a put: " + kNotFinite, "maker.objects refused a put: " + kAbove));
}

TEST_F(Refusals, ANumberThatIsAnotherEachTimeDoesNotFillTheLog) {
  for (int i = 0; i < 100; ++i) {
    put(100 + i);
    advance(100ms);
  }
  EXPECT_THAT(log.lines, SizeIs(1));
  advance(100ms);
  put(99);
  EXPECT_THAT(log.lines, SizeIs(2));
}

TEST_F(Refusals, APortThatNobodyWiredIsUnwiredSinceItWasMade) {
  advance(90s);
  Made<Maker> late("late", executor, clock, log);
  advance(5s);
  EXPECT_EQ(clock.now() - late->others.connection_since(), 5s);
}

}  // namespace
}  // namespace fiona::sdk_test
