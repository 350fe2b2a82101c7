#pragma once

#include <bit>
#include <span>
#include <utility>

#include "ground_task.hpp"

namespace fiona::planning {

/// A state: one bit for each fact.
using State = std::span<const std::uint64_t>;
using MutableState = std::span<std::uint64_t>;

inline bool holds(State state, Index fact) { return (state[fact / 64] >> (fact % 64) & 1) != 0; }
inline void set(MutableState state, Index fact) { state[fact / 64] |= std::uint64_t{1} << (fact % 64); }
inline void clear(MutableState state, Index fact) { state[fact / 64] &= ~(std::uint64_t{1} << (fact % 64)); }

inline bool all_hold(State state, std::span<const Index> facts) {
  for (const Index fact : facts)
    if (!holds(state, fact)) return false;
  return true;
}

/// Makes `state` what it is after the operator.
inline void apply(const GroundTask& task, Index op, MutableState state) {
  for (const Index fact : task.deletes[op]) clear(state, fact);
  for (const Index fact : task.adds[op]) set(state, fact);
}

/// States, each once, numbered in the order in which they came.
class StateTable {
 public:
  StateTable(Index fact_count, std::pmr::memory_resource* memory);

  std::size_t words() const { return words_; }
  Index size() const { return static_cast<Index>(hashes_.size()); }
  State operator[](Index number) const { return {chunks_[number / kChunk].data() + number % kChunk * words_, words_}; }
  /// Its number, and whether it is new.
  std::pair<Index, bool> insert(State state);

 private:
  static constexpr std::size_t kChunk = 1024;  ///< states that are stored together
  void grow();

  const std::size_t words_;
  List<List<std::uint64_t>> chunks_;
  List<std::uint32_t> hashes_;
  List<Index> slots_;
};

/// Which operators can be applied in a state. Each operator is looked at only where the one of its facts holds that the
/// fewest others need.
class Successors {
 public:
  Successors(const GroundTask& task, std::pmr::memory_resource* memory);

  template <class F>
  void for_each(State state, F use) const {
    for (const Index op : always_) use(op);
    for (std::size_t word = 0; word < state.size(); ++word) {
      for (std::uint64_t bits = state[word]; bits != 0; bits &= bits - 1) {
        const auto fact = static_cast<Index>(word * 64 + static_cast<std::size_t>(std::countr_zero(bits)));
        for (const Index op : watched_[fact])
          if (all_hold(state, task_.needs[op])) use(op);
      }
    }
  }

 private:
  const GroundTask& task_;
  List<Index> always_;
  Lists watched_;  ///< for each fact the operators
};

}  // namespace fiona::planning
