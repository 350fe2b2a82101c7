// One process with links, and another one by hand at their other end.
#pragma once

#include <atomic>
#include <chrono>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <thread>

#include <gtest/gtest.h>

#include "../temporary_directory.hpp"
#include "fiona/component.hpp"
#include "fiona/hull.hpp"
#include "fiona/localisation.fiona.hpp"
#include "fiona/navigation.fiona.hpp"
#include "fiona/perception.fiona.hpp"
#include "fiona/sensors.fiona.hpp"
#include "link_keys.hpp"
#include "links.hpp"
#include "raw_peer.hpp"

namespace fiona::host {

using namespace std::chrono_literals;

inline const std::string kLinksKey(kKeyBytes, 'k');
inline const std::string kLinksToken = "0123456789abcdef";

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

/// One process with both ends of several services.
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

  tests::TemporaryDirectory directory;
  SystemClock clock;
  Pool pool{2};
  NoEvents events;
  Hull hull{"both", {pool, clock, events, {}}};
  BothEnds* ends = nullptr;
  zmq::context_t context;
  Links links{pool, clock, at("links"), {kLinksKey}, [](std::uint64_t, const std::string&) {}};
};

inline wire::Frame opening_by_hand(std::uint64_t wire, bool ahead) {
  wire::Frame open = frame_for(wire);
  open.mutable_open()->set_version(wire::VERSION_1);
  open.mutable_open()->set_token(kLinksToken);
  open.mutable_open()->set_ahead(ahead);
  return open;
}

inline void open_by_hand(RawPeer& peer, std::uint64_t wire) {
  peer.send(opening_by_hand(wire, false));
  EXPECT_TRUE(peer.receive().has_opened());
}

}  // namespace fiona::host
