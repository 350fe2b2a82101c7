// Components that each break one promise of their services, and one that keeps them all: for the tests of
// fiona-contract.
#include <fiona/component.hpp>
#include <fiona/plugin.hpp>

#include <chrono>
#include <csignal>
#include <limits>
#include <stdexcept>

#include "fiona/hmi.fiona.hpp"
#include "fiona/localisation.fiona.hpp"
#include "fiona/navigation.fiona.hpp"
#include "fiona/sensors.fiona.hpp"
#include "fiona/zoo/pace.pb.h"

namespace zoo {

using namespace std::chrono_literals;
using fiona::localisation::CommLocation;
using fiona::localisation::LocationProvider;
using fiona::localisation::StepProvider;
using fiona::navigation::CommRasterMapInfo;
using fiona::navigation::CommRasterMapInfoRequest;
using fiona::navigation::RasterMapInfoProvider;

/// Serves a timed push; what it says, and when, is in the derived class.
class Locator : public fiona::Component {
 public:
  using Component::Component;

 protected:
  virtual void say() = 0;
  void put(CommLocation object) { location_.put(std::move(object)); }
  void put_with_confidence(std::initializer_list<double> elements) {
    CommLocation object;
    for (const double element : elements) object.mutable_position()->add_confidence(element);
    put(std::move(object));
  }

 private:
  fiona::Provides<LocationProvider> location_{*this, "location", &Locator::say};
};

struct KeepsAll final : Locator {
  using Locator::Locator;
  void say() override { put_with_confidence({2, 1, 0, 1, 2, 0, 0, 0, 0}); }
};
struct SaysEachSecondTime final : Locator {
  using Locator::Locator;
  int times = 0;
  void say() override {
    if (++times % 2 == 0) put({});
  }
};
struct SaysTwiceATime final : Locator {
  using Locator::Locator;
  void say() override {
    put({});
    put({});
  }
};
struct SaysNothing final : Locator {
  using Locator::Locator;
  void say() override {}
};
struct NegativeVariance final : Locator {
  using Locator::Locator;
  void say() override { put_with_confidence({1, 0, 0, 0, -1, 0, 0, 0, 1}); }
};
/// Each variance is positive, and each two elements across the diagonal are equal: that makes no covariance yet.
struct TooStrongCorrelation final : Locator {
  using Locator::Locator;
  void say() override { put_with_confidence({1, 2, 0, 2, 1, 0, 0, 0, 1}); }
};
struct AsymmetricCovariance final : Locator {
  using Locator::Locator;
  void say() override { put_with_confidence({1, 0.5, 0, 0, 1, 0, 0, 0, 1}); }
};
struct ShortCovariance final : Locator {
  using Locator::Locator;
  void say() override { put_with_confidence({1, 0, 0, 1}); }
};
struct OutOfRange final : Locator {
  using Locator::Locator;
  void say() override {
    CommLocation object;
    object.mutable_orientation()->set_yaw(9);
    put(std::move(object));
  }
};
struct NotANumber final : Locator {
  using Locator::Locator;
  void say() override {
    CommLocation object;
    object.mutable_position()->set_x(std::numeric_limits<double>::quiet_NaN());
    put(std::move(object));
  }
};
struct ThrowsAfterAWhile final : Locator {
  using Locator::Locator;
  int times = 0;
  void say() override {
    if (++times > 3) throw std::runtime_error("no more");
    put({});
  }
};
struct Crashes final : Locator {
  using Locator::Locator;
  void say() override { std::raise(SIGKILL); }
};
struct DoesNotStart final : Locator {
  using Locator::Locator;
  void on_start() override { throw std::runtime_error("no sensor here"); }
  void say() override { put({}); }
};

/// Puts some objects and then no more, though its service has a lease.
class FallsSilent final : public fiona::Component {
 public:
  using Component::Component;

 private:
  void say() {
    if (++times_ < 5) steps_.put(fiona::localisation::CommStep());
  }

  int times_ = 0;
  fiona::Provides<StepProvider> steps_{*this, "steps"};
  fiona::Task sayer_{*this, "sayer", 100ms, &FallsSilent::say};
};

class NeverAnswers final : public fiona::Component {
 public:
  using Component::Component;

 private:
  void answer(const CommRasterMapInfoRequest&, fiona::Reply<CommRasterMapInfo> reply) { kept_ = std::move(reply); }

  std::optional<fiona::Reply<CommRasterMapInfo>> kept_;
  fiona::Provides<RasterMapInfoProvider> info_{*this, "info", &NeverAnswers::answer};
};

class DropsRequests final : public fiona::Component {
 public:
  using Component::Component;

 private:
  void answer(const CommRasterMapInfoRequest&, fiona::Reply<CommRasterMapInfo>) {}

  fiona::Provides<RasterMapInfoProvider> info_{*this, "info", &DropsRequests::answer};
};

class AnswersBeyondItsRange final : public fiona::Component {
 public:
  using Component::Component;

 private:
  CommRasterMapInfo answer(const CommRasterMapInfoRequest&) {
    CommRasterMapInfo info;
    info.set_pixel_size(-1);
    return info;
  }

  fiona::Provides<RasterMapInfoProvider> info_{*this, "info", &AnswersBeyondItsRange::answer};
};

/// A reason is an answer.
class RefusesWithAReason final : public fiona::Component {
 public:
  using Component::Component;

 private:
  CommRasterMapInfo answer(const CommRasterMapInfoRequest&) {
    throw fiona::Error(fiona::ErrorCode::NotFound, "there is no such map");
  }

  fiona::Provides<RasterMapInfoProvider> info_{*this, "info", &RefusesWithAReason::answer};
};

class ThrowsWhenSentTo final : public fiona::Component {
 public:
  using Component::Component;

 private:
  void on_destination(const fiona::navigation::CommDestination&) { throw std::runtime_error("nowhere"); }

  fiona::Provides<fiona::navigation::DestinationProvider> destination_{*this, "destination",
                                                                       &ThrowsWhenSentTo::on_destination};
};

/// Takes the upper end of its range, and cannot live with it.
class FailsAtItsLimit final : public fiona::Component {
 public:
  using Component::Component;

 private:
  void look() {
    if (pace_->rate() >= 10) throw std::runtime_error("too fast");
  }

  fiona::Params<fiona::zoo::Pace> pace_{*this};
  fiona::Task looker_{*this, "looker", 100ms, &FailsAtItsLimit::look};
};

/// Takes what it requires for granted: that each reading has a beacon's name.
class FailsOnItsInput final : public fiona::Component {
 public:
  using Component::Component;

 private:
  void on_signal(const fiona::sensors::RFSignalRSSI& signal) {
    if (signal.transmitter_id().empty()) throw std::runtime_error("who sends?");
  }

  fiona::Requires<fiona::sensors::RFSignalRSSIService> radio_{*this, "radio", &FailsOnItsInput::on_signal};
};

}  // namespace zoo

FIONA_PLUGIN(plugin) {
  plugin.add<zoo::KeepsAll>("keeps-all");
  plugin.add<zoo::SaysEachSecondTime>("says-each-second-time");
  plugin.add<zoo::SaysTwiceATime>("says-twice-a-time");
  plugin.add<zoo::SaysNothing>("says-nothing");
  plugin.add<zoo::NegativeVariance>("negative-variance");
  plugin.add<zoo::TooStrongCorrelation>("too-strong-correlation");
  plugin.add<zoo::AsymmetricCovariance>("asymmetric-covariance");
  plugin.add<zoo::ShortCovariance>("short-covariance");
  plugin.add<zoo::OutOfRange>("out-of-range");
  plugin.add<zoo::NotANumber>("not-a-number");
  plugin.add<zoo::ThrowsAfterAWhile>("throws-after-a-while");
  plugin.add<zoo::Crashes>("crashes");
  plugin.add<zoo::DoesNotStart>("does-not-start");
  plugin.add<zoo::FallsSilent>("falls-silent");
  plugin.add<zoo::NeverAnswers>("never-answers");
  plugin.add<zoo::DropsRequests>("drops-requests");
  plugin.add<zoo::AnswersBeyondItsRange>("answers-beyond-its-range");
  plugin.add<zoo::RefusesWithAReason>("refuses-with-a-reason");
  plugin.add<zoo::ThrowsWhenSentTo>("throws-when-sent-to");
  plugin.add<zoo::FailsAtItsLimit>("fails-at-its-limit");
  plugin.add<zoo::FailsOnItsInput>("fails-on-its-input");
}
