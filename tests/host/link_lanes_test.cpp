// What goes next over a link (docs/architecture.md, The way of a message): lanes in turn, chunks between small
// messages, bounds and loss.
#include <gmock/gmock.h>
#include <google/protobuf/struct.pb.h>
#include <google/protobuf/wrappers.pb.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cstring>
#include <random>
#include <set>
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
    item.payload = std::make_shared<const Payload>(std::make_shared<BytesValue>(object));
    frame.set_size(object.ByteSizeLong());
    item.record = make_record(frame, ObjectBytes(item.payload->chunks().front().inside));
  } else {
    item.record = make_record(frame, &object, object.ByteSizeLong());
  }
  return item;
}

/// As the link puts a small message of a push. Returns what was lost for it.
std::size_t put_small(PeerLanes& lanes, PeerLanes::Lane& lane, std::uint64_t wire) {
  PeerLanes::Item item = item_of(wire, 64, Rule::DropOldest);
  std::uint8_t* const place = lanes.join(lane, wire, item.cost, item.record.size());
  if (!place) return lanes.offer(lane, std::move(item)).lost;
  std::copy_n(item.record.data(), item.record.size(), place);
  return 0;
}

/// Reads what lanes give out, as the peer would.
class Reader final : public FrameReader::Receiver {
 public:
  /// "wire" of each frame of one message: "1+" when a chunk came that did not end the object.
  std::vector<std::string> read(PeerLanes::Outgoing& out) {
    std::vector<zmq::message_t> parts;
    parts.emplace_back(out.records.data(), out.records.size());
    if (out.payload && !out.payload->chunks()[out.chunk].beside.empty()) {
      const auto beside = out.payload->chunks()[out.chunk].beside;
      parts.emplace_back(beside.data(), beside.size());
    }
    seen_.clear();
    EXPECT_TRUE(reader_.read(parts, *this));
    if (seen_.empty()) seen_.push_back("chunk");
    return seen_;
  }
  std::optional<std::uint64_t> accepts(const wire::Frame& frame) override { return frame.wire(); }
  void on_frame(const wire::Frame& frame, const ObjectBytes& object) override {
    seen_.push_back(std::to_string(frame.wire()) +
                    (frame.has_lost() ? " lost " + std::to_string(frame.lost().messages()) : ""));
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
  for (const auto* expected : {"chunk", "chunk", "chunk", "2"})
    EXPECT_THAT(next_of(lanes, reader), ElementsAre(expected));
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

/// Fills the lane's window and lets messages wait for credit behind it; returns how many were taken.
int fill(PeerLanes& lanes, PeerLanes::Lane& lane, std::uint64_t wire) {
  Reader reader;
  int taken = 0;
  while (lanes.offer(lane, item_of(wire, kLaneWindow / 8)).ok) {
    ++taken;
    while (!next_of(lanes, reader).empty()) continue;
  }
  return taken;
}

TEST(LinkLanes, LaneThatEndsGivesOutWhatItHadTakenAndTheFrameBehindIt) {
  PeerLanes lanes;
  Reader reader;
  const auto lane = lanes.open();
  fill(lanes, *lane, 1);
  lanes.offer(*lane, item_of(1, 0, Rule::Control));
  EXPECT_EQ(lanes.close(*lane, PeerLanes::Rest::Goes), 0U);
  EXPECT_FALSE(lanes.has_ready());
  const std::uint64_t id = lane->id();
  for (int i = 0; i < 100 && lanes.lanes() > 0; ++i) {
    lanes.credit(id, kLaneWindow / 8);
    while (!next_of(lanes, reader).empty()) continue;
  }
  EXPECT_EQ(lanes.lanes(), 0U);
  EXPECT_GE(reader.bytes, 7 * kLaneWindow / 8);
}

TEST(LinkLanes, LanesThatEndKeepOneWindowTogether) {
  PeerLanes lanes;
  const auto first = lanes.open();
  const auto second = lanes.open();
  fill(lanes, *first, 1);
  fill(lanes, *second, 2);
  EXPECT_EQ(lanes.close(*first, PeerLanes::Rest::Goes), 0U);
  EXPECT_GT(lanes.close(*second, PeerLanes::Rest::Goes), 0U);
  EXPECT_EQ(lanes.lanes(), 1U);
}

TEST(LinkLanes, LaneThatEndsCountsWhatItLosesOnceForEachWire) {
  PeerLanes lanes;
  const auto lane = lanes.open();
  lanes.offer(*lane, item_of(1, 64, Rule::DropOldest));
  auto shared = item_of(1, 64, Rule::DropOldest);
  shared.also = std::make_shared<const std::vector<std::uint64_t>>(3, 2);
  lanes.offer(*lane, std::move(shared));
  EXPECT_EQ(lanes.close(*lane), 5U);
}

TEST(LinkLanes, WhatALaneThatEndsLosesIsToldBeforeTheEndAndOneObjectGoesWhateverItsSize) {
  PeerLanes lanes;
  Reader reader;
  const auto end_with = [&](std::uint64_t wire, std::size_t objects, std::size_t bytes) {
    const auto lane = lanes.open();
    lanes.offer(*lane, item_of(wire, kLaneWindow - 2 * kChunkBytes, Rule::DropOldest));
    while (!next_of(lanes, reader).empty()) continue;  // the window is used up
    for (std::size_t i = 0; i < objects; ++i) lanes.offer(*lane, item_of(wire, bytes, Rule::DropOldest));
    auto end = item_of(wire, 0, Rule::Control);
    end.cost = 0;
    lanes.offer(*lane, std::move(end));
    return std::pair(lane->id(), lanes.close(*lane, PeerLanes::Rest::Goes));
  };
  const auto large = end_with(1, 1, 2 * kLaneWindow);
  EXPECT_EQ(large.second, 0U);
  const auto other = end_with(2, 2, 2 * kChunkBytes);
  EXPECT_EQ(other.second, 2U) << "what ends so keeps no more than a window, all lanes together";
  EXPECT_THAT(next_of(lanes, reader), ElementsAre("2 lost 2", "2"));
  lanes.credit(large.first, kLaneWindow);
  while (!next_of(lanes, reader).empty()) continue;
  EXPECT_EQ(lanes.lanes(), 0U);
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

TEST(LinkLanes, SmallMessagesOfAPushThatWaitAreKeptTogetherAndCountedOneByOne) {
  PeerLanes lanes;
  Reader reader;
  const auto lane = lanes.open();
  constexpr std::uint64_t kPut = 200'000;
  std::uint64_t given = 0;
  std::uint64_t lost = 0;
  const auto take_all = [&] {
    for (auto seen = next_of(lanes, reader); !seen.empty(); seen = next_of(lanes, reader)) {
      given += static_cast<std::uint64_t>(std::count(seen.begin(), seen.end(), "1"));
    }
  };
  const auto put_half = [&] {
    for (std::uint64_t i = 0; i < kPut / 2; ++i) lost += put_small(lanes, *lane, 1);
  };
  put_half();
  EXPECT_GT(lost, 0U);
  take_all();  // the window is used up
  EXPECT_GT(given, 0U);
  put_half();
  lanes.credit(lane->id(), kLaneWindow / 4);
  take_all();
  const std::uint64_t closed = lanes.close(*lane);
  EXPECT_GT(closed, 0U);
  EXPECT_EQ(given + lost + closed, kPut);
}

TEST(LinkLanes, MessagesOfOtherWiresAreNotKeptWithThoseBeforeThem) {
  PeerLanes lanes;
  Reader reader;
  const auto lane = lanes.open();
  for (const std::uint64_t wire : {1, 1, 2, 2, 1}) put_small(lanes, *lane, wire);
  EXPECT_THAT(next_of(lanes, reader), ElementsAre("1", "1", "2", "2", "1"));
}

TEST(LinkLanes, NothingIsKeptWithWhatIsNoPushIsForOthersTooOrIsOfALaneThatHasEnded) {
  PeerLanes lanes;
  const auto lane = lanes.open();
  EXPECT_EQ(lanes.join(*lane, 1, 64, 64), nullptr) << "nothing waits";
  lanes.offer(*lane, item_of(1, 64, Rule::MustFit));
  EXPECT_EQ(lanes.join(*lane, 1, 64, 64), nullptr);
  auto shared = item_of(1, 64, Rule::DropOldest);
  shared.also = std::make_shared<const std::vector<std::uint64_t>>(1, 2);
  lanes.offer(*lane, std::move(shared));
  EXPECT_EQ(lanes.join(*lane, 1, 64, 64), nullptr);
  lanes.offer(*lane, item_of(1, kLaneWindow / 2, Rule::DropOldest));
  EXPECT_EQ(lanes.join(*lane, 1, 64, 64), nullptr) << "its record is that of a chunk";
  lanes.offer(*lane, item_of(1, 64, Rule::DropOldest));
  EXPECT_EQ(lanes.join(*lane, 1, 64, kTogetherBytes), nullptr) << "more than are kept together";
  EXPECT_EQ(lanes.join(*lane, 1, kLaneWindow, 64), nullptr) << "the lane is full";
  EXPECT_NE(lanes.join(*lane, 1, 64, 64), nullptr);
  lanes.close(*lane, PeerLanes::Rest::Goes);
  EXPECT_EQ(lanes.join(*lane, 1, 64, 64), nullptr);
}

TEST(LinkLanes, WhatCostsNoCreditIsCountedWhileItWaits) {
  PeerLanes lanes;
  Reader reader;
  const auto lane = lanes.open();
  for (int i = 0; i < 10; ++i) {
    PeerLanes::Item item = item_of(1, 0, Rule::Control);
    item.cost = 0;
    lanes.offer(*lane, std::move(item));
  }
  EXPECT_GE(lanes.control_bytes(), 10 * kFrameCost);
  while (!next_of(lanes, reader).empty()) continue;
  EXPECT_EQ(lanes.control_bytes(), 0U);
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
  for (const std::size_t size :
       {0UL, 1UL, kInlineBytes - 1, kInlineBytes, kInlineBytes + 1, kChunkBytes - 20, kChunkBytes - 6, kChunkBytes - 5,
        kChunkBytes - 4, kChunkBytes, kChunkBytes + 1, 3 * kChunkBytes + 17}) {
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
  std::optional<std::uint64_t> accepts(const wire::Frame& frame) override {
    const bool its = frame.wire() == 1 || std::find(frame.also().begin(), frame.also().end(), 1) != frame.also().end();
    return its ? std::optional<std::uint64_t>(1) : std::nullopt;
  }
  void on_frame(const wire::Frame&, const ObjectBytes&) override { ++frames; }
  int frames = 0;
};

bool read_chunk(FrameReader& reader, FrameReader::Receiver& receiver, const wire::Frame& frame, std::size_t bytes) {
  const Block record = make_record(frame, nullptr, 0);
  std::vector<zmq::message_t> parts;
  parts.emplace_back(record.data(), record.size());
  parts.emplace_back(bytes);
  return reader.read(parts, receiver);
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

TEST(LinkChunks, ChunkThatIsEmptyOrTooLargeOrMoreThanTheObjectEndsIt) {
  for (const std::size_t wrong : {std::size_t(0), kChunkBytes + 1, kChunkBytes}) {
    FrameReader reader;
    Nobody nobody;
    EXPECT_TRUE(read_chunk(reader, nobody, first_of(1, 2 * kChunkBytes - 1), kChunkBytes));
    EXPECT_FALSE(read_chunk(reader, nobody, more_of(1), wrong));
    EXPECT_EQ(reader.unfinished(), 0U);
    EXPECT_EQ(nobody.frames, 0);
  }
}

TEST(LinkChunks, ObjectByteByByteIsEnded) {
  FrameReader reader;
  Nobody nobody;
  EXPECT_TRUE(read_chunk(reader, nobody, first_of(1, 2 * kChunkBytes), 1));
  for (std::size_t i = 1; i < most_chunks(2 * kChunkBytes); ++i) EXPECT_TRUE(read_chunk(reader, nobody, more_of(1), 1));
  EXPECT_FALSE(read_chunk(reader, nobody, more_of(1), 1));
  EXPECT_EQ(reader.unfinished(), 0U);
}

/// Fields of every size, in one object.
google::protobuf::ListValue mixed_object(const std::vector<std::size_t>& sizes) {
  google::protobuf::ListValue object;
  for (const std::size_t size : sizes)
    object.add_values()->mutable_string_value()->assign(size, static_cast<char>('a' + size % 26));
  return object;
}

/// Passes the payload through a reader.
class Assembled final : public FrameReader::Receiver {
 public:
  Assembled(const Payload& payload, google::protobuf::Message& object) : reader_(payload.chunk()), object_(object) {
    wire::Frame frame = first_of(1, payload.chunks().size() > 1 ? payload.size() : 0);
    for (const auto& chunk : payload.chunks()) {
      Block record = make_record(frame, ObjectBytes(chunk.inside));
      std::vector<zmq::message_t> parts;
      parts.emplace_back(record.data(), record.size());
      if (!chunk.beside.empty()) parts.emplace_back(chunk.beside.data(), chunk.beside.size());
      EXPECT_LE(chunk.size(), payload.chunk());
      EXPECT_TRUE(reader_.read(parts, *this));
      frame = more_of(1);
    }
  }
  int frames = 0;

 private:
  std::optional<std::uint64_t> accepts(const wire::Frame& frame) override { return frame.wire(); }
  void on_frame(const wire::Frame&, const ObjectBytes& object) override {
    ++frames;
    EXPECT_TRUE(object.parse_into(object_));
  }
  FrameReader reader_;
  google::protobuf::Message& object_;
};

TEST(LinkPayload, EveryMixtureOfFieldsArrivesAsItWas) {
  std::mt19937 random(20261121);
  for (int round = 0; round < 300; ++round) {
    std::vector<std::size_t> sizes(1 + random() % 12);
    for (auto& size : sizes) size = random() % (std::size_t(1) << random() % 20);
    const auto object = std::make_shared<google::protobuf::ListValue>(mixed_object(sizes));
    const Payload payload(object);
    EXPECT_LE(payload.chunks().size(), most_chunks(payload.size()));
    google::protobuf::ListValue arrived;
    EXPECT_EQ(Assembled(payload, arrived).frames, payload.size() > 0 ? 1 : 0);
    ASSERT_EQ(arrived.SerializeAsString(), object->SerializeAsString());
  }
}

TEST(LinkPayload, WhateverAnObjectIsMadeOfItComesInNoMoreChunksThanItMay) {
  constexpr std::size_t kString = 128 * 1024;
  std::vector<std::size_t> mixed;
  for (int i = 0; i < 10; ++i) mixed.insert(mixed.end(), {5'000, kString});
  const std::vector<std::size_t> strings(73, kString);
  for (const std::size_t chunk : {kChunkBytes, kLocalChunkBytes}) {
    std::vector<std::size_t> at_the_bound;
    for (int i = 0; i < 40; ++i) at_the_bound.insert(at_the_bound.end(), {4'100, chunk / 4});
    for (const auto& sizes : {mixed, strings, at_the_bound}) {
      const auto object = std::make_shared<google::protobuf::ListValue>(mixed_object(sizes));
      const Payload payload(object, chunk);
      EXPECT_LE(payload.chunks().size(), most_chunks(payload.size(), chunk)) << chunk << " " << sizes.size();
      google::protobuf::ListValue arrived;
      EXPECT_EQ(Assembled(payload, arrived).frames, 1);
      EXPECT_TRUE(arrived.SerializeAsString() == object->SerializeAsString());
    }
  }
}

TEST(LinkPayload, WhatHasComeInManyPiecesIsPassedOnInWholeChunks) {
  std::vector<zmq::message_t> pieces;
  const std::size_t most = most_chunks(20 * kChunkBytes);
  std::string sent;
  for (std::size_t i = 0; i < most; ++i) {
    const std::string piece(20 * kChunkBytes / most, static_cast<char>('a' + i % 26));
    pieces.emplace_back(piece.data(), piece.size());
    sent += piece;
  }
  const Payload payload{ObjectBytes(pieces, sent.size())};
  EXPECT_EQ(payload.chunks().size(), (sent.size() + kChunkBytes - 1) / kChunkBytes);
  std::string passed_on;
  for (const auto& chunk : payload.chunks()) passed_on.append(chunk.inside).append(chunk.beside);
  EXPECT_TRUE(passed_on == sent);
}

TEST(LinkPayload, LongStringsAreSentFromWhereTheObjectHasThem) {
  const auto object = std::make_shared<google::protobuf::ListValue>(mixed_object({10, 1024 * 1024, 10}));
  const std::string& longest = object->values(1).string_value();
  const Payload payload(object);
  std::size_t shown = 0;
  for (const auto& chunk : payload.chunks()) {
    const bool its = chunk.beside.data() >= longest.data() && chunk.beside.data() < longest.data() + longest.size();
    if (its) shown += chunk.beside.size();
  }
  EXPECT_EQ(shown, longest.size());
}

TEST(LinkPayload, WhatIsPassedOnArrivesAsItWas) {
  const auto object = std::make_shared<google::protobuf::ListValue>(mixed_object({10, 700'000, 20'000, 10}));
  const std::string bytes = object->SerializeAsString();
  const Payload payload{ObjectBytes(bytes)};
  google::protobuf::ListValue arrived;
  EXPECT_EQ(Assembled(payload, arrived).frames, 1);
  EXPECT_EQ(arrived.SerializeAsString(), bytes);
}

TEST(LinkChunks, SecondObjectOfAWireBeforeTheFirstHasEndedIsRefused) {
  FrameReader reader;
  Nobody nobody;
  EXPECT_TRUE(read_chunk(reader, nobody, first_of(1, 2 * kChunkBytes), kChunkBytes));
  EXPECT_FALSE(read_chunk(reader, nobody, first_of(1, 2 * kChunkBytes), kChunkBytes));
  EXPECT_EQ(reader.unfinished(), 0U);
}

/// Some wires, which end.
struct Ending final : FrameReader::Receiver {
  std::optional<std::uint64_t> accepts(const wire::Frame& frame) override {
    if (wires.contains(frame.wire())) return frame.wire();
    const auto other =
        std::find_if(frame.also().begin(), frame.also().end(), [this](auto one) { return wires.contains(one); });
    if (other != frame.also().end()) return *other;
    ++refused;
    return std::nullopt;
  }
  void on_frame(const wire::Frame&, const ObjectBytes&) override { ++frames; }
  std::set<std::uint64_t> wires;
  int refused = 0;
  int frames = 0;
};

TEST(LinkChunks, UnfinishedObjectOfAWireThatHasEndedGoesWhenAnotherBegins) {
  FrameReader reader;
  Ending ending;
  for (std::uint64_t wire = 1; wire <= 100; ++wire) {
    ending.wires = {wire};
    EXPECT_TRUE(read_chunk(reader, ending, first_of(wire, 2 * kChunkBytes), kChunkBytes));
    EXPECT_EQ(reader.unfinished(), 1U);
  }
  EXPECT_EQ(ending.refused, 99) << "its credit is paid back as that of any that is not accepted";
}

TEST(LinkChunks, UnfinishedObjectStaysForTheWireThatIsLeftOfThoseThatItIsFor) {
  FrameReader reader;
  Ending ending;
  ending.wires = {1, 2, 3};
  wire::Frame first = first_of(1, 2 * kChunkBytes);
  first.add_also(2);
  EXPECT_TRUE(read_chunk(reader, ending, first, kChunkBytes));
  ending.wires = {2, 3};
  EXPECT_TRUE(read_chunk(reader, ending, first_of(3, 2 * kChunkBytes), kChunkBytes));
  EXPECT_EQ(reader.unfinished(), 2U);
  EXPECT_FALSE(read_chunk(reader, ending, first_of(2, 2 * kChunkBytes), kChunkBytes)) << "the other has not ended";
  EXPECT_EQ(reader.unfinished(), 1U);
}

TEST(LinkChunks, FrameForMoreWiresThanOneMayBeForIsRefused) {
  FrameReader reader;
  Nobody nobody;
  wire::Frame frame = first_of(1, 0);
  for (std::uint64_t i = 0; i < kMostAlso; ++i) frame.add_also(2);
  EXPECT_TRUE(read_chunk(reader, nobody, frame, 1));
  frame.add_also(2);
  EXPECT_FALSE(read_chunk(reader, nobody, frame, 1));
  EXPECT_EQ(nobody.frames, 1);
}

TEST(LinkChunks, SecondObjectOfAWireIsRefusedThoughItNamesAnotherFirst) {
  FrameReader reader;
  Nobody nobody;
  int refused = 0;
  for (std::uint64_t other = 1000; other < 1100; ++other) {
    wire::Frame first = first_of(other, 2 * kChunkBytes);
    first.add_also(1);
    refused += read_chunk(reader, nobody, first, kChunkBytes) ? 0 : 1;
    EXPECT_LE(reader.unfinished(), 1U);
  }
  EXPECT_EQ(refused, 50) << "each that meets an unfinished one, which it ends";
}

}  // namespace
}  // namespace fiona::host
