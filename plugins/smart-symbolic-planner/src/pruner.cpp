#include "pruner.hpp"

#include <utility>

namespace fiona::planning {

class Pruner {
 public:
  Pruner(GroundTask& task, Pace& pace, std::pmr::memory_resource* memory)
      : task_(task), pace_(pace), memory_(memory), number_(task.fact_count, kNone, memory), open_(memory) {}

  Async<> run() {
    auto marked = mark();
    co_await marked;
    Index count = 0;
    for (Index& number : number_)
      if (number != kNone) number = count++;
    if (count == task_.fact_count) co_return;
    GroundTask kept(memory_);
    for (std::size_t op = 0; op < task_.operator_count(); ++op) {
      if (pace_.due()) co_await pace_.pause();
      if (!copy(task_.adds[op], kept.adds)) continue;
      copy(task_.needs[op], kept.needs);
      copy(task_.deletes[op], kept.deletes);
      for (Lists* lists : {&kept.adds, &kept.needs, &kept.deletes}) lists->end_list();
      kept.costs.push_back(task_.costs[op]);
      kept.actions.push_back(task_.actions[op]);
      kept.arguments.add(task_.arguments[op]);
    }
    kept.fact_count = count;
    for (const Index fact : task_.init)
      if (number_[fact] != kNone) kept.init.push_back(number_[fact]);
    for (const Index fact : task_.goal) kept.goal.push_back(number_[fact]);
    task_ = std::move(kept);
  }

 private:
  Async<> mark() {
    const Lists adders = task_.adds.inverted(task_.fact_count);
    List<bool> seen(task_.operator_count(), false, memory_);
    for (const Index fact : task_.goal) want(fact);
    while (!open_.empty()) {
      const Index fact = open_.back();
      open_.pop_back();

      for (const Index op : adders[fact]) {
        if (pace_.due()) co_await pace_.pause();
        if (seen[op]) continue;
        seen[op] = true;
        for (const Index needed : task_.needs[op]) want(needed);
      }
    }
  }

  void want(Index fact) {
    if (number_[fact] != kNone) return;
    number_[fact] = 0;
    open_.push_back(fact);
  }

  bool copy(std::span<const Index> from, Lists& to) const {
    bool any = false;
    for (const Index fact : from) {
      if (number_[fact] == kNone) continue;
      to.push(number_[fact]);
      any = true;
    }
    return any;
  }

  GroundTask& task_;
  Pace& pace_;
  std::pmr::memory_resource* memory_;
  List<Index> number_;  ///< kNone: left out
  List<Index> open_;
};

Async<> prune(GroundTask& task, Pace& pace, std::pmr::memory_resource* memory) {
  Pruner pruner(task, pace, memory);
  auto work = pruner.run();
  co_await work;
}

}  // namespace fiona::planning
