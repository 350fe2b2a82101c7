#pragma once

#include <span>
#include <unordered_map>

#include "lifted_task.hpp"

namespace fiona::planning {

/// Atoms without parameters, each once, numbered in the order in which they came.
class AtomTable {
 public:
  explicit AtomTable(std::pmr::memory_resource* memory)
      : symbols_(memory), begins_(1, 0, memory), arguments_(memory), slots_(kFirstSlots, kNone, memory) {}

  Index size() const { return static_cast<Index>(symbols_.size()); }
  Index symbol(Index atom) const { return symbols_[atom]; }
  std::span<const Index> arguments(Index atom) const {
    return {arguments_.data() + begins_[atom], arguments_.data() + begins_[atom + 1]};
  }
  /// kNone if it is not there.
  Index find(Index symbol, std::span<const Index> arguments) const;
  /// Its number, and whether it is new.
  std::pair<Index, bool> insert(Index symbol, std::span<const Index> arguments);

 private:
  static constexpr std::size_t kFirstSlots = 64;
  std::size_t slot_of(Index symbol, std::span<const Index> arguments) const;
  void grow();

  List<Index> symbols_;
  List<std::size_t> begins_;
  List<Index> arguments_;
  List<Index> slots_;
};

/// Which atoms have a certain object as a certain argument, and which have a certain symbol, in ascending order.
class AtomIndex {
 public:
  explicit AtomIndex(std::pmr::memory_resource* memory) : by_symbol_(memory), by_argument_(memory) {}
  void add(Index symbol, std::span<const Index> arguments, Index atom);
  const List<Index>& with(Index symbol) const;
  const List<Index>& with(Index symbol, std::size_t place, Index object) const;

 private:
  static std::uint64_t key(Index symbol, std::size_t place, Index object) {
    return (std::uint64_t{symbol} * kMostParameters + place) << 32 | object;
  }
  std::pmr::unordered_map<Index, List<Index>> by_symbol_;
  std::pmr::unordered_map<std::uint64_t, List<Index>> by_argument_;
  const List<Index> none_{};
};

}  // namespace fiona::planning
