#include "fiona/trust/signing_key.hpp"

#include <fcntl.h>
#include <sodium/crypto_sign.h>
#include <sodium/utils.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <fiona/trust/host_keys.hpp>

#include "../durable.hpp"
#include "../files.hpp"
#include "digest.hpp"
#include "public_key.hpp"
#include "refuse.hpp"
#include "role_file.hpp"

namespace fiona::tuf {
namespace {

namespace filesystem = std::filesystem;

constexpr std::string_view kKeyHead = "fiona-signing-key 1 ";
constexpr std::string_view kKeyEnding = ".key";
constexpr std::uint64_t kMostRoleBytes = 8 << 20;

bool is_key_name(const std::string& name) {
  const auto fits = [](char c) { return (c >= 'a' && c <= 'z') || (c >= '0' && c <= '9') || c == '-' || c == '.'; };
  return !name.empty() && name.size() <= 80 && name[0] >= 'a' && name[0] <= 'z' && std::ranges::all_of(name, fits);
}

void require_private(const marketplace::FileDescriptor& file, const filesystem::path& path) {
  struct stat status {};
  if (::fstat(file.number(), &status) == 0 && status.st_uid == ::geteuid() && (status.st_mode & 077) == 0) return;
  refuse(ErrorCode::NotAllowed, ErrorText{.what = "the signing key is not private to this user",
                                          .where = path.string(),
                                          .expected = "a file of this user with mode 0600",
                                          .next = "if nobody can have read it, chmod 600 it; else make another"});
}

}  // namespace

SigningKey::SigningKey(const std::array<unsigned char, 64>& secret)
    : secret_(secret), open_(to_hex({reinterpret_cast<const char*>(secret.data()) + 32, 32})) {}

SigningKey::~SigningKey() { sodium_memzero(secret_.data(), secret_.size()); }

SigningKey SigningKey::make() {
  unsigned char open[crypto_sign_PUBLICKEYBYTES];
  std::array<unsigned char, crypto_sign_SECRETKEYBYTES> secret{};
  crypto_sign_keypair(open, secret.data());
  const SigningKey key{secret};
  sodium_memzero(secret.data(), secret.size());
  return key;
}

std::optional<SigningKey> SigningKey::from_seed(std::string_view hex) {
  std::string seed = from_hex(hex);
  if (seed.size() != crypto_sign_SEEDBYTES) return std::nullopt;
  unsigned char open[crypto_sign_PUBLICKEYBYTES];
  std::array<unsigned char, crypto_sign_SECRETKEYBYTES> secret{};
  crypto_sign_seed_keypair(open, secret.data(), reinterpret_cast<const unsigned char*>(seed.data()));
  sodium_memzero(seed.data(), seed.size());
  return SigningKey{secret};
}

std::string SigningKey::seed() const { return to_hex({reinterpret_cast<const char*>(secret_.data()), 32}); }

std::string SigningKey::sign(std::string_view message) const {
  std::string signature(crypto_sign_BYTES, '\0');
  crypto_sign_detached(reinterpret_cast<unsigned char*>(signature.data()), nullptr,
                       reinterpret_cast<const unsigned char*>(message.data()), message.size(), secret_.data());
  return signature;
}

bool is_open_key(std::string_view text) {
  return text.size() == 64 && text.find_first_not_of("0123456789abcdef") == std::string_view::npos;
}

std::string key_id_of(const OpenKey& key) { return key_id(key_json(key)); }

SigningKeys::SigningKeys(filesystem::path directory)
    : directory_(directory.empty() ? trust::KeyDirectory().path() / "signing" : std::move(directory)) {}

namespace {

SigningKey write_key(const marketplace::DurableDirectory& directory, const std::string& file_name) {
  SigningKey key = SigningKey::make();
  const marketplace::FileDescriptor file = directory.create(file_name, 0600);
  directory.write(file, std::string(kKeyHead) + key.seed() + "\n", file_name);
  directory.sync(file, file_name);
  directory.sync();
  return key;
}

}  // namespace

SigningKey SigningKeys::make(const std::string& name) const {
  if (!is_key_name(name)) {
    refuse(ErrorCode::Usage,
           ErrorText{.what = "'" + name + "' is no name of a key",
                     .expected = "lower-case letters, digits, '-' and '.', at most 80, a letter first"});
  }
  const marketplace::OsCalls os = marketplace::system_calls();
  const marketplace::DurableDirectory directory{os, directory_, 0700};
  const std::string file_name = name + std::string(kKeyEnding);
  if (directory.has(file_name)) {
    refuse(ErrorCode::NotAllowed, ErrorText{.what = "there is a key '" + name + "' already",
                                            .where = (directory_ / file_name).string(),
                                            .next = "fiona keys; to give it up, remove the file"});
  }
  return write_key(directory, file_name);
}

SigningKey SigningKeys::renew(const std::string& name) const {
  get(name);
  const marketplace::OsCalls os = marketplace::system_calls();
  const marketplace::DurableDirectory directory{os, directory_, 0700};
  const std::string file_name = name + std::string(kKeyEnding), fresh = file_name + ".new";
  directory.remove_file(fresh);
  const SigningKey key = write_key(directory, fresh);
  directory.move(file_name, directory, file_name + ".old");
  directory.move(fresh, directory, file_name);
  return key;
}

SigningKey SigningKeys::get(const std::string& name) const {
  const filesystem::path path = directory_ / (name + std::string(kKeyEnding));
  const marketplace::FileDescriptor file =
      is_key_name(name) ? marketplace::open_regular(AT_FDCWD, path, path) : marketplace::FileDescriptor{};
  if (!file) {
    const auto known = names();
    throw Error(ErrorCode::NotFound, ErrorText{.what = "this user has no signing key '" + name + "'",
                                               .where = directory_.string(),
                                               .next = "fiona keys new " + name,
                                               .near = nearest_names(name, known)});
  }
  require_private(file, path);
  std::string text = marketplace::read_all(file, 200, path);
  if (!text.empty() && text.back() == '\n') text.pop_back();
  auto key = text.starts_with(kKeyHead) ? SigningKey::from_seed(text.substr(kKeyHead.size())) : std::nullopt;
  if (key) return *key;
  refuse(ErrorCode::Failed, ErrorText{.what = "the signing key is damaged",
                                      .where = path.string(),
                                      .expected = std::string(kKeyHead) + "and 64 hexadecimal digits",
                                      .next = "bring it back from a copy"});
}

std::vector<std::string> SigningKeys::names() const {
  std::vector<std::string> names;
  std::error_code failure;
  for (filesystem::directory_iterator entry{directory_, failure}; !failure && entry != filesystem::directory_iterator{};
       entry.increment(failure)) {
    if (entry->path().extension() == kKeyEnding) names.push_back(entry->path().stem().string());
  }
  std::ranges::sort(names);
  return names;
}

std::optional<SigningKey> SigningKeys::with_id(const std::string& wanted) const {
  for (const auto& name : names()) {
    try {
      SigningKey key = get(name);
      if (key_id_of(key.open()) == wanted) return key;
    } catch (const Error&) {  // one that cannot be read signs nothing
    }
  }
  return std::nullopt;
}

void SigningKeys::require_readable() const {
  for (const auto& name : names()) get(name);
}

std::optional<std::string> SigningKeys::signed_role(const std::string& name) const {
  const filesystem::path path = directory_ / (name + ".json");
  const marketplace::FileDescriptor file = marketplace::open_regular(AT_FDCWD, path, path);
  if (!file) return std::nullopt;
  return marketplace::read_all(file, kMostRoleBytes, path);
}

void SigningKeys::keep_signed_role(const std::string& name, std::string_view role) const {
  const marketplace::OsCalls os = marketplace::system_calls();
  marketplace::DurableDirectory{os, directory_, 0700}.replace(name + ".json", role);
}

}  // namespace fiona::tuf
