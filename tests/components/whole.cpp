// Objects of which one can see whether they are whole: every field of one carries the same number.
#include <string>
#include <thread>
#include <utility>

#include "components.hpp"

namespace fiona::test {
namespace {

/// The number in eight bytes, again and again: long enough to be written in several pieces.
std::string stamped(std::uint64_t number) {
  constexpr std::size_t kTimes = 256;
  std::string text;
  text.reserve(kTimes * sizeof number);
  for (std::size_t i = 0; i < kTimes; ++i) text.append(reinterpret_cast<const char*>(&number), sizeof number);
  return text;
}

void stamp(Sample& sample, std::uint64_t number) {
  sample.set_number(number);
  sample.set_sent_ns(static_cast<std::int64_t>(number));
  sample.set_value(static_cast<double>(number));
  sample.set_payload(stamped(number));
}

bool is_whole(const Sample& sample) {
  return sample.sent_ns() == static_cast<std::int64_t>(sample.number()) &&
         sample.value() == static_cast<double>(sample.number()) && sample.payload() == stamped(sample.number());
}

}  // namespace

/// Puts stamped samples, each into a message that its port may have used before, and shows them in a probe that a
/// thread of its own sets.
class Stamper final : public Paced {
 public:
  using Paced::Paced;

 private:
  void tick() override {
    auto sample = samples_.make();
    stamp(*sample, ++number_);
    if (params_->value() > 0) sample->set_value(params_->value());  // the seeded fault
    samples_.put(std::move(sample));
    again_after(params_->period_ms());
  }
  void show(const OwnThread& own) {
    Sample sample;
    stamp(sample, ++shown_);
    shows_.set(std::move(sample));
    own.wait_for(1ms);
  }

  std::uint64_t number_ = 0;
  std::uint64_t shown_ = 0;
  Params<SourceParams> params_{*this};
  Provides<SampleNewest> samples_{*this, "samples"};
  Probe<Sample> shows_{*this, "shows"};
  Task show_{*this, "show", free_running, &Stamper::show};
};

/// Looks at stamped samples in every way in which one gets them, each twice: a value that is held is not used again.
class Inspector final : public Component {
 public:
  using Component::Component;
  void on_mode(std::string_view mode) override {
    if (mode == kModeActive) spawn(wait());
  }

 private:
  struct Seen {
    std::uint64_t last = 0;
    std::uint64_t distinct = 0;
  };
  void inspect(const Sample& sample, Seen& seen, Probe<std::uint64_t>& shown) {
    const bool was_whole = is_whole(sample);
    std::this_thread::sleep_for(50us);
    if (!was_whole || !is_whole(sample)) torn_.set(++tears_);
    if (std::exchange(seen.last, sample.number()) != sample.number()) shown.set(++seen.distinct);
  }
  void on_each(const Sample& sample) { inspect(sample, each_seen_, eaches_); }
  void on_newest(const Sample& sample) { inspect(sample, newest_seen_, newests_); }
  void look() {
    if (const auto latest = slot_.latest()) inspect(**latest, slot_seen_, slots_);
  }
  Async<> wait() {
    while (true) {
      const auto next = co_await updates_.wait_update(1s);
      if (next) inspect(**next, update_seen_, waits_);
      if (next.outcome() == Outcome::NotActive) co_return;
    }
  }

  std::uint64_t tears_ = 0;
  Seen each_seen_, newest_seen_, slot_seen_, update_seen_;
  Requires<SampleNewest> each_{*this, "each", &Inspector::on_each};
  Requires<SampleNewest> newest_{*this, "newest", &Inspector::on_newest, {.delivery = Delivery::Newest}};
  Requires<SampleNewest> slot_{*this, "slot"};
  Requires<SampleNewest> updates_{*this, "updates"};
  Probe<std::uint64_t> torn_{*this, "torn", {.doc = "looks at an object whose fields did not belong together"}};
  Probe<std::uint64_t> eaches_{*this, "each_seen", {.doc = "different objects"}};
  Probe<std::uint64_t> newests_{*this, "newest_seen", {.doc = "different objects"}};
  Probe<std::uint64_t> slots_{*this, "slot_seen", {.doc = "different objects"}};
  Probe<std::uint64_t> waits_{*this, "updates_seen", {.doc = "different objects"}};
  Task look_{*this, "look", 1ms, &Inspector::look};
};

void add_whole(Plugin& plugin) {
  plugin.add<Stamper>("stamper", "puts samples of which one sees whether they are whole");
  plugin.add<Inspector>("inspector", "sees whether they are");
}

}  // namespace fiona::test
