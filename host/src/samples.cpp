#include "samples.hpp"

namespace fiona::host {

control::Sample sample_of(const wire::Tapped& tapped, TimePoint start) {
  control::Sample sample;
  const TimePoint origin{Duration(tapped.origin_ns())};
  sample.set_type(tapped.type());
  sample.set_object(tapped.object());
  sample.set_unit(tapped.unit());
  sample.set_sequence(tapped.sequence());
  sample.set_time_s(to_seconds(origin - start));
  sample.set_origin_ns(tapped.origin_ns());
  sample.set_age_ms(1e3 * to_seconds(TimePoint{Duration(tapped.told_ns())} - origin));
  return sample;
}

bool Gaps::takes(const wire::Tapped& next) {
  if (next.opening() < newest_opening_) return false;
  newest_opening_ = next.opening();
  return true;
}

std::uint64_t Gaps::before(const wire::Tapped& next) {
  if (next.opening() != opening_) number_ = skipped_ = 0;
  opening_ = next.opening();
  const std::uint64_t missing = next.skipped() - skipped_ + next.number() - number_ - 1;
  skipped_ = next.skipped();
  number_ = next.number();
  return missing;
}

}  // namespace fiona::host
