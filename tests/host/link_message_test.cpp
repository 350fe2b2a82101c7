// Frames out of whatever a peer sends: those that most messages have are read without protobuf's parser, and mean the
// same.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "link_message.hpp"

namespace fiona::host {
namespace {

/// What a reader makes of one message.
struct Seen final : FrameReader::Receiver {
  std::optional<std::uint64_t> accepts(const wire::Frame&) override { return std::nullopt; }
  void on_frame(const wire::Frame& frame, const ObjectBytes& object) override {
    frames.push_back(frame.SerializeAsString());
    objects.push_back(object.to_string());
  }
  bool read(const std::string& message) {
    std::vector<zmq::message_t> parts;
    parts.emplace_back(message.data(), message.size());
    return reader.read(parts, *this);
  }
  FrameReader reader;
  std::vector<std::string> frames;
  std::vector<std::string> objects;
};

/// A record, whatever its frame is.
std::string record_of(std::string_view frame, std::string_view object) {
  std::string record;
  for (const std::size_t length : {frame.size(), object.size()}) {
    for (int shift = 0; shift < 32; shift += 8) record += static_cast<char>(length >> shift & 0xff);
  }
  return record.append(frame).append(object);
}

std::string object_frame(std::uint64_t wire, std::uint64_t lane, std::uint64_t sequence, std::int64_t origin_ns) {
  wire::Frame frame;
  frame.set_wire(wire);
  frame.set_lane(lane);
  frame.mutable_object()->set_sequence(sequence);
  frame.mutable_object()->set_origin_ns(origin_ns);
  return frame.SerializeAsString();
}

/// It is what protobuf makes of the frame, or refused as that refuses it.
void expect_as_protobuf(const std::string& frame) {
  wire::Frame parsed;
  const bool parses = parsed.ParseFromString(frame) && !(is_of_link(parsed) && parsed.wire() != 0);
  if (parsed.has_more() || parsed.size() != 0) return;  // of an object in chunks
  // What follows must not depend on the frame before it.
  const std::string before = record_of(object_frame(77, 78, 79, 80), "first");
  Seen seen;
  EXPECT_EQ(seen.read(before + record_of(frame, "second")), parses) << testing::PrintToString(frame);
  if (!parses) return;
  ASSERT_EQ(seen.frames.size(), 2U);
  EXPECT_EQ(seen.frames.back(), parsed.SerializeAsString()) << testing::PrintToString(frame);
  EXPECT_EQ(seen.objects.back(), "second");
}

TEST(LinkMessage, FrameOfAnObjectIsWhatProtobufMakesOfItWhateverItsBytesAre) {
  for (const std::uint64_t number : {std::uint64_t{0}, std::uint64_t{1}, std::uint64_t{127}, std::uint64_t{128},
                                     std::uint64_t{1} << 42, ~std::uint64_t{0}}) {
    for (const std::int64_t origin_ns : {std::int64_t{0}, std::int64_t{1'700'000'000'000'000'000}, std::int64_t{-1}}) {
      expect_as_protobuf(object_frame(number, 3, 4, origin_ns));
      expect_as_protobuf(object_frame(2, number, 4, origin_ns));
      expect_as_protobuf(object_frame(2, 3, number, origin_ns));
    }
  }
  const std::string frame = object_frame(300, 5, 70'000, 1'700'000'000'000'000'000);
  for (std::size_t at = 0; at < frame.size(); ++at) {
    expect_as_protobuf(frame.substr(0, at));
    expect_as_protobuf(frame.substr(at));
    for (int byte = 0; byte < 256; ++byte) {
      std::string other = frame;
      other[at] = static_cast<char>(byte);
      expect_as_protobuf(other);
      other.insert(at, 1, static_cast<char>(byte));
      expect_as_protobuf(other);
    }
  }
  expect_as_protobuf(frame + frame);
  const std::size_t length = frame.find('\x3a') + 1;  // behind the tag of the object
  for (std::size_t more = 1; more < 10; ++more) {
    std::string longer = frame;
    longer[length] = static_cast<char>(longer[length] | 0x80);
    longer.insert(length + 1, std::string(more - 1, '\x80') + '\0');
    expect_as_protobuf(longer);
  }
}

}  // namespace
}  // namespace fiona::host
