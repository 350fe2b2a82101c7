#include "link_lanes.hpp"

#include <algorithm>
#include <cstring>
#include <utility>

namespace fiona::host {

/// Whether its first item may go: one that has begun, one that needs no credit, one that has it, or one that is larger
/// than the window while nothing is on its way but what the receiver has not yet given credit for.
bool PeerLanes::Lane::may_go() const {
  if (queue_.empty()) return false;
  const Item& first = queue_.front();
  return first.next_chunk > 0 || first.cost == 0 || in_flight_ < kCreditPortion ||
         in_flight_ + first.cost <= kLaneWindow;
}

/// How many messages were lost by it, counted for each wire; 0: there is none that may go.
std::size_t PeerLanes::Lane::drop_oldest() {
  const auto oldest = std::find_if(queue_.begin(), queue_.end(), [](const Item& item) {
    return item.rule == Rule::DropOldest && item.next_chunk == 0;
  });
  if (oldest == queue_.end()) return 0;
  const std::size_t losses = note_lost(*oldest);
  waiting_ -= oldest->cost;
  queue_.erase(oldest);
  return losses;
}

std::size_t PeerLanes::Lane::note_lost(const Item& item) {
  lost_[item.wire] += item.messages;
  if (item.also) {
    for (const std::uint64_t wire : *item.also) lost_[wire] += item.messages;
  }
  return item.losses();
}

std::shared_ptr<PeerLanes::Lane> PeerLanes::open() {
  const auto lane = std::make_shared<Lane>(next_lane_++);
  lanes_.emplace(lane->id(), lane);
  return lane;
}

std::size_t PeerLanes::close(Lane& lane, Rest rest) {
  if (lane.closed_) return 0;
  std::size_t kept = lane.waiting_;
  for (const auto& [id, other] : lanes_) kept += other->closed_ ? other->waiting_ : 0;
  lane.closed_ = true;
  const auto waits = [](const Item& item) { return item.cost > 0 && item.next_chunk == 0; };
  const bool is_one_object = kept == lane.waiting_ && std::count_if(lane.queue_.begin(), lane.queue_.end(), waits) == 1;
  std::size_t lost = 0;
  if (rest == Rest::IsLost || (kept > kLaneWindow && !is_one_object)) {
    std::erase_if(lane.queue_, [&](const Item& item) {
      if (!waits(item)) return false;
      // Of a push its client is told; who has sent something else counts it himself.
      lost += item.rule == Rule::DropOldest ? lane.note_lost(item) : item.losses();
      return true;
    });
    if (rest == Rest::IsLost) lane.lost_.clear();  // else it is told before the end of the wire
    lane.waiting_ = 0;
  }
  update(lane);
  return lost;
}

PeerLanes::Taken PeerLanes::offer(Lane& lane, Item item) {
  Taken taken;
  if (lane.closed_ && item.cost > 0) return taken;
  if (item.rule == Rule::MustFit && lane.is_full(item.cost)) return {false, 0};
  while (item.rule == Rule::DropOldest && lane.is_full(item.cost)) {
    const std::size_t lost = lane.drop_oldest();
    if (lost == 0) break;
    taken.lost += lost;
  }
  if (taken.lost > 0 && !item.payload && !item.also) {  // as `join` would have, had there been room
    if (std::uint8_t* const place = join(lane, item.wire, item.cost, item.record.size())) {
      std::memcpy(place, item.record.data(), item.record.size());
      return taken;
    }
  }
  lane.waiting_ += item.cost;
  if (item.cost == 0) control_bytes_ += item.record.size() + kFrameCost;
  lane.queue_.push_back(std::move(item));
  update(lane);
  return taken;
}

std::uint8_t* PeerLanes::join(Lane& lane, std::uint64_t wire, std::size_t cost, std::size_t record_size) {
  if (lane.closed_ || lane.queue_.empty() || lane.is_full(cost)) return nullptr;
  Item& last = lane.queue_.back();
  if (last.rule != Rule::DropOldest || last.payload || last.also || last.wire != wire) return nullptr;
  if (last.record.size() + record_size > kTogetherBytes) return nullptr;
  std::uint8_t* const place = last.record.extend(record_size, kTogetherBytes);
  lane.waiting_ += cost;
  last.cost += cost;
  ++last.messages;
  update(lane);
  return place;
}

void PeerLanes::credit(std::uint64_t id, std::size_t bytes) {
  const auto found = lanes_.find(id);
  if (found == lanes_.end()) return;  // of a lane that has gone
  Lane& lane = *found->second;
  lane.in_flight_ -= std::min(lane.in_flight_, bytes);
  update(lane);
}

/// Puts the lane where it belongs: at the end of a line, or away once it is closed and empty.
void PeerLanes::update(Lane& lane) {
  Turns* turns = !lane.may_go() ? nullptr : lane.queue_.front().payload ? &large_ : &small_;
  if (turns != lane.turns_) {
    if (lane.turns_) std::erase(*lane.turns_, &lane);
    if (turns) turns->push_back(&lane);
    lane.turns_ = turns;
  }
  if (lane.closed_ && lane.queue_.empty()) lanes_.erase(lane.id());
}

/// Small messages and chunks take turns, and within each kind the lanes.
bool PeerLanes::next(Outgoing& out) {
  if (small_.empty() && large_.empty()) return false;
  out.payload = nullptr;
  const bool small = !small_.empty() && (small_is_next_ || large_.empty());
  small_is_next_ = !small;
  small ? take_small(out) : take_chunk(out);
  return true;
}

namespace {

Block joined(std::vector<Block>& records) {
  if (records.size() == 1) return std::move(records.front());
  std::size_t bytes = 0;
  for (const Block& record : records) bytes += record.size();
  Block all(bytes);
  std::uint8_t* end = all.data();
  for (const Block& record : records) {
    std::memcpy(end, record.data(), record.size());
    end += record.size();
  }
  return all;
}

}  // namespace

/// The record of the lane's first item, behind what the wires have lost right before it.
void PeerLanes::begin(Lane& lane) {
  for (const auto& [wire, messages] : lane.lost_) {
    wire::Frame frame;
    frame.set_wire(wire);
    frame.mutable_lost()->set_messages(messages);
    records_.push_back(make_record(frame, nullptr, 0));
  }
  lane.lost_.clear();
  Item& item = lane.queue_.front();
  lane.waiting_ -= item.cost;
  lane.in_flight_ += item.cost;
  if (item.cost == 0) control_bytes_ -= item.record.size() + kFrameCost;
  records_.push_back(std::move(item.record));
}

void PeerLanes::take_chunk(Outgoing& out) {
  Lane& lane = *large_.front();
  Item& item = lane.queue_.front();
  records_.clear();
  if (item.next_chunk == 0) {
    begin(lane);
  } else {
    wire::Frame frame;
    frame.set_wire(item.wire);
    frame.mutable_more();
    records_.push_back(make_record(frame, ObjectBytes(item.payload->chunks()[item.next_chunk].inside)));
  }
  out.records = joined(records_);
  out.payload = item.payload;
  out.chunk = item.next_chunk++;
  if (item.next_chunk == item.payload->chunks().size()) lane.queue_.pop_front();
  large_.pop_front();
  lane.turns_ = nullptr;
  update(lane);
}

/// Up to a block: many small messages cost one.
void PeerLanes::take_small(Outgoing& out) {
  records_.clear();
  std::size_t bytes = 0;
  while (!small_.empty() && (records_.empty() || bytes + small_.front()->queue_.front().record.size() <= kBlockBytes)) {
    Lane& lane = *small_.front();
    bytes += lane.queue_.front().record.size();
    begin(lane);
    lane.queue_.pop_front();
    const bool next_too = small_.size() == 1 && lane.may_go() && !lane.queue_.front().payload;
    if (next_too) continue;
    small_.pop_front();
    lane.turns_ = nullptr;
    update(lane);
  }
  out.records = joined(records_);
}

}  // namespace fiona::host
