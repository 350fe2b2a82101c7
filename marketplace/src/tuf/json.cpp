#include "json.hpp"

#include <fiona/error.hpp>
#include <limits>
#include <set>
#include <vector>

#include "refuse.hpp"

namespace fiona::tuf {
namespace {

constexpr int kMostLevels = 32;

// nlohmann keeps the last of two members of one name, and turns what does not fit 64 bits into a double: both are seen
// only while it reads.
class StrictReading {
 public:
  explicit StrictReading(const std::string& where) : where_(where) {}

  bool operator()(int depth, Json::parse_event_t event, Json& value) {
    if (depth > kMostLevels)
      refuse_form(where_, "it is nested more than " + std::to_string(kMostLevels) + " levels deep");
    switch (event) {
      case Json::parse_event_t::object_start: names_.emplace_back(); break;
      case Json::parse_event_t::object_end: names_.pop_back(); break;
      case Json::parse_event_t::key: check_name(value.get_ref<const std::string&>()); break;
      case Json::parse_event_t::value:
        if (value.is_number_float()) refuse_form(where_, "it has a number that is not an integer of 64 bits");
        break;
      default: break;
    }
    return true;
  }

 private:
  void check_name(const std::string& name) {
    if (!names_.back().insert(name).second) refuse_form(where_, "an object in it has '" + name + "' twice");
  }

  const std::string& where_;
  std::vector<std::set<std::string>> names_;
};

void append_text(const std::string& text, std::string& to) {
  to += '"';
  for (const char c : text) {
    if (c == '"' || c == '\\') to += '\\';
    to += c;
  }
  to += '"';
}

void append_canonical(const Json& value, std::string& to) {
  const auto list = [&to](char open, char close, const Json& items, auto&& append_item) {
    to += open;
    bool first = true;
    for (auto item = items.begin(); item != items.end(); ++item) {
      if (!first) to += ',';
      first = false;
      append_item(item);
    }
    to += close;
  };
  if (value.is_object()) {
    // The library's objects are sorted by bytes already.
    return list('{', '}', value, [&to](const auto& item) {
      append_text(item.key(), to);
      to += ':';
      append_canonical(item.value(), to);
    });
  }
  if (value.is_array()) return list('[', ']', value, [&to](const auto& item) { append_canonical(*item, to); });
  if (value.is_string()) return append_text(value.get_ref<const std::string&>(), to);
  to += value.dump();  // true, false, null, an integer
}

const Json& member(const Json& object, const char* name, const std::string& where) {
  const auto found = object.find(name);
  if (found == object.end()) refuse_form(where, std::string("'") + name + "' is missing");
  return *found;
}

}  // namespace

void refuse_form(const std::string& where, const std::string& fault) {
  refuse(ErrorCode::BadSignature, ErrorText{.what = where + " is not TUF metadata: " + fault,
                                            .next = "tell the repository's keeper; nothing was changed here"});
}

Json parse_json(std::string_view text, const std::string& where) {
  try {
    return Json::parse(text, StrictReading(where));
  } catch (const Json::parse_error& error) {
    refuse_form(where, "JSON ends or breaks at byte " + std::to_string(error.byte));
  } catch (const Json::out_of_range&) {  // not even a double holds it
    refuse_form(where, "it has a number that is not an integer of 64 bits");
  }
}

std::string canonical(const Json& value) {
  std::string text;
  append_canonical(value, text);
  return text;
}

const Json& object_in(const Json& object, const char* name, const std::string& where) {
  const Json& value = member(object, name, where);
  if (!value.is_object()) refuse_form(where, std::string("'") + name + "' is not an object");
  return value;
}

const Json& array_in(const Json& object, const char* name, const std::string& where) {
  const Json& value = member(object, name, where);
  if (!value.is_array()) refuse_form(where, std::string("'") + name + "' is not an array");
  return value;
}

const std::string& string_in(const Json& object, const char* name, const std::string& where) {
  const Json& value = member(object, name, where);
  if (!value.is_string()) refuse_form(where, std::string("'") + name + "' is not a string");
  return value.get_ref<const std::string&>();
}

std::int64_t number_in(const Json& object, const char* name, std::int64_t least, const std::string& where) {
  const Json& value = member(object, name, where);
  const bool fits =
      value.is_number_integer() &&
      (!value.is_number_unsigned() ||
       value.get<std::uint64_t>() <= static_cast<std::uint64_t>(std::numeric_limits<std::int64_t>::max()));
  if (!fits || value.get<std::int64_t>() < least) {
    refuse_form(where, std::string("'") + name + "' is not an integer from " + std::to_string(least) + " on");
  }
  return value.get<std::int64_t>();
}

std::vector<std::string> strings_in(const Json& object, const char* name, const std::string& where) {
  std::vector<std::string> strings;
  for (const Json& item : array_in(object, name, where)) {
    if (!item.is_string()) refuse_form(where, std::string("'") + name + "' has an element that is not a string");
    strings.push_back(item.get<std::string>());
  }
  return strings;
}

}  // namespace fiona::tuf
