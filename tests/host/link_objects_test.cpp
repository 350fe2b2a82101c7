// What crosses the links of one process: each object once, in its order, counted where it is lost and refused where it
// breaks a rule.
#include <gtest/gtest.h>

#include <atomic>
#include <chrono>
#include <cstdint>
#include <future>
#include <memory>
#include <string>

#include <google/protobuf/type.pb.h>

#include "links_fixture.hpp"

namespace fiona::host {
namespace {

/// An obstacle that counts how often it is serialised. Its type has no rules, for which a put would look into it.
class CountedObstacle final : public google::protobuf::Message {
 public:
  explicit CountedObstacle(std::size_t bytes) {
    shown_.GetReflection()->MutableUnknownFields(&shown_)->AddLengthDelimited(1000, std::string(bytes, 'x'));
  }
  CountedObstacle* New(google::protobuf::Arena*) const override { return nullptr; }
  google::protobuf::Metadata GetMetadata() const override { return shown_.GetMetadata(); }
  std::size_t ByteSizeLong() const override { return shown_.ByteSizeLong(); }
  int GetCachedSize() const override { return shown_.GetCachedSize(); }
  std::uint8_t* _InternalSerialize(std::uint8_t* to, google::protobuf::io::EpsCopyOutputStream* stream) const override {
    ++serialised;
    return shown_._InternalSerialize(to, stream);
  }
  mutable std::atomic<int> serialised{0};

 private:
  perception::CommObstacle shown_;
};

TEST_F(LinksOfAProcess, AnObjectIsSerialisedOnceForEachProcessAndALargeOneOnceHoweverManyWiresItIsFor) {
  constexpr std::size_t kLarge = kLaneWindow;  // more than goes to one that does not read: it is there for the next one
  RawPeer one(context, at("links"), "one", "one", 1), other(context, at("links"), "other", "other", 1);
  std::uint64_t wire = 0;
  const auto open_eight = [&](RawPeer& peer, const std::string& name) {
    peer.prove(kLinksKey);
    for (int i = 0; i < 8; ++i) {
      links.provide(++wire, kLinksToken, name, ends->shown, 1, "client");
      peer.send(opening_by_hand(wire, false));
    }
    EXPECT_TRUE(becomes_true([&] { return ends->shown.subscribers() == wire; }));
  };
  const auto serialised = [&](std::size_t bytes) {
    const auto obstacle = std::make_shared<CountedObstacle>(bytes);
    EXPECT_TRUE(hull.strand().call([&] { ends->shown.put_object(obstacle, clock.now()); }, 20s));
    return obstacle->serialised.load();
  };
  open_eight(one, "one");
  EXPECT_EQ(serialised(10), 1);
  EXPECT_EQ(serialised(kLarge), 1);
  open_eight(other, "other");
  EXPECT_EQ(serialised(10), 2);
  EXPECT_EQ(serialised(kLarge), 1);
}

TEST_F(LinksOfAProcess, APushThatIsReplacedHasBroughtAllThatWasPutBefore) {
  constexpr std::uint64_t kPuts = FIONA_SANITIZED ? 200 : 2'000;
  constexpr auto kPatience = 100ms;  // in which they have to come
  Links other{pool, clock, at("other"), {kLinksKey}, [](std::uint64_t, const std::string&) {}};
  const auto& counters = ends->heard.counters();
  bool in_time = false;
  // On a busy machine they may come too late, and are counted; not each time.
  for (std::uint64_t wire = 1; wire <= 20 && !in_time; ++wire) {
    const std::uint64_t come = counters.messages + counters.superseded;
    const std::uint64_t dropped = counters.dropped;
    other.provide(wire, kLinksToken, "both", ends->told, 1, "both.heard");
    const auto end = ends->heard.end_for("both.told");
    links.require(wire, kLinksToken, end, {at("other"), "both", link_key(kLinksKey, "both")}, false, 0, 0, nullptr);
    EXPECT_TRUE(hull.strand().call(
        [&] {
          for (std::uint64_t i = 0; i < kPuts; ++i) ends->told.put(localisation::CommLocation());
        },
        20s));
    const auto begin = std::chrono::steady_clock::now();
    links.retire(wire, true);
    in_time = std::chrono::steady_clock::now() - begin < kPatience;
    if (in_time) {
      EXPECT_EQ(counters.messages + counters.superseded, come + kPuts);
      EXPECT_EQ(counters.dropped, dropped);
    }
    EXPECT_TRUE(becomes_true(
        [&] { return counters.messages + counters.superseded + counters.dropped == come + dropped + kPuts; }));
    EXPECT_TRUE(becomes_true([&] { return ends->told.subscribers() == 0; }));
  }
  EXPECT_TRUE(in_time) << "it has waited for an end that does not come";
  other.release(hull, "the test is over");
  other.stop();
}

TEST_F(LinksOfAProcess, WhatIsPutForAPeerThatIsLostIsDeliveredOrCounted) {
  constexpr std::uint64_t kPuts = 150'000;
  links.provide(1, kLinksToken, "peer", ends->told, 1, "client");
  RawPeer peer(context, at("links"), "peer");
  peer.prove(kLinksKey);
  open_by_hand(peer, 1);  // and pays nothing back
  EXPECT_TRUE(hull.strand().call(
      [&] {
        for (std::uint64_t i = 0; i < kPuts; ++i) ends->told.put(localisation::CommLocation());
      },
      20s));
  const auto& dropped = ends->told.counters().dropped;
  const std::uint64_t dropped_before = dropped;
  EXPECT_GT(dropped_before, 0U);
  links.peer_lost("", "peer", "its process has ended");
  constexpr std::uint64_t kOnTheirWay = kLaneWindow / kFrameCost;
  EXPECT_GE(dropped, kPuts - kOnTheirWay);
  EXPECT_GT(dropped, dropped_before) << "those that waited";
  EXPECT_EQ(ends->told.subscribers(), 0U);
}

TEST_F(LinksOfAProcess, APushThatBreaksARuleIsRefusedWhereItArrivesAndReachesNoHandler) {
  ProviderByHand other(at("other"));
  require(1, ends->noticed);
  const auto nowhere = std::make_shared<localisation::CommLocation>();
  nowhere->mutable_position()->set_reference_lat(91);
  other.send(frame_for(1), nowhere);
  other.send(frame_for(1), std::make_shared<localisation::CommLocation>());
  EXPECT_TRUE(becomes_true([&] { return ends->noticed_so_far > 0; })) << "the one behind it";
  EXPECT_TRUE(hull.strand().call([] {}, 20s));
  EXPECT_EQ(ends->noticed_so_far, 1);
  EXPECT_EQ(ends->noticed.counters().refused, 1U);
  links.release(hull, "the test is over");
}

TEST_F(LinksOfAProcess, AnEventThatBreaksARuleIsRefusedWhereItArrivesAndReachesNoHandler) {
  std::atomic<std::uint64_t> activation{0};
  ProviderByHand other(at("other"), [&](const wire::Frame& frame) {
    if (frame.has_request()) activation = frame.request().id();
  });
  require(1, ends->pictured);
  EXPECT_TRUE(hull.strand().call([&] { ends->begin_to_wait_for_pictures(); }, 20s));
  ASSERT_TRUE(becomes_true([&] { return activation > 0; }));
  wire::Frame fired = frame_for(1);
  fired.mutable_fired()->set_id(activation);
  other.send(fired);
  for (const float frequency_hz : {-1.0F, 1.0F}) {
    const auto picture = std::make_shared<sensors::ImageInput>();
    picture->set_update_frequency(frequency_hz);
    fired.mutable_fired()->set_sequence(fired.fired().sequence() + 1);
    other.send(fired, picture);
  }
  EXPECT_TRUE(becomes_true([&] { return ends->pictured_so_far > 0; })) << "the one behind it";
  EXPECT_TRUE(hull.strand().call([] {}, 20s));
  EXPECT_EQ(ends->pictured_so_far, 1);
  EXPECT_EQ(ends->pictured.counters().refused, 1U);
  EXPECT_EQ(ends->pictured.counters().dropped, 0U);
  links.release(hull, "the test is over");
}

TEST_F(LinksOfAProcess, AnObjectForWiresOfSeveralTypesGoesToThoseOfTheFirstOneAlone) {
  ProviderByHand other(at("other"));
  require(1, ends->heard);
  require(2, ends->turned);
  wire::Frame frame = frame_for(1);
  frame.add_also(2);
  other.send(frame, std::make_shared<localisation::CommLocation>());
  EXPECT_TRUE(becomes_true([&] { return ends->heard.counters().messages == 1 && links.status().not_granted() == 1; }));
  EXPECT_EQ(ends->turned.counters().messages, 0U);
  links.release(hull, "the test is over");
}

TEST_F(LinksOfAProcess, AQuestionForRoomThatComesBeforeTheWireIsOpenIsAnsweredWhateverComesBehindIt) {
  std::promise<void> answered;
  ProviderByHand* asks = nullptr;
  ProviderByHand other(at("other"), [&](const wire::Frame& frame) {
    if (frame.has_room()) answered.set_value();
    if (!frame.has_open()) return;
    wire::Frame question = frame_for(frame.wire());
    question.mutable_room()->set_bytes(1);
    asks->send(question);
    auto large = std::make_shared<google::protobuf::Field>();
    large->mutable_default_value()->assign(kLaneWindow + 1, 'x');  // one field that a location has not
    asks->send(frame_for(frame.wire()), std::move(large));
  });
  asks = &other;
  require(1, ends->noticed);
  EXPECT_EQ(answered.get_future().wait_for(5s), std::future_status::ready);
  links.release(hull, "the test is over");
}

}  // namespace
}  // namespace fiona::host
