#include "states.hpp"

#include <algorithm>

namespace fiona::planning {
namespace {

std::uint32_t hash_of(State state) {
  std::uint64_t hash = 0x9E3779B97F4A7C15u;
  for (const std::uint64_t word : state) {
    hash = (hash ^ word) * 0xD6E8FEB86659FD93u;
    hash ^= hash >> 32;
  }
  return static_cast<std::uint32_t>(hash);
}

}  // namespace

StateTable::StateTable(Index fact_count, std::pmr::memory_resource* memory)
    : words_(std::max<std::size_t>(1, (fact_count + 63) / 64)),
      chunks_(memory),
      hashes_(memory),
      slots_(1024, kNone, memory) {}

std::pair<Index, bool> StateTable::insert(State state) {
  if (2 * hashes_.size() >= slots_.size()) grow();
  const std::uint32_t hash = hash_of(state);
  const std::size_t mask = slots_.size() - 1;
  std::size_t slot = hash & mask;
  for (; slots_[slot] != kNone; slot = (slot + 1) & mask) {
    const Index number = slots_[slot];
    if (hashes_[number] == hash && std::ranges::equal((*this)[number], state)) return {number, false};
  }
  const Index number = size();
  if (number % kChunk == 0) chunks_.emplace_back(kChunk * words_);
  std::ranges::copy(state, chunks_.back().begin() + static_cast<std::ptrdiff_t>(number % kChunk * words_));
  hashes_.push_back(hash);
  slots_[slot] = number;
  return {number, true};
}

void StateTable::grow() {
  slots_.assign(2 * slots_.size(), kNone);
  const std::size_t mask = slots_.size() - 1;
  for (Index number = 0; number < size(); ++number) {
    std::size_t slot = hashes_[number] & mask;
    while (slots_[slot] != kNone) slot = (slot + 1) & mask;
    slots_[slot] = number;
  }
}

Successors::Successors(const GroundTask& task, std::pmr::memory_resource* memory)
    : task_(task), always_(memory), watched_(memory) {
  List<Index> needed(task.fact_count, 0, memory);
  for (std::size_t op = 0; op < task.operator_count(); ++op)
    for (const Index fact : task.needs[op]) ++needed[fact];
  Lists rarest(memory);
  for (Index op = 0; op < task.operator_count(); ++op) {
    const auto needs = task.needs[op];
    if (needs.empty()) {
      always_.push_back(op);
    } else {
      rarest.push(
          *std::min_element(needs.begin(), needs.end(), [&](Index a, Index b) { return needed[a] < needed[b]; }));
    }
    rarest.end_list();
  }
  watched_ = rarest.inverted(task.fact_count);
}

}  // namespace fiona::planning
