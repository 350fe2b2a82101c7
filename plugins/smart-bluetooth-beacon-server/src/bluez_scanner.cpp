#include "bluez_scanner.hpp"

#include <algorithm>
#include <cstdlib>

namespace fiona::beacon_server {
namespace {

constexpr const char* kBluez = "org.bluez";
constexpr const char* kAdapter = "org.bluez.Adapter1";
constexpr const char* kDevice = "org.bluez.Device1";
constexpr const char* kManager = "org.freedesktop.DBus.ObjectManager";
constexpr const char* kPropertiesInterface = "org.freedesktop.DBus.Properties";
constexpr int kNotAvailable_dbm = 127;
constexpr std::size_t kMostMessages = 1000;  // handled in one run, so that a storm does not hold up who calls it

std::string lower(std::string text) {
  for (char& c : text) c = c >= 'A' && c <= 'Z' ? static_cast<char>(c - 'A' + 'a') : c;
  return text;
}

/// Throws MalformedMessage if it is of another type.
template <class T>
std::optional<T> value(const Properties& properties, const char* name) {
  const auto found = properties.find(name);
  if (found == properties.end()) return std::nullopt;
  const T* const held = std::get_if<T>(&found->second);
  if (!held) throw MalformedMessage();
  return *held;
}

/// Data of a company or service; none if it has none.
template <class Key>
std::optional<Bytes> data_of(const Properties& properties, const char* name, const Key& key) {
  const auto all = value<std::map<Key, Bytes>>(properties, name);
  const auto found = all ? all->find(key) : typename std::map<Key, Bytes>::const_iterator();
  return all && found != all->end() ? std::optional(found->second) : std::nullopt;
}

std::optional<Identity> identity_of(const Properties& properties) {
  if (const auto data = data_of<std::uint16_t>(properties, "ManufacturerData", kApple)) {
    if (auto beacon = parse_ibeacon(*data)) return beacon;
  }
  const auto data = data_of<std::string>(properties, "ServiceData", kEddystone);
  return data ? parse_eddystone_uid(*data) : std::nullopt;
}

}  // namespace

std::string system_bus() {
  const char* const told = std::getenv("DBUS_SYSTEM_BUS_ADDRESS");
  return told && *told ? told : "unix:path=/run/dbus/system_bus_socket";
}

BluezScanner::BluezScanner(const std::string& bus, std::string adapter, std::chrono::milliseconds look_again)
    : wanted_(std::move(adapter)), every_(look_again), bus_(bus) {
  watch();
}

void BluezScanner::watch() {
  const std::string from = std::string("type='signal',sender='") + kBluez + "',";
  bus_.match(from + "interface='" + kPropertiesInterface + "',member='PropertiesChanged'");
  bus_.match(from + "interface='" + kManager + "',member='InterfacesAdded'");
  bus_.match(from + "interface='" + kManager + "',member='InterfacesRemoved'");
  bus_.match(std::string("type='signal',sender='") + DBUS_SERVICE_DBUS + "',member='NameOwnerChanged',arg0='" + kBluez +
             "'");
}

void BluezScanner::run(std::chrono::milliseconds at_most) {
  if (look_again_ || (radio_ != Radio::Listening && std::chrono::steady_clock::now() >= next_look_)) start_over();
  std::size_t handled = 0;
  for (Message message; handled < kMostMessages && (message = bus_.next_signal()); ++handled) on_signal(message);
  bus_.wait(handled > 0 ? std::chrono::milliseconds(0) : at_most);
}

void BluezScanner::on_signal(const Message& message) {
  const auto is = [&](const char* interface, const char* member) {
    return ::dbus_message_is_signal(message.get(), interface, member) != FALSE;
  };
  try {
    if (is(kPropertiesInterface, "PropertiesChanged")) on_properties(message);
    if (is(kManager, "InterfacesAdded")) on_added(message);
    if (is(kManager, "InterfacesRemoved")) on_removed(message);
    if (is(DBUS_INTERFACE_DBUS, "NameOwnerChanged")) on_owner(message);
  } catch (const MalformedMessage&) {  // another type than the interface has: this message alone is lost
    ++malformed_;
  }
}

void BluezScanner::set(Radio radio, std::string reason) {
  radio_ = radio;
  reason_ = std::move(reason);
}

Message BluezScanner::call(const std::string& path, const char* interface, const char* method) {
  return bus_.call(call_of(kBluez, path, interface, method));
}

void BluezScanner::start_over() {
  look_again_ = false;
  next_look_ = std::chrono::steady_clock::now() + every_;
  try {
    find_adapter();
    if (!adapter_.empty() && radio_ != Radio::Off) listen();
  } catch (const MalformedMessage&) {
    ++malformed_;
    set(Radio::Refused, "BlueZ answers as no BlueZ does");
  } catch (const BusError& error) {
    if (error.name() == DBUS_ERROR_SERVICE_UNKNOWN || error.name() == DBUS_ERROR_NAME_HAS_NO_OWNER)
      return set(Radio::NoBluez, "bluetoothd does not run");
    if (error.name() == "org.bluez.Error.NotReady") return set(Radio::Off, "the radio is switched off");
    set(Radio::Refused, std::string("BlueZ refused: ") + error.what());
  }
}

void BluezScanner::find_adapter() {
  adapter_.clear();
  devices_.clear();
  const Objects objects = Reader(call("/", kManager, "GetManagedObjects")).objects();
  for (const auto& [path, interfaces] : objects) {
    const auto found = interfaces.find(kAdapter);
    if (found == interfaces.end()) continue;
    if (!wanted_.empty() && path != "/org/bluez/" + wanted_) continue;
    adapter_ = path;
    receiver_ = lower(value<std::string>(found->second, "Address").value_or(""));
    value<bool>(found->second, "Powered").value_or(false) ? set(Radio::Refused, "not listening yet")
                                                          : set(Radio::Off, "the radio is switched off");
    break;
  }
  if (adapter_.empty()) {
    return set(Radio::NoAdapter, wanted_.empty() ? "there is no Bluetooth radio" : "there is no radio " + wanted_);
  }
  for (const auto& [path, interfaces] : objects) {
    // What BlueZ remembers is no packet: its RSSI may be of minutes ago.
    if (const auto found = interfaces.find(kDevice); found != interfaces.end()) on_device(path, found->second, false);
  }
}

void BluezScanner::listen() {
  Message filter = call_of(kBluez, adapter_, kAdapter, "SetDiscoveryFilter");
  append(filter, {{"Transport", std::string("le")}, {"DuplicateData", true}});
  bus_.call(std::move(filter));
  try {
    call(adapter_, kAdapter, "StartDiscovery");
  } catch (const BusError& error) {
    if (error.name() != "org.bluez.Error.InProgress") throw;
  }
  set(Radio::Listening, {});
}

void BluezScanner::on_owner(const Message& message) {
  Reader told(message);
  told.text();  // the name
  told.text();  // who had it
  const std::string now = told.text();
  adapter_.clear();
  devices_.clear();
  set(Radio::NoBluez, "bluetoothd does not run");
  look_again_ = !now.empty();
}

void BluezScanner::on_added(const Message& message) {
  Reader told(message);
  const std::string path = told.text();
  const Interfaces interfaces = told.interfaces();
  if (interfaces.contains(kAdapter) && adapter_.empty()) look_again_ = true;
  if (const auto found = interfaces.find(kDevice); found != interfaces.end()) on_device(path, found->second, true);
}

void BluezScanner::on_removed(const Message& message) {
  Reader told(message);
  const std::string path = told.text();
  const std::vector<std::string> interfaces = told.texts();
  if (path == adapter_ && std::find(interfaces.begin(), interfaces.end(), kAdapter) != interfaces.end()) {
    look_again_ = true;
  }
  if (std::find(interfaces.begin(), interfaces.end(), kDevice) != interfaces.end()) devices_.erase(path);
}

void BluezScanner::on_properties(const Message& message) {
  Reader told(message);
  const std::string path = ::dbus_message_get_path(message.get());
  const std::string interface = told.text();
  const Properties changed = told.properties();
  const std::vector<std::string> invalidated = told.texts();
  if (interface == kAdapter && path == adapter_) return on_adapter(changed);
  if (interface != kDevice) return;
  // The RSSI is withdrawn when discovery ends.
  if (std::find(invalidated.begin(), invalidated.end(), "RSSI") != invalidated.end()) {
    if (const auto found = devices_.find(path); found != devices_.end()) found->second.rssi_dbm.reset();
  }
  on_device(path, changed, true);
}

void BluezScanner::on_adapter(const Properties& changed) {
  const auto powered = value<bool>(changed, "Powered"), discovering = value<bool>(changed, "Discovering");
  if (powered == false) return set(Radio::Off, "the radio is switched off");
  if (powered == true) look_again_ = true;
  if (discovering == false && radio_ == Radio::Listening) {
    set(Radio::Refused, "BlueZ has ended discovery");
    look_again_ = true;
  }
}

void BluezScanner::on_device(const std::string& path, const Properties& changed, bool is_packet) {
  if (adapter_.empty() || !path.starts_with(adapter_ + "/")) return;
  auto found = devices_.find(path);
  if (found == devices_.end()) {
    if (devices_.size() >= kMostDevices) return void(++dropped_);
    // /org/bluez/hci0/dev_AA_BB_CC_DD_EE_FF
    std::string address = lower(path.substr(path.rfind('/') + 1));
    if (!address.starts_with("dev_")) return;
    address.erase(0, 4);
    std::replace(address.begin(), address.end(), '_', ':');
    found = devices_.emplace(path, Device{address, {}, {}}).first;
  }
  Device& device = found->second;
  const bool has_data = changed.contains("ManufacturerData") || changed.contains("ServiceData");
  if (const auto rssi = value<std::int16_t>(changed, "RSSI")) {
    device.rssi_dbm =
        *rssi >= -127 && *rssi <= 20 && *rssi != kNotAvailable_dbm ? std::optional<int>(*rssi) : std::nullopt;
  } else if (!has_data) {
    return;
  }
  if (has_data) {
    if (const auto beacon = identity_of(changed)) device.beacon = beacon;
  }
  if (!is_packet || !device.rssi_dbm || radio_ != Radio::Listening) return;
  if (readings_.size() >= kMostReadings) return void(++dropped_);
  readings_.push_back({device.address, device.beacon, *device.rssi_dbm, std::chrono::system_clock::now()});
}

}  // namespace fiona::beacon_server
