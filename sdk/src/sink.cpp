// Which sink a client's messages go to at this moment.
#include "fiona/sink.hpp"

namespace fiona::detail {

void Target::set(std::shared_ptr<Sink> sink) {
  const std::lock_guard lock(mutex_);
  sink_ = std::move(sink);
}

std::shared_ptr<Sink> Target::get() {
  const std::lock_guard lock(mutex_);
  return sink_;
}

std::optional<Outcome> Target::deliver(const Parcel& parcel) {
  for (auto sink = get(); sink;) {
    const Outcome outcome = sink->deliver(parcel);
    auto present = get();
    if (outcome != Outcome::Disconnected || present == sink) return outcome;
    sink = std::move(present);
  }
  return std::nullopt;
}

}  // namespace fiona::detail
