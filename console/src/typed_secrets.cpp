#include "typed_secrets.hpp"

#include <algorithm>

#include "system_view.hpp"
#include "types.hpp"
#include "verb_table.hpp"

namespace fiona::console {
namespace {

/// As long as a key press may take.
constexpr std::chrono::milliseconds kPatience{150};

/// What the fields of a call belong to: a service, or the argument of a trigger; empty: there is nothing of this name.
std::string type_called(const control::System& system, std::string_view target) {
  const std::size_t dot = std::min(target.find('.'), target.size());
  const auto* instance = find_instance(system, target.substr(0, dot));
  if (instance == nullptr || dot == target.size()) return "";
  const std::string_view name = target.substr(dot + 1);
  if (const auto* port = find_port(*instance, name)) return port->service();
  const auto trigger = std::find_if(instance->triggers().begin(), instance->triggers().end(),
                                    [name](const auto& one) { return one.name() == name; });
  return trigger == instance->triggers().end() ? "" : trigger->argument();
}

/// False: the host does not say what fields there are.
bool learn_fields(std::string_view target, Session& session, Names& names) {
  const control::System* system = names.system();
  const std::string type = system == nullptr ? "" : type_called(*system, target);
  if (type.empty()) return false;
  control::Request request;
  request.mutable_describe()->set_name(type);
  const TypeSet types(session.host().call(std::move(request), kPatience).description().files());
  if (const auto* service = types.service(type)) {
    for (int i = 0; i < service->method_count(); ++i) session.out.secrets.learn(*service->method(i)->input_type());
    return service->method_count() > 0;
  }
  const auto* object = types.object(type);
  if (object != nullptr) session.out.secrets.learn(*object);
  return object != nullptr;
}

bool is_known(const WordLine& words, Session& session, Names& names) {
  if (words.empty()) return true;
  const auto is_call = [](const WordLine::Item& item) {
    return item.word.is_plain("call") || item.word.is_plain("send");
  };
  const auto call = std::find_if(words.items.begin(), words.items.end(), is_call);
  if (call == words.items.end()) return find_verb(words.items.front().word.text) != nullptr;
  return call + 1 != words.items.end() && learn_fields((call + 1)->word.text, session, names);
}

/// Whether it is known which of the line's values are secret. Of a line that is none, or may be meant as a call, it is
/// not; what others set are parameters, which are no secrets.
bool is_known(const std::string& line, Session& session, Names& names) {
  try {
    return is_known(split_line(line), session, names);
  } catch (const Error&) {
    return false;
  }
}

}  // namespace

std::string kept_part(const std::string& line, Session& session, Names& names) {
  const bool known = line.find_first_of("={") == std::string::npos || is_known(line, session, names);
  const std::size_t any_value = known ? std::string::npos : line.find_first_of("={") + 1;
  return line.substr(0, std::min(session.out.secrets.begin_in(line), any_value));
}

}  // namespace fiona::console
