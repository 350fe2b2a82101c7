#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <limits>
#include <utility>

#include <fmt/format.h>

#include "grammar.hpp"
#include "inert.hpp"
#include "scanner.hpp"

namespace fiona::console {
namespace {

bool is_digit(char c) { return c >= '0' && c <= '9'; }

// µ (U+00B5, U+03BC), ° and Ω are written in units; the rest is ASCII.
bool is_unit(std::string_view text) {
  for (std::size_t at = 0; at < text.size();) {
    const Character next = decode(text.substr(at));
    const bool ascii_letter = next.code < 0x80 && std::isalpha(static_cast<int>(next.code)) != 0;
    const bool sign = next.code == '%' || next.code == 0xb5 || next.code == 0x3bc || next.code == 0xb0 ||
                      next.code == 0x2126 || next.code == 0x3a9;
    const bool inner = next.code == '/' || next.code == '^' || next.code == '*' || next.code == '2' || next.code == '3';
    if (!next.valid || !(ascii_letter || sign || (at > 0 && inner))) return false;
    at += next.bytes;
  }
  return true;
}

std::optional<control::Value> number_of(const std::string& text) {
  std::string_view digits = text;
  if (digits.starts_with('+')) digits.remove_prefix(1);
  const std::string_view unsigned_digits =
      digits.starts_with('-') && digits.size() != text.size() - 1 ? digits.substr(1) : digits;
  const bool begins = !unsigned_digits.empty() &&
                      (is_digit(unsigned_digits[0]) ||
                       (unsigned_digits[0] == '.' && unsigned_digits.size() > 1 && is_digit(unsigned_digits[1])));
  if (!begins) return std::nullopt;
  double number = 0;
  const auto [end, problem] = std::from_chars(digits.data(), digits.data() + digits.size(), number);
  const std::string_view unit(end, static_cast<std::size_t>(digits.data() + digits.size() - end));
  if (problem != std::errc{} || !is_unit(unit)) return std::nullopt;
  control::Value value;
  const std::string_view mantissa(digits.data(), static_cast<std::size_t>(end - digits.data()));
  std::int64_t integer = 0;
  const auto whole = std::from_chars(mantissa.data(), mantissa.data() + mantissa.size(), integer);
  if (whole.ec == std::errc{} && whole.ptr == mantissa.data() + mantissa.size()) {
    value.set_integer(integer);
  } else {
    value.set_number(number);
  }
  value.set_unit(std::string(unit));
  value.set_typed(text);
  return value;
}

control::Value plain_value(const Word& word) {
  if (auto number = number_of(word.text)) return *std::move(number);
  control::Value value;
  if (word.text == "true" || word.text == "false") {
    value.set_flag(word.text == "true");
    value.set_typed(word.text);
  } else {
    value.set_text(word.text);
  }
  return value;
}

bool is_bare(std::string_view text) {
  if (text.empty() || text.find_first_of(" \t\"\\") != std::string_view::npos || inert(text) != text) return false;
  if (text[0] == '#' || text[0] == '[' || text[0] == '{') return false;
  const std::size_t equals = text.find('=');
  return equals == std::string_view::npos || text[0] == '=';
}

std::string in_quotes(std::string_view text) {
  std::string out = "\"";
  while (!text.empty()) {
    const Character next = decode(text);
    const std::string_view character = text.substr(0, next.bytes);
    if (next.code == '"' || next.code == '\\') out += '\\';
    out += inert(character);
    text.remove_prefix(next.bytes);
  }
  return out + "\"";
}

std::string typed_number(const control::Value& value) {
  std::string out = value.kind_case() == control::Value::kInteger ? fmt::format("{}", value.integer())
                                                                  : fmt::format("{}", value.number());
  const bool looks_whole = out.find_first_not_of("-0123456789") == std::string::npos;
  if (value.kind_case() == control::Value::kNumber && looks_whole) out += ".0";
  return out + value.unit();
}

bool same_number(const control::Value& a, const control::Value& b) {
  return a.kind_case() == b.kind_case() && a.number() == b.number() && a.integer() == b.integer() &&
         a.unit() == b.unit();
}

struct TimeUnit {
  std::string_view name;
  double ms;
};
constexpr std::array kTimeUnits{TimeUnit{"ns", 1e-6}, TimeUnit{"us", 1e-3}, TimeUnit{"µs", 1e-3}, TimeUnit{"ms", 1},
                                TimeUnit{"s", 1e3},   TimeUnit{"min", 6e4}, TimeUnit{"h", 3.6e6}};

}  // namespace

control::Value value_of(const Word& word, const WordLine& line) {
  control::Value value;
  switch (word.kind) {
    case WordKind::Plain: return plain_value(word);
    case WordKind::Quoted: value.set_text(word.text); break;
    case WordKind::Message: {
      // A trailing \ only joins the physical lines; protobuf text does not know it.
      std::string text = word.text.substr(1, word.text.size() - 2);
      for (const std::string_view joint : {"\\\r\n", "\\\n"}) {
        for (std::size_t at = 0; (at = text.find(joint, at)) != std::string::npos;) text.replace(at, joint.size(), " ");
      }
      value.set_message(std::move(text));
      break;
    }
    case WordKind::List:
      value.mutable_list();
      for (const Word& element : list_elements(word, line))
        *value.mutable_list()->add_values() = value_of(element, line);
      break;
  }
  return value;
}

std::string quoted_word(std::string_view text) { return is_bare(text) ? std::string(text) : in_quotes(text); }

std::string typed_text(std::string_view text) {
  const bool plain = is_bare(text) && !is_keyword(text) && text[0] != '-' && text[0] != '=' &&
                     plain_value({.text = std::string(text)}).kind_case() == control::Value::kText;
  return plain ? std::string(text) : in_quotes(text);
}

std::string typed(const control::Value& value) {
  switch (value.kind_case()) {
    case control::Value::kNumber:
    case control::Value::kInteger: {
      const auto read_back = number_of(value.typed());
      return read_back && same_number(*read_back, value) ? value.typed() : typed_number(value);
    }
    case control::Value::kFlag: return value.flag() ? "true" : "false";
    case control::Value::kText: return typed_text(value.text());
    case control::Value::kMessage: return "{" + inert(value.message()) + "}";
    case control::Value::kList: {
      std::string out;
      for (const auto& element : value.list().values()) {
        std::string text = typed(element);
        const bool breaks_list = element.kind_case() == control::Value::kText &&
                                 text.find_first_of(",[]{}") != std::string::npos && text[0] != '"';
        out += (out.empty() ? "" : ", ") + (breaks_list ? in_quotes(element.text()) : text);
      }
      return "[" + out + "]";
    }
    case control::Value::KIND_NOT_SET: break;
  }
  return "\"\"";
}

double duration_ms(const Word& word, const WordLine& line) {
  const auto value = word.kind == WordKind::Plain ? number_of(word.text) : std::nullopt;
  const double number = !value                                           ? -1
                        : value->kind_case() == control::Value::kInteger ? static_cast<double>(value->integer())
                                                                         : value->number();
  const auto unit = std::find_if(kTimeUnits.begin(), kTimeUnits.end(),
                                 [&value](const TimeUnit& known) { return value && known.name == value->unit(); });
  if (number < 0 || unit == kTimeUnits.end()) {
    throw LineError(line, word.place,
                    {.what = fmt::format("'{}' is no duration", word.text),
                     .expected = "a number with ns, us, ms, s, min or h: 500ms, 1.5s"});
  }
  return number * unit->ms;
}

unsigned count_of(const Word& word, const WordLine& line) {
  const auto value = word.kind == WordKind::Plain ? number_of(word.text) : std::nullopt;
  const bool sound = value && value->kind_case() == control::Value::kInteger && value->unit().empty() &&
                     value->integer() >= 1 && value->integer() <= std::numeric_limits<std::int32_t>::max();
  if (!sound)
    throw LineError(line, word.place,
                    {.what = fmt::format("'{}' is no count", word.text), .expected = "a whole number from 1"});
  return static_cast<unsigned>(value->integer());
}

control::PortName watched_name(const Word& word, const WordLine& line) {
  const std::size_t dot = word.text.find('.');
  const bool has_parts =
      dot != std::string::npos && dot > 0 && word.text.back() != '.' && word.text.find("..") == std::string::npos;
  const std::size_t field = has_parts ? word.text.find('.', dot + 1) : std::string::npos;
  const bool has_path = field != std::string::npos && word.text.find('.', field + 1) != std::string::npos;
  if (!has_parts || has_path)
    throw LineError(
        line, word.place,
        {.what = fmt::format("'{}' is no port and no probe", word.text),
         .expected = "instance.port, instance.probe, instance.port.rate",
         .next = has_path ? fmt::format("watch {} {}", word.text.substr(0, field), word.text.substr(field + 1)) : ""});
  control::PortName name;
  name.set_instance(word.text.substr(0, dot));
  name.set_port(word.text.substr(dot + 1));
  return name;
}

control::PortName port_name(const Word& word, const WordLine& line) {
  const std::size_t dot = word.text.find('.');
  const bool sound = dot != std::string::npos && dot > 0 && dot + 1 < word.text.size() &&
                     word.text.find('.', dot + 1) == std::string::npos;
  if (!sound)
    throw LineError(line, word.place, {.what = fmt::format("'{}' is no port", word.text), .expected = "instance.port"});
  control::PortName name;
  name.set_instance(word.text.substr(0, dot));
  name.set_port(word.text.substr(dot + 1));
  return name;
}

}  // namespace fiona::console
