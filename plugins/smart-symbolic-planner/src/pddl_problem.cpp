#include <algorithm>

#include "pddl_terms.hpp"

namespace fiona::planning {

class ProblemReader {
  using Word = PddlReader::Word;

 public:
  ProblemReader(LiftedTask& task, Pace& pace)
      : task_(task),
        pace_(pace),
        in_(Text::Problem, task.problem_text, pace),
        terms_(task, in_),
        sections_(task.memory) {}

  Async<> read() {
    find_sections();
    go_to(":domain");
    domain();
    if (find(":requirements")) terms_.requirements();
    if (find(":objects")) terms_.objects();
    go_to(":init");
    auto reading = init();
    co_await reading;
    go_to(":goal");
    goal();
    if (find(":metric")) metric();
  }

 private:
  void find_sections() {
    std::string_view name;
    sections_ =
        terms_.sections("problem", name, {":domain", ":requirements", ":objects", ":init", ":goal", ":metric"}, {});
  }

  bool find(std::string_view keyword) {
    const auto found =
        std::find_if(sections_.begin(), sections_.end(), [&](const auto& s) { return s.keyword == keyword; });
    if (found != sections_.end()) in_.go_to(found->inside);
    return found != sections_.end();
  }

  void go_to(std::string_view keyword) {
    if (!find(keyword))
      in_.fail(0, {.what = "the problem has no section '(" + std::string(keyword) + " ...)'", .next = "add it"});
  }

  void domain() {
    const Word name = in_.name("the name of the domain");
    if (name.text != task_.domain_name)
      in_.fail(name,
               "the problem is one of the domain " + quoted(name.text) + ", and the domain given is " +
                   quoted(task_.domain_name),
               "give the domain that it is one of, or correct its (:domain ...)");
    in_.expect(")", "')'");
  }

  Async<> init() {
    while (!in_.take(")")) {
      if (pace_.look()) co_await pace_.pause();
      in_.expect("(", "an atom, '(PREDICATE ...)', or ')'");
      const Word word = in_.next();
      if (word == "=") {
        value();
      } else if (word == "not") {
        // What is not listed is false: this says no more than leaving it out.
        in_.expect("(", "an atom, '(PREDICATE ...)'");
        terms_.predicate(in_.name("a predicate"));
        in_.expect(")", "')' behind the atom of 'not'");
      } else {
        if (!word.is_name()) in_.fail_expected(word, "a predicate or '='");
        if (word == "at" && !task_.predicate_index.contains("at"))
          in_.fail(word, "the predicate 'at' is not declared, and timed literals are not supported",
                   "declare it in the domain's :predicates");
        task_.init.push_back(terms_.predicate(word));
      }
    }
  }

  void value() {
    in_.expect("(", "a function, '(NAME ...)'");
    const Word name = in_.name("a function");
    const Atom function = terms_.function(name);
    const Word number = in_.next();
    const Cost value = terms_.number(number);
    in_.expect(")", "')' behind the value");
    if (function.symbol == task_.total_cost) {
      if (value != 0) in_.fail(number, "the total cost begins at 0", "write 0, or take it out");
      return;
    }
    task_.values.emplace_back(function, value);
  }

  void goal() {
    terms_.conditions(task_.goal);
    in_.expect(")", "')' behind the goal, which is one condition");
  }

  void metric() {
    const Word direction = in_.next();
    if (direction.text != "minimize") in_.fail_expected(direction, "'minimize'");
    static constexpr std::string_view kExpected = "'(total-cost)': the only metric that is supported";
    in_.expect("(", kExpected);
    const Word function = in_.next();
    if (function.text != "total-cost") in_.fail_expected(function, kExpected);
    if (task_.total_cost == kNone) in_.fail(function, "'total-cost' is not declared in the domain", kDeclareCost);
    in_.expect(")", "')'");
    in_.expect(")", "')' behind the metric");
    task_.has_metric = true;
  }

  LiftedTask& task_;
  Pace& pace_;
  PddlReader in_;
  PddlTerms terms_;
  List<PddlTerms::Section> sections_;
};

Async<> read_problem(LiftedTask& task, std::string_view text, Pace& pace) {
  task.problem_text = lower_case(text, task.memory);
  ProblemReader reader(task, pace);
  auto reading = reader.read();
  co_await reading;
}

}  // namespace fiona::planning
