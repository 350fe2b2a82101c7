#include "atom_table.hpp"

#include <algorithm>
#include <utility>

namespace fiona::planning {

std::size_t AtomTable::slot_of(Index symbol, std::span<const Index> arguments) const {
  std::uint64_t hash = symbol;
  for (const Index argument : arguments) hash = (hash ^ argument) * 0x9E3779B97F4A7C15u + (hash >> 29);
  hash ^= hash >> 32;
  hash *= 0xD6E8FEB86659FD93u;
  const std::size_t mask = slots_.size() - 1;
  for (std::size_t slot = (hash >> 20) & mask;; slot = (slot + 1) & mask) {
    const Index atom = slots_[slot];
    if (atom == kNone) return slot;
    if (symbols_[atom] == symbol && std::ranges::equal(this->arguments(atom), arguments)) return slot;
  }
}

Index AtomTable::find(Index symbol, std::span<const Index> arguments) const {
  return slots_[slot_of(symbol, arguments)];
}

std::pair<Index, bool> AtomTable::insert(Index symbol, std::span<const Index> arguments) {
  if (2 * symbols_.size() >= slots_.size()) grow();
  const std::size_t slot = slot_of(symbol, arguments);
  if (slots_[slot] != kNone) return {slots_[slot], false};
  slots_[slot] = size();
  arguments_.insert(arguments_.end(), arguments.begin(), arguments.end());
  begins_.push_back(arguments_.size());
  symbols_.push_back(symbol);
  return {slots_[slot], true};
}

void AtomTable::grow() {
  List<Index> larger(2 * slots_.size(), kNone, slots_.get_allocator());
  slots_.swap(larger);
  for (Index atom = 0; atom < size(); ++atom) slots_[slot_of(symbols_[atom], arguments(atom))] = atom;
}

void AtomIndex::add(Index symbol, std::span<const Index> arguments, Index atom) {
  by_symbol_[symbol].push_back(atom);
  for (std::size_t place = 0; place < arguments.size(); ++place)
    by_argument_[key(symbol, place, arguments[place])].push_back(atom);
}

const List<Index>& AtomIndex::with(Index symbol) const {
  const auto found = by_symbol_.find(symbol);
  return found == by_symbol_.end() ? none_ : found->second;
}

const List<Index>& AtomIndex::with(Index symbol, std::size_t place, Index object) const {
  const auto found = by_argument_.find(key(symbol, place, object));
  return found == by_argument_.end() ? none_ : found->second;
}

}  // namespace fiona::planning
