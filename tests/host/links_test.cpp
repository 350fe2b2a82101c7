// The links of one process: how wires over them open, take each other's place and end.
#include <gtest/gtest.h>

#include <chrono>
#include <cstdint>
#include <functional>
#include <memory>

#include "../pulse.hpp"
#include "links_fixture.hpp"
#include "os/limits.hpp"

namespace fiona::host {
namespace {

TEST_F(LinksOfAProcess, AWireThatIsLostWhileItIsBeingOpenedIsNotShownAsConnected) {
  Links other{pool, clock, at("other"), {kLinksKey}, [](std::uint64_t, const std::string&) {}};
  other.provide(1, kLinksToken, "both", ends->told, 1, "both.heard");
  const auto end = ends->heard.end_for("both.told");
  const auto is_lost = [&] { links.peer_lost(at("other"), "other", "its process has ended"); };
  links.require(1, kLinksToken, end, {at("other"), "both", link_key(kLinksKey, "both")}, false, 0, 0, is_lost);
  EXPECT_EQ(ends->heard.connection(), Connection::Lost);
  EXPECT_EQ(ends->heard.connection_reason(), "its process has ended");
  other.stop();
}

/// It has not been answered, and is kept: what is refused at once came behind it.
void open_ahead_by_hand(RawPeer& peer, std::uint64_t wire) {
  constexpr std::uint64_t kNobodys = 1000;
  peer.send(opening_by_hand(wire, true));
  peer.send(opening_by_hand(kNobodys, false));
  const wire::Frame refused = peer.receive();
  EXPECT_EQ(refused.wire(), kNobodys);
  EXPECT_EQ(refused.refused().reason(), kNotGranted);
}

TEST_F(LinksOfAProcess, AWireThatIsAskedForAheadOfItsGrantIsOpenedWithIt) {
  RawPeer peer(context, at("links"), "peer"), other(context, at("links"), "other");
  peer.prove(kLinksKey);
  other.prove(kLinksKey);
  open_ahead_by_hand(other, 1);  // another one's, which is here first, takes nothing away
  open_ahead_by_hand(peer, 1);
  EXPECT_EQ(ends->told.subscribers(), 0U);
  links.provide(1, kLinksToken, "peer", ends->told, 1, "client");
  const wire::Frame opened = peer.receive();
  EXPECT_TRUE(opened.has_opened());
  EXPECT_EQ(opened.wire(), 1U);
  EXPECT_EQ(other.receive().refused().reason(), kNotGranted);
  EXPECT_EQ(ends->told.subscribers(), 1U);
}

TEST_F(LinksOfAProcess, AWireThatIsNotGrantedAfterAllIsRefusedWithTheReason) {
  RawPeer peer(context, at("links"), "peer");
  peer.prove(kLinksKey);
  open_ahead_by_hand(peer, 1);
  links.deny(1, "there is no such port");
  EXPECT_EQ(peer.receive().refused().reason(), "there is no such port");
  peer.send(opening_by_hand(1, true));
  EXPECT_EQ(peer.receive().refused().reason(), kNotGranted) << "it is not waited for any more";
}

TEST_F(LinksOfAProcess, APeerThatAsksForManyWiresAheadHasTheOldestRefused) {
  RawPeer peer(context, at("links"), "peer"), other(context, at("links"), "other");
  peer.prove(kLinksKey);
  other.prove(kLinksKey);
  open_ahead_by_hand(other, 1);
  for (std::uint64_t wire = 11; wire <= 20; ++wire) {
    peer.send(opening_by_hand(wire, true));
    if (wire < 15) continue;
    const wire::Frame refused = peer.receive();
    EXPECT_EQ(refused.wire(), wire - 4);
    EXPECT_EQ(refused.refused().reason(), kNotGranted);
  }
  links.provide(17, kLinksToken, "peer", ends->told, 1, "client");
  EXPECT_EQ(peer.receive().wire(), 17U);
  links.provide(1, kLinksToken, "other", ends->told, 1, "client");
  EXPECT_TRUE(other.receive().has_opened()) << "another peer's are not counted";
}

TEST_F(LinksOfAProcess, AWireToAProcessThatIsKnownCostsOneRoundTripAndMakesNoSocket) {
  Links other{pool, clock, at("other"), {kLinksKey}, [](std::uint64_t, const std::string&) {}};
  const auto open = [&](std::uint64_t wire, ProvidedPort& provider, RequiredPort& client) {
    other.provide(wire, kLinksToken, "both", provider, 1, client.full_name());
    require(wire, client);
    EXPECT_EQ(client.connection(), Connection::Connected);
  };
  open(1, ends->told, ends->heard);
  const auto descriptors_before = os::open_descriptors();
  open(2, ends->told, ends->noticed);
  open(3, ends->asked, ends->asks);
  for (Links* end : {&links, &other}) {
    EXPECT_TRUE(becomes_true([&] { return end->status().sent_messages() >= 3; }));
    EXPECT_EQ(end->status().sent_messages(), 3U) << "of each wire a question, and its answer";
  }
  EXPECT_EQ(os::open_descriptors(), descriptors_before);
  links.release(hull, "the test is over");
  other.release(hull, "the test is over");
  other.stop();
}

TEST_F(LinksOfAProcess, APushThatIsReplacedIsAskedForItsEndAsSoonAsTheNewOneIsOpen) {
  Links other{pool, clock, at("other"), {kLinksKey}, [](std::uint64_t, const std::string&) {}};
  const auto end = ends->heard.end_for("both.told");
  const auto open = [&](std::uint64_t wire, std::uint64_t replaces, const std::function<void()>& then) {
    other.provide(wire, kLinksToken, "both", ends->told, 1, "both.heard");
    links.require(wire, kLinksToken, end, {at("other"), "both", link_key(kLinksKey, "both")}, false, replaces, 0, then);
  };
  open(1, 0, nullptr);
  open(2, 1, [&] {
    EXPECT_TRUE(becomes_true([&] { return ends->told.subscribers() == 1; }));
    links.retire(1, true);
  });
  EXPECT_EQ(ends->heard.connection(), Connection::Connected);
  EXPECT_EQ(ends->told.subscribers(), 1U);
  other.release(hull, "the test is over");
  other.stop();
}

TEST_F(LinksOfAProcess, AWireWhosePlaceAnotherHasTakenGoesOnceNothingIsOpenOnIt) {
  Links other{pool, clock, at("other"), {kLinksKey}, [](std::uint64_t, const std::string&) {}};
  other.provide(1, kLinksToken, "both", ends->asked, 1, "both.asks");
  const auto end = ends->asks.end_for("both.asked");
  links.require(1, kLinksToken, end, {at("other"), "both", link_key(kLinksKey, "both")}, false, 0, 0, nullptr);
  const auto wires = [&] {
    wire::Adopted held;
    links.add_held(held);
    other.add_held(held);
    return held.wires_size();
  };
  EXPECT_TRUE(hull.strand().call([&] { EXPECT_TRUE(ends->asks.request({})); }, 20s));
  EXPECT_TRUE(becomes_true([&] { return ends->asked_so_far == 1; }));
  links.retire(1, true);
  EXPECT_EQ(wires(), 2) << "a request is open on it";
  EXPECT_TRUE(hull.strand().call([&] { ends->open->answer(navigation::CommLevelMap()); }, 20s));
  EXPECT_TRUE(becomes_true([&] { return wires() == 0; }));
  links.release(hull, "the test is over");
  other.release(hull, "the test is over");
  other.stop();
}

TEST_F(LinksOfAProcess, AWireWhosePlaceAnotherHasTakenGoesWhenItsProviderEndsIt) {
  Links other{pool, clock, at("other"), {kLinksKey}, [](std::uint64_t, const std::string&) {}};
  other.provide(1, kLinksToken, "both", ends->asked, 1, "both.asks");
  const auto end = ends->asks.end_for("both.asked");
  links.require(1, kLinksToken, end, {at("other"), "both", link_key(kLinksKey, "both")}, false, 0, 0, nullptr);
  EXPECT_TRUE(hull.strand().call([&] { EXPECT_TRUE(ends->asks.request({})); }, 20s));
  EXPECT_TRUE(becomes_true([&] { return ends->asked_so_far == 1; }));
  links.retire(1, true);
  other.cut(1, "it was unloaded");
  EXPECT_TRUE(becomes_true([&] {
    wire::Adopted held;
    links.add_held(held);
    return held.wires_size() == 0;
  }));
  other.release(hull, "the test is over");
  other.stop();
}

TEST_F(LinksOfAProcess, AWireThatComesBackToAPushAfterItsLastOneHasItsOwnLane) {
  RawPeer peer(context, at("links"), "peer");
  peer.prove(kLinksKey);
  for (std::uint64_t wire = 1; wire <= 3; ++wire) {
    links.provide(wire, kLinksToken, "peer", ends->told, 1, "client");
    open_by_hand(peer, wire);
    EXPECT_TRUE(hull.strand().call([&] { ends->told.put(localisation::CommLocation()); }, 20s));
    EXPECT_EQ(peer.receive().wire(), wire);
    links.cut(wire, "it is over");
    EXPECT_TRUE(peer.receive().has_closed());
  }
  EXPECT_EQ(ends->told.counters().dropped, 0U);
}

TEST_F(LinksOfAProcess, AProviderThatDoesNotEndAWireThatIsReplacedIsNotWaitedForLong) {
  constexpr double kPatience_ms = 200;
  constexpr double kBetween_ms = FIONA_SANITIZED ? 1000 : 50;  // to open the new one, and to wake up twice
  ProviderByHand other(at("other"));
  require(1, ends->heard);
  const tests::Pulse pulse;
  const auto begin = std::chrono::steady_clock::now();
  links.require(2, kLinksToken, ends->heard.end_for("other.port"), {at("other"), "both", link_key(kLinksKey, "both")},
                false, 1, 0, [&] { links.retire(1, true); });
  const std::chrono::duration<double, std::milli> took = std::chrono::steady_clock::now() - begin;
  EXPECT_LE(took.count(), kPatience_ms + kBetween_ms + pulse.longest_ms());
  other.send(frame_for(1), std::make_shared<localisation::CommLocation>());
  EXPECT_TRUE(becomes_true([&] { return ends->heard.counters().dropped == 1; })) << "what comes too late is counted";
  wire::Frame closed = frame_for(1);
  closed.mutable_closed();
  other.send(closed);
  wire::Adopted held;
  EXPECT_TRUE(becomes_true([&] {
    held.Clear();
    links.add_held(held);
    return held.wires_size() == 1;
  })) << "and it is there until its end comes";
  EXPECT_EQ(ends->heard.counters().messages, 0U);
  links.release(hull, "the test is over");
}

}  // namespace
}  // namespace fiona::host
