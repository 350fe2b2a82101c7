// wait, expect, sleep, quit: what headless scripts and tests are made of.
#include <algorithm>
#include <array>
#include <chrono>

#include <fmt/format.h>
#include <fmt/ranges.h>

#include "verbs.hpp"

namespace fiona::console::verbs {
namespace {

struct Operator {
  std::string_view typed;
  control::Comparison meant;
};
constexpr std::chrono::milliseconds kLooks{10};
constexpr std::chrono::seconds kEnds{5};
constexpr std::array kOperators{Operator{"==", control::EQUAL},  Operator{"!=", control::NOT_EQUAL},
                                Operator{"<", control::LESS},    Operator{"<=", control::LESS_OR_EQUAL},
                                Operator{">", control::GREATER}, Operator{">=", control::GREATER_OR_EQUAL}};

control::Comparison comparison_of(const Word& word, const Line& line) {
  for (const Operator& known : kOperators) {
    if (word.text == known.typed) return known.meant;
  }
  throw line.error(word, {.what = fmt::format("'{}' compares nothing", word.text),
                          .expected = "== != < <= > >=",
                          .next = word.text == "=" ? "equality is ==" : ""});
}

void tell_met(Session& session, const control::Met& met) {
  session.out.done(fmt::format("{} after {:.0f} ms", met.seen().empty() ? "reached" : met.seen(), met.after_ms()),
                   {{"after_ms", met.after_ms()}, {"seen", met.seen()}});
}

/// Until another host can have its name: who starts one next is not refused because this one is still letting go.
void wait_until_gone(Session& session, const ControlClient& host) {
  if (host.remote()) return;
  const auto end = std::chrono::steady_clock::now() + kEnds;
  const auto later = [](SteadyTime most) { return std::min(most, std::chrono::steady_clock::now() + kLooks); };
  while (answers(host.endpoint().socket)) {
    if (std::chrono::steady_clock::now() >= end)
      return session.out.remark(
          fmt::format("the host has not ended within {} s: it is still letting go", kEnds.count()));
    session.reactor.run_until([] { return false; }, later(end));
  }
}

}  // namespace

void wait(Session& session, const Line& line) {
  control::Request request;
  control::WaitMode& wait = *request.mutable_wait_mode();
  wait.set_instance(line.positional[0].text);
  wait.set_mode(line.positional[1].text);
  const Word* within = line.clause("for");
  wait.set_within_ms(within != nullptr ? duration_ms(*within, line.words)
                                       : static_cast<double>(session.options.timeout.count()));
  tell_met(session, session.host().call_waiting(std::move(request)).met());
}

void expect(Session& session, const Line& line) {
  const Word& target = line.positional[0];
  const std::size_t first = target.text.find('.');
  const std::size_t second = first == std::string::npos ? first : target.text.find('.', first + 1);
  if (first == std::string::npos || target.text.back() == '.')
    throw line.error(target, {.what = fmt::format("'{}' names no field and no probe", target.text),
                              .expected = "instance.port.field, instance.probe"});
  control::Request request;
  control::Expect& expect = *request.mutable_expect();
  Word port = target;
  if (second != std::string::npos) {
    port.text.resize(second);
    expect.set_field(target.text.substr(second + 1));
  }
  *expect.mutable_port() = port_name(port, line.words);
  expect.set_comparison(comparison_of(line.positional[1], line));
  *expect.mutable_value() = value_of(line.positional[2], line.words);
  if (const Word* within = line.clause("for")) expect.set_within_ms(duration_ms(*within, line.words));
  tell_met(session, session.host().call_waiting(std::move(request)).met());
}

void sleep(Session& session, const Line& line) {
  control::Request request;
  request.mutable_sleep()->set_duration_ms(duration_ms(line.positional[0], line.words));
  session.host().call_waiting(std::move(request));
  session.out.done("");
}

void quit(Session& session, const Line& line) {
  int code = 0;
  if (!line.positional.empty()) {
    const Word& word = line.positional[0];
    const control::Value value = value_of(word, line.words);
    const bool sound = value.kind_case() == control::Value::kInteger && value.unit().empty() && value.integer() >= 0 &&
                       value.integer() <= 255;
    if (!sound)
      throw line.error(word, {.what = fmt::format("'{}' is no exit code", word.text), .expected = "0 .. 255"});
    code = static_cast<int>(value.integer());
  }
  if (session.is_guest && session.setting == Setting::Prompt && !line.has("-y")) {
    const auto yes =
        session.ask ? session.ask("end the host and its system, for all who use it? (yes/no) ") : std::nullopt;
    if (!yes.value_or(false)) return session.out.remark("nothing was ended; Ctrl-D leaves the prompt");
  }
  control::Request request;
  request.mutable_quit()->set_exit_code(code);
  ControlClient& host = session.host();
  host.call(std::move(request));
  session.finished = code;
  wait_until_gone(session, host);
  session.out.done("");
}

}  // namespace fiona::console::verbs
