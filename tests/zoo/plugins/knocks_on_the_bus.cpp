#include <dbus/dbus.h>
#include <dirent.h>
#include <stdlib.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <functional>
#include <set>
#include <stdexcept>
#include <string>
#include <vector>

#include "animal.hpp"

// May talk to org.fiona.zoo.Open on D-Bus, and tries to reach whom else there is: org.fiona.zoo.Closed above all.
// Throws what worked, and what it was let do of what it may.
namespace {

using namespace std::chrono_literals;

constexpr const char* kOpen = "org.fiona.zoo.Open";
constexpr const char* kClosed = "org.fiona.zoo.Closed";

class Caller {
 public:
  explicit Caller(const std::string& address) : connection_(::dbus_connection_open_private(address.c_str(), nullptr)) {
    if (!connection_) return;
    ::dbus_connection_set_exit_on_disconnect(connection_, FALSE);
    ::dbus_bus_register(connection_, nullptr);
  }
  ~Caller() {
    if (!connection_) return;
    ::dbus_connection_close(connection_);
    ::dbus_connection_unref(connection_);
  }

  /// The answer; null: there is none, or a refusal.
  DBusMessage* call(const char* whom, const char* interface, const char* method, int first = DBUS_TYPE_INVALID, ...) {
    if (!connection_) return nullptr;
    const bool is_bus = std::string(whom) == DBUS_SERVICE_DBUS;
    DBusMessage* const request = ::dbus_message_new_method_call(whom, is_bus ? DBUS_PATH_DBUS : "/", interface, method);
    va_list arguments;
    va_start(arguments, first);
    ::dbus_message_append_args_valist(request, first, arguments);
    va_end(arguments);
    DBusMessage* const answer = ::dbus_connection_send_with_reply_and_block(connection_, request, 500, nullptr);
    ::dbus_message_unref(request);
    return answer;
  }
  std::string ask(const char* whom) {
    const char* text = "";
    DBusMessage* const answer = call(whom, "org.fiona.Zoo", "Ask");
    if (answer) ::dbus_message_get_args(answer, nullptr, DBUS_TYPE_STRING, &text, DBUS_TYPE_INVALID);
    return text;
  }
  /// Of a call of the bus itself with a name, and a number if it takes one.
  std::uint32_t number_of(const char* method, const char* name, int flags = -1) {
    std::uint32_t number = 0;
    const std::uint32_t sent = static_cast<std::uint32_t>(flags);
    DBusMessage* const answer =
        flags < 0 ? call(DBUS_SERVICE_DBUS, DBUS_INTERFACE_DBUS, method, DBUS_TYPE_STRING, &name, DBUS_TYPE_INVALID)
                  : call(DBUS_SERVICE_DBUS, DBUS_INTERFACE_DBUS, method, DBUS_TYPE_STRING, &name, DBUS_TYPE_UINT32,
                         &sent, DBUS_TYPE_INVALID);
    if (answer && !::dbus_message_get_args(answer, nullptr, DBUS_TYPE_UINT32, &number, DBUS_TYPE_INVALID))
      ::dbus_message_get_args(answer, nullptr, DBUS_TYPE_BOOLEAN, &number, DBUS_TYPE_INVALID);
    return number;
  }
  bool lists(const char* name) {
    char** names = nullptr;
    int count = 0;
    DBusMessage* const answer = call(DBUS_SERVICE_DBUS, DBUS_INTERFACE_DBUS, "ListNames");
    if (answer)
      ::dbus_message_get_args(answer, nullptr, DBUS_TYPE_ARRAY, DBUS_TYPE_STRING, &names, &count, DBUS_TYPE_INVALID);
    return std::count(names, names + count, std::string(name)) > 0;
  }
  /// What is heard within a while.
  std::set<std::string> heard(const char* match) {
    std::set<std::string> all;
    if (!connection_) return all;
    ::dbus_bus_add_match(connection_, match, nullptr);
    for (const auto end = std::chrono::steady_clock::now() + 300ms; std::chrono::steady_clock::now() < end;) {
      ::dbus_connection_read_write(connection_, 5);
      while (DBusMessage* const message = ::dbus_connection_pop_message(connection_)) {
        const char* text = "";
        if (::dbus_message_get_type(message) == DBUS_MESSAGE_TYPE_SIGNAL)
          ::dbus_message_get_args(message, nullptr, DBUS_TYPE_STRING, &text, DBUS_TYPE_INVALID);
        all.insert(text);
        ::dbus_message_unref(message);
      }
    }
    return all;
  }

 private:
  DBusConnection* const connection_;
};

bool connects(const std::string& path) {
  sockaddr_un address{};
  address.sun_family = AF_UNIX;
  path.copy(address.sun_path, sizeof address.sun_path - 1);
  const int made = ::socket(AF_UNIX, SOCK_STREAM, 0);
  const bool connected = ::connect(made, reinterpret_cast<const sockaddr*>(&address), sizeof address) == 0;
  ::close(made);
  return connected;
}

std::size_t entries_of(const std::string& folder) {
  DIR* const opened = ::opendir(folder.c_str());
  std::size_t count = 0;
  while (opened && ::readdir(opened)) ++count;
  if (opened) ::closedir(opened);
  return count - std::min<std::size_t>(count, 2);
}

struct Try {
  const char* name;
  std::function<bool(Caller&)> works;
};

std::vector<Try> knocks(const std::string& socket) {
  return {
      {"a call", [](Caller& bus) { return bus.ask(kClosed) == "closed"; }},
      {"a call by number",
       [](Caller& bus) {
         for (int number = 0; number < 20; ++number) {
           if (bus.ask((":1." + std::to_string(number)).c_str()) == "closed") return true;
         }
         return false;
       }},
      {"names", [](Caller& bus) { return bus.lists(kClosed); }},
      {"an owner",
       [](Caller& bus) {
         return bus.call(DBUS_SERVICE_DBUS, DBUS_INTERFACE_DBUS, "GetNameOwner", DBUS_TYPE_STRING, &kClosed,
                         DBUS_TYPE_INVALID) != nullptr;
       }},
      {"is there an owner", [](Caller& bus) { return bus.number_of("NameHasOwner", kClosed) != 0; }},
      {"a process", [](Caller& bus) { return bus.number_of("GetConnectionUnixProcessID", kClosed) != 0; }},
      {"a name of its own", [](Caller& bus) { return bus.number_of("RequestName", "org.fiona.zoo.Mine", 0) == 1; }},
      {"the open one's name", [](Caller& bus) { return bus.number_of("RequestName", kOpen, 2) != 0; }},
      {"starting a service", [](Caller& bus) { return bus.number_of("StartServiceByName", kClosed, 0) != 0; }},
      {"signals", [](Caller& bus) { return bus.heard("type='signal',interface='org.fiona.Zoo'").contains("closed"); }},
      {"overhearing",
       [](Caller& bus) { return bus.heard("eavesdrop='true',interface='org.fiona.Zoo'").contains("closed"); }},
      {"a monitor",
       [](Caller& bus) {
         const char* const* const none = nullptr;
         const std::uint32_t flags = 0;
         return bus.call(DBUS_SERVICE_DBUS, "org.freedesktop.DBus.Monitoring", "BecomeMonitor", DBUS_TYPE_ARRAY,
                         DBUS_TYPE_STRING, &none, 0, DBUS_TYPE_UINT32, &flags, DBUS_TYPE_INVALID) != nullptr;
       }},
      {"the bus itself",
       [](Caller&) { return connects("/var/tmp/fiona-zoo-" + std::to_string(::getppid()) + ".bus"); }},
      {"the machine's bus", [](Caller&) { return connects("/run/dbus/system_bus_socket"); }},
      {"other groups' ways", [=](Caller&) {
         const auto folder = socket.substr(0, socket.rfind('/'));
         return entries_of(folder.substr(0, folder.rfind('/'))) > 1;
       }}};
}

}  // namespace

void zoo::act() {
  std::string found;
  std::size_t works = 0, tried = 0;
  for (const char* variable : {"DBUS_SYSTEM_BUS_ADDRESS", "DBUS_SESSION_BUS_ADDRESS"}) {
    const char* const told = ::getenv(variable);
    if (!told) continue;
    const std::string address = told;
    Caller may(address);
    found += std::string("; ") + variable + ": it says " + may.ask(kOpen) + ", and " +
             (may.heard("type='signal',interface='org.fiona.Zoo'").contains("open") ? "is heard" : "is silent");
    for (const Try& one : knocks(address.substr(address.find('/')))) {
      ++tried;
      Caller bus(address);  // each has one of its own: who is refused may be thrown out
      if (!one.works(bus)) continue;
      ++works;
      found += std::string(", ") + one.name;
    }
  }
  throw std::runtime_error(std::to_string(works) + " of " + std::to_string(tried) + " knocks" + found);
}
