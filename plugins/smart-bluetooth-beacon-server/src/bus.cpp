#include "bus.hpp"

#include <functional>

namespace fiona::beacon_server {
namespace {

constexpr int kCall_ms = 5'000;
constexpr long kMostReceived = 16L << 20U;  // bytes that wait to be handled
constexpr long kLongestMessage = 4L << 20U;

/// What a call of libdbus has set, thrown.
class Fault {
 public:
  Fault() { ::dbus_error_init(&error_); }
  ~Fault() { ::dbus_error_free(&error_); }
  Fault(const Fault&) = delete;
  Fault& operator=(const Fault&) = delete;
  DBusError* operator&() { return &error_; }
  void rethrow() const {
    if (::dbus_error_is_set(&error_)) throw BusError(error_.name, error_.message);
  }

 private:
  DBusError error_{};
};

void require_type(DBusMessageIter& at, int type) {
  if (::dbus_message_iter_get_arg_type(&at) != type) throw MalformedMessage();
}

template <class T>
T basic(DBusMessageIter& at) {
  T value{};
  ::dbus_message_iter_get_basic(&at, &value);
  return value;
}

std::string text_of(DBusMessageIter& at) {
  const int type = ::dbus_message_iter_get_arg_type(&at);
  if (type != DBUS_TYPE_STRING && type != DBUS_TYPE_OBJECT_PATH) throw MalformedMessage();
  return basic<const char*>(at);
}

DBusMessageIter inside(DBusMessageIter& at, int type) {
  require_type(at, type);
  DBusMessageIter inner{};
  ::dbus_message_iter_recurse(&at, &inner);
  return inner;
}

/// Each entry of a dictionary: its key, then its value.
void each_entry(DBusMessageIter& at, const std::function<void(DBusMessageIter& key, DBusMessageIter& value)>& take) {
  require_type(at, DBUS_TYPE_ARRAY);
  if (::dbus_message_iter_get_element_type(&at) != DBUS_TYPE_DICT_ENTRY) throw MalformedMessage();
  DBusMessageIter entry = inside(at, DBUS_TYPE_ARRAY);
  for (; ::dbus_message_iter_get_arg_type(&entry) != DBUS_TYPE_INVALID; ::dbus_message_iter_next(&entry)) {
    DBusMessageIter key = inside(entry, DBUS_TYPE_DICT_ENTRY);
    DBusMessageIter value = key;
    ::dbus_message_iter_next(&value);
    take(key, value);
  }
}

Bytes bytes_of(DBusMessageIter& variant) {
  DBusMessageIter array = inside(variant, DBUS_TYPE_VARIANT);
  require_type(array, DBUS_TYPE_ARRAY);
  if (::dbus_message_iter_get_element_type(&array) != DBUS_TYPE_BYTE) throw MalformedMessage();
  DBusMessageIter elements = inside(array, DBUS_TYPE_ARRAY);
  const std::uint8_t* first = nullptr;
  int count = 0;
  ::dbus_message_iter_get_fixed_array(&elements, &first, &count);
  return count > 0 ? Bytes(first, first + count) : Bytes();
}

Value dictionary_of(DBusMessageIter& at) {
  const std::unique_ptr<char, void (*)(void*)> signature(::dbus_message_iter_get_signature(&at), &::dbus_free);
  const std::string kind = signature.get();
  if (kind == "a{qv}") {
    std::map<std::uint16_t, Bytes> all;
    each_entry(at, [&](auto& key, auto& value) { all[basic<std::uint16_t>(key)] = bytes_of(value); });
    return all;
  }
  if (kind != "a{sv}") return {};
  std::map<std::string, Bytes> all;
  each_entry(at, [&](auto& key, auto& value) { all[text_of(key)] = bytes_of(value); });
  return all;
}

Value value_of(DBusMessageIter& variant) {
  DBusMessageIter at = inside(variant, DBUS_TYPE_VARIANT);
  switch (::dbus_message_iter_get_arg_type(&at)) {
    case DBUS_TYPE_BOOLEAN: return basic<dbus_bool_t>(at) != FALSE;
    case DBUS_TYPE_INT16: return basic<std::int16_t>(at);
    case DBUS_TYPE_STRING:
    case DBUS_TYPE_OBJECT_PATH: return text_of(at);
    case DBUS_TYPE_ARRAY: return dictionary_of(at);
    default: return {};
  }
}

Properties properties_of(DBusMessageIter& at) {
  Properties all;
  each_entry(at, [&](auto& key, auto& value) { all[text_of(key)] = value_of(value); });
  return all;
}

Interfaces interfaces_of(DBusMessageIter& at) {
  Interfaces all;
  each_entry(at, [&](auto& key, auto& value) { all[text_of(key)] = properties_of(value); });
  return all;
}

}  // namespace

Reader::Reader(const Message& message) { ::dbus_message_iter_init(message.get(), &at_); }

std::string Reader::text() {
  std::string taken = text_of(at_);
  ::dbus_message_iter_next(&at_);
  return taken;
}

std::vector<std::string> Reader::texts() {
  std::vector<std::string> taken;
  DBusMessageIter element = inside(at_, DBUS_TYPE_ARRAY);
  for (; ::dbus_message_iter_get_arg_type(&element) != DBUS_TYPE_INVALID; ::dbus_message_iter_next(&element))
    taken.push_back(text_of(element));
  ::dbus_message_iter_next(&at_);
  return taken;
}

Properties Reader::properties() {
  Properties taken = properties_of(at_);
  ::dbus_message_iter_next(&at_);
  return taken;
}

Interfaces Reader::interfaces() {
  Interfaces taken = interfaces_of(at_);
  ::dbus_message_iter_next(&at_);
  return taken;
}

Objects Reader::objects() {
  Objects taken;
  each_entry(at_, [&](auto& key, auto& value) { taken[text_of(key)] = interfaces_of(value); });
  ::dbus_message_iter_next(&at_);
  return taken;
}

void Bus::Close::operator()(DBusConnection* connection) const {
  ::dbus_connection_close(connection);
  ::dbus_connection_unref(connection);
}

Bus::Bus(const std::string& address) {
  Fault fault;
  connection_.reset(::dbus_connection_open_private(address.c_str(), &fault));
  fault.rethrow();
  ::dbus_connection_set_exit_on_disconnect(connection_.get(), FALSE);
  ::dbus_connection_set_max_received_size(connection_.get(), kMostReceived);
  ::dbus_connection_set_max_message_size(connection_.get(), kLongestMessage);
  ::dbus_bus_register(connection_.get(), &fault);
  fault.rethrow();
}

void Bus::match(const std::string& rule) {
  Fault fault;
  ::dbus_bus_add_match(connection_.get(), rule.c_str(), &fault);
  fault.rethrow();
}

Message Bus::call(Message request) {
  Fault fault;
  Message reply(::dbus_connection_send_with_reply_and_block(connection_.get(), request.get(), kCall_ms, &fault));
  fault.rethrow();
  return reply;
}

void Bus::wait(std::chrono::milliseconds at_most) {
  if (!::dbus_connection_read_write(connection_.get(), static_cast<int>(at_most.count())))
    throw BusError(DBUS_ERROR_DISCONNECTED, "the bus has closed the connection");
}

Message Bus::next_signal() {
  while (Message message{::dbus_connection_pop_message(connection_.get())}) {
    const bool is_of_others = !::dbus_message_has_interface(message.get(), DBUS_INTERFACE_LOCAL);
    if (::dbus_message_get_type(message.get()) == DBUS_MESSAGE_TYPE_SIGNAL && is_of_others) return message;
  }
  return nullptr;
}

Message call_of(const std::string& destination, const std::string& path, const char* interface, const char* method) {
  return Message(::dbus_message_new_method_call(destination.c_str(), path.c_str(), interface, method));
}

void append(const Message& message, const Properties& properties) {
  DBusMessageIter at{}, dictionary{};
  ::dbus_message_iter_init_append(message.get(), &at);
  ::dbus_message_iter_open_container(&at, DBUS_TYPE_ARRAY, "{sv}", &dictionary);
  for (const auto& [name, value] : properties) {
    DBusMessageIter entry{}, variant{};
    const char* const key = name.c_str();
    ::dbus_message_iter_open_container(&dictionary, DBUS_TYPE_DICT_ENTRY, nullptr, &entry);
    ::dbus_message_iter_append_basic(&entry, DBUS_TYPE_STRING, &key);
    if (const auto* flag = std::get_if<bool>(&value)) {
      const dbus_bool_t told = *flag;
      ::dbus_message_iter_open_container(&entry, DBUS_TYPE_VARIANT, DBUS_TYPE_BOOLEAN_AS_STRING, &variant);
      ::dbus_message_iter_append_basic(&variant, DBUS_TYPE_BOOLEAN, &told);
    } else {
      const char* const told = std::get<std::string>(value).c_str();
      ::dbus_message_iter_open_container(&entry, DBUS_TYPE_VARIANT, DBUS_TYPE_STRING_AS_STRING, &variant);
      ::dbus_message_iter_append_basic(&variant, DBUS_TYPE_STRING, &told);
    }
    ::dbus_message_iter_close_container(&entry, &variant);
    ::dbus_message_iter_close_container(&dictionary, &entry);
  }
  ::dbus_message_iter_close_container(&at, &dictionary);
}

}  // namespace fiona::beacon_server
