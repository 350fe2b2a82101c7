#pragma once

#include <chrono>
#include <cstdint>
#include <map>
#include <memory>
#include <stdexcept>
#include <string>
#include <variant>
#include <vector>

#include <dbus/dbus.h>

namespace fiona::beacon_server {

using Bytes = std::vector<std::uint8_t>;
/// A property of an object on D-Bus, of the types that BlueZ's have that matter here: b, n, s or o, a{qv} and a{sv} of
/// bytes. std::monostate: another type.
using Value = std::variant<std::monostate, bool, std::int16_t, std::string, std::map<std::uint16_t, Bytes>,
                           std::map<std::string, Bytes>>;
using Properties = std::map<std::string, Value>;
using Interfaces = std::map<std::string, Properties>;
using Objects = std::map<std::string, Interfaces>;

/// What the bus, or who is called on it, has refused.
class BusError : public std::runtime_error {
 public:
  BusError(std::string name, const std::string& message) : std::runtime_error(message), name_(std::move(name)) {}
  const std::string& name() const { return name_; }  ///< "org.bluez.Error.NotReady"

 private:
  std::string name_;
};

/// A message whose types are not those that were expected.
class MalformedMessage : public std::runtime_error {
 public:
  MalformedMessage() : std::runtime_error("a message of other types") {}
};

struct Unref {
  void operator()(DBusMessage* message) const { ::dbus_message_unref(message); }
};
using Message = std::unique_ptr<DBusMessage, Unref>;

/// Takes what a message holds, one argument after the other. Throws MalformedMessage where it is of another type.
class Reader {
 public:
  explicit Reader(const Message& message);
  std::string text();  ///< s or o
  std::vector<std::string> texts();
  Properties properties();  ///< a{sv}
  Interfaces interfaces();  ///< a{sa{sv}}
  Objects objects();        ///< a{oa{sa{sv}}}

 private:
  DBusMessageIter at_{};
};

/// A connection to a bus. libdbus waits for each answer of the handshake, as xdg-dbus-proxy(1) of Debian 12 demands, by
/// which a sandbox is let through to a bus; sd-bus does not (https://github.com/flatpak/xdg-dbus-proxy/issues/21). One
/// thread.
class Bus {
 public:
  /// Throws BusError if nobody is there.
  explicit Bus(const std::string& address);

  /// From now on signals come that match the rule (D-Bus specification, "Match Rules"). Throws BusError.
  void match(const std::string& rule);
  /// Throws BusError: what was answered, or that nobody did.
  Message call(Message request);
  /// Throws BusError once the bus is gone.
  void wait(std::chrono::milliseconds at_most);
  /// The signal that has come next; null: none.
  Message next_signal();

 private:
  struct Close {
    void operator()(DBusConnection* connection) const;
  };
  std::unique_ptr<DBusConnection, Close> connection_;
};

Message call_of(const std::string& destination, const std::string& path, const char* interface, const char* method);
/// Appends a{sv}. Of the types of Value it takes bool and std::string.
void append(const Message& message, const Properties& properties);

}  // namespace fiona::beacon_server
