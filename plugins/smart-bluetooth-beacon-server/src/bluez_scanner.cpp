#include "bluez_scanner.hpp"

#include <poll.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>

namespace fiona::beacon_server {
namespace {

constexpr const char* kBluez = "org.bluez";
constexpr const char* kAdapter = "org.bluez.Adapter1";
constexpr const char* kDevice = "org.bluez.Device1";
constexpr const char* kManager = "org.freedesktop.DBus.ObjectManager";
constexpr const char* kPropertiesInterface = "org.freedesktop.DBus.Properties";
constexpr std::uint64_t kCall_us = 5'000'000;
constexpr std::chrono::seconds kLookAgain{2};  // for what has no signal, such as a refusal
constexpr int kNotAvailable_dbm = 127;
constexpr std::size_t kMostMessages = 1000;  // handled in one run, so that a storm does not hold up who calls it

std::string lower(std::string text) {
  for (char& c : text) c = c >= 'A' && c <= 'Z' ? static_cast<char>(c - 'A' + 'a') : c;
  return text;
}

/// Whether a unix socket has a listener; `name` begins with a zero if it is an abstract one.
int connect_to(const std::string& name) {
  sockaddr_un address{};
  if (name.size() >= sizeof address.sun_path) return ENAMETOOLONG;
  address.sun_family = AF_UNIX;
  std::memcpy(address.sun_path, name.data(), name.size());
  const int socket = ::socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0);
  if (socket < 0) return errno;
  const auto length = static_cast<socklen_t>(offsetof(sockaddr_un, sun_path) + name.size());
  const int fault = ::connect(socket, reinterpret_cast<const sockaddr*>(&address), length) == 0 ? 0 : errno;
  ::close(socket);
  return fault == EAGAIN ? 0 : fault;  // somebody listens, and is busy
}

/// sdbus-c++ 1.2 loses 1.8 KB with each connection that cannot be opened: a bus that is not there is not asked for one.
/// Looks at the plain form of an address (D-Bus specification, "Server Addresses"); any other is left to the library.
void require_listener(const std::string& bus) {
  constexpr std::string_view kPath = "unix:path=", kAbstract = "unix:abstract=";
  const bool by_path = bus.starts_with(kPath);
  if ((!by_path && !bus.starts_with(kAbstract)) || bus.find_first_of(";%") != std::string::npos) return;
  const std::size_t begin = by_path ? kPath.size() : kAbstract.size();
  const std::string name = bus.substr(begin, std::min(bus.find(','), bus.size()) - begin);
  if (const int fault = connect_to(by_path ? name : std::string(1, '\0') + name)) {
    throw sdbus::Error("org.freedesktop.DBus.Error.NoServer", std::strerror(fault));
  }
}

std::unique_ptr<sdbus::IConnection> connect(const std::string& bus) {
  require_listener(bus);
  return sdbus::createSessionBusConnectionWithAddress(bus);
}

template <class T>
std::optional<T> value(const std::map<std::string, sdbus::Variant>& properties, const char* name) {
  const auto found = properties.find(name);
  return found == properties.end() ? std::nullopt : std::optional(found->second.get<T>());
}

/// Data of a company or service out of a dictionary of variants; nothing if it has none.
template <class Key>
std::optional<std::vector<std::uint8_t>> data_of(const sdbus::Variant& dictionary, const Key& key) {
  const auto all = dictionary.get<std::map<Key, sdbus::Variant>>();
  const auto found = all.find(key);
  return found == all.end() ? std::nullopt : std::optional(found->second.template get<std::vector<std::uint8_t>>());
}

std::optional<Identity> identity_of(const std::map<std::string, sdbus::Variant>& properties) {
  if (const auto found = properties.find("ManufacturerData"); found != properties.end()) {
    if (const auto data = data_of<std::uint16_t>(found->second, kApple)) {
      if (auto beacon = parse_ibeacon(*data)) return beacon;
    }
  }
  if (const auto found = properties.find("ServiceData"); found != properties.end()) {
    if (const auto data = data_of<std::string>(found->second, kEddystone)) return parse_eddystone_uid(*data);
  }
  return std::nullopt;
}

}  // namespace

BluezScanner::BluezScanner(const std::string& bus, std::string adapter)
    : wanted_(std::move(adapter)), connection_(connect(bus)) {
  watch();
}

BluezScanner::~BluezScanner() = default;

template <class F>
sdbus::message_handler BluezScanner::guarded(F handle) {
  return [this, handle](sdbus::Message& message) {
    try {
      (this->*handle)(message);
    } catch (const sdbus::Error&) {  // another type than the interface has: this message alone is lost
      ++malformed_;
    }
  };
}

void BluezScanner::watch() {
  const std::string from = std::string("type='signal',sender='") + kBluez + "',";
  connection_->addMatch(from + "interface='" + kPropertiesInterface + "',member='PropertiesChanged'",
                        guarded(&BluezScanner::on_properties), sdbus::floating_slot);
  connection_->addMatch(from + "interface='" + kManager + "',member='InterfacesAdded'",
                        guarded(&BluezScanner::on_added), sdbus::floating_slot);
  connection_->addMatch(from + "interface='" + kManager + "',member='InterfacesRemoved'",
                        guarded(&BluezScanner::on_removed), sdbus::floating_slot);
  connection_->addMatch(
      std::string("type='signal',sender='org.freedesktop.DBus',member='NameOwnerChanged',arg0='") + kBluez + "'",
      guarded(&BluezScanner::on_owner), sdbus::floating_slot);
}

void BluezScanner::run(std::chrono::milliseconds at_most) {
  if (look_again_ || (radio_ != Radio::Listening && std::chrono::steady_clock::now() >= next_look_)) start_over();
  std::size_t handled = 0;
  while (handled < kMostMessages && connection_->processPendingRequest()) ++handled;
  if (handled > 0) return;
  const auto wanted = connection_->getEventLoopPollData();
  pollfd bus{wanted.fd, wanted.events, 0};
  ::poll(&bus, 1, static_cast<int>(at_most.count()));
}

void BluezScanner::set(Radio radio, std::string reason) {
  radio_ = radio;
  reason_ = std::move(reason);
}

sdbus::MethodReply BluezScanner::call(const std::string& path, const char* interface, const char* method,
                                      const std::function<void(sdbus::MethodCall&)>& fill) {
  const auto proxy = sdbus::createProxy(*connection_, kBluez, path);
  auto message = proxy->createMethodCall(interface, method);
  if (fill) fill(message);
  return proxy->callMethod(message, kCall_us);
}

void BluezScanner::start_over() {
  look_again_ = false;
  next_look_ = std::chrono::steady_clock::now() + kLookAgain;
  try {
    find_adapter();
    if (!adapter_.empty() && radio_ != Radio::Off) listen();
  } catch (const sdbus::Error& error) {
    const bool nobody = error.getName() == "org.freedesktop.DBus.Error.ServiceUnknown" ||
                        error.getName() == "org.freedesktop.DBus.Error.NameHasNoOwner";
    if (nobody) return set(Radio::NoBluez, "bluetoothd does not run");
    if (error.getName() == "org.bluez.Error.NotReady") return set(Radio::Off, "the radio is switched off");
    set(Radio::Refused, "BlueZ refused: " + error.getMessage());
  }
}

void BluezScanner::find_adapter() {
  adapter_.clear();
  devices_.clear();
  std::map<sdbus::ObjectPath, Interfaces> objects;
  auto reply = call("/", kManager, "GetManagedObjects");
  reply >> objects;
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
  call(adapter_, kAdapter, "SetDiscoveryFilter", [](sdbus::MethodCall& message) {
    message << Properties{{"Transport", sdbus::Variant(std::string("le"))}, {"DuplicateData", sdbus::Variant(true)}};
  });
  try {
    call(adapter_, kAdapter, "StartDiscovery");
  } catch (const sdbus::Error& error) {
    if (error.getName() != "org.bluez.Error.InProgress") throw;
  }
  set(Radio::Listening, {});
}

void BluezScanner::on_owner(sdbus::Message& message) {
  std::string name, before, now;
  message >> name >> before >> now;
  adapter_.clear();
  devices_.clear();
  set(Radio::NoBluez, "bluetoothd does not run");
  look_again_ = !now.empty();
}

void BluezScanner::on_added(sdbus::Message& message) {
  sdbus::ObjectPath path;
  Interfaces interfaces;
  message >> path >> interfaces;
  if (interfaces.contains(kAdapter) && adapter_.empty()) look_again_ = true;
  if (const auto found = interfaces.find(kDevice); found != interfaces.end()) on_device(path, found->second, true);
}

void BluezScanner::on_removed(sdbus::Message& message) {
  sdbus::ObjectPath path;
  std::vector<std::string> interfaces;
  message >> path >> interfaces;
  if (path == adapter_ && std::find(interfaces.begin(), interfaces.end(), kAdapter) != interfaces.end()) {
    look_again_ = true;
  }
  if (std::find(interfaces.begin(), interfaces.end(), kDevice) != interfaces.end()) devices_.erase(path);
}

void BluezScanner::on_properties(sdbus::Message& message) {
  std::string interface;
  Properties changed;
  std::vector<std::string> invalidated;
  message >> interface >> changed >> invalidated;
  if (interface == kAdapter && message.getPath() == adapter_) return on_adapter(changed);
  if (interface != kDevice) return;
  // The RSSI is withdrawn when discovery ends.
  if (std::find(invalidated.begin(), invalidated.end(), "RSSI") != invalidated.end()) {
    if (const auto found = devices_.find(message.getPath()); found != devices_.end()) found->second.rssi_dbm.reset();
  }
  on_device(message.getPath(), changed, true);
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
