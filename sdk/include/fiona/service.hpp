#pragma once

#include <google/protobuf/message.h>

#include <concepts>
#include <string>
#include <string_view>

#include "fiona/options.pb.h"
#include "fiona/time.hpp"

namespace fiona {

/// A communication object, whatever its type.
using Object = google::protobuf::Message;

/// A service as its descriptor declares it: the pattern, the contract, the objects. One per service and process,
/// alive until the process ends.
class ServiceInfo {
 public:
  explicit ServiceInfo(const google::protobuf::ServiceDescriptor& descriptor);

  const std::string& name() const { return descriptor_.full_name(); }
  const google::protobuf::ServiceDescriptor& descriptor() const { return descriptor_; }
  Pattern pattern() const { return contract_.pattern(); }
  bool is_push() const { return pattern() == PUSH_NEWEST || pattern() == PUSH_TIMED; }
  const ServiceContract& contract() const { return contract_; }

  /// What travels from client to provider (send, query; of an event the activation), else what is pushed.
  const google::protobuf::Descriptor& object() const { return *object_; }
  /// What comes back: a query's answer, an event's result; null for other patterns.
  const google::protobuf::Descriptor* answer() const { return answer_; }

  /// Silence longer than this means that a push provider is lost (docs/patterns.md, Push newest): `lease_ms`, else
  /// three periods, at least 300 ms. Zero where the service has neither lease nor period: it may be silent for ever.
  Duration lease() const;
  Duration period() const { return std::chrono::milliseconds(contract_.period_ms()); }

 private:
  const google::protobuf::ServiceDescriptor& descriptor_;
  ServiceContract contract_;
  const google::protobuf::Descriptor* object_ = nullptr;
  const google::protobuf::Descriptor* answer_ = nullptr;
};

/// `push newest`, `query`, …: the words of docs, console and errors.
std::string_view to_string(Pattern pattern);

/// Bases of the types that the protoc plugin generates from a proto `service`:
/// `struct LocationProvider : PushTimed<CommLocation> { static const ServiceInfo& info(); };`
template <class T>
struct PushNewest {
  using ObjectType = T;
  static constexpr Pattern kPattern = PUSH_NEWEST;
};
template <class T>
struct PushTimed {
  using ObjectType = T;
  static constexpr Pattern kPattern = PUSH_TIMED;
};
template <class T>
struct Send {
  using ObjectType = T;
  static constexpr Pattern kPattern = SEND;
};
template <class Q, class A>
struct Query {
  using RequestType = Q;
  using AnswerType = A;
  static constexpr Pattern kPattern = QUERY;
};
template <class A, class R, class S>
struct Event {
  using ActivationType = A;
  using ResultType = R;
  using StateType = S;
  static constexpr Pattern kPattern = EVENT;
};

template <class S>
concept Service = requires {
  { S::kPattern } -> std::convertible_to<Pattern>;
  { S::info() } -> std::same_as<const ServiceInfo&>;
};
template <class S>
concept PushService = Service<S> &&(S::kPattern == PUSH_NEWEST || S::kPattern == PUSH_TIMED);
template <class S>
concept SendService = Service<S> && S::kPattern == SEND;
template <class S>
concept QueryService = Service<S> && S::kPattern == QUERY;
template <class S>
concept EventService = Service<S> && S::kPattern == EVENT;

}  // namespace fiona
