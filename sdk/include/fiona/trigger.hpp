#pragma once

#include <atomic>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <type_traits>
#include <vector>

#include "fiona/query.hpp"

namespace fiona {

class ActivityHold;

/// What an author may say of a trigger.
struct TriggerOptions {
  std::string_view doc = {};
  std::string_view activity = {};  ///< works in the main modes that have it; empty: in all
};

namespace detail {

/// A named command of a component, without the types of its argument and result.
class TriggerBase {
 public:
  /// Calls that may be under way at once.
  static constexpr int kMaxCalls = 64;
  using Handler = std::function<std::optional<Async<>>(const Object& argument, std::shared_ptr<ReplySink> reply)>;

  TriggerBase(Component& owner, std::string_view name, const google::protobuf::Descriptor& argument,
              const google::protobuf::Descriptor& result, const TriggerOptions& options, Handler handler);
  TriggerBase(const TriggerBase&) = delete;
  TriggerBase& operator=(const TriggerBase&) = delete;

  const std::string& name() const { return name_; }
  const std::string& doc() const { return doc_; }
  const std::string& activity() const { return activity_; }
  const google::protobuf::Descriptor& argument() const { return argument_; }
  const google::protobuf::Descriptor& result() const { return result_; }

  /// [any thread] Runs it on the strand; `reply` gets one outcome: the result, NotActive, or Rejected with the reason.
  void call(std::shared_ptr<const Object> argument, std::shared_ptr<ReplySink> reply);

 private:
  class Counted;
  void run(const std::shared_ptr<const Object>& argument, std::shared_ptr<ReplySink> reply);

  Hull& hull_;
  const std::string name_;
  const std::string doc_;
  const std::string activity_;
  const google::protobuf::Descriptor& argument_;
  const google::protobuf::Descriptor& result_;
  const ObjectRules rules_;
  const Handler handler_;
  const std::shared_ptr<std::atomic<int>> calls_ = std::make_shared<std::atomic<int>>(0);
  std::vector<std::shared_ptr<ActivityHold>> holds_;  ///< of coroutines; strand only
};

template <class C, class A, class R, class F>
TriggerBase::Handler trigger_handler(C& owner, F function) {
  return [&owner, function](const Object& object, std::shared_ptr<ReplySink> sink) -> std::optional<Async<>> {
    const auto& argument = static_cast<const A&>(object);
    Reply<R> reply(std::move(sink));
    if constexpr (std::is_same_v<std::invoke_result_t<F, C&, const A&>, Async<R>>) {
      return answer_later<R>((owner.*function)(argument), std::move(reply));
    } else {
      try {
        reply.answer((owner.*function)(argument));
      } catch (const Error& error) {
        reply.reject(error.what());
      }
      return std::nullopt;
    }
  };
}

}  // namespace detail

/// A command that the console, or whoever may operate the system, gives to a component: `call belt.calibrate turns=2`.
///
///     fiona::Trigger<CalibrateRequest, CalibrateResult> calibrate_{*this, "calibrate", &Self::calibrate};
///     CalibrateResult calibrate(const CalibrateRequest& request);              // or fiona::Async<CalibrateResult>
///
/// It runs on the strand. A handler that throws Error rejects the call with its text; one that throws anything else
/// fails the instance. A coroutine holds its activity while it runs.
template <class A, class R>
class Trigger : public detail::TriggerBase {
 public:
  template <class C>
  Trigger(C& owner, std::string_view name, R (C::*handler)(const A&), TriggerOptions options = {})
      : TriggerBase(owner, name, *A::descriptor(), *R::descriptor(), options,
                    detail::trigger_handler<C, A, R>(owner, handler)) {}
  template <class C>
  Trigger(C& owner, std::string_view name, Async<R> (C::*handler)(const A&), TriggerOptions options = {})
      : TriggerBase(owner, name, *A::descriptor(), *R::descriptor(), options,
                    detail::trigger_handler<C, A, R>(owner, handler)) {}
};

}  // namespace fiona
