#include "symbolic_planner.hpp"

#include <algorithm>
#include <string>
#include <utility>

namespace fiona::planning {
namespace {

/// What was asked for, where it is granted.
std::uint32_t bound(std::uint32_t asked, std::uint32_t granted) {
  return asked == 0 ? granted : std::min(asked, granted);
}

PlanRequest plan_request(const navigation::CommPlanRequest& request,
                         const smart_symbolic_planner::Parameters& granted) {
  return {.domain = request.domain(),
          .problem = request.problem(),
          .optimal = request.search() == navigation::CommPlanRequest::OPTIMAL,
          .time_bound = std::chrono::milliseconds(bound(request.time_bound(), granted.time_bound())),
          .memory_bound = std::size_t{bound(request.memory_bound(), granted.memory_bound())} << 20};
}

navigation::CommPlan::Outcome outcome_of(const PlanAnswer& answer) {
  switch (answer.outcome) {
    case PlanAnswer::Outcome::Solved: return navigation::CommPlan::SOLVED;
    case PlanAnswer::Outcome::Unsolvable: return navigation::CommPlan::UNSOLVABLE;
    case PlanAnswer::Outcome::OutOfTime: return navigation::CommPlan::OUT_OF_TIME;
    case PlanAnswer::Outcome::OutOfMemory: return navigation::CommPlan::OUT_OF_MEMORY;
    case PlanAnswer::Outcome::BadInput: return navigation::CommPlan::BAD_INPUT;
  }
  return navigation::CommPlan::OUTCOME_UNSPECIFIED;
}

navigation::CommPlan message_of(const PlanAnswer& answer) {
  navigation::CommPlan message;
  message.set_outcome(outcome_of(answer));
  for (const PlanStep& step : answer.steps) {
    auto& added = *message.add_steps();
    added.set_action(step.action);
    for (const std::string& argument : step.arguments) added.add_arguments(argument);
    added.set_cost(step.cost);
  }
  message.set_cost(answer.cost);
  message.set_is_optimal(answer.is_optimal);
  message.set_expanded(answer.statistics.expanded);
  message.set_generated(answer.statistics.generated);
  message.set_time(std::chrono::duration<double, std::milli>(answer.time).count());
  message.set_memory(static_cast<double>(answer.memory) / (1 << 20));
  message.set_message(answer.message);
  if (answer.fault) {
    message.set_fault_in(answer.fault->text == Text::Domain ? navigation::CommPlan::DOMAIN_TEXT
                                                            : navigation::CommPlan::PROBLEM_TEXT);
    message.set_line(answer.fault->line);
    message.set_column(answer.fault->column);
  }
  return message;
}

}  // namespace

SymbolicPlanner::Open::Open(const Request& from, const smart_symbolic_planner::Parameters& granted, Reply<Answer> to)
    : request(from), reply(std::move(to)), planning(plan_request(request, granted)) {}

void SymbolicPlanner::on_mode(std::string_view mode) {
  if (mode == kModeActive) return;
  for (const auto& open : open_) open->reply.reject("the planner has left its mode '" + std::string(kModeActive) + "'");
  open_.clear();
  waiting_.set(0);
}

void SymbolicPlanner::on_request(const Request& request, Reply<Answer> reply) {
  std::erase_if(open_, [](const auto& open) { return open->reply.abandoned(); });
  if (open_.size() >= params_->open_requests()) {
    refused_.set(++refused_count_);
    return reply.reject(std::to_string(open_.size()) +
                        " requests are being planned for already: try again later, or set " + name() +
                        " open_requests");
  }
  open_.push_back(std::make_unique<Open>(request, *params_, std::move(reply)));
  waiting_.set(static_cast<std::int64_t>(open_.size()));
  if (open_.size() == 1) next_slice_.at(now());
}

void SymbolicPlanner::work() {
  std::erase_if(open_, [](const auto& open) { return open->reply.abandoned(); });
  if (!open_.empty()) {
    auto open = std::move(open_.front());
    open_.pop_front();
    if (open->planning.advance(kSlice)) {
      finish(*open);
    } else {
      open_.push_back(std::move(open));
    }
  }
  waiting_.set(static_cast<std::int64_t>(open_.size()));
  if (!open_.empty()) next_slice_.at(now());
}

void SymbolicPlanner::finish(Open& open) {
  const PlanAnswer& answer = open.planning.answer();
  time_.set(std::chrono::duration<double, std::milli>(answer.time).count());
  if (answer.outcome != PlanAnswer::Outcome::Solved) log(LogLevel::Info, answer.message);
  open.reply.answer(message_of(answer));
}

}  // namespace fiona::planning
