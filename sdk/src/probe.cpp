#include "fiona/probe.hpp"

#include <algorithm>

#include "fiona/hull.hpp"

namespace fiona::detail {

ProbeBase::ProbeBase(Component& owner, std::string_view name, std::string type,
                     const google::protobuf::Descriptor& object, const ProbeOptions& options)
    : ProbeBase(owner.hull(), name, std::move(type), object, options) {
  hull_.add(*this);
}

ProbeBase::ProbeBase(Hull& hull, std::string_view name, std::string type, const google::protobuf::Descriptor& object,
                     const ProbeOptions& options)
    : hull_(hull), name_(name), type_(std::move(type)), unit_(options.unit), doc_(options.doc), object_(object) {}

TimePoint ProbeBase::now() const { return hull_.clock().now(); }

Envelope ProbeBase::envelope() const {
  if (sequence_ == 0) return {};
  Envelope envelope{value(), sequence_, origin_, 0};
  envelope.bytes = envelope.object->ByteSizeLong();
  return envelope;
}

Envelope ProbeBase::read() const {
  const std::lock_guard lock(mutex_);
  return envelope();
}

void ProbeBase::tell() const {
  const Envelope now = envelope();
  for (const auto& sink : sinks_) sink->deliver({now, nullptr});
}

void ProbeBase::attach(std::shared_ptr<Sink> sink) {
  const std::lock_guard lock(mutex_);
  sinks_.push_back(sink);
  if (sequence_ > 0) sink->deliver({envelope(), nullptr});
}

void ProbeBase::detach(const Sink& sink) {
  const std::lock_guard lock(mutex_);
  std::erase_if(sinks_, [&sink](const auto& other) { return other.get() == &sink; });
}

}  // namespace fiona::detail
