// Wires that pass through a process on their way to another one.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <future>
#include <memory>
#include <mutex>
#include <string>
#include <vector>

#include "links_fixture.hpp"

namespace fiona::host {
namespace {

/// With a field of this size that no location has.
constexpr std::size_t kLocationBytes = 2000;
localisation::CommLocation large_location() {
  localisation::CommLocation location;
  location.GetReflection()->MutableUnknownFields(&location)->AddLengthDelimited(1000, std::string(kLocationBytes, 'x'));
  return location;
}

/// One wire of a push passes through this process, to a peer that gives no credit; another one ends here.
TEST_F(LinksOfAProcess, APushThatIsPassedOnToOneThatDoesNotReadIsLostForThatOneAloneAndItsProviderIsTold) {
  constexpr std::uint64_t kPuts = 8'000;
  constexpr std::uint64_t kAtOnce = 500;
  constexpr std::uint64_t kOnTheirWay = kLaneWindow / kLocationBytes;
  Links other{pool, clock, at("other"), {kLinksKey}, [](std::uint64_t, const std::string&) {}};
  for (const std::uint64_t wire : {1, 2}) other.provide(wire, kLinksToken, "both", ends->told, 1, "client");
  links.relay(1, kLinksToken, "deaf", {at("other"), "both", link_key(kLinksKey, "both")});
  RawPeer deaf(context, at("links"), "deaf");
  deaf.prove(kLinksKey);
  open_by_hand(deaf, 1);
  require(2, ends->noticed);
  for (std::uint64_t put = kAtOnce; put <= kPuts; put += kAtOnce) {
    EXPECT_TRUE(hull.strand().call(
        [&] {
          for (std::uint64_t i = 0; i < kAtOnce; ++i) ends->told.put(large_location());
        },
        20s));
    ASSERT_TRUE(becomes_true([&] { return ends->noticed_so_far == static_cast<int>(put); })) << put;
  }
  const auto& dropped = ends->told.counters().dropped;
  EXPECT_TRUE(becomes_true([&] { return dropped > 0; }));
  EXPECT_LE(dropped, kPuts - kOnTheirWay) << "what it may keep waits here";
  links.peer_lost("", "deaf", "its process has ended");
  EXPECT_TRUE(becomes_true([&] { return dropped >= kPuts - kOnTheirWay; })) << dropped;
  EXPECT_LE(dropped, kPuts);
  EXPECT_EQ(ends->noticed.counters().dropped, 0U);
  EXPECT_EQ(links.status().overrun() + links.status().late(), 0U);
  links.release(hull, "the test is over");
  other.stop();
}

TEST_F(LinksOfAProcess, WhoFloodsOneThatDoesNotReadIsNotFloodedWithWhatIsLost) {
  constexpr std::size_t kLost = 20'000;
  std::atomic<std::size_t> told{0};
  std::atomic<std::size_t> lost{0};
  ProviderByHand other(at("other"), [&](const wire::Frame& frame) {
    told += frame.has_lost() ? 1 : 0;
    lost += frame.lost().messages();
  });
  links.relay(1, kLinksToken, "deaf", {at("other"), "both", link_key(kLinksKey, "both")});
  RawPeer deaf(context, at("links"), "deaf");
  deaf.prove(kLinksKey);
  open_by_hand(deaf, 1);
  const auto location = std::make_shared<localisation::CommLocation>(large_location());
  EXPECT_TRUE(becomes_true([&] {
    for (int i = 0; i < 100; ++i) other.send(frame_for(1), location);
    return lost >= kLost;
  }));
  EXPECT_LT(told, kLost / 30);
}

/// Who has a wire through a host does not speak as that host to whoever is at its other end, nor more than fits there.
TEST_F(LinksOfAProcess, OnlyWhatIsOfAWireIsPassedOnOverIt) {
  std::mutex mutex;
  std::vector<wire::Frame> passed;
  ProviderByHand other(at("other"), [&](const wire::Frame& frame) {
    const std::lock_guard lock(mutex);
    passed.push_back(frame);
  });
  links.relay(1, kLinksToken, "peer", {at("other"), "both", link_key(kLinksKey, "both")});
  RawPeer peer(context, at("links"), "peer");
  peer.prove(kLinksKey);
  open_by_hand(peer, 1);
  std::vector<wire::Frame> forged(6, frame_for(1));
  forged[0].mutable_host()->mutable_request()->set_group("main");
  forged[1].mutable_host()->mutable_gone();
  forged[2].mutable_memory();
  forged[3].mutable_credit()->add_lane(1);
  forged[4].mutable_hello();
  forged[5].mutable_closed()->set_reason(std::string(kMostFrame, 'x'));
  for (const auto& frame : forged) peer.send(frame);
  wire::Frame cancel = frame_for(1);
  cancel.mutable_cancel()->set_id(7);
  peer.send(cancel);
  EXPECT_TRUE(becomes_true([&] {
    const std::lock_guard lock(mutex);
    return !passed.empty() && passed.back().has_cancel();
  }));
  const std::lock_guard lock(mutex);
  EXPECT_EQ(passed.size(), 2U) << "the one that opens it, and what was given up";
  EXPECT_EQ(links.status().garbled(), forged.size());
}

TEST_F(LinksOfAProcess, WhoFloodsAWireThatPassesThroughWithWhatIsFreeLosesThatWireAlone) {
  constexpr std::size_t kFrames = 4'000;  // of 40,000 bytes each: ZeroMQ takes some 64 MiB of them
  std::promise<void> goes_on;
  std::atomic<bool> stands{false}, ended{false};
  ProviderByHand other(at("other"), [&, waits = goes_on.get_future().share()](const wire::Frame& frame) {
    ended = ended || (frame.wire() == 2 && frame.has_closed());
    if (!frame.has_cancel()) return;
    stands = true;
    waits.wait();
  });
  for (const std::uint64_t wire : {1, 2}) {
    links.relay(wire, kLinksToken, "peer", {at("other"), "both", link_key(kLinksKey, "both")});
  }
  RawPeer peer(context, at("links"), "peer");
  peer.prove(kLinksKey);
  open_by_hand(peer, 1);
  open_by_hand(peer, 2);
  wire::Frame flood = frame_for(1);
  flood.mutable_cancel()->set_id(1);
  peer.send(flood);
  EXPECT_TRUE(becomes_true([&] { return stands.load(); }));
  flood.mutable_lease()->set_reason(std::string(40'000, 'x'));
  for (std::size_t i = 0; i < kFrames; ++i) peer.send(flood);
  const wire::Frame end = peer.receive();
  EXPECT_EQ(end.wire(), 1U);
  EXPECT_THAT(end.closed().reason(), testing::HasSubstr("too much"));
  EXPECT_GT(links.status().overrun(), 0U);
  goes_on.set_value();
  wire::Frame last = frame_for(2);
  last.mutable_closed();
  peer.send(last);
  EXPECT_TRUE(becomes_true([&] { return ended.load(); })) << "the other one is as it was";
}

/// Of 10 MiB each: where one waits, the next has no credit, and none is needed.
TEST_F(LinksOfAProcess, OfLargeObjectsOfAPushThatArePassedOnTheOldestAreLostAndTold) {
  constexpr std::size_t kPuts = 5;
  std::atomic<std::size_t> lost{0};
  ProviderByHand other(at("other"), [&](const wire::Frame& frame) { lost += frame.lost().messages(); });
  links.relay(1, kLinksToken, "deaf", {at("other"), "both", link_key(kLinksKey, "both")});
  RawPeer deaf(context, at("links"), "deaf");
  deaf.prove(kLinksKey);
  open_by_hand(deaf, 1);
  auto location = large_location();
  location.GetReflection()->MutableUnknownFields(&location)->AddLengthDelimited(1000, std::string(10'000'000, 'x'));
  const auto image = std::make_shared<localisation::CommLocation>(location);
  for (std::size_t i = 0; i < kPuts; ++i) other.send_waiting(frame_for(1), image);
  EXPECT_TRUE(becomes_true([&] { return lost >= kPuts - 2; })) << lost << ": one has begun, and one waits";
  EXPECT_EQ(links.status().overrun(), 0U);
}

TEST_F(LinksOfAProcess, SendsThatAreToBePassedOnGoThoughTheirWireHasEndedBehindThem) {
  constexpr std::size_t kSends = 100;  // of 64 KiB each: more than there is credit for
  std::promise<void> goes_on;
  std::atomic<std::size_t> come{0};
  std::atomic<bool> closed{false};
  ProviderByHand other(at("other"), [&, waits = goes_on.get_future().share()](const wire::Frame& frame) {
    if (frame.has_object()) waits.wait();
    come += frame.has_object() ? 1 : 0;
    closed = closed || (frame.has_closed() && come == kSends);
  });
  links.relay(1, kLinksToken, "peer", {at("other"), "both", link_key(kLinksKey, "both")});
  RawPeer peer(context, at("links"), "peer");
  peer.prove(kLinksKey);
  open_by_hand(peer, 1);
  wire::Frame sent = frame_for(1);
  sent.mutable_object();
  sent.set_lane(1);
  const std::string object(64 * 1024, 'x');
  for (std::size_t i = 0; i < kSends; ++i) peer.send(sent, object);
  wire::Frame end = frame_for(1);
  end.mutable_closed();
  peer.send(end);
  const auto before = links.status().not_granted();
  peer.send(frame_for(7));  // of nobody: once it is refused, what was before it has been passed on
  EXPECT_TRUE(becomes_true([&] { return links.status().not_granted() > before; }));
  goes_on.set_value();
  EXPECT_TRUE(becomes_true([&] { return closed.load(); })) << come << " have come";
  EXPECT_EQ(links.status().overrun(), 0U);
}

}  // namespace
}  // namespace fiona::host
