// call, send: what uses one port or trigger by hand.
#include <algorithm>

#include <fmt/format.h>

#include <fiona/secrets.hpp>

#include "../system_view.hpp"
#include "../types.hpp"
#include "verbs.hpp"

namespace fiona::console::verbs {
namespace {

/// What a trigger answers is for whoever has called it by hand: nobody else could have. A query's answer is for
/// components, and goes without its secrets.
Secrets secrets_of(Session& session, const control::PortName& target, const google::protobuf::Message& result) {
  if (!first_secret(*result.GetDescriptor())) return Secrets::Hidden;
  const control::System system = session.snapshot();
  const auto* instance = find_instance(system, target.instance());
  const bool is_trigger =
      instance != nullptr && std::any_of(instance->triggers().begin(), instance->triggers().end(),
                                         [&target](const auto& trigger) { return trigger.name() == target.port(); });
  return is_trigger ? Secrets::Shown : Secrets::Hidden;
}

void tell_result(Session& session, const control::PortName& name, const control::Called& called) {
  const std::string target = text_of(name);
  nlohmann::json facts{
      {"call", target}, {"run", called.run()}, {"outcome", called.outcome()}, {"after_ms", called.after_ms()}};
  std::string text = fmt::format("{} ended after {:.0f} ms", target, called.after_ms());
  if (!called.result().type().empty()) {
    const TypeSet types(called.result().files());
    const auto object = types.make(called.result().type());
    if (!object || !object->ParseFromString(called.result().object())) {
      throw Error(ErrorCode::Failed, {.what = fmt::format("the answer of {} is not readable here", target),
                                      .found = called.result().type(),
                                      .next = "tell the component's publisher: market info tells who"});
    }
    const Secrets secrets = secrets_of(session, name, *object);
    facts["result"] = object_json(*object, secrets);
    for (const FieldText& field : field_texts(*object, {}, secrets)) {
      text += fmt::format("\n  {}={}{}", field.path, field.text, field.unit.empty() ? "" : " " + field.unit);
    }
  }
  session.out.object(facts);
  session.out.text(text);
}

control::Value object_of(const Line& line, const Word& word) {
  if (word.kind == WordKind::Message) return value_of(word, line.words);
  throw line.error(
      word, {.what = fmt::format("'{}' is no object", word.text), .expected = "{FIELD: VALUE …}, or FIELD=VALUE"});
}

}  // namespace

void call(Session& session, const Line& line) {
  const std::string& target = line.positional[0].text;
  control::Request request;
  control::Call& call = *request.mutable_call();
  *call.mutable_target() = port_name(line.positional[0], line.words);
  if (line.positional.size() > 1) *call.add_arguments()->mutable_value() = object_of(line, line.positional[1]);
  for (control::Argument& argument : line.control_arguments()) *call.add_arguments() = std::move(argument);
  if (const Word* within = line.clause("for")) call.set_within_ms(duration_ms(*within, line.words));
  const control::PortName name = call.target();
  const control::Called called = session.host().call_waiting(std::move(request)).called();
  if (called.outcome() == "ok") return tell_result(session, name, called);
  throw Error(
      called.outcome() == "timeout" ? ErrorCode::Unreachable : ErrorCode::Failed,
      {.what = fmt::format("{}: {}{}", target, called.outcome(), called.reason().empty() ? "" : ", " + called.reason()),
       .where = target,
       .next = "show " + name.instance()});
}

}  // namespace fiona::console::verbs
