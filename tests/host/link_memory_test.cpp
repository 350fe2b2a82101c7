// Memory that two processes share for large objects: the way there, and what is not taken for it.
#include "link_memory.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <list>
#include <string>
#include <vector>

#include "os/limits.hpp"

namespace fiona::host {
namespace {

/// Both ends in this process, where all of it is as between two but for whose memory it is.
class MemoryOfALink : public testing::Test {
 protected:
  /// Tells each what the other says, until neither has anything more to say.
  static void talk(LinkMemory& from, LinkMemory& to, std::optional<wire::Memory> told) {
    for (auto *teller = &from, *hearer = &to; told; std::swap(teller, hearer)) told = hearer->on_told(*told);
  }
  std::optional<std::string> carried(LinkMemory& from, LinkMemory& to, const std::string& chunk) {
    auto parts = sent(from, chunk);
    if (parts.empty() || !to.take(parts)) return std::nullopt;
    EXPECT_EQ(parts.size(), 2U);
    return parts[1].to_string();
  }
  static std::vector<zmq::message_t> sent(LinkMemory& from, const std::string& chunk) {
    std::vector<zmq::message_t> parts;
    auto place = from.put(chunk);
    if (!place) return parts;
    parts.resize(2);
    parts.push_back(std::move(*place));
    return parts;
  }

  LinkMemory one;
  LinkMemory other;
};

TEST_F(MemoryOfALink, CarriesChunksBothWaysOnceOneSideHasOfferedIts) {
  const auto before = os::open_descriptors();
  EXPECT_FALSE(one.put("too early"));
  talk(one, other, one.offer());
  EXPECT_FALSE(one.offer()) << "once";
  EXPECT_FALSE(other.offer()) << "it was, with the answer";
  const std::string chunk(kLocalChunkBytes, 'x');
  EXPECT_EQ(carried(one, other, chunk), chunk);
  EXPECT_EQ(carried(other, one, "the other way"), "the other way");
  EXPECT_EQ(os::open_descriptors(), before) << "what both have mapped needs none";
}

TEST_F(MemoryOfALink, ComesAboutWhenBothOfferAtATime) {
  const auto first = one.offer();
  const auto second = other.offer();
  const auto answer = one.on_told(*second);
  const auto other_answer = other.on_told(*first);
  ASSERT_TRUE(answer && other_answer);
  EXPECT_FALSE(other.on_told(*answer));
  EXPECT_FALSE(one.on_told(*other_answer));
  EXPECT_EQ(carried(one, other, "there"), "there");
  EXPECT_EQ(carried(other, one, "back"), "back");
}

TEST_F(MemoryOfALink, WritesIntoNoSlotThatTheReceiverHasNotDoneWith) {
  talk(one, other, one.offer());
  std::list<std::vector<zmq::message_t>> lent;
  for (std::size_t i = 0; i < kMemorySlots; ++i) {
    lent.push_back(sent(one, "chunk " + std::to_string(i)));
    ASSERT_TRUE(other.take(lent.back()));
  }
  EXPECT_FALSE(one.put("one more"));
  EXPECT_EQ(lent.front()[1].to_string_view(), "chunk 0");
  lent.pop_front();
  EXPECT_EQ(carried(one, other, "in its place"), "in its place");
  for (std::size_t i = 1; const auto& parts : lent) {
    EXPECT_EQ(parts[1].to_string_view(), "chunk " + std::to_string(i++));
  }
}

TEST_F(MemoryOfALink, OutlivesItsLinkInWhatIsStillRead) {
  std::vector<zmq::message_t> parts;
  {
    LinkMemory sender;
    LinkMemory receiver;
    talk(sender, receiver, sender.offer());
    parts = sent(sender, "still here");
    ASSERT_TRUE(receiver.take(parts));
  }
  EXPECT_EQ(parts[1].to_string_view(), "still here");
}

TEST_F(MemoryOfALink, OfAProcessThatIsNotReachedIsDeclinedAndTheSocketTakesEverything) {
  auto offered = one.offer();
  offered->set_process(0);
  talk(one, other, offered);
  EXPECT_FALSE(one.put("nowhere"));
  EXPECT_FALSE(other.put("nowhere"));
  EXPECT_FALSE(one.offer()) << "nor is it tried again";
}

TEST_F(MemoryOfALink, IsNoOtherDescriptorOfThatProcess) {
  wire::Memory offered;
  offered.set_process(::getpid());
  offered.set_file_descriptor(STDERR_FILENO);
  const auto answer = other.on_told(offered);
  ASSERT_TRUE(answer);
  EXPECT_EQ(answer->file_descriptor(), 0);
  EXPECT_FALSE(answer->seen());
}

TEST_F(MemoryOfALink, TakesNoPlaceThatIsNotThere) {
  const auto place = [](std::uint32_t slot, std::uint32_t size) {
    std::vector<zmq::message_t> parts(2);
    const std::array<std::uint32_t, 2> numbers{slot, size};
    parts.emplace_back(numbers.data(), sizeof numbers);
    return parts;
  };
  auto early = place(0, 1);
  EXPECT_FALSE(other.take(early)) << "before any memory was offered";
  talk(one, other, one.offer());
  std::vector<std::vector<zmq::message_t>> bad;
  bad.push_back(place(kMemorySlots, 1));
  bad.push_back(place(0xffffffff, 0xffffffff));
  bad.push_back(place(0, kLocalChunkBytes + 1));
  bad.push_back(place(0, 1));
  bad.back()[1] = zmq::message_t(std::string("not empty"));
  bad.push_back(place(0, 1));
  bad.back()[2] = zmq::message_t(std::string("nine byte"));
  bad.push_back(place(0, 1));
  bad.back().pop_back();
  for (auto& parts : bad) {
    const std::size_t before = parts.size();
    EXPECT_FALSE(other.take(parts));
    EXPECT_EQ(parts.size(), before);
  }
}

TEST_F(MemoryOfALink, IsThereForSoManyLinksOfAProcessAndNoMore) {
  std::list<LinkMemory> links(kMostMemories + 1);
  int offered = 0;
  for (LinkMemory& link : links) offered += link.offer() ? 1 : 0;
  EXPECT_EQ(offered, kMostMemories);
  EXPECT_FALSE(one.offer());
  links.clear();
  EXPECT_TRUE(other.offer());
  EXPECT_FALSE(one.offer()) << "one that has done without goes on so";
}

}  // namespace
}  // namespace fiona::host
