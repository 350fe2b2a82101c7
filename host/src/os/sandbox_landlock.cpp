// Landlock: what files, ports and processes may be reached. Its rights came one kernel after the other; Debian's
// headers are older than many kernels, so the numbers of the later ones are here (linux/landlock.h).
#include <fcntl.h>
#include <linux/landlock.h>
#include <sys/stat.h>
#include <sys/statvfs.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <cerrno>
#include <cstdint>
#include <system_error>

#include "os/descriptor.hpp"
#include "os/sandbox.hpp"

namespace fiona::os::detail {
namespace {

struct Ruleset {
  std::uint64_t files = 0;
  std::uint64_t network = 0;  // ABI 4
  std::uint64_t scopes = 0;   // ABI 6
};
constexpr std::uint64_t kRefer = 1U << 13U;     // ABI 2
constexpr std::uint64_t kTruncate = 1U << 14U;  // ABI 3
constexpr std::uint64_t kIoctl = 1U << 15U;     // ABI 5
constexpr std::uint64_t kTcp = 0b11;            // bind and connect
constexpr std::uint64_t kScopes = 0b11;         // abstract unix sockets, signals
constexpr std::uint64_t kUpToAbi1 = (1U << 13U) - 1;

constexpr std::uint64_t kRead = LANDLOCK_ACCESS_FS_READ_FILE | LANDLOCK_ACCESS_FS_READ_DIR;
constexpr std::uint64_t kWrite = kRead | LANDLOCK_ACCESS_FS_WRITE_FILE | LANDLOCK_ACCESS_FS_REMOVE_FILE |
                                 LANDLOCK_ACCESS_FS_REMOVE_DIR | LANDLOCK_ACCESS_FS_MAKE_DIR |
                                 LANDLOCK_ACCESS_FS_MAKE_REG | LANDLOCK_ACCESS_FS_MAKE_SOCK | kTruncate;
/// Its folder is on the disk of the user, who has no bound for files there.
constexpr std::uint64_t kListen =
    LANDLOCK_ACCESS_FS_READ_DIR | LANDLOCK_ACCESS_FS_MAKE_SOCK | LANDLOCK_ACCESS_FS_REMOVE_FILE;
constexpr std::uint64_t kDevice = LANDLOCK_ACCESS_FS_READ_FILE | LANDLOCK_ACCESS_FS_WRITE_FILE | kIoctl;
/// What a rule for a file, and not for a folder, may name.
constexpr std::uint64_t kOfFiles =
    LANDLOCK_ACCESS_FS_READ_FILE | LANDLOCK_ACCESS_FS_WRITE_FILE | LANDLOCK_ACCESS_FS_EXECUTE | kTruncate | kIoctl;

void require_ruled(bool holds, const std::string& what) {
  if (!holds) throw std::system_error(errno, std::generic_category(), what);
}

void allow(const Descriptor& ruleset, const std::filesystem::path& path, std::uint64_t access) {
  const Descriptor place(::open(path.c_str(), O_PATH | O_CLOEXEC));
  if (!place) return;
  struct stat kind {};
  ::fstat(place.get(), &kind);
  if (!S_ISDIR(kind.st_mode)) access &= kOfFiles;
  landlock_path_beneath_attr rule{};
  rule.allowed_access = access;
  rule.parent_fd = place.get();
  require_ruled(::syscall(SYS_landlock_add_rule, ruleset.get(), LANDLOCK_RULE_PATH_BENEATH, &rule, 0) == 0, path);
}

}  // namespace

std::string restrict_by_landlock(const Reach& reach) {
  const long abi = ::syscall(SYS_landlock_create_ruleset, nullptr, 0, LANDLOCK_CREATE_RULESET_VERSION);
  require_ruled(abi >= 1, "landlock");
  Ruleset rules;
  rules.files = kUpToAbi1 | (abi >= 2 ? kRefer : 0) | (abi >= 3 ? kTruncate : 0) | (abi >= 5 ? kIoctl : 0);
  rules.network = abi >= 4 && !reach.network ? kTcp : 0;
  rules.scopes = abi >= 6 ? kScopes : 0;
  const std::size_t size = abi >= 6 ? sizeof rules : abi >= 4 ? 2 * sizeof(std::uint64_t) : sizeof(std::uint64_t);
  const Descriptor ruleset(static_cast<int>(::syscall(SYS_landlock_create_ruleset, &rules, size, 0)));
  require_ruled(static_cast<bool>(ruleset), "landlock");
  for (const char* path :
       {"/usr", "/lib", "/lib64", "/etc/ld.so.cache", "/etc/localtime", "/dev/random", "/dev/urandom", "/dev/full"}) {
    allow(ruleset, path, kRead & rules.files);
  }
  allow(ruleset, "/dev/null", kDevice & rules.files);
  // Where the reach has parts below it, it has none of its own, and what is not granted there stays so.
  struct statvfs temporary {};
  const bool is_its_own = ::statvfs("/tmp", &temporary) == 0 && (temporary.f_flag & ST_RDONLY) == 0;
  if (is_its_own) allow(ruleset, "/tmp", kWrite & rules.files);
  for (const auto& path : reach.readable) allow(ruleset, path, kRead & rules.files);
  for (const auto& path : reach.writable) allow(ruleset, path, kWrite & rules.files);
  for (const auto& path : reach.socket_folders) allow(ruleset, path, kListen & rules.files);
  for (const auto& path : reach.devices) allow(ruleset, path, kDevice & rules.files);
  require_ruled(::syscall(SYS_landlock_restrict_self, ruleset.get(), 0) == 0, "landlock");
  return "ABI " + std::to_string(abi);
}

}  // namespace fiona::os::detail
