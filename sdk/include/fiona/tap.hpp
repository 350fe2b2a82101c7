#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <string_view>

#include "fiona/clock.hpp"
#include "fiona/error.hpp"
#include "fiona/port.hpp"

namespace fiona {

/// What a watcher of a probe or a push port asks for (patterns.md, Monitoring). Without a condition: push mode. With
/// one: event mode, the value with which the condition becomes true; it has to become false before there is another.
struct TapTerms {
  std::uint32_t every = 1;  ///< each n-th value only
  /// The shortest time between two values that are passed on or looked at, on the instance's clock: what came between
  /// is skipped, and the newest is not lost. Of what the hull samples, the period; zero: 200 ms.
  Duration period{};
  std::function<bool(const Object&)> holds = nullptr;  ///< a condition; throws Error if it does not fit the value
  bool changes = false;                                ///< a condition: the value is not what it was before
  Duration older_than{};                               ///< a condition: nothing has come for so long
};

/// What a watcher gets.
struct Tapped {
  Envelope envelope;          ///< its object is null: old, and there never was a value
  std::uint64_t number = 0;   ///< counts what the watch has passed on, from 1: a gap was lost on the way
  std::uint64_t skipped = 0;  ///< values that the period left out so far
};

/// Somebody who watches. All calls [any thread], and must not wait.
class Watcher {
 public:
  virtual ~Watcher() = default;
  virtual void value(const Tapped& watched) = 0;
  /// Nothing more comes: the instance has ended, or the condition does not fit the values.
  virtual void ended(const Error& why) = 0;
};

/// One watch of one probe or port, made by `Hull::tap`. It looks at values where they come, so that a watcher far away
/// costs no more than what it asked for; times are kept by a strand of the hull's, never by the component's.
class Tap final : public Sink, public std::enable_shared_from_this<Tap> {
 public:
  using Sample = std::function<std::optional<Envelope>()>;
  static constexpr Duration kSamplePeriod = std::chrono::milliseconds(200);

  Tap(std::string name, TapTerms terms, std::shared_ptr<Strand> strand, std::shared_ptr<Watcher> watcher);

  /// [once] Begins. `sample` reads what the hull counts; null: values are delivered.
  void start(Sample sample);
  /// [any thread] After it returned the watcher is not called and nothing is sampled any more.
  void stop();
  /// [any thread] Tells the watcher, and stops.
  void end(const Error& why);

  /// [any thread] The next value.
  Outcome deliver(Parcel parcel) override;

 private:
  void take(const Envelope& envelope);
  void judge(const Envelope& envelope);
  void judge_age(const Envelope& envelope);
  void pass_on(const Envelope& envelope);
  void wake_at(TimePoint at);
  void arm();
  void fire();
  void on_time();
  void sample_now();
  bool is_old(TimePoint now) const { return now - newest_.origin >= terms_.older_than; }

  const std::string name_;
  const TapTerms terms_;
  const std::shared_ptr<Strand> strand_;
  Clock& clock_;
  const std::shared_ptr<Watcher> watcher_;

  std::mutex mutex_;  ///< guards the rest
  Sample sample_;
  bool stopped_ = false;
  std::uint64_t taken_ = 0;
  std::uint64_t number_ = 0;
  std::uint64_t skipped_ = 0;
  std::uint64_t staged_ = 0;
  bool held_ = false;                  ///< the condition was true of the last value
  std::optional<std::string> before_;  ///< the last value's bytes, where a change is waited for
  Envelope newest_;                    ///< its origin is when the watch began while there is none
  std::optional<Envelope> pending_;    ///< came before its time
  TimePoint next_{};                   ///< before this nothing is passed on
  std::optional<TimePoint> wake_;      ///< when the strand is to look again; set: asked for already
  TimerId timer_ = 0;
};

}  // namespace fiona
