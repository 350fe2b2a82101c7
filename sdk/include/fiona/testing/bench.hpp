#pragma once

#include <google/protobuf/text_format.h>

#include <deque>
#include <filesystem>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "fiona/error.hpp"
#include "fiona/hull.hpp"
#include "fiona/rules.hpp"
#include "fiona/testing/inline_executor.hpp"

namespace fiona::testing {

/// The bench without the component's type: what one does whose components come from a plugin.
class AnyBench : private HullEvents {
 public:
  explicit AnyBench(const Hull::Factory& make, std::string name = "component", std::filesystem::path share = {})
      : hull_(std::move(name), {executor_, clock_, *this, std::move(share)}) {
    hull_.create([this, &make](Hull& hull) {
      auto made = make(hull);
      component_ = made.get();
      return made;
    });
    for (Port* port : hull_.ports()) wire(*port);
  }
  ~AnyBench() override { hull_.shut_down(kDefaultDeadline); }

  /// Sets one parameter: a text or an enumerator's name, a number in the field's unit, a flag. Throws Error if refused.
  void set(std::string_view name, std::string_view text) {
    change(name, [&](control::Value& value) { value.set_text(std::string(text)); });
  }
  void set(std::string_view name, const char* text) { set(name, std::string_view(text)); }
  void set(std::string_view name, double number) {
    change(name, [&](control::Value& value) { value.set_number(number); });
  }
  void set(std::string_view name, int number) {
    change(name, [&](control::Value& value) { value.set_integer(number); });
  }
  void set(std::string_view name, bool flag) {
    change(name, [&](control::Value& value) { value.set_flag(flag); });
  }

  /// Brings the instance into a mode, `active` if none is named. Throws Error ComponentFailed if it refuses.
  void start(std::string_view mode = kModeActive) { hull_.set_mode(mode, kDefaultDeadline); }
  /// Lets the clock run for `duration`, and everything that this causes.
  void advance(Duration duration) {
    // The stop first: a released clock goes on at once.
    clock_.stop_at(clock_.now() + duration, [this] { clock_.hold(); });
    clock_.release();
    executor_.help();
  }
  TimePoint now() const { return clock_.now(); }

  /// Hands a message to a required push port or a provided send port, as a wire would; it has been handled when
  /// this returns. Rejected, and counted as refused, when a field breaks a rule that it declares.
  template <class S>
  Outcome put(std::string_view port, typename S::ObjectType object) {
    return put_any(port, std::make_shared<const typename S::ObjectType>(std::move(object)));
  }
  /// The same of an object that is of the port's type.
  Outcome put_any(std::string_view port, std::shared_ptr<const Object> object) {
    if (const auto violation = broken_rule(*object)) {
      find(port).counters().refuse(*violation, clock_.now());
      return Outcome::Rejected;
    }
    Envelope envelope{std::move(object), ++sequence_, clock_.now(), 0};
    envelope.bytes = envelope.object->ByteSizeLong();
    const Outcome outcome = inbox(port).push({std::move(envelope), nullptr});
    executor_.help();
    return outcome;
  }

  /// What the component has put or sent through `port` since the last call.
  template <class S>
  std::vector<Received<typename S::ObjectType>> take(std::string_view port) {
    std::vector<Received<typename S::ObjectType>> all;
    for (const auto& envelope : take_any(port)) all.push_back(detail::received<typename S::ObjectType>(envelope));
    return all;
  }
  std::vector<Envelope> take_any(std::string_view port) {
    std::vector<Envelope> all;
    for (auto& parcel : std::exchange(collector(port).parcels, {})) all.push_back(std::move(parcel.envelope));
    return all;
  }
  /// Why a provided push port has counted as silent since the last call: its lease ran out.
  std::optional<std::string> take_silence(std::string_view port) { return std::exchange(collector(port).silence, {}); }

  /// Asks a provided query port; time runs until it has answered, at most for `deadline`; then it is given up. Rejected
  /// too when a field of the request or the answer breaks a rule that it declares.
  template <QueryService S>
  Result<std::shared_ptr<const typename S::AnswerType>> ask(std::string_view port, typename S::RequestType request,
                                                            Duration deadline = kDefaultDeadline) {
    const auto answer = ask_any(port, std::make_shared<const typename S::RequestType>(std::move(request)), deadline);
    if (!answer) return {answer.outcome(), answer.reason()};
    return std::static_pointer_cast<const typename S::AnswerType>(*answer);
  }
  /// The same of a request that is of the port's type; of an event port, an activation, whose answer has no object.
  Result<std::shared_ptr<const Object>> ask_any(std::string_view port, std::shared_ptr<const Object> request,
                                                Duration deadline = kDefaultDeadline) {
    if (const auto violation = broken_rule(*request)) {
      const bool is_query = find(port).service().pattern() == QUERY;
      return {Outcome::Rejected, (is_query ? "the request" : "the activation") + kRefused + *violation};
    }
    auto reply = std::make_shared<Collected>();
    const Outcome outcome = inbox(port).push({Envelope{std::move(request), ++sequence_, clock_.now(), 0}, reply});
    executor_.help();
    if (outcome != Outcome::Ok) return outcome;
    if (!reply->answered) advance(deadline);
    if (!reply->answered) {
      reply->abandon();
      return Outcome::Timeout;
    }
    if (reply->outcome != Outcome::Ok) return {reply->outcome, reply->reason};
    if (const auto violation = reply->object ? broken_rule(*reply->object) : std::nullopt) {
      return {Outcome::Rejected, "the answer" + kRefused + *violation};
    }
    return reply->object;
  }

  /// From now on a required query port is answered by `answer(request)`.
  template <QueryService S, class F>
  void answer_with(std::string_view port, F answer) {
    answer_any_with(port, [answer = std::move(answer)](const Object& request) {
      return std::make_shared<const typename S::AnswerType>(
          answer(static_cast<const typename S::RequestType&>(request)));
    });
  }
  void answer_any_with(std::string_view port, std::function<std::shared_ptr<const Object>(const Object&)> answer) {
    collector(port).answer = [answer = std::move(answer)](const Parcel& parcel) {
      parcel.reply->answer(Outcome::Ok, {}, answer(*parcel.envelope.object));
    };
  }

  /// Fires an event for each activation of a required event port. Gives how many there are. Throws Error for an event
  /// that breaks a rule of its fields.
  template <class S>
  std::size_t fire(std::string_view port, typename S::ResultType event) {
    if (const auto violation = broken_rule(event)) {
      throw Error(ErrorCode::Usage, {.what = "the event" + kRefused + *violation,
                                     .where = std::string(port),
                                     .next = "fire what the rules of its message allow: they are in its .proto"});
    }
    auto& activations = collector(port).activations;
    std::erase_if(activations, [](const auto& activation) { return activation->abandoned(); });
    const auto object = std::make_shared<const typename S::ResultType>(std::move(event));
    for (const auto& activation : activations) {
      activation->event({object, ++sequence_, clock_.now(), object->ByteSizeLong()});
    }
    executor_.help();
    return activations.size();
  }

  /// The value of a probe that the component declares, or of one of the hull's own ("mode", "steps.rate"); none if it
  /// has none yet. T as declared; the name of an enumerator is a std::string.
  template <class T>
  std::optional<T> probe(std::string_view name) const {
    const auto object = hull_.read(name).object;
    if (!object) return std::nullopt;
    if constexpr (std::is_base_of_v<Object, T>) {
      return dynamic_cast<const T&>(*object);
    } else {
      return static_cast<T>(dynamic_cast<const typename detail::ProbeValue<T>::Carrier&>(*object).value());
    }
  }

  /// What the component, as master, has asked for since the last call. Each is answered as done, after `refuse_with` as
  /// refused for that reason; the next value of what it watches, when it is shown one.
  std::vector<control::Request> take_requests() { return std::exchange(requests_, {}); }
  void refuse_with(std::string reason) { refusal_ = std::move(reason); }
  /// Answers the oldest of the component's watches that waits for its next value. False: none does.
  bool show(const control::Sample& sample) {
    if (nexts_.empty()) return false;
    control::Reply reply;
    *reply.mutable_sample() = sample;
    hull_.answer(nexts_.front(), std::move(reply));
    nexts_.pop_front();
    return true;
  }

  std::string mode() const { return hull_.mode(); }
  std::string reason() const { return hull_.reason(); }
  Hull& hull() { return hull_; }
  /// The exit code with which the component ended the run, and why; none if it has not.
  const std::optional<std::pair<int, std::string>>& run_end() const { return run_end_; }
  const std::vector<std::string>& log() const { return log_; }

 private:
  struct Collector final : Sink {
    Outcome deliver(Parcel parcel) override {
      if (answer) answer(parcel);
      if (takes_activations) {
        parcel.reply->event({});  // taken
        activations.push_back(parcel.reply);
      }
      parcels.push_back(std::move(parcel));
      return Outcome::Ok;
    }
    void lease(bool held, const std::string& reason) override {
      if (!held) silence = reason;
    }
    std::vector<Parcel> parcels;
    std::optional<std::string> silence;
    std::function<void(const Parcel&)> answer;
    bool takes_activations = false;
    std::vector<std::shared_ptr<ReplySink>> activations;
  };
  struct Collected final : ReplySink {
    void answer(Outcome result, std::string why, std::shared_ptr<const Object> what) override {
      if (std::exchange(answered, true)) return;
      outcome = result;
      reason = std::move(why);
      object = std::move(what);
    }
    Outcome event(Envelope event) override {
      if (!event.object) answer(Outcome::Ok, {}, nullptr);  // the activation has been taken
      return Outcome::Ok;
    }
    bool answered = false;
    Outcome outcome = Outcome::NoData;
    std::string reason;
    std::shared_ptr<const Object> object;
  };

  void wire(Port& port) {
    auto sink = std::make_shared<Collector>();
    sink->takes_activations = dynamic_cast<detail::EventClient*>(&port) != nullptr;
    if (auto* provider = dynamic_cast<detail::PushProvider*>(&port)) provider->attach(sink);
    if (auto* client = dynamic_cast<RequiredPort*>(&port)) {
      const auto end = client->end_for("bench");
      end->set_target(sink);
      end->set_connection(Connection::Connected, "on the bench");
    }
    collectors_.emplace(port.name(), std::move(sink));
  }

  static inline const std::string kRefused = " was refused: ";
  std::optional<std::string> broken_rule(const Object& object) {
    const auto* type = object.GetDescriptor();
    return rules_.try_emplace(type, *type).first->second.first_violation(object);
  }

  Port& find(std::string_view name) {
    if (Port* port = hull_.find_port(name)) return *port;
    std::string known;
    for (const Port* port : hull_.ports()) known += (known.empty() ? "" : ", ") + port->name();
    throw Error(ErrorCode::NotFound,
                {.what = "the component has no port '" + std::string(name) + "'", .expected = "one of " + known});
  }
  Inbox& inbox(std::string_view name) {
    if (Inbox* inbox = find(name).inbox()) return *inbox;
    throw Error(ErrorCode::Usage, {.what = "nothing can be handed to port '" + std::string(name) + "'",
                                   .expected = "a port that takes or answers something",
                                   .next = "take(\"" + std::string(name) + "\") gives what came out of this one"});
  }
  Collector& collector(std::string_view name) { return *collectors_.at(find(name).name()); }

  template <class F>
  void change(std::string_view name, F fill) {
    control::Argument argument;
    argument.set_name(std::string(name));
    fill(*argument.mutable_value());
    hull_.set_parameters({&argument, 1}, kDefaultDeadline);
  }

  void mode_changed(const std::string&, const std::string&, const std::string&) override {}
  void run_ended(const std::string&, int exit_code, const std::string& reason) override {
    if (!run_end_) run_end_.emplace(exit_code, reason);
  }
  void logged(const std::string&, LogLevel, std::string_view text) override { log_.emplace_back(text); }
  void asked(const std::string&, std::uint64_t number, const control::Request& request) override {
    requests_.push_back(request);
    if (request.has_next()) return nexts_.push_back(number);
    control::Reply reply;
    if (!refusal_.empty()) {
      reply.mutable_failure()->set_what(refusal_);
    } else if (request.has_snapshot()) {
      reply.mutable_system();
    } else {
      reply.mutable_done();
    }
    hull_.answer(number, std::move(reply));
  }

 protected:
  Component& any_component() { return *component_; }

 private:
  InlineExecutor executor_;
  VirtualClock clock_;
  Hull hull_;
  Component* component_ = nullptr;
  std::map<std::string, std::shared_ptr<Collector>> collectors_;
  std::map<const google::protobuf::Descriptor*, ObjectRules> rules_;
  std::uint64_t sequence_ = 0;
  std::optional<std::pair<int, std::string>> run_end_;
  std::vector<std::string> log_;
  std::vector<control::Request> requests_;
  std::deque<std::uint64_t> nexts_;
  std::string refusal_;
};

/// A component on the bench: alone, on the test's thread, on a clock that the test moves. No host, process or socket.
///
///     Bench<StepCounter> bench;
///     bench.start();
///     bench.put<GetIMUService>("imu", sample);
///     bench.advance(100ms);
///     EXPECT_EQ(bench.take<StepProvider>("steps").size(), 1);
///
/// Every port is wired to the bench: what the component puts is kept until taken, what it asks is answered by
/// `answer_with`, what it activates is fired by `fire`. An outcome or exception that fails the instance is seen by
/// `mode()` and `reason()`.
template <class C>
class Bench : public AnyBench {
 public:
  explicit Bench(std::string name = "component", std::filesystem::path share = {})
      : AnyBench([](Hull& hull) { return std::make_unique<C>(hull); }, std::move(name), std::move(share)) {}

  C& component() { return static_cast<C&>(any_component()); }
};

}  // namespace fiona::testing
