#pragma once

#include <google/protobuf/generated_enum_reflection.h>

#include <concepts>
#include <cstdint>
#include <limits>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <string_view>
#include <type_traits>
#include <utility>
#include <vector>

#include "fiona/message.hpp"
#include "fiona/port.hpp"
#include "fiona/probe.pb.h"

namespace fiona {

class Component;
class Hull;

/// What an author may say of a probe.
struct ProbeOptions {
  std::string_view unit = {};  ///< of a number: "m", "ms", "1/s"
  std::string_view doc = {};
};

namespace detail {

/// A probe without the type of its value.
class ProbeBase {
 public:
  ProbeBase(Component& owner, std::string_view name, std::string type, const google::protobuf::Descriptor& object,
            const ProbeOptions& options);
  /// One of the hull's own, which it knows by itself.
  ProbeBase(Hull& hull, std::string_view name, std::string type, const google::protobuf::Descriptor& object,
            const ProbeOptions& options);
  virtual ~ProbeBase() = default;
  ProbeBase(const ProbeBase&) = delete;
  ProbeBase& operator=(const ProbeBase&) = delete;

  const std::string& name() const { return name_; }
  const std::string& type() const { return type_; }
  const std::string& unit() const { return unit_; }
  const std::string& doc() const { return doc_; }
  /// What its value travels as: the message itself, or one of fiona/probe.proto.
  const google::protobuf::Descriptor& object() const { return object_; }

  /// [any thread] The value of now, whoever watches; no object: it was never set.
  Envelope read() const;
  /// [any thread] From here on `sink` gets each value, beginning with the one of now.
  void attach(std::shared_ptr<Sink> sink);
  /// [any thread]
  void detach(const Sink& sink);

 protected:
  /// Called with the mutex held.
  virtual std::shared_ptr<const Object> value() const = 0;
  /// [any thread] Switches to the value that `store` puts in place. Who watches is told; nobody waits for them.
  template <class F>
  void change(TimePoint origin, F store) {
    const std::lock_guard lock(mutex_);
    store();
    origin_ = origin;
    ++sequence_;
    if (!sinks_.empty()) tell();
  }
  TimePoint now() const;

 private:
  Envelope envelope() const;
  void tell() const;

  Hull& hull_;
  const std::string name_;
  const std::string type_;
  const std::string unit_;
  const std::string doc_;
  const google::protobuf::Descriptor& object_;
  mutable std::mutex mutex_;
  TimePoint origin_{};
  std::uint64_t sequence_ = 0;
  std::vector<std::shared_ptr<Sink>> sinks_;
};

/// How a value of type T travels: `type` as the interface says it, `Carrier`, `to_object`.
template <class T>
struct ProbeValue;

template <std::floating_point T>
struct ProbeValue<T> {
  using Carrier = probe::Number;
  static std::string type() { return sizeof(T) == sizeof(float) ? "float" : "double"; }
  static double carried(T value) { return static_cast<double>(value); }
};
template <std::integral T>
struct ProbeValue<T> {
  using Carrier = probe::Integer;
  static std::string type() { return "int64"; }
  /// Beyond what 63 bits hold it stays at the largest number.
  static std::int64_t carried(T value) {
    constexpr auto kMost = std::numeric_limits<std::int64_t>::max();
    return std::in_range<std::int64_t>(value) ? static_cast<std::int64_t>(value) : kMost;
  }
};
template <>
struct ProbeValue<bool> {
  using Carrier = probe::Flag;
  static std::string type() { return "bool"; }
  static bool carried(bool value) { return value; }
};
template <>
struct ProbeValue<std::string> {
  using Carrier = probe::Text;
  static std::string type() { return "string"; }
  static const std::string& carried(const std::string& value) { return value; }
};
template <class T>
requires google::protobuf::is_proto_enum<T>::value struct ProbeValue<T> {
  using Carrier = probe::Text;
  static std::string type() { return "enum " + google::protobuf::GetEnumDescriptor<T>()->name(); }
  static std::string carried(T value) {
    const auto* known = google::protobuf::GetEnumDescriptor<T>()->FindValueByNumber(value);
    return known ? known->name() : std::to_string(static_cast<int>(value));
  }
};

}  // namespace detail

/// A value that a component shows to whoever wants to see it (patterns.md, Monitoring): a number, a flag, a text, an
/// enumerator or a message. A whole number beyond what 63 bits hold is shown as the largest that they do.
///
///     fiona::Probe<double> spread_{*this, "spread", {.unit = "m", .doc = "standard deviation of the position"}};
///     spread_.set(1.5);                                     // watch nav.spread when above 3
///
/// While nobody watches, setting costs one short lock and one look at the clock. A watcher costs what it asked for, and
/// never makes the component wait.
template <class T>
class Probe : public detail::ProbeBase {
 public:
  template <class C>
  Probe(C& owner, std::string_view name, ProbeOptions options = {})
      : ProbeBase(owner, name, detail::ProbeValue<T>::type(), *detail::ProbeValue<T>::Carrier::descriptor(), options) {}

  /// [any thread] The value from now on. `origin`: since when it is true, where that is not now.
  void set(T value) { set(std::move(value), now()); }
  void set(T value, TimePoint origin) {
    change(origin, [&] { std::swap(value_, value); });
  }

 private:
  std::shared_ptr<const Object> value() const override {
    auto object = std::make_shared<typename detail::ProbeValue<T>::Carrier>();
    object->set_value(detail::ProbeValue<T>::carried(value_));
    return object;
  }
  T value_{};
};

/// The same of a message, which all who watch share.
template <class T>
requires std::derived_from<T, Object>
class Probe<T> : public detail::ProbeBase {
 public:
  template <class C>
  Probe(C& owner, std::string_view name, ProbeOptions options = {})
      : ProbeBase(owner, name, T::descriptor()->full_name(), *T::descriptor(), options) {}

  /// [any thread] As of any probe.
  void set(T message) { set(std::move(message), now()); }
  void set(T message, TimePoint origin) {
    auto shared = std::make_shared<const T>(std::move(message));
    change(origin, [&] { value_.swap(shared); });
  }

 private:
  std::shared_ptr<const Object> value() const override { return value_; }
  std::shared_ptr<const T> value_;
};

}  // namespace fiona
