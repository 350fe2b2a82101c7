#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <mutex>
#include <span>
#include <string>
#include <type_traits>
#include <vector>

#include "fiona/control.pb.h"
#include "fiona/service.hpp"

namespace fiona {

class Component;
class Hull;

namespace detail {

/// A component's parameters without their type: the current values, the rules, the component's own check.
class ParamsBase {
 public:
  using Check = std::function<void(const Object&)>;
  ParamsBase(Component& owner, std::unique_ptr<Object> defaults, Check check, std::function<void()> changed);
  ParamsBase(const ParamsBase&) = delete;
  ParamsBase& operator=(const ParamsBase&) = delete;

  /// [strand] All or nothing: fields typed and converted to their units, declared rules, the component's check on
  /// the whole draft, then the switch. Throws Error naming field, value and rule, or what `changed` throws; the values
  /// are then as before.
  void apply(std::span<const control::Argument> changes);
  /// [strand] To the values before that; `changed` is told again.
  void take_back(std::shared_ptr<const Object> former);

  /// [any thread] The values of this moment.
  std::shared_ptr<const Object> snapshot() const;
  /// [any thread] Every field with value, default, unit, range and doc, as the console shows it.
  std::vector<control::ParameterStatus> status() const;
  /// [any thread] The fields that differ from their defaults, as arguments that set them.
  std::vector<control::Argument> differences() const;

 protected:
  const Object& current() const { return *current_; }

 private:
  void take(std::shared_ptr<const Object> values);

  Hull& hull_;
  const std::shared_ptr<const Object> defaults_;
  const Check check_;
  const std::function<void()> changed_;
  mutable std::mutex mutex_;
  std::shared_ptr<const Object> current_;
};

}  // namespace detail

/// Fills `message` with the defaults that its fields declare (`(fiona.default_value)`). A default that does not parse
/// or breaks its own range throws Error naming the field: a mistake of the author, seen when the plugin is built.
void set_declared_defaults(Object& message);

/// Sets the fields that `changes` name (one without a name: those in its protobuf text), converting units, and checks
/// every declared rule (range, size, enumerators). Throws Error naming field, value, rule; `message` is then
/// unspecified, so pass a draft.
void set_fields(Object& message, std::span<const control::Argument> changes);

/// The fields of `values` that differ from those of `others`, a message of the same type, as arguments that set them.
std::vector<control::Argument> differences(const Object& values, const Object& others);

/// A component's parameters, as one proto message whose field options carry default, range, unit and doc:
///
///     fiona::Params<StepHeadingParams> params_{*this};                // params_->gain()
///     fiona::Params<P> params_{*this, &Self::check, &Self::changed};  // check(draft) throws Error to refuse
///     fiona::Params<P> params_{*this, nullptr, &Self::changed};
///
/// Tasks and handlers see one consistent set: a change happens between them, on the strand. Those of the `load` line
/// are in place before `on_start`, which reads them; `changed` is called for what is set later.
template <class M>
class Params : public detail::ParamsBase {
 public:
  template <class C>
  explicit Params(C& owner) : ParamsBase(owner, defaults(), nullptr, nullptr) {}
  template <class C>
  Params(C& owner, void (std::type_identity_t<C>::*check)(const M& draft) const,
         void (std::type_identity_t<C>::*changed)() = nullptr)
      : ParamsBase(
            owner, defaults(),
            check ? Check([&owner, check](const Object& d) { (owner.*check)(static_cast<const M&>(d)); }) : nullptr,
            changed ? std::function<void()>([&owner, changed] { (owner.*changed)(); }) : nullptr) {}

  /// [strand] Valid until the handler or task ends.
  const M& operator*() const { return static_cast<const M&>(current()); }
  const M* operator->() const { return &**this; }
  /// [any thread] The values of this moment, whatever is set later: for a free running task.
  std::shared_ptr<const M> snapshot() const { return std::static_pointer_cast<const M>(ParamsBase::snapshot()); }

 private:
  static std::unique_ptr<Object> defaults() {
    auto message = std::make_unique<M>();
    set_declared_defaults(*message);
    return message;
  }
};

}  // namespace fiona
