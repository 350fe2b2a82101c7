// What the component says of a radio, against a bluetoothd of tests. It listens in a thread of its own, for which no
// clock of a bench can wait: here the machine's clock runs.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <map>
#include <mutex>
#include <thread>

#include "bluez_world.hpp"
#include "fiona/hull.hpp"
#include "fiona/pool.hpp"
#include "smart_bluetooth_beacon_server.hpp"

namespace fiona::smart_bluetooth_beacon_server {
namespace {

using namespace std::chrono_literals;
using beacon_server::distance_factor;
using beacon_server::distance_m;
using beacon_server::kIbeacon;
using ::testing::ElementsAre;
using ::testing::IsEmpty;

constexpr const char* kBeacon = "aa:bb:cc:dd:ee:01";

class NoEvents final : public HullEvents {
  void mode_changed(const std::string&, const std::string&, const std::string&) override {}
  void run_ended(const std::string&, int, const std::string&) override {}
  void logged(const std::string&, LogLevel, std::string_view) override {}
  void asked(const std::string&, std::uint64_t, const control::Request&) override {}
};

/// What a port has put, and whether it counts as silent.
class Kept final : public Sink {
 public:
  Outcome deliver(Parcel parcel) override {
    const std::lock_guard lock(mutex_);
    put_.push_back(std::move(parcel.envelope));
    return Outcome::Ok;
  }
  void lease(bool held, const std::string&) override {
    const std::lock_guard lock(mutex_);
    silent_ = !held;
  }
  template <class T>
  std::vector<T> all() const {
    const std::lock_guard lock(mutex_);
    std::vector<T> objects;
    for (const Envelope& one : put_) objects.push_back(dynamic_cast<const T&>(*one.object));
    return objects;
  }
  std::vector<Envelope> envelopes() const {
    const std::lock_guard lock(mutex_);
    return put_;
  }
  std::size_t size() const {
    const std::lock_guard lock(mutex_);
    return put_.size();
  }
  bool silent() const {
    const std::lock_guard lock(mutex_);
    return silent_;
  }

 private:
  mutable std::mutex mutex_;
  std::vector<Envelope> put_;
  bool silent_ = false;
};

class BeaconServerTest : public beacon_server::BluezTest {
 protected:
  BeaconServerTest() {
    hull_.create([](Hull& hull) { return std::make_unique<SmartBluetoothBeaconServer>(hull); });
    for (Port* port : hull_.ports()) {
      auto* const provider = dynamic_cast<detail::PushProvider*>(port);
      if (provider) provider->attach(kept_[port->name()] = std::make_shared<Kept>());
    }
    set("bus", bus_.output);
  }
  ~BeaconServerTest() override {
    hull_.shut_down(10s);
    clock_.stop();
  }

  void set(const std::string& name, const std::string& text) {
    change(name, [&](control::Value& value) { value.set_text(text); });
  }
  void set(const std::string& name, double number) {
    change(name, [&](control::Value& value) { value.set_number(number); });
  }
  void change(const std::string& name, const std::function<void(control::Value&)>& fill) {
    control::Argument argument;
    argument.set_name(name);
    fill(*argument.mutable_value());
    hull_.set_parameters({&argument, 1}, 10s);
  }

  void start() { hull_.set_mode(kModeActive, 10s); }
  void start_listening() {
    start_bluetoothd();
    adapter();
    start();
    ASSERT_TRUE(until_radio_says("listening"));
  }
  /// False if it is not so within twenty seconds.
  static bool until(const std::function<bool()>& so) {
    for (const auto end = std::chrono::steady_clock::now() + 20s; !so(); std::this_thread::sleep_for(5ms)) {
      if (std::chrono::steady_clock::now() > end) return false;
    }
    return true;
  }
  bool until_radio_says(const std::string& said) {
    return until([&] { return text_of("radio") == said; });
  }
  /// The first list that is so.
  std::optional<sensors::CommiBeaconList> list(const std::function<bool(const sensors::CommiBeaconList&)>& so) {
    std::optional<sensors::CommiBeaconList> found;
    std::size_t seen = 0;
    until([&] {
      const auto all = kept_["beacons"]->all<sensors::CommiBeaconList>();
      for (; seen < all.size() && !found; ++seen) {
        if (so(all[seen])) found = all[seen];
      }
      return found.has_value();
    });
    return found;
  }
  std::vector<sensors::RFSignalRSSI> signals() { return kept_["signals"]->all<sensors::RFSignalRSSI>(); }
  bool until_signals(std::size_t count) {
    return until([&] { return kept_["signals"]->size() >= count; });
  }
  /// The reference is heard once at that distance.
  void measure(double metres, std::int16_t rssi_dbm) {
    set("reference_distance", metres);
    const std::size_t before = kept_["signals"]->size();
    packet(rssi_dbm, kIbeacon);
    ASSERT_TRUE(until_signals(before + 1));
    set("reference_distance", 0.0);
  }

  std::string text_of(const std::string& probe) const {
    const auto object = hull_.read(probe).object;
    return object ? dynamic_cast<const detail::ProbeValue<std::string>::Carrier&>(*object).value() : "";
  }
  double number_of(const std::string& probe) const {
    const auto object = hull_.read(probe).object;
    return object ? dynamic_cast<const detail::ProbeValue<double>::Carrier&>(*object).value() : 0.0;
  }

  SystemClock clock_;
  Pool pool_{2};
  NoEvents events_;
  Hull hull_{"radio", {pool_, clock_, events_, {}}};
  std::map<std::string, std::shared_ptr<Kept>> kept_;
};

std::int64_t now_ms() {
  const auto now = std::chrono::system_clock::now().time_since_epoch();
  return std::chrono::duration_cast<std::chrono::milliseconds>(now).count();
}

TEST_F(BeaconServerTest, EachPacketOfEachDeviceIsASignalWithItsTimeAndStrength) {
  start_listening();
  const std::int64_t begun_ms = now_ms();
  packet(-60, kIbeacon);
  packet(-60, kIbeacon);
  packet(-85, {0x10, 0x05}, "AA:BB:CC:DD:EE:02");
  ASSERT_TRUE(until_signals(3));
  const auto all = signals();
  ASSERT_EQ(all.size(), 3u);
  std::vector<std::pair<std::string, float>> told;
  for (const auto& signal : all) {
    EXPECT_EQ(signal.receiver_id(), "00:11:22:33:44:55");
    EXPECT_EQ(signal.rf_type(), "BT");
    EXPECT_GE(signal.t(), begun_ms);
    EXPECT_LE(signal.t(), now_ms());
    told.emplace_back(signal.transmitter_id(), signal.rss());
  }
  EXPECT_THAT(told, ElementsAre(std::pair(kBeacon, -60.0f), std::pair(kBeacon, -60.0f),
                                std::pair("aa:bb:cc:dd:ee:02", -85.0f)));
}

TEST_F(BeaconServerTest, ABeaconIsListedWithTheMeanOfTheWindowAndItsDistance) {
  set("window", 10'000);
  set("path_loss_exponent", 2.0);
  set("receiver_gain", 3.0);
  start_listening();
  packet(-60, kIbeacon);
  packet(-70, kIbeacon);
  const auto told =
      list([](const auto& one) { return one.beacon_list_size() == 1 && one.beacon_list(0).rssi() == -65; });
  ASSERT_TRUE(told);
  EXPECT_EQ(told->beacon_list(0).address(), kBeacon);
  EXPECT_FLOAT_EQ(told->beacon_list(0).distance(), static_cast<float>(distance_m(-59, -65, {2.0, 0.0, 3.0})));
}

TEST_F(BeaconServerTest, AListThatRepeatsWhatWasHeardIsAsOldAsThat) {
  set("window", 10'000);
  start_listening();
  packet(-60, kIbeacon);
  std::vector<Envelope> lists;
  ASSERT_TRUE(until([&] {
    lists = kept_["beacons"]->envelopes();
    std::erase_if(lists, [](const Envelope& one) {
      return dynamic_cast<const sensors::CommiBeaconList&>(*one.object).beacon_list().empty();
    });
    return lists.size() >= 6;  // 1.5 s
  }));
  for (const Envelope& one : lists) {
    const auto& beacon = dynamic_cast<const sensors::CommiBeaconList&>(*one.object).beacon_list(0);
    EXPECT_NEAR(static_cast<double>(to_milliseconds(one.origin)), static_cast<double>(beacon.t()), 500.0);
  }
}

TEST_F(BeaconServerTest, ABeaconThatFallsSilentLeavesTheList) {
  start_listening();
  packet(-60, kIbeacon);
  ASSERT_TRUE(list([](const auto& one) { return one.beacon_list_size() == 1; }));
  const std::size_t before = kept_["beacons"]->size();
  EXPECT_TRUE(until([&] {
    const auto all = kept_["beacons"]->all<sensors::CommiBeaconList>();
    return all.size() > before && all.back().beacon_list().empty();
  }));
}

TEST_F(BeaconServerTest, ARadioThatHearsNothingSaysSoWithEmptyLists) {
  start_listening();
  ASSERT_TRUE(until([&] { return kept_["beacons"]->size() >= 3; }));
  for (const auto& told : kept_["beacons"]->all<sensors::CommiBeaconList>()) EXPECT_THAT(told.beacon_list(), IsEmpty());
  EXPECT_FALSE(kept_["beacons"]->silent());
}

TEST_F(BeaconServerTest, ARadioThatDoesNotListenIsSilenceAndNoEmptyList) {
  start_listening();
  ASSERT_TRUE(until([&] { return kept_["beacons"]->size() > 0; }));
  mock("Power", std::string("hci0"), false);
  ASSERT_TRUE(until_radio_says("the radio is switched off"));
  const std::size_t told = kept_["beacons"]->size();
  EXPECT_TRUE(until([&] { return kept_["beacons"]->silent() && kept_["signals"]->silent(); }));
  EXPECT_EQ(kept_["beacons"]->size(), told);
  mock("Power", std::string("hci0"), true);
  EXPECT_TRUE(until([&] { return !kept_["beacons"]->silent() && !kept_["signals"]->silent(); }));
  EXPECT_GT(kept_["beacons"]->size(), told);
}

TEST_F(BeaconServerTest, WhatAnUnpluggedRadioHeardIsNotSaidWhenItIsBack) {
  set("window", 10'000);
  start_listening();
  packet(-60, kIbeacon);
  ASSERT_TRUE(list([](const auto& one) { return one.beacon_list_size() == 1; }));
  unplug();
  ASSERT_TRUE(until_radio_says("there is no Bluetooth radio"));
  const std::size_t before = kept_["beacons"]->size();
  adapter();
  ASSERT_TRUE(until_radio_says("listening"));
  ASSERT_TRUE(until([&] { return kept_["beacons"]->size() > before; }));
  EXPECT_THAT(kept_["beacons"]->all<sensors::CommiBeaconList>().at(before).beacon_list(), IsEmpty());
}

TEST_F(BeaconServerTest, WhyThereIsNoRadioIsSaidWithoutABus) {
  set("bus", "unix:path=/nowhere/bus");
  start();
  EXPECT_TRUE(until([&] { return text_of("radio").starts_with("no bus at unix:path=/nowhere/bus: "); }));
}

TEST_F(BeaconServerTest, HowGoodADistanceIsFollowsTheParametersWhetherOrNotABeaconIsHeard) {
  start();
  EXPECT_TRUE(until([&] { return number_of("distance_factor") > 0.0; }));
  EXPECT_NEAR(number_of("distance_factor"), 1.6, 0.05);
  set("path_loss_exponent", 2.0);
  set("path_loss_spread", 6.0);
  EXPECT_TRUE(until([&] {
    return std::abs(number_of("distance_factor") - distance_factor({2.0, 6.0})) < 1e-9;
  })) << number_of("distance_factor");
}

TEST_F(BeaconServerTest, APathLossIsFittedToAReferenceAtKnownDistances) {
  set("reference", kBeacon);
  start_listening();
  packet(-99, kIbeacon);  // on the way there
  packet(-40, kIbeacon, "AA:BB:CC:DD:EE:02");
  ASSERT_TRUE(until_signals(2));
  measure(1.0, -61);
  measure(1.0, -63);
  EXPECT_TRUE(until([&] { return text_of("fitted") == "2 readings: not enough, or all at one distance"; }));
  measure(10.0, -86);
  measure(10.0, -88);
  EXPECT_TRUE(until([&] {
    return text_of("fitted") == "4 readings: path_loss_exponent=2.50 path_loss_spread=1.4 receiver_gain=-3.0";
  })) << text_of("fitted");
}

TEST_F(BeaconServerTest, WhatWasHeardOfAnotherReferenceDoesNotCount) {
  set("reference", kBeacon);
  start_listening();
  measure(1.0, -61);
  EXPECT_TRUE(until([&] { return text_of("fitted").starts_with("1 readings"); }));
  set("reference", "aa:bb:cc:dd:ee:02");
  EXPECT_TRUE(until([&] { return text_of("fitted").starts_with("0 readings"); }));
}

}  // namespace
}  // namespace fiona::smart_bluetooth_beacon_server
