#include "fiona/trust/host_keys.hpp"

#include <fcntl.h>
#include <sodium/crypto_box.h>
#include <sodium/crypto_scalarmult.h>
#include <sodium/utils.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <chrono>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <sstream>
#include <thread>

#include "fiona/error.hpp"

namespace fiona::trust {
namespace {

constexpr std::string_view kPairHead = "fiona-host-key 1 ";
constexpr std::size_t kMaxEntries = 1000;  ///< of a list

std::filesystem::path default_directory() {
  const auto variable = [](const char* name) {
    const char* value = std::getenv(name);
    return std::string(value ? value : "");
  };
  if (!variable("FIONA_KEYS").empty()) return variable("FIONA_KEYS");
  if (!variable("XDG_CONFIG_HOME").empty()) return std::filesystem::path(variable("XDG_CONFIG_HOME")) / "fiona";
  if (!variable("HOME").empty()) return std::filesystem::path(variable("HOME")) / ".config" / "fiona";
  throw Error(ErrorCode::Failed, {.what = "there is no place for keys: the user has no home",
                                  .next = "set FIONA_KEYS to a directory of yours"});
}

[[noreturn]] void fail(std::string what, const std::filesystem::path& file) {
  const int code = errno;
  throw Error(ErrorCode::Failed, {.what = std::move(what),
                                  .where = file.string(),
                                  .found = std::strerror(code),
                                  .next = "see who owns it and what it allows: ls -la " + file.parent_path().string()});
}

/// Writes a file that did not exist, and brings it to the disk.
void write_new(const std::filesystem::path& file, const std::string& text) {
  const int descriptor = ::open(file.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC | O_NOFOLLOW, 0600);
  if (descriptor < 0) fail("the file cannot be made", file);
  const bool written =
      ::write(descriptor, text.data(), text.size()) == static_cast<ssize_t>(text.size()) && ::fsync(descriptor) == 0;
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

bool is_address(const std::string& text) {
  const std::size_t colon = text.rfind(':');
  const auto digit = [](char c) { return c >= '0' && c <= '9'; };
  const bool port = colon != std::string::npos && colon > 0 && colon + 1 < text.size() && text.size() - colon <= 6 &&
                    std::all_of(text.begin() + static_cast<std::ptrdiff_t>(colon) + 1, text.end(), digit);
  return port && text.size() <= 300 &&
         std::all_of(text.begin(), text.end(), [](char c) { return c > ' ' && c < '\x7f' && c != '='; });
}

std::optional<Key> Key::from_text(std::string_view text) {
  Key key;
  std::size_t size = 0;
  const char* end = nullptr;
  const int bad = sodium_hex2bin(reinterpret_cast<unsigned char*>(key.bytes_.data()), kBytes, text.data(), text.size(),
                                 nullptr, &size, &end);
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
  if (::mkdir(directory_.c_str(), 0700) != 0 && errno != EEXIST)
    fail("the directory for keys cannot be made", directory_);
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
    throw Error(
        ErrorCode::NotFound,
        {.what = "tcp needs keys, and this user has none", .where = pair_file().string(), .next = "fiona keys make"});
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

void KeyDirectory::make_directory() const {
  std::error_code ignored;
  std::filesystem::create_directories(directory_.parent_path(), ignored);
  if (::mkdir(directory_.c_str(), 0700) != 0 && errno != EEXIST)
    fail("the directory for keys cannot be made", directory_);
}

void KeyDirectory::replace(const std::filesystem::path& file, const std::string& text) const {
  make_directory();
  const std::filesystem::path beside = file.string() + "." + std::to_string(::getpid());
  write_new(beside, text);
  if (::rename(beside.c_str(), file.c_str()) != 0) {
    ::unlink(beside.c_str());
    fail("the list cannot be replaced", file);
  }
  sync_directory(directory_);
}

namespace {

/// Who changes a list has it for itself, from reading it on: nobody's change is lost, a key that is forgotten least of
/// all. Throws Error Unreachable where another one has it for longer than a change takes.
class Changing {
 public:
  explicit Changing(const std::filesystem::path& directory)
      : directory_(::open(directory.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC)) {
    constexpr auto kMost = std::chrono::seconds(5);
    constexpr auto kAgain = std::chrono::milliseconds(10);
    if (directory_ < 0) fail("the directory for keys cannot be opened", directory);
    const auto end = std::chrono::steady_clock::now() + kMost;
    while (::flock(directory_, LOCK_EX | LOCK_NB) != 0) {
      if (std::chrono::steady_clock::now() >= end) {
        ::close(directory_);
        throw Error(
            ErrorCode::Unreachable,
            {.what = "somebody else is changing the lists of keys", .where = directory.string(), .next = "try again"});
      }
      std::this_thread::sleep_for(kAgain);
    }
  }
  ~Changing() { ::close(directory_); }
  Changing(const Changing&) = delete;
  Changing& operator=(const Changing&) = delete;

 private:
  const int directory_;
};

using Words = std::vector<std::string>;

/// A file of lines that begin with a name; one of their words is a key.
struct List {
  const char* file;
  const char* head;    ///< its first line, for people
  const char* what;    ///< it is a list of
  const char* damage;  ///< what follows if it cannot be read
  const char* line;    ///< what each line has
  std::size_t words;
  std::size_t key;  ///< the word that is one
};
constexpr List kHosts{
    "hosts.allowed",
    "Hosts that may connect to hosts of this user: NAME KEY. Changed by: fiona keys allow, fiona keys forget",
    "hosts that may connect",
    "nobody may until it is mended",
    "NAME and a key of 64 hexadecimal digits",
    2,
    1};
constexpr List kConsoles{"consoles.allowed",
                         "Consoles that may connect to hosts of this user: NAME KEY LEVEL. Changed by: fiona keys "
                         "allow … as, fiona keys forget",
                         "consoles that may connect",
                         "none may until it is mended",
                         "NAME, a key of 64 hexadecimal digits, and observe, operate, compose or administer",
                         3,
                         1};
constexpr List kKnown{"hosts.known",
                      "Hosts on other machines: NAME ADDRESS:PORT KEY. Changed by: fiona keys know, fiona keys forget",
                      "known hosts",
                      "none is known until it is mended",
                      "NAME, ADDRESS:PORT and a key of 64 hexadecimal digits",
                      3,
                      2};

bool fits(const List& list, const Words& words) {
  return words.size() == list.words && is_host_name(words[0]) && Key::from_text(words[list.key]) &&
         (list.file != kConsoles.file || access_of(words[2])) && (list.file != kKnown.file || is_address(words[1]));
}

std::vector<Words> read(const List& list, const std::filesystem::path& path) {
  std::vector<Words> entries;
  if (!std::filesystem::exists(path)) return entries;
  std::ifstream file(path);
  if (!file) fail("the list of " + std::string(list.what) + " cannot be read", path);
  std::size_t number = 0;
  for (std::string line; std::getline(file, line);) {
    ++number;
    if (line.empty() || line.starts_with('#')) continue;
    std::istringstream text(line);
    Words words;
    for (std::string word; text >> word;) words.push_back(word);
    if (!fits(list, words) || entries.size() >= kMaxEntries) {
      throw Error(ErrorCode::Failed,
                  {.what = "the list of " + std::string(list.what) + " is damaged: " + list.damage,
                   .where = path.string() + ":" + std::to_string(number),
                   .expected = std::string(list.line) + ", at most " + std::to_string(kMaxEntries) + " lines",
                   .next = "mend the line, or remove it"});
    }
    entries.push_back(std::move(words));
  }
  return entries;
}

std::string text_of(const List& list, const std::vector<Words>& entries) {
  std::string text = "# " + std::string(list.head) + "\n";
  for (const auto& words : entries) {
    for (std::size_t i = 0; i < words.size(); ++i) text += (i == 0 ? "" : " ") + words[i];
    text += "\n";
  }
  return text;
}

void check_name_and_key(const std::string& name, const std::string& key) {
  if (!is_host_name(name)) {
    throw Error(ErrorCode::Usage, {.what = "'" + name + "' is no name of a host",
                                   .expected = "letters, digits, '-' and '_', at most 40"});
  }
  if (Key::from_text(key)) return;
  throw Error(ErrorCode::Usage, {.what = "this is no key of a host",
                                 .expected = "64 hexadecimal digits",
                                 .found = key.substr(0, 80),
                                 .next = "on the other host: fiona keys show"});
}

/// One of this name, and one with this key.
void refuse_second(const List& list, const std::vector<Words>& entries, const Words& added) {
  for (const auto& words : entries) {
    const bool same_key = Key::from_text(words[list.key]) == Key::from_text(added[list.key]);
    if (words[0] != added[0] && !same_key) continue;
    const std::string noun = list.file == kConsoles.file ? "console" : "host";
    throw Error(ErrorCode::NotAllowed,
                {.what = words[0] == added[0] ? "there is a " + noun + " '" + words[0] + "' in the list already"
                                              : "the key is in the list already, as '" + words[0] + "'",
                 .found = words[0] + " " + words[list.key],
                 .next = "fiona keys forget " + words[0]});
  }
}

}  // namespace

std::vector<AllowedHost> KeyDirectory::allowed() const {
  std::vector<AllowedHost> hosts;
  for (const auto& words : read(kHosts, directory_ / kHosts.file))
    hosts.push_back({words[0], *Key::from_text(words[1])});
  return hosts;
}

std::vector<AllowedConsole> KeyDirectory::consoles() const {
  std::vector<AllowedConsole> consoles;
  for (const auto& words : read(kConsoles, directory_ / kConsoles.file)) {
    consoles.push_back({words[0], *Key::from_text(words[1]), *access_of(words[2])});
  }
  return consoles;
}

std::vector<KnownHost> KeyDirectory::known() const {
  std::vector<KnownHost> hosts;
  for (const auto& words : read(kKnown, directory_ / kKnown.file))
    hosts.push_back({words[0], words[1], *Key::from_text(words[2])});
  return hosts;
}

void KeyDirectory::allow(const std::string& name, const std::string& key) const {
  check_name_and_key(name, key);
  make_directory();
  const Changing changing(directory_);
  auto entries = read(kHosts, directory_ / kHosts.file);
  const Words added{name, Key::from_text(key)->text()};
  refuse_second(kHosts, entries, added);
  entries.push_back(added);
  replace(directory_ / kHosts.file, text_of(kHosts, entries));
}

void KeyDirectory::allow_console(const std::string& name, const std::string& key, Access level) const {
  check_name_and_key(name, key);
  make_directory();
  const Changing changing(directory_);
  auto entries = read(kConsoles, directory_ / kConsoles.file);
  const Words added{name, Key::from_text(key)->text(), access_name(level)};
  std::erase_if(entries, [&added](const Words& one) {
    return one[0] == added[0] && Key::from_text(one[1]) == Key::from_text(added[1]);
  });
  refuse_second(kConsoles, entries, added);
  entries.push_back(added);
  replace(directory_ / kConsoles.file, text_of(kConsoles, entries));
}

void KeyDirectory::know(const std::string& name, const std::string& address, const std::string& key) const {
  check_name_and_key(name, key);
  if (!is_address(address)) {
    throw Error(ErrorCode::Usage, {.what = "this does not say where a host serves consoles",
                                   .expected = "ADDRESS:PORT",
                                   .found = address.substr(0, 80)});
  }
  make_directory();
  const Changing changing(directory_);
  auto entries = read(kKnown, directory_ / kKnown.file);
  const Words added{name, address, Key::from_text(key)->text()};
  // Two hosts of one user have one key, so a key may stand here twice.
  std::erase_if(entries, [&name](const Words& one) { return one[0] == name; });
  entries.push_back(added);
  replace(directory_ / kKnown.file, text_of(kKnown, entries));
}

void KeyDirectory::forget(const std::string& name) const {
  make_directory();
  const Changing changing(directory_);
  std::vector<std::string> names;
  bool found = false;
  for (const List& list : {kHosts, kConsoles, kKnown}) {
    auto entries = read(list, directory_ / list.file);
    for (const auto& words : entries) names.push_back(words[0]);
    if (std::erase_if(entries, [&name](const Words& words) { return words[0] == name; }) == 0) continue;
    replace(directory_ / list.file, text_of(list, entries));
    found = true;
  }
  if (!found)
    throw Error(
        ErrorCode::NotFound,
        {.what = "no host '" + name + "' may connect", .next = "fiona keys", .near = nearest_names(name, names)});
}

}  // namespace fiona::trust
