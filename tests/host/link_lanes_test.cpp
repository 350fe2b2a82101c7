// What goes next over a link (architecture, data plane): lanes in turn, chunks between small messages, bounds and loss.
#include <google/protobuf/wrappers.pb.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstring>
#include <string>
#include <vector>

#include "link_lanes.hpp"

namespace fiona::host {
namespace {

using google::protobuf::BytesValue;
using testing::ElementsAre;
using Rule = PeerLanes::Rule;

/// Of this many bytes once serialised, heads included.
BytesValue object_of(std::size_t payload) {
  BytesValue object;
  object.mutable_value()->assign(payload, 'x');
  return object;
}

PeerLanes::Item item_of(std::uint64_t wire, std::size_t payload, Rule rule = Rule::MustFit) {
  const BytesValue object = object_of(payload);
  wire::Frame frame;
  frame.set_wire(wire);
  frame.mutable_object()->set_sequence(1);
  PeerLanes::Item item;
  item.rule = rule;
  item.wire = wire;
  item.cost = object.ByteSizeLong() + kFrameCost;
  if (object.ByteSizeLong() > kInlineBytes) {
    item.payload = std::make_shared<const Payload>(object);
    frame.set_size(object.ByteSizeLong());
    item.record = make_record(frame, nullptr, 0);
  } else {
    item.record = make_record(frame, &object, object.ByteSizeLong());
  }
  return item;
}

/// Reads what lanes give out, as the peer would.
class Reader final : public FrameReader::Receiver {
 public:
  /// "wire" of each frame of one message: "1+" when a chunk came that did not end the object.
  std::vector<std::string> read(PeerLanes::Outgoing& out) {
    std::vector<zmq::message_t> parts;
    parts.emplace_back(out.records.data(), out.records.size());
    if (out.payload) parts.emplace_back(out.payload->chunks()[out.chunk].data(), out.payload->chunks()[out.chunk].size());
    seen_.clear();
    EXPECT_TRUE(reader_.read(parts, *this));
    if (seen_.empty()) seen_.push_back("chunk");
    return seen_;
  }
  bool accepts(const wire::Frame&) override { return true; }
  void on_frame(const wire::Frame& frame, const ObjectBytes& object) override {
    seen_.push_back(std::to_string(frame.wire()) + (frame.has_lost() ? " lost " + std::to_string(frame.lost().messages()) : ""));
    bytes += object.size();
    BytesValue parsed;
    EXPECT_TRUE(object.parse_into(parsed));
    EXPECT_EQ(parsed.value(), std::string(parsed.value().size(), 'x'));
  }
  std::size_t bytes = 0;

 private:
  FrameReader reader_;
  std::vector<std::string> seen_;
};

std::vector<std::string> next_of(PeerLanes& lanes, Reader& reader) {
  PeerLanes::Outgoing out;
  return lanes.next(out) ? reader.read(out) : std::vector<std::string>{};
}

TEST(LinkLanes, SmallMessageGoesAfterOneChunkOfALargeOneAtMost) {
  PeerLanes lanes;
  Reader reader;
  const auto large = lanes.open();
  const auto small = lanes.open();
  lanes.offer(*large, item_of(1, 8 * kChunkBytes));
  EXPECT_THAT(next_of(lanes, reader), ElementsAre("chunk"));
  lanes.offer(*small, item_of(2, 64));
  EXPECT_THAT(next_of(lanes, reader), ElementsAre("2"));
  EXPECT_THAT(next_of(lanes, reader), ElementsAre("chunk"));
}

TEST(LinkLanes, LargeMessagesOfSeveralWiresTakeTurnsChunkByChunk) {
  PeerLanes lanes;
  Reader reader;
  const auto long_one = lanes.open();
  const auto short_one = lanes.open();
  lanes.offer(*long_one, item_of(1, 8 * kChunkBytes));
  lanes.offer(*short_one, item_of(2, 2 * kChunkBytes - 100));
  for (const auto* expected : {"chunk", "chunk", "chunk", "2"}) EXPECT_THAT(next_of(lanes, reader), ElementsAre(expected));
}

TEST(LinkLanes, LargeMessageIsNotHeldUpByAStreamOfSmallOnes) {
  PeerLanes lanes;
  Reader reader;
  const auto large = lanes.open();
  const auto small = lanes.open();
  lanes.offer(*large, item_of(1, 2 * kChunkBytes - 100));
  std::vector<std::string> seen;
  for (int i = 0; i < 4; ++i) {
    for (int n = 0; n < 30; ++n) lanes.offer(*small, item_of(2, kInlineBytes - 100));
    seen.push_back(next_of(lanes, reader).front());
  }
  EXPECT_THAT(seen, ElementsAre("2", "chunk", "2", "1"));
}

TEST(LinkLanes, SmallMessagesThatWaitShareOneCrossing) {
  PeerLanes lanes;
  Reader reader;
  const auto one = lanes.open();
  const auto two = lanes.open();
  for (int i = 0; i < 3; ++i) lanes.offer(*one, item_of(1, 64));
  lanes.offer(*two, item_of(2, 64));
  EXPECT_THAT(next_of(lanes, reader), ElementsAre("1", "2", "1", "1"));
  EXPECT_FALSE(lanes.has_ready());
}

TEST(LinkLanes, LaneWithoutCreditStopsAndTheOthersDoNot) {
  PeerLanes lanes;
  Reader reader;
  const auto stopped = lanes.open();
  const auto other = lanes.open();
  for (int i = 0; i < 8; ++i) {
    ASSERT_TRUE(lanes.offer(*stopped, item_of(1, kLaneWindow / 4 - kChunkBytes)).ok);
    while (!next_of(lanes, reader).empty()) continue;
  }
  EXPECT_LE(reader.bytes, kLaneWindow);
  lanes.offer(*other, item_of(2, 64));
  EXPECT_THAT(next_of(lanes, reader), ElementsAre("2"));
  const auto before = reader.bytes;
  lanes.credit(stopped->id(), kLaneWindow);
  while (!next_of(lanes, reader).empty()) continue;
  EXPECT_GT(reader.bytes, before + 64);
}

TEST(LinkLanes, FullLaneOfAPushLosesItsOldestAndTellsEachClientBeforeTheNextMessage) {
  PeerLanes lanes;
  Reader reader;
  const auto lane = lanes.open();
  const auto put = [&](std::uint64_t wire) {
    auto item = item_of(wire, kLaneWindow / 2 - kChunkBytes, Rule::DropOldest);
    item.also = std::make_shared<const std::vector<std::uint64_t>>(1, wire + 1);
    return lanes.offer(*lane, std::move(item)).lost;
  };
  std::size_t lost = 0;
  for (int i = 0; i < 2; ++i) lost += put(1);
  while (!next_of(lanes, reader).empty()) continue;  // the window is used up
  for (int i = 0; i < 5; ++i) lost += put(1);
  EXPECT_EQ(lost, 6U) << "three messages, each of two wires";
  lanes.credit(lane->id(), kLaneWindow);
  EXPECT_THAT(next_of(lanes, reader), ElementsAre("1 lost 3", "2 lost 3"));
}

TEST(LinkLanes, FullLaneOfRequestsTakesNoMore) {
  PeerLanes lanes;
  const auto lane = lanes.open();
  for (int i = 0; i < 2; ++i) EXPECT_TRUE(lanes.offer(*lane, item_of(1, kLaneWindow / 2 - kChunkBytes)).ok);
  EXPECT_FALSE(lanes.offer(*lane, item_of(1, kLaneWindow / 2)).ok);
}

TEST(LinkLanes, MessageLargerThanTheWindowGoesWhileLittleIsWithoutCredit) {
  PeerLanes lanes;
  Reader reader;
  const auto lane = lanes.open();
  lanes.offer(*lane, item_of(1, 64));
  EXPECT_THAT(next_of(lanes, reader), ElementsAre("1"));
  // The receiver gives credit back in portions: it may keep this one for ever.
  EXPECT_TRUE(lanes.offer(*lane, item_of(1, 2 * kLaneWindow)).ok);
  while (!next_of(lanes, reader).empty()) continue;
  EXPECT_GT(reader.bytes, 2 * kLaneWindow);
}

TEST(LinkLanes, ClosedLaneEndsWhatHasBegunAndGoes) {
  PeerLanes lanes;
  Reader reader;
  const auto lane = lanes.open();
  lanes.offer(*lane, item_of(1, 2 * kChunkBytes - 100));
  lanes.offer(*lane, item_of(1, 64));
  EXPECT_THAT(next_of(lanes, reader), ElementsAre("chunk"));
  wire::Frame closed;
  closed.set_wire(1);
  closed.mutable_closed();
  PeerLanes::Item item;
  item.record = make_record(closed, nullptr, 0);
  lanes.offer(*lane, std::move(item));
  lanes.close(*lane);
  EXPECT_THAT(next_of(lanes, reader), ElementsAre("1")) << "the object's rest";
  EXPECT_THAT(next_of(lanes, reader), ElementsAre("1")) << "that it is closed";
  EXPECT_THAT(next_of(lanes, reader), testing::IsEmpty());
  EXPECT_EQ(lanes.lanes(), 0U);
}

TEST(LinkLanes, ObjectsOfEverySizeArriveAsTheyWere) {
  for (const std::size_t size : {0UL, 1UL, kInlineBytes - 1, kInlineBytes, kInlineBytes + 1, kChunkBytes - 20, kChunkBytes - 6,
                                 kChunkBytes - 5, kChunkBytes - 4, kChunkBytes, kChunkBytes + 1, 3 * kChunkBytes + 17}) {
    PeerLanes lanes;
    Reader reader;
    const auto lane = lanes.open();
    lanes.offer(*lane, item_of(1, size));
    while (!next_of(lanes, reader).empty()) continue;
    EXPECT_EQ(reader.bytes, object_of(size).ByteSizeLong()) << size;
  }
}

// ---- what is refused ------------------------------------------------------------------------------------------

struct Nobody final : FrameReader::Receiver {
  bool accepts(const wire::Frame& frame) override { return frame.wire() == 1; }
  void on_frame(const wire::Frame&, const ObjectBytes&) override { ++frames; }
  int frames = 0;
};

bool read_chunk(FrameReader& reader, Nobody& nobody, const wire::Frame& frame, std::size_t bytes) {
  const Block record = make_record(frame, nullptr, 0);
  std::vector<zmq::message_t> parts;
  parts.emplace_back(record.data(), record.size());
  parts.emplace_back(bytes);
  return reader.read(parts, nobody);
}

wire::Frame first_of(std::uint64_t wire, std::size_t size) {
  wire::Frame frame;
  frame.set_wire(wire);
  frame.set_size(size);
  frame.mutable_object();
  return frame;
}

wire::Frame more_of(std::uint64_t wire) {
  wire::Frame frame;
  frame.set_wire(wire);
  frame.mutable_more();
  return frame;
}

TEST(LinkChunks, ObjectAboveTheCapIsNotPutTogether) {
  FrameReader reader;
  Nobody nobody;
  EXPECT_FALSE(read_chunk(reader, nobody, first_of(1, kMaxObject + 1), kChunkBytes));
  EXPECT_EQ(reader.unfinished(), 0U);
}

TEST(LinkChunks, OfWiresThatAreNotThePeersAreNotKept) {
  FrameReader reader;
  Nobody nobody;
  EXPECT_TRUE(read_chunk(reader, nobody, first_of(2, 2 * kChunkBytes), kChunkBytes));
  EXPECT_TRUE(read_chunk(reader, nobody, more_of(2), kChunkBytes));
  EXPECT_EQ(reader.unfinished(), 0U);
  EXPECT_EQ(nobody.frames, 0);
}

TEST(LinkChunks, ChunkOfAnotherSizeEndsTheObject) {
  FrameReader reader;
  Nobody nobody;
  EXPECT_TRUE(read_chunk(reader, nobody, first_of(1, 2 * kChunkBytes), kChunkBytes));
  EXPECT_FALSE(read_chunk(reader, nobody, more_of(1), 1));
  EXPECT_EQ(reader.unfinished(), 0U);
  EXPECT_FALSE(read_chunk(reader, nobody, first_of(1, 2 * kChunkBytes), 1));
  EXPECT_EQ(reader.unfinished(), 0U);
}

TEST(LinkChunks, SecondObjectOfAWireBeforeTheFirstHasEndedIsRefused) {
  FrameReader reader;
  Nobody nobody;
  EXPECT_TRUE(read_chunk(reader, nobody, first_of(1, 2 * kChunkBytes), kChunkBytes));
  EXPECT_FALSE(read_chunk(reader, nobody, first_of(1, 2 * kChunkBytes), kChunkBytes));
  EXPECT_EQ(reader.unfinished(), 0U);
}

}  // namespace
}  // namespace fiona::host
