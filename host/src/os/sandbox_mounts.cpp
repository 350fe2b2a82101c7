// A file system of its own: what is in reach, and the system's libraries.
#include <fcntl.h>
#include <linux/openat2.h>
#include <sched.h>
#include <signal.h>
#include <sys/mount.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <sys/statvfs.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <fstream>
#include <iterator>
#include <map>
#include <system_error>

#include "os/descriptor.hpp"
#include "os/sandbox.hpp"

namespace fiona::os::detail {
namespace {

namespace fs = std::filesystem;

/// Any directory that every system has: the new root is mounted over it, and then becomes the root.
constexpr const char* kNewRoot = "/tmp";
constexpr std::uint64_t kTemporaryBytes = 16U << 20U;
/// Empty files take memory, too, which no limit of bytes counts.
constexpr int kTemporaryFiles = 1024;

/// What the loader and the C library read.
constexpr const char* kSystemFiles[] = {"/usr/lib", "/usr/lib64", "/usr/share/zoneinfo", "/etc/ld.so.cache",
                                        "/etc/localtime"};
constexpr const char* kSystemLinks[] = {"/lib", "/lib64"};  // to folders below /usr; where they are folders: those
/// Not zero, of which mappings are memory that is not counted when they are gone.
constexpr const char* kSystemDevices[] = {"/dev/null", "/dev/full", "/dev/random", "/dev/urandom"};

void require_mounted(bool holds, const std::string& what) {
  if (!holds) throw std::system_error(errno, std::generic_category(), what);
}

/// A part of the old file system, kept by a descriptor, which the new root cannot hide. Without one: an empty folder
/// over what lies in another part.
struct Part {
  fs::path path;
  Descriptor descriptor;
  unsigned long flags;
};

bool is_in(const fs::path& folder, const fs::path& path) {
  const fs::path below = path.lexically_relative(folder);
  return !below.empty() && *below.begin() != "..";
}

/// Whether somebody who may write to these folders could have made a link of a part of the way.
bool leads_through(const std::vector<fs::path>& folders, const fs::path& path) {
  fs::path way;
  return std::any_of(path.begin(), path.end(), [&](const fs::path& step) {
    std::error_code ignored;
    const fs::path real = fs::weakly_canonical(way /= step, ignored);
    return std::any_of(folders.begin(), folders.end(),
                       [&](const fs::path& folder) { return is_in(fs::weakly_canonical(folder, ignored), real); });
  });
}

/// openat2(2), of Linux 5.6.
Descriptor open_without_links(const fs::path& path) {
  open_how how{};
  how.flags = O_PATH | O_CLOEXEC;
  how.resolve = RESOLVE_NO_SYMLINKS;
  return Descriptor(static_cast<int>(::syscall(SYS_openat2, AT_FDCWD, path.c_str(), &how, sizeof how)));
}

/// What was granted in a folder that it may write to is that, and not what it has made a link to before it was started
/// again.
void add(std::vector<Part>& parts, const fs::path& path, unsigned long flags,
         const std::vector<fs::path>& writable = {}) {
  Descriptor descriptor =
      leads_through(writable, path) ? open_without_links(path) : Descriptor(::open(path.c_str(), O_PATH | O_CLOEXEC));
  if (descriptor) parts.push_back({path, std::move(descriptor), flags});
}

/// Of what is open there, whatever links the way to it has led over.
fs::path real_path(const Descriptor& open) { return fs::read_symlink("/proc/self/fd/" + std::to_string(open.get())); }

/// To read a folder is to connect to the sockets in it, which no flag of a mount prevents.
void add_covers(std::vector<Part>& parts, const fs::path& hidden) {
  const Descriptor folder(::open(hidden.c_str(), O_PATH | O_DIRECTORY | O_CLOEXEC));
  if (!folder) return;
  std::vector<Part> covers;
  for (const Part& part : parts) {
    if (!part.descriptor) continue;
    const fs::path real = real_path(folder), of_part = real_path(part.descriptor);
    if (!is_in(of_part, real)) continue;
    const fs::path below = real.lexically_relative(of_part);
    covers.push_back({below == "." ? part.path : part.path / below, {}, 0});
  }
  std::move(covers.begin(), covers.end(), std::back_inserter(parts));
}

std::vector<fs::path> others_than(const fs::path& one, std::vector<fs::path> folders) {
  std::erase(folders, one);
  return folders;
}

std::vector<Part> parts_of(const Reach& reach) {
  std::vector<Part> parts;
  for (const char* file : kSystemFiles) add(parts, file, MS_RDONLY | MS_NODEV);
  for (const char* link : kSystemLinks) {
    if (!fs::is_symlink(link)) add(parts, link, MS_RDONLY | MS_NODEV);
  }
  // The device is written to all the same, and nobody changes its node's rights, which are everybody's.
  for (const char* device : kSystemDevices) add(parts, device, MS_RDONLY);
  for (const auto& path : reach.readable) add(parts, path, MS_RDONLY | MS_NODEV, reach.writable);
  for (const auto& path : reach.writable) add(parts, path, MS_NODEV | MS_NOEXEC, others_than(path, reach.writable));
  for (const auto& path : reach.socket_folders) add(parts, path, MS_NODEV | MS_NOEXEC);
  for (const auto& path : reach.devices) add(parts, path, MS_RDONLY);
  for (const auto& path : reach.hidden) add_covers(parts, path);
  // What lies in another comes after it.
  std::stable_sort(parts.begin(), parts.end(),
                   [](const Part& a, const Part& b) { return a.path.native().size() < b.path.native().size(); });
  return parts;
}

/// As who it was: a normal user gets a user namespace in which it may mount.
std::string unshare_mounts() {
  constexpr int kSpaces = CLONE_NEWNS | CLONE_NEWIPC;
  if (::unshare(kSpaces) == 0) return "mount namespace";
  const uid_t user = ::geteuid();
  const gid_t group = ::getegid();
  require_mounted(::unshare(CLONE_NEWUSER | kSpaces) == 0, "unshare");
  const auto write = [](const char* file, const std::string& text) {
    std::ofstream stream(file);
    stream << text << std::flush;
    require_mounted(static_cast<bool>(stream), file);
  };
  write("/proc/self/setgroups", "deny");
  write("/proc/self/uid_map", std::to_string(user) + " " + std::to_string(user) + " 1");
  write("/proc/self/gid_map", std::to_string(group) + " " + std::to_string(group) + " 1");
  return "mount and user namespace";
}

/// The flags that the part has already may be locked, and must be given again.
unsigned long flags_at(const std::string& target, unsigned long wanted) {
  struct statvfs there {};
  require_mounted(::statvfs(target.c_str(), &there) == 0, target);
  constexpr std::pair<unsigned long, unsigned long> kKept[] = {
      {ST_RDONLY, MS_RDONLY},   {ST_NODEV, MS_NODEV},       {ST_NOEXEC, MS_NOEXEC},
      {ST_NOATIME, MS_NOATIME}, {ST_RELATIME, MS_RELATIME}, {ST_NODIRATIME, MS_NODIRATIME}};
  unsigned long flags = wanted | MS_NOSUID;
  for (const auto& [has, flag] : kKept) {
    if (there.f_flag & has) flags |= flag;
  }
  return flags;
}

/// mount_setattr(2), of Linux 5.12.
bool sets_flags_of_all_below() { return ::mount_setattr(-1, "", 0, nullptr, 0) != 0 && errno != ENOSYS; }

/// With what is mounted below it, and has the same flags then. Older kernels change the flags of one mount at a time:
/// there it comes without, which they refuse to a normal user who would see what was hidden.
void mount_part(const std::string& source, const std::string& target, unsigned long flags) {
  const bool all = sets_flags_of_all_below();
  require_mounted(::mount(source.c_str(), target.c_str(), nullptr, MS_BIND | (all ? MS_REC : 0), nullptr) == 0, target);
  if (!all) {
    const unsigned long changed = MS_BIND | MS_REMOUNT | flags_at(target, flags);
    return require_mounted(::mount(nullptr, target.c_str(), nullptr, changed, nullptr) == 0, target);
  }
  mount_attr attributes{};
  attributes.attr_set = MOUNT_ATTR_NOSUID | (flags & MS_RDONLY ? MOUNT_ATTR_RDONLY : 0) |
                        (flags & MS_NODEV ? MOUNT_ATTR_NODEV : 0) | (flags & MS_NOEXEC ? MOUNT_ATTR_NOEXEC : 0);
  require_mounted(::mount_setattr(AT_FDCWD, target.c_str(), AT_RECURSIVE, &attributes, sizeof attributes) == 0, target);
}

void bind(const Part& part) {
  const std::string source = "/proc/self/fd/" + std::to_string(part.descriptor.get());
  const fs::path target = fs::path(kNewRoot) / part.path.relative_path();
  struct stat kind {};
  require_mounted(::fstat(part.descriptor.get(), &kind) == 0, part.path);
  fs::create_directories(S_ISDIR(kind.st_mode) ? target : target.parent_path());
  if (!S_ISDIR(kind.st_mode) && !fs::exists(target)) require_mounted(static_cast<bool>(std::ofstream(target)), target);
  mount_part(source, target, part.flags);
}

/// What else is in reach there comes into it yet.
void cover(const Part& part) {
  const fs::path target = fs::path(kNewRoot) / part.path.relative_path();
  fs::create_directories(target);
  constexpr unsigned long kFlags = MS_NOSUID | MS_NODEV | MS_NOEXEC;
  require_mounted(::mount("fiona", target.c_str(), "tmpfs", kFlags, "mode=0755,size=64k") == 0, part.path);
}

void close_cover(const Part& part) {
  const fs::path target = fs::path(kNewRoot) / part.path.relative_path();
  constexpr unsigned long kReadOnly = MS_BIND | MS_REMOUNT | MS_RDONLY | MS_NOSUID | MS_NODEV | MS_NOEXEC;
  require_mounted(::mount(nullptr, target.c_str(), nullptr, kReadOnly, nullptr) == 0, part.path);
}

/// Folders with nothing but the copies, over what may be there.
void put_copies(const std::vector<PrivateCopy>& copies) {
  constexpr std::uint64_t kRounding = 64U << 10U;
  std::map<fs::path, std::vector<const PrivateCopy*>> folders;
  for (const PrivateCopy& copy : copies) folders[copy.path.parent_path()].push_back(&copy);
  for (const auto& [path, files] : folders) {
    const fs::path folder = fs::path(kNewRoot) / path.relative_path();
    fs::create_directories(folder);
    std::uint64_t bytes = 0;
    for (const PrivateCopy* file : files) bytes += file->size + kRounding;
    const std::string options = "mode=0755,size=" + std::to_string(bytes);
    require_mounted(::mount("fiona", folder.c_str(), "tmpfs", MS_NOSUID | MS_NODEV, options.c_str()) == 0, path);
    for (const PrivateCopy* file : files) file->write_to(folder / file->path.filename());
    constexpr unsigned long kReadOnly = MS_BIND | MS_REMOUNT | MS_RDONLY | MS_NOSUID | MS_NODEV;
    require_mounted(::mount(nullptr, folder.c_str(), nullptr, kReadOnly, nullptr) == 0, path);
  }
}

/// Who was granted no folder needs no more than the temporary one has. A write beyond fails, and does not end the
/// process.
void limit_files() {
  const rlimit most{kTemporaryBytes, kTemporaryBytes};
  require_mounted(::setrlimit(RLIMIT_FSIZE, &most) == 0, "a limit for files");
  ::signal(SIGXFSZ, SIG_IGN);
}

}  // namespace

std::string enter_namespaces(const Reach& reach) {
  const std::string made_of = unshare_mounts();
  require_mounted(::mount(nullptr, "/", nullptr, MS_REC | MS_PRIVATE, nullptr) == 0, "private mounts");
  const std::vector<Part> parts = parts_of(reach);
  require_mounted(::mount("fiona", kNewRoot, "tmpfs", MS_NOSUID | MS_NODEV, "size=1m,mode=0755") == 0, "a new root");
  for (const Part& part : parts) part.descriptor ? bind(part) : cover(part);
  put_copies(reach.copies);
  for (const Part& part : parts) {
    if (!part.descriptor) close_cover(part);
  }
  for (const char* link : kSystemLinks) {
    if (fs::is_symlink(link)) fs::create_symlink(fs::read_symlink(link), std::string(kNewRoot) + link);
  }
  const std::string temporary = std::string(kNewRoot) + "/tmp";
  fs::create_directories(temporary);
  // Not over what lies below it.
  const bool is_used =
      std::any_of(parts.begin(), parts.end(), [](const Part& part) { return part.path.native().starts_with("/tmp/"); });
  if (!is_used) {
    const std::string options =
        "mode=0700,size=" + std::to_string(kTemporaryBytes) + ",nr_inodes=" + std::to_string(kTemporaryFiles);
    require_mounted(
        ::mount("fiona", temporary.c_str(), "tmpfs", MS_NOSUID | MS_NODEV | MS_NOEXEC, options.c_str()) == 0, "/tmp");
  }
  require_mounted(::chdir(kNewRoot) == 0, kNewRoot);
  require_mounted(::syscall(SYS_pivot_root, ".", ".") == 0, "pivot_root");
  require_mounted(::umount2(".", MNT_DETACH) == 0, "the old root");
  require_mounted(::mount(nullptr, "/", nullptr, MS_BIND | MS_REMOUNT | MS_RDONLY | MS_NOSUID | MS_NODEV, nullptr) == 0,
                  "a root that is only read");
  require_mounted(::chdir("/") == 0, "/");
  if (reach.writable.empty()) limit_files();
  return made_of;
}

}  // namespace fiona::os::detail
