// The links of one process, whatever a peer does on the way.
#include <gmock/gmock.h>
#include <google/protobuf/type.pb.h>
#include <gtest/gtest.h>

#include <array>
#include <atomic>
#include <chrono>
#include <filesystem>
#include <fstream>
#include <functional>
#include <future>
#include <memory>
#include <optional>
#include <string>
#include <thread>

#include <unistd.h>

#include "../pulse.hpp"
#include "../temporary_directory.hpp"
#include "fiona/component.hpp"
#include "fiona/error.hpp"
#include "fiona/hull.hpp"
#include "fiona/localisation.fiona.hpp"
#include "fiona/navigation.fiona.hpp"
#include "fiona/perception.fiona.hpp"
#include "fiona/sensors.fiona.hpp"
#include "leader_link.hpp"
#include "link_keys.hpp"
#include "links.hpp"
#include "peer_link.hpp"
#include "raw_peer.hpp"
#include "remote_group.hpp"
#include "uninterrupted.hpp"
#include "zap.hpp"

namespace fiona::host {
namespace {

using namespace std::chrono_literals;
using tests::TemporaryDirectory;

const std::string kLinksKey(kKeyBytes, 'k');
const std::string kLinksToken = "0123456789abcdef";

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

struct ObstaclePort final : Provides<perception::ObstacleProvider> {
  using Provides::Provides;
  using PushProvider::put_object;
};

class BothEnds final : public Component {
 public:
  using Component::Component;
  Provides<localisation::LocationProvider> told{*this, "told"};
  Requires<localisation::LocationProvider> heard{*this, "heard"};
  Requires<localisation::LocationProvider> noticed{*this, "noticed", &BothEnds::on_location};
  Requires<localisation::OrientationProvider> turned{*this, "turned"};
  Provides<navigation::LevelMap> asked{*this, "asked", &BothEnds::on_question};
  Requires<navigation::LevelMap> asks{*this, "asks"};
  ObstaclePort shown{*this, "shown"};
  Requires<sensors::ImageInputService> pictured{*this, "pictured", &BothEnds::on_picture};
  std::optional<Reply<navigation::CommLevelMap>> open;
  std::atomic<int> asked_so_far{0};
  std::atomic<int> noticed_so_far{0};
  std::atomic<int> pictured_so_far{0};

  void begin_to_wait_for_pictures() { spawn(activate()); }

 private:
  Async<> activate() { static_cast<void>(co_await pictured.activate(EventMode::Continuous, {})); }
  void on_location(const localisation::CommLocation&) { ++noticed_so_far; }
  void on_picture(const Fired<sensors::ImageInput>&) { ++pictured_so_far; }
  void on_question(const navigation::CommLevelMapRequest&, Reply<navigation::CommLevelMap> reply) {
    open = std::move(reply);
    ++asked_so_far;
  }
};

struct NoEvents final : HullEvents {
  void mode_changed(const std::string&, const std::string&, const std::string&) override {}
  void run_ended(const std::string&, int, const std::string&) override {}
  void logged(const std::string&, LogLevel, std::string_view) override {}
  void asked(const std::string&, std::uint64_t, const control::Request&) override {}
};

template <class F>
bool becomes_true(F fits) {
  const auto end = std::chrono::steady_clock::now() + 20s;
  while (!fits() && std::chrono::steady_clock::now() < end) std::this_thread::yield();
  return fits();
}

/// Another process, by hand: it opens whatever it is asked to, and says what it likes before.
class ProviderByHand final : public LinkSocket::Receiver {
 public:
  using OnFrame = std::function<void(const wire::Frame&)>;

  explicit ProviderByHand(
      const std::string& endpoint, OnFrame on_frame = [](const auto&) {})
      : on_frame_(std::move(on_frame)) {
    link_->listen(endpoint, {kLinksKey});
  }
  ~ProviderByHand() override { link_->stop(); }

  std::optional<std::uint64_t> accepts(const std::string&, const wire::Frame& frame) override { return frame.wire(); }
  void on_frame(const std::string& peer, const wire::Frame& frame, const ObjectBytes&) override {
    if (frame.has_open() && !lane_.peer) lane_ = link_->open_lane(peer);
    on_frame_(frame);
    wire::Frame opened = frame_for(frame.wire());
    opened.mutable_opened();
    if (frame.has_open()) link_->send(lane_, opened);
  }
  void on_refused(const std::string&) override {}
  void send(wire::Frame frame) { link_->send(lane_, frame); }
  void send(wire::Frame frame, std::shared_ptr<const Object> object) {
    if (!frame.has_fired()) frame.mutable_object()->set_sequence(1);
    link_->send(lane_, frame, object, LinkSocket::Rule::MustFit);
  }
  void send_waiting(wire::Frame frame, std::shared_ptr<const Object> object) {
    frame.mutable_object()->set_sequence(1);
    while (link_->send(lane_, frame, object, LinkSocket::Rule::MustFit).what == LinkSocket::Sent::What::Full)
      std::this_thread::yield();
  }

 private:
  const OnFrame on_frame_;
  LinkCounters counters_;
  Pool pool_{1};
  zmq::context_t context_;
  LinkSocket::Lane lane_;
  const std::shared_ptr<LinkSocket> link_ =
      std::make_shared<LinkSocket>(pool_, context_, zmq::socket_type::router, counters_, *this);
};

class LinksOfAProcess : public testing::Test {
 protected:
  LinksOfAProcess() {
    hull.create([this](Hull& owner) {
      auto made = std::make_unique<BothEnds>(owner);
      ends = made.get();
      return made;
    });
    hull.set_mode(kModeActive, 20s);
  }
  ~LinksOfAProcess() override {
    links.stop();
    hull.shut_down(20s);
    clock.stop();
  }
  std::string at(const std::string& name) const { return "ipc://" + (directory.path / name).string(); }
  /// To the process that listens at "other".
  void require(std::uint64_t wire, RequiredPort& client) {
    const auto end = client.end_for("other.port");
    links.require(wire, kLinksToken, end, {at("other"), "both", link_key(kLinksKey, "both")}, false, 0, 0, nullptr);
  }

  TemporaryDirectory directory;
  SystemClock clock;
  Pool pool{2};
  NoEvents events;
  Hull hull{"both", {pool, clock, events, {}}};
  BothEnds* ends = nullptr;
  zmq::context_t context;
  Links links{pool, clock, at("links"), {kLinksKey}, [](std::uint64_t, const std::string&) {}};
};

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

wire::Frame opening_by_hand(std::uint64_t wire, bool ahead) {
  wire::Frame open = frame_for(wire);
  open.mutable_open()->set_version(wire::VERSION_1);
  open.mutable_open()->set_token(kLinksToken);
  open.mutable_open()->set_ahead(ahead);
  return open;
}

void open_by_hand(RawPeer& peer, std::uint64_t wire) {
  peer.send(opening_by_hand(wire, false));
  EXPECT_TRUE(peer.receive().has_opened());
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

long descriptors() {
  const auto all = std::filesystem::directory_iterator("/proc/self/fd");
  return std::distance(begin(all), end(all));
}

TEST_F(LinksOfAProcess, AWireToAProcessThatIsKnownCostsOneRoundTripAndMakesNoSocket) {
  Links other{pool, clock, at("other"), {kLinksKey}, [](std::uint64_t, const std::string&) {}};
  const auto open = [&](std::uint64_t wire, ProvidedPort& provider, RequiredPort& client) {
    other.provide(wire, kLinksToken, "both", provider, 1, client.full_name());
    require(wire, client);
    EXPECT_EQ(client.connection(), Connection::Connected);
  };
  open(1, ends->told, ends->heard);
  const long descriptors_before = descriptors();
  open(2, ends->told, ends->noticed);
  open(3, ends->asked, ends->asks);
  for (Links* end : {&links, &other}) {
    EXPECT_TRUE(becomes_true([&] { return end->status().sent_messages() >= 3; }));
    EXPECT_EQ(end->status().sent_messages(), 3U) << "of each wire a question, and its answer";
  }
  EXPECT_EQ(descriptors(), descriptors_before);
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

TEST_F(LinksOfAProcess, APeerHasOneUnfinishedObjectForEachOfItsWiresWhateverItCallsThem) {
  links.provide(1, kLinksToken, "peer", ends->told, 1, "client");
  RawPeer peer(context, at("links"), "peer");
  peer.prove(kLinksKey);
  open_by_hand(peer, 1);
  for (std::uint64_t i = 0; i < 100; ++i) {
    wire::Frame first = frame_for(1000 + i);
    first.add_also(1);
    first.set_size(2 * kLocalChunkBytes);
    first.mutable_object()->set_sequence(1);
    peer.send(first, "x");
  }
  EXPECT_TRUE(becomes_true([&] { return links.status().garbled() == 50; })) << "each that meets an unfinished one";
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

TEST_F(LinksOfAProcess, APeersSentencesAreCutToWhatASentenceMayHave) {
  ProviderByHand other(at("other"));
  require(1, ends->noticed);
  wire::Frame silent = frame_for(1);
  silent.mutable_lease()->set_reason(std::string(kMostFrame - 100, 'x'));
  other.send(silent);
  EXPECT_TRUE(becomes_true([&] { return ends->noticed.connection() == Connection::Lost; }));
  EXPECT_LT(ends->noticed.connection_reason().size(), 5'000U);
  links.release(hull, "the test is over");
}

TEST_F(LinksOfAProcess, AProviderThatComesAndGoesFasterThanItsClientWorksFillsNothing) {
  ProviderByHand other(at("other"));
  require(1, ends->noticed);
  std::promise<void> works, goes_on;
  hull.strand().post([&] {
    works.set_value();
    goes_on.get_future().wait();
  });
  works.get_future().wait();
  const std::size_t before = hull.strand().waiting_jobs();
  for (int i = 0; i < 200; ++i) {
    wire::Frame lease = frame_for(1);
    lease.mutable_lease()->set_held(i % 2 == 1);
    other.send(lease);
    const auto told = i % 2 == 1 ? Connection::Connected : Connection::Lost;
    ASSERT_TRUE(becomes_true([&] { return ends->noticed.connection() == told; }));
  }
  EXPECT_LE(hull.strand().waiting_jobs(), before + 16);
  goes_on.set_value();
  other.send(frame_for(1), std::make_shared<localisation::CommLocation>());
  EXPECT_TRUE(becomes_true([&] { return ends->noticed_so_far == 1; }));
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

TEST_F(LinksOfAProcess, AClientCannotSayThatMoreWasLostThanWasPut) {
  links.provide(1, kLinksToken, "peer", ends->told, 1, "client");
  RawPeer peer(context, at("links"), "peer");
  peer.prove(kLinksKey);
  open_by_hand(peer, 1);
  EXPECT_TRUE(hull.strand().call([&] { ends->told.put(localisation::CommLocation()); }, 20s));
  for (const std::uint64_t messages : {1ULL, ~0ULL, 5ULL}) {
    wire::Frame frame = frame_for(1);
    frame.mutable_lost()->set_messages(messages);
    peer.send(frame);
  }
  const auto before = links.status().not_granted();
  peer.send(frame_for(7));
  EXPECT_TRUE(becomes_true([&] { return links.status().not_granted() > before; }));
  EXPECT_EQ(ends->told.counters().dropped, 1U);
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

std::size_t resident_bytes() {
  std::ifstream file("/proc/self/statm");
  std::size_t pages = 0;
  file >> pages >> pages;
  return pages * static_cast<std::size_t>(::sysconf(_SC_PAGESIZE));
}

TEST_F(LinksOfAProcess, WhoAsksWithoutReadingTheAnswersTakesNoMemory) {
  constexpr std::size_t kMessages = 2000;
  constexpr std::size_t kTogether = 500;
  RawPeer peer(context, at("links"), "peer", "peer", 1);
  peer.prove(kLinksKey);
  wire::Frame open = frame_for(7);
  open.mutable_open()->set_version(wire::VERSION_1);
  const Block record = make_record(open, nullptr, 0);
  std::string message;
  for (std::size_t i = 0; i < kTogether; ++i)
    message.append(reinterpret_cast<const char*>(record.data()), record.size());
  const std::size_t before = resident_bytes();
  for (std::size_t i = 0; i < kMessages; ++i) peer.send(RawPeer::Message{message});
  EXPECT_TRUE(becomes_true([&] { return links.status().received_messages() >= kMessages; }));
  EXPECT_EQ(links.status().overrun(), 1U);
  EXPECT_EQ(links.status().peers(), 0U);
  if (FIONA_SANITIZED) return;  // which keep what was freed
  EXPECT_LT(resident_bytes(), before + 64 * 1024 * 1024);
}

/// A host that may be led, and what its leader says to it by hand.
class LedHost {
 public:
  using OnChange = std::function<void(const HostChange&)>;

  LedHost(const std::filesystem::path& directory, Pool& pool, Clock& clock, Links& links, zmq::context_t& context,
          OnChange on_change)
      : ours_(directory / "ours"), leaders_(directory / "leaders"), context_(context) {
    ours_.make();
    leaders_.make();
    ours_.allow("leader", leaders_.pair().open.text());
    zap_.emplace(context, Zap::hosts(ours_), [](const std::string&) {});
    around_.emplace(HostSurroundings{"led", 1, ours_.pair(), pool, clock, links, context, {}, std::move(on_change)});
    link_ = std::make_unique<LeaderLink>(*around_, ours_, "tcp://127.0.0.1:0");
    serving_ = std::thread([this] { serve(); });
  }
  ~LedHost() {
    link_->stop();
    ends_ = true;
    serving_.join();
  }
  LeaderLink& link() { return *link_; }
  /// The leader connects.
  zmq::socket_t connect() {
    zmq::socket_t socket(context_, zmq::socket_type::dealer);
    socket.set(zmq::sockopt::linger, 0);
    socket.set(zmq::sockopt::rcvtimeo, 5000);
    socket.set(zmq::sockopt::curve_serverkey, ours_.pair().open.bytes());
    socket.set(zmq::sockopt::curve_publickey, leaders_.pair().open.bytes());
    socket.set(zmq::sockopt::curve_secretkey, leaders_.pair().secret.bytes());
    socket.connect(link_->address());
    return socket;
  }
  static void say_hello(zmq::socket_t& socket, std::int64_t now_ns = 0, wire::Version version = wire::VERSION_1) {
    wire::Frame frame;
    auto& hello = *frame.mutable_host()->mutable_hello();
    hello.set_version(version);
    hello.set_run(1);
    hello.mutable_beat()->set_now_ns(now_ns);
    const Block record = make_record(frame, nullptr, 0);
    sent(socket, zmq::buffer(record.data(), record.size()));
  }

 private:
  void serve() {
    std::array<zmq::pollitem_t, 1> waits{{{zap_->socket().handle(), 0, ZMQ_POLLIN, 0}}};
    while (!ends_) {
      if (zmq::poll(waits, 10ms) > 0) zap_->serve();
    }
  }

  trust::KeyDirectory ours_;
  trust::KeyDirectory leaders_;
  zmq::context_t& context_;
  std::optional<Zap> zap_;
  std::optional<HostSurroundings> around_;
  std::unique_ptr<LeaderLink> link_;
  std::atomic<bool> ends_{false};
  std::thread serving_;
};

/// What a host says next to who leads it.
wire::HostFrame said_to(zmq::socket_t& socket) {
  zmq::message_t message;
  wire::Frame frame;
  if (!uninterrupted([&] { return socket.recv(message); })) return {};
  const auto* in = static_cast<const std::uint8_t*>(message.data());
  return frame.ParseFromArray(in + kRecordHead, in[0] | in[1] << 8) ? frame.host() : wire::HostFrame();
}

TEST_F(LinksOfAProcess, AHostHoldsNothingWhileItTellsWhoLeads) {
  LedHost* led = nullptr;
  std::future<std::string> asked;
  std::promise<bool> answered;
  LedHost host(directory.path, pool, clock, links, context, [&](const HostChange& change) {
    if (change.what != HostChange::What::Joined) return;
    asked = std::async(std::launch::async, [&] { return led->link().leader(); });
    answered.set_value(asked.wait_for(5s) == std::future_status::ready);
  });
  led = &host;
  zmq::socket_t leader = host.connect();
  LedHost::say_hello(leader);
  auto whether = answered.get_future();
  ASSERT_EQ(whether.wait_for(20s), std::future_status::ready);
  EXPECT_TRUE(whether.get());
  EXPECT_EQ(asked.get(), "leader");
}

TEST_F(LinksOfAProcess, AHelloOfAConnectionThatItsLeaderHasGivenUpTakesNothingOver) {
  std::atomic<int> changes{0};
  LedHost host(directory.path, pool, clock, links, context, [&](const HostChange&) { ++changes; });
  zmq::socket_t later = host.connect();
  LedHost::say_hello(later, 200);
  EXPECT_TRUE(said_to(later).has_welcome());
  zmq::socket_t earlier = host.connect();
  LedHost::say_hello(earlier, 100);
  LedHost::say_hello(earlier, 100, static_cast<wire::Version>(99));
  EXPECT_TRUE(said_to(earlier).has_refused()) << "and nothing before that";
  EXPECT_EQ(changes, 1) << "it was joined";
  LedHost::say_hello(earlier, 300);
  EXPECT_TRUE(said_to(earlier).has_welcome()) << "one that comes anew resumes";
}

/// Stands still for those who ask from other threads than the one that it was made on.
class StandingClock final : public Clock {
 public:
  explicit StandingClock(Clock& clock) : clock_(clock) {}
  TimePoint now() const override {
    while (std::this_thread::get_id() != owner_ && !goes_on) is_asked = true;
    return clock_.now();
  }
  TimePoint start() const override { return clock_.start(); }
  TimerId schedule(TimePoint at, const std::shared_ptr<Strand>& strand, Job job) override {
    return clock_.schedule(at, strand, std::move(job));
  }
  void cancel(TimerId timer) override { clock_.cancel(timer); }
  mutable std::atomic<bool> is_asked{false};
  std::atomic<bool> goes_on{false};

 private:
  Clock& clock_;
  const std::thread::id owner_ = std::this_thread::get_id();
};

/// A host that another one leads, by hand.
class HostByHand {
 public:
  HostByHand(const std::filesystem::path& directory, zmq::context_t& context)
      : leaders_(directory / "leaders"), own_(directory / "own"), socket_(context, zmq::socket_type::router) {
    leaders_.make();
    own_.make();
    socket_.set(zmq::sockopt::linger, 0);
    socket_.set(zmq::sockopt::curve_server, true);
    socket_.set(zmq::sockopt::curve_secretkey, own_.pair().secret.bytes());
    socket_.bind("tcp://127.0.0.1:*");
  }
  PeerAddress address() const { return {"by-hand", socket_.get(zmq::sockopt::last_endpoint), own_.pair().open}; }
  trust::KeyPair leaders_keys() const { return leaders_.pair(); }
  /// Says welcome to whatever has come.
  void answer() {
    wire::HostFrame welcome;
    welcome.mutable_welcome()->set_run(2);
    zmq::message_t identity;
    while (received(socket_, identity)) {
      for (zmq::message_t rest; received(socket_, rest);) continue;
      leader_ = identity.to_string();
      say(welcome);
    }
  }
  void say(const wire::HostFrame& what) {
    wire::Frame frame;
    frame.mutable_host();
    const bool is_small = what.ByteSizeLong() <= kInlineBytes;
    if (is_small) *frame.mutable_host() = what;
    const Block record = make_record(frame, is_small ? nullptr : &what, is_small ? 0 : what.ByteSizeLong());
    sent(socket_, zmq::buffer(leader_), zmq::send_flags::sndmore);
    sent(socket_, zmq::buffer(record.data(), record.size()));
  }

 private:
  trust::KeyDirectory leaders_;
  trust::KeyDirectory own_;
  zmq::socket_t socket_;
  std::string leader_;
};

TEST_F(LinksOfAProcess, AHostThatIsWelcomedWhileItGivesUpIsNotJoinedWithoutAConnection) {
  HostByHand other(directory.path, context);
  StandingClock standing(clock);
  std::optional<HostChange> last;
  const auto on_change = [&](HostChange change) { last = std::move(change); };
  const HostSurroundings around{"ours", 1, other.leaders_keys(), pool, standing, links, context, {}, on_change};
  PeerLink peer(around, other.address());
  EXPECT_TRUE(becomes_true([&] {
    peer.tick(std::chrono::steady_clock::now());
    other.answer();
    return standing.is_asked.load();
  }));
  auto given_up = std::async(std::launch::async, [&] { peer.tick(std::chrono::steady_clock::now() + 1h); });
  given_up.wait_for(100ms);  // it waits for who reads the welcome; where it has not come so far, there is a connection
  standing.goes_on = true;
  given_up.get();
  try {
    peer.request("main", {}, 1s);
    ADD_FAILURE() << "nobody has answered";
  } catch (const Error& error) {
    EXPECT_EQ(peer.joined(), error.text().what == "host 'by-hand' does not answer") << error.text().what;
  }
  ASSERT_TRUE(last);
  EXPECT_EQ(peer.joined(), last->what == HostChange::What::Joined);
  EXPECT_EQ(peer.joined(), last->reason.empty()) << last->reason;
  peer.stop();
}

TEST_F(LinksOfAProcess, AGroupOfAnotherHostIsAskedForItsStatusNoLongerThanThereIsPatience) {
  HostByHand other(directory.path, context);
  const auto on_change = [](const HostChange&) {};
  const HostSurroundings around{"ours", 1, other.leaders_keys(), pool, clock, links, context, {}, on_change};
  PeerLink peer(around, other.address());
  ASSERT_TRUE(becomes_true([&] {
    peer.tick(std::chrono::steady_clock::now());
    other.answer();
    return peer.joined();
  }));
  RemoteGroup group("by-hand", peer, "main", nullptr);
  const auto begun = std::chrono::steady_clock::now();
  EXPECT_FALSE(group.status(1ms));
  EXPECT_LT(std::chrono::steady_clock::now() - begun, 1s) << "which requests have for the way";
  EXPECT_TRUE(group.silent_since());
  peer.stop();
}

TEST_F(LinksOfAProcess, AHostThatSaysMoreThanIsReadLosesItsSession) {
  HostByHand other(directory.path, context);
  std::atomic<std::size_t> heard{0};
  std::mutex mutex;
  std::string lost;
  const auto on_event = [&](const wire::GroupMessage&) { ++heard; };
  const auto on_change = [&](const HostChange& change) {
    const std::lock_guard lock(mutex);
    if (change.what == HostChange::What::Lost) lost = change.reason;
  };
  const HostSurroundings around{"ours", 1, other.leaders_keys(), pool, clock, links, context, on_event, on_change};
  PeerLink peer(around, other.address());
  const auto now_joined = [&] {
    peer.tick(std::chrono::steady_clock::now());
    other.answer();
    return peer.joined();
  };
  ASSERT_TRUE(becomes_true(now_joined));
  wire::GroupRequest create;
  create.mutable_create()->set_instance("talker");
  ASSERT_TRUE(peer.tell("main", create));
  wire::HostFrame said;
  said.mutable_message()->mutable_logged()->set_instance("talker");
  said.mutable_message()->mutable_logged()->set_text(std::string(512 * 1024, 'x'));
  for (std::size_t i = 1; i <= 200; ++i) {
    other.say(said);
    ASSERT_TRUE(becomes_true([&] { return now_joined() && heard == i; })) << i;
    if (i % 100 == 0) peer.was_read();
  }
  for (std::size_t i = 0; i < 200; ++i) other.say(said);
  EXPECT_TRUE(becomes_true([&] {
    peer.tick(std::chrono::steady_clock::now());
    const std::lock_guard lock(mutex);
    return !lost.empty();
  }));
  EXPECT_THAT(lost, testing::StartsWith("host 'by-hand' has said more than 64 MiB"));
  EXPECT_LT((heard - 200) * 512 * 1024, kMostUnread);
  peer.stop();
}

}  // namespace
}  // namespace fiona::host
