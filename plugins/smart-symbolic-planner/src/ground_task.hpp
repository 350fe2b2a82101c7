#pragma once

#include <span>

#include "lifted_task.hpp"

namespace fiona::planning {

/// Many lists of numbers in two blocks of memory.
class Lists {
 public:
  explicit Lists(std::pmr::memory_resource* memory) : begins_(1, 0, memory), values_(memory) {}

  std::size_t size() const { return begins_.size() - 1; }
  std::span<const Index> operator[](std::size_t i) const {
    return {values_.data() + begins_[i], values_.data() + begins_[i + 1]};
  }
  /// Adds to the last list, which `end_list` ends.
  void push(Index value) { values_.push_back(value); }
  void end_list() { begins_.push_back(values_.size()); }
  void add(std::span<const Index> list) {
    values_.insert(values_.end(), list.begin(), list.end());
    end_list();
  }
  /// For each number below `count`, the lists that have it, in ascending order.
  Lists inverted(std::size_t count) const;

 private:
  List<std::size_t> begins_;
  List<Index> values_;
};

/// A planning task without parameters: facts that are numbers, and operators that need, add and delete some of them.
/// What never changes is left out, and what no way to the goal needs. Where an operator or the goal needs that
/// something is not so, this is a fact of its own.
struct GroundTask {
  explicit GroundTask(std::pmr::memory_resource* memory)
      : needs(memory),
        adds(memory),
        deletes(memory),
        costs(memory),
        actions(memory),
        arguments(memory),
        init(memory),
        goal(memory) {}

  std::size_t operator_count() const { return costs.size(); }

  Index fact_count = 0;
  Lists needs;
  Lists adds;     ///< none that it needs
  Lists deletes;  ///< none that it adds
  List<Cost> costs;
  List<Index> actions;  ///< of the lifted task
  Lists arguments;      ///< its objects
  List<Index> init;
  List<Index> goal;
  bool is_solvable = true;  ///< false: proven that there is no plan
};

}  // namespace fiona::planning
