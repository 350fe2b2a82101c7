#pragma once

#include <cstdint>
#include <string>
#include <string_view>

#include "fiona/component.hpp"
#include "fiona/push.hpp"

namespace fiona::recording_player {

/// Adds `by_ms` to what counts milliseconds since the timeline's epoch: the catalogue's times are `int64` with the unit
/// "ms" (proto/README.md), in an object and in those that it holds. None becomes negative.
void shift_times(google::protobuf::Message& object, std::int64_t by_ms);
/// Whether objects of this type have such times.
bool has_times(const google::protobuf::Descriptor& type);

/// A provided port, without its type.
class Outlet {
 public:
  virtual ~Outlet() = default;
  virtual const google::protobuf::Descriptor& type() const = 0;
  /// [strand] An object as protobuf has written it, true since `origin`; the times in it are made later by `shift_ms`.
  /// False: it is none. One that breaks a rule of its type is counted by the port.
  virtual bool put(std::string_view bytes, TimePoint origin, std::int64_t shift_ms) = 0;
};

template <PushService S>
class OutletOf final : public Outlet {
 public:
  using ObjectType = typename S::ObjectType;

  template <class C>
  OutletOf(C& owner, std::string_view name, std::string_view doc) : port_(owner, name, {.doc = doc}) {}

  const google::protobuf::Descriptor& type() const override { return *ObjectType::descriptor(); }
  bool put(std::string_view bytes, TimePoint origin, std::int64_t shift_ms) override {
    auto object = port_.make();
    if (!object->ParseFromArray(bytes.data(), static_cast<int>(bytes.size()))) return false;
    if (has_times_ && shift_ms != 0) shift_times(*object, shift_ms);
    port_.put(std::move(object), origin);
    return true;
  }

 private:
  Provides<S> port_;
  const bool has_times_ = has_times(*ObjectType::descriptor());
};

}  // namespace fiona::recording_player
