#include "fiona/trust/host_keys.hpp"

#include <fcntl.h>
#include <sodium/crypto_box.h>
#include <sodium/crypto_scalarmult.h>
#include <sodium/utils.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <sstream>

#include "fiona/error.hpp"

namespace fiona::trust {
namespace {

constexpr std::string_view kPairHead = "fiona-host-key 1 ";
constexpr std::size_t kMaxAllowed = 1000;  ///< hosts in the list

std::filesystem::path default_directory() {
  const auto variable = [](const char* name) {
    const char* value = std::getenv(name);
    return std::string(value ? value : "");
  };
  if (!variable("FIONA_KEYS").empty()) return variable("FIONA_KEYS");
  if (!variable("XDG_CONFIG_HOME").empty()) return std::filesystem::path(variable("XDG_CONFIG_HOME")) / "fiona";
  if (!variable("HOME").empty()) return std::filesystem::path(variable("HOME")) / ".config" / "fiona";
  throw Error(ErrorCode::Failed, {.what = "there is no place for keys: the user has no home", .next = "set FIONA_KEYS to a directory of yours"});
}

[[noreturn]] void fail(std::string what, const std::filesystem::path& file) {
  const int code = errno;
  throw Error(ErrorCode::Failed, {.what = std::move(what), .where = file.string(), .found = std::strerror(code)});
}

/// Writes a file that did not exist, and brings it to the disk.
void write_new(const std::filesystem::path& file, const std::string& text) {
  const int descriptor = ::open(file.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC | O_NOFOLLOW, 0600);
  if (descriptor < 0) fail("the file cannot be made", file);
  const bool written = ::write(descriptor, text.data(), text.size()) == static_cast<ssize_t>(text.size()) && ::fsync(descriptor) == 0;
  ::close(descriptor);
  if (written) return;
  ::unlink(file.c_str());
  fail("the file cannot be written", file);
}

void sync_directory(const std::filesystem::path& directory) {
  const int descriptor = ::open(directory.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  if (descriptor < 0) return;
  ::fsync(descriptor);
  ::close(descriptor);
}

bool is_host_name(const std::string& name) {
  const auto fits = [](char c) { return std::isalnum(static_cast<unsigned char>(c)) || c == '-' || c == '_'; };
  return !name.empty() && name.size() <= 40 && std::all_of(name.begin(), name.end(), fits);
}

Key open_of(const Key& secret) {
  unsigned char open[Key::kBytes];
  crypto_scalarmult_base(open, reinterpret_cast<const unsigned char*>(secret.bytes().data()));
  return *Key::from_bytes({reinterpret_cast<const char*>(open), sizeof open});
}

}  // namespace

std::optional<Key> Key::from_text(std::string_view text) {
  Key key;
  std::size_t size = 0;
  const char* end = nullptr;
  const int bad = sodium_hex2bin(reinterpret_cast<unsigned char*>(key.bytes_.data()), kBytes, text.data(), text.size(), nullptr, &size, &end);
  if (bad != 0 || size != kBytes || text.size() != 2 * kBytes || end != text.data() + text.size()) return std::nullopt;
  return key;
}

std::optional<Key> Key::from_bytes(std::string_view bytes) {
  if (bytes.size() != kBytes) return std::nullopt;
  Key key;
  std::copy(bytes.begin(), bytes.end(), key.bytes_.begin());
  return key;
}

std::string Key::text() const {
  char text[2 * kBytes + 1];
  sodium_bin2hex(text, sizeof text, reinterpret_cast<const unsigned char*>(bytes_.data()), kBytes);
  return text;
}

KeyDirectory::KeyDirectory(std::filesystem::path directory)
    : directory_(directory.empty() ? default_directory() : std::move(directory)) {}

bool KeyDirectory::has_pair() const { return std::filesystem::exists(pair_file()); }

KeyPair KeyDirectory::make() const {
  if (has_pair()) {
    throw Error(ErrorCode::NotAllowed, {.what = "there is a key pair already, and other hosts may know this one by it",
                                        .where = pair_file().string(),
                                        .next = "fiona keys show; to give it up, remove the file"});
  }
  std::error_code ignored;
  std::filesystem::create_directories(directory_.parent_path(), ignored);
  if (::mkdir(directory_.c_str(), 0700) != 0 && errno != EEXIST) fail("the directory for keys cannot be made", directory_);
  unsigned char open[Key::kBytes];
  unsigned char secret[Key::kBytes];
  crypto_box_keypair(open, secret);
  const KeyPair pair{*Key::from_bytes({reinterpret_cast<const char*>(secret), sizeof secret}),
                     *Key::from_bytes({reinterpret_cast<const char*>(open), sizeof open})};
  sodium_memzero(secret, sizeof secret);
  write_new(pair_file(), std::string(kPairHead) + pair.secret.text() + "\n");
  sync_directory(directory_);
  return pair;
}

KeyPair KeyDirectory::pair() const {
  struct stat status {};
  if (::lstat(pair_file().c_str(), &status) != 0) {
    if (errno != ENOENT) fail("the key pair cannot be read", pair_file());
    throw Error(ErrorCode::NotFound, {.what = "tcp needs keys, and this user has none", .where = pair_file().string(), .next = "fiona keys make"});
  }
  if (!S_ISREG(status.st_mode) || status.st_uid != ::geteuid() || (status.st_mode & 077) != 0) {
    throw Error(ErrorCode::NotAllowed, {.what = "the secret key is not private to this user",
                                        .where = pair_file().string(),
                                        .expected = "a file of this user with mode 0600",
                                        .next = "chmod 600 it, or remove it and: fiona keys make"});
  }
  std::ifstream file(pair_file());
  std::string line;
  std::getline(file, line);
  const auto secret = line.starts_with(kPairHead) ? Key::from_text(line.substr(kPairHead.size())) : std::nullopt;
  if (!secret) {
    throw Error(ErrorCode::Failed, {.what = "the key pair is damaged",
                                    .where = pair_file().string(),
                                    .expected = std::string(kPairHead) + "and 64 hexadecimal digits",
                                    .next = "bring it back from a copy, or remove it and: fiona keys make"});
  }
  return {*secret, open_of(*secret)};
}

std::vector<AllowedHost> KeyDirectory::allowed() const {
  std::vector<AllowedHost> hosts;
  if (!std::filesystem::exists(allowed_file())) return hosts;
  std::ifstream file(allowed_file());
  if (!file) fail("the list of hosts that may connect cannot be read", allowed_file());
  std::size_t number = 0;
  for (std::string line; std::getline(file, line);) {
    ++number;
    if (line.empty() || line.starts_with('#')) continue;
    std::istringstream words(line);
    std::string name;
    std::string key;
    std::string more;
    words >> name >> key;
    const auto parsed = Key::from_text(key);
    if (!is_host_name(name) || !parsed || words >> more || hosts.size() >= kMaxAllowed) {
      throw Error(ErrorCode::Failed, {.what = "the list of hosts that may connect is damaged: nobody may until it is mended",
                                      .where = allowed_file().string() + ":" + std::to_string(number),
                                      .expected = "NAME and a key of 64 hexadecimal digits, at most " + std::to_string(kMaxAllowed) + " lines",
                                      .next = "mend the line, or remove it"});
    }
    hosts.push_back({name, *parsed});
  }
  return hosts;
}

void KeyDirectory::replace(const std::filesystem::path& file, const std::string& text) const {
  std::error_code ignored;
  std::filesystem::create_directories(directory_.parent_path(), ignored);
  if (::mkdir(directory_.c_str(), 0700) != 0 && errno != EEXIST) fail("the directory for keys cannot be made", directory_);
  const std::filesystem::path beside = file.string() + "." + std::to_string(::getpid());
  write_new(beside, text);
  if (::rename(beside.c_str(), file.c_str()) != 0) {
    ::unlink(beside.c_str());
    fail("the list of hosts that may connect cannot be replaced", file);
  }
  sync_directory(directory_);
}

namespace {

std::string text_of(const std::vector<AllowedHost>& hosts) {
  std::string text = "# Hosts that may connect to hosts of this user: NAME KEY. Changed by: fiona keys allow, fiona keys forget\n";
  for (const auto& host : hosts) text += host.name + " " + host.key.text() + "\n";
  return text;
}

}  // namespace

void KeyDirectory::allow(const std::string& name, const std::string& text) const {
  if (!is_host_name(name)) {
    throw Error(ErrorCode::Usage, {.what = "'" + name + "' is no name of a host", .expected = "letters, digits, '-' and '_', at most 40"});
  }
  const auto key = Key::from_text(text);
  if (!key) {
    throw Error(ErrorCode::Usage, {.what = "this is no key of a host",
                                   .expected = "64 hexadecimal digits",
                                   .found = text.substr(0, 80),
                                   .next = "on the other host: fiona keys show"});
  }
  auto hosts = allowed();
  for (const auto& host : hosts) {
    if (host.name != name && host.key != *key) continue;
    throw Error(ErrorCode::NotAllowed, {.what = host.name == name ? "there is a host '" + name + "' in the list already"
                                                                  : "the key is in the list already, as '" + host.name + "'",
                                        .found = host.name + " " + host.key.text(),
                                        .next = "fiona keys forget " + host.name});
  }
  hosts.push_back({name, *key});
  replace(allowed_file(), text_of(hosts));
}

void KeyDirectory::forget(const std::string& name) const {
  auto hosts = allowed();
  std::vector<std::string> names;
  for (const auto& host : hosts) names.push_back(host.name);
  if (std::erase_if(hosts, [&name](const auto& host) { return host.name == name; }) == 0) {
    throw Error(ErrorCode::NotFound, {.what = "no host '" + name + "' may connect", .next = "fiona keys", .near = nearest_names(name, names)});
  }
  replace(allowed_file(), text_of(hosts));
}

}  // namespace fiona::trust
