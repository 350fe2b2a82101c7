#include "durable.hpp"

#include <dirent.h>
#include <fcntl.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <fiona/error.hpp>
#include <fstream>
#include <iterator>
#include <memory>
#include <optional>
#include <sstream>
#include <thread>
#include <utility>

#include "text_check.hpp"

namespace fiona::marketplace {
namespace {

namespace filesystem = std::filesystem;

template <typename Call>
auto after_signals(Call&& call) {
  for (;;) {
    const auto result = call();
    if (result >= 0 || errno != EINTR) return result;
  }
}

// Every component that is missing, the uppermost first; each is synced into its parent before the next is
// made.
void make_all(const OsCalls& os, const filesystem::path& path, mode_t mode) {
  std::error_code failure;
  if (filesystem::is_directory(path, failure) || path == path.root_path()) return;
  make_all(os, path.parent_path(), mode);
  const FileDescriptor parent{::open(path.parent_path().c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC)};
  if (!parent) throw_os_error("open this directory", path.parent_path(), errno);
  if (after_signals([&] { return os.mkdir(parent.number(), path.filename().c_str(), mode); }) == 0) {
    if (after_signals([&] { return os.fsync(parent.number()); }) == 0) return;
    throw_os_error("make sure of this directory", path.parent_path(), errno);
  }
  if (errno != EEXIST) throw_os_error("make this directory", path, errno);
}

// "process 4711 (fiona market install acme/nav)", as far as the kernel tells.
std::string lock_holder(const FileDescriptor& locked) {
  struct stat status {};
  ::fstat(locked.number(), &status);
  std::ifstream locks("/proc/locks");
  for (std::string line; std::getline(locks, line);) {
    // "1: FLOCK ADVISORY WRITE 4711 00:1a:123 0 EOF"
    std::istringstream words(line);
    std::string number, kind, mode, access, place;
    int process = 0;
    words >> number >> kind >> mode >> access >> process >> place;
    if (kind != "FLOCK" || process <= 0 || !place.ends_with(":" + std::to_string(status.st_ino))) continue;
    std::ifstream file("/proc/" + std::to_string(process) + "/cmdline");
    std::string command{std::istreambuf_iterator<char>(file), {}};
    while (command.ends_with('\0')) command.pop_back();
    std::ranges::replace(command, '\0', ' ');
    if (const std::size_t slash = command.substr(0, command.find(' ')).rfind('/'); slash != std::string::npos)
      command.erase(0, slash + 1);
    const bool shown = !command.empty() && command.size() <= 200 && text_fault(command, false).empty();
    return "process " + std::to_string(process) + (shown ? " (" + command + ")" : "");
  }
  return "another process";
}

}  // namespace

DurableDirectory::DurableDirectory(const OsCalls& os, filesystem::path path, mode_t mode)
    : os_(&os), path_(filesystem::absolute(path).lexically_normal()) {
  if (!path_.has_filename()) path_ = path_.parent_path();  // "store/" is "store"
  make_all(os, path_, mode);
  directory_ = FileDescriptor{::open(path_.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC)};
  if (!directory_) throw_os_error("open this directory", path_, errno);
}

DurableDirectory DurableDirectory::child(const std::string& name, mode_t mode) const {
  if (!has(name)) {
    make_directory(name, mode);
    sync();
  }
  return existing_child(name);
}

DurableDirectory DurableDirectory::existing_child(const std::string& name) const {
  FileDescriptor directory = open_directory(descriptor(), name, path_ / name);
  if (!directory) throw_os_error("open this directory", path_ / name, ENOENT);
  return {*os_, std::move(directory), path_ / name};
}

void DurableDirectory::lock(std::chrono::milliseconds wait,
                            const std::function<void(const std::string& who)>& on_wait) {
  const auto end = std::chrono::steady_clock::now() + wait;
  bool told = false;
  while (after_signals([&] { return os_->flock(descriptor(), LOCK_EX | LOCK_NB); }) != 0) {
    if (errno != EWOULDBLOCK) throw_os_error("lock this directory", path_, errno);
    if (std::chrono::steady_clock::now() >= end) {
      throw Error(ErrorCode::Unreachable,
                  ErrorText{.what = lock_holder(directory_) + " is changing this directory and has not ended",
                            .where = path_.string(),
                            .next = "try again when it has"});
    }
    if (!std::exchange(told, true) && on_wait) on_wait(lock_holder(directory_));
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
  }
}

FileDescriptor DurableDirectory::create(const std::string& name, mode_t mode) const {
  FileDescriptor file{after_signals([&] { return os_->create(descriptor(), name.c_str(), mode); })};
  if (!file) throw_os_error("create it", path_ / name, errno);
  return file;
}

void DurableDirectory::make_directory(const std::string& name, mode_t mode) const {
  if (after_signals([&] { return os_->mkdir(descriptor(), name.c_str(), mode); }) != 0) {
    throw_os_error("make this directory", path_ / name, errno);
  }
}

void DurableDirectory::write(const FileDescriptor& file, std::string_view bytes, const std::string& name) const {
  while (!bytes.empty()) {
    const auto count = after_signals([&] { return os_->write(file.number(), bytes.data(), bytes.size()); });
    if (count < 0) throw_os_error("write it", path_ / name, errno);
    if (count == 0) throw_os_error("write it", path_ / name, EIO);
    bytes.remove_prefix(static_cast<std::size_t>(count));
  }
}

void DurableDirectory::sync(const FileDescriptor& file, const std::string& name) const {
  if (after_signals([&] { return os_->fsync(file.number()); }) != 0) {
    throw_os_error("bring it safely to the disk", path_ / name, errno);
  }
}

void DurableDirectory::sync() const { sync(directory_, "."); }

void DurableDirectory::move(const std::string& from, const DurableDirectory& to, const std::string& name) const {
  const auto rename = [&] { return os_->rename(descriptor(), from.c_str(), to.descriptor(), name.c_str()); };
  if (after_signals(rename) != 0) throw_os_error("rename " + from + " to it", to.path_ / name, errno);
  to.sync();
}

void DurableDirectory::switch_to(const std::string& name, std::string_view content) const {
  const std::string fresh = name + ".new";
  remove_file(fresh);
  {
    const FileDescriptor file = create(fresh, 0644);
    write(file, content, fresh);
    sync(file, fresh);
  }
  const auto rename = [&] { return os_->rename(descriptor(), fresh.c_str(), descriptor(), name.c_str()); };
  if (after_signals(rename) != 0) throw_os_error("replace it", path_ / name, errno);
  sync();
}

void DurableDirectory::replace(const std::string& name, std::string_view content) const {
  std::optional<std::string> before;
  if (const FileDescriptor old = open_regular(descriptor(), name, path_ / name)) {
    before = read_all(old, size_of(old), path_ / name);
  }
  try {
    switch_to(name, content);
  } catch (const Error&) {
    // The name may already mean the new content: only the last sync failed. Whoever is told of a failure must
    // find the old state.
    try {
      const FileDescriptor now = open_regular(descriptor(), name, path_ / name);
      const bool switched =
          now && read_all(now, content.size() + (before ? before->size() : 0), path_ / name) == content;
      if (switched && before != content) before ? switch_to(name, *before) : remove_file(name);
      remove_file(name + ".new");
    } catch (const Error&) {
      // The disk obeys no more. The file is the old or the new, whole; the first failure is what the caller
      // hears.
    }
    throw;
  }
}

void DurableDirectory::remove_file(const std::string& name) const {
  if (!has(name)) return;
  const auto unlink = [&] { return os_->unlink(descriptor(), name.c_str(), 0); };
  if (after_signals(unlink) != 0 && errno != ENOENT) throw_os_error("remove it", path_ / name, errno);
}

std::vector<std::string> DurableDirectory::names() const {
  // A descriptor of its own: a directory stream keeps its place in the one that it is given.
  const int copy = ::openat(descriptor(), ".", O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  const std::unique_ptr<DIR, int (*)(DIR*)> stream{copy < 0 ? nullptr : ::fdopendir(copy), ::closedir};
  if (!stream) throw_os_error("list this directory", path_, errno);
  std::vector<std::string> names;
  errno = 0;
  while (const dirent* entry = ::readdir(stream.get())) {
    const std::string name = entry->d_name;
    if (name != "." && name != "..") names.push_back(name);
  }
  if (errno != 0) throw_os_error("list this directory", path_, errno);
  std::ranges::sort(names);
  return names;
}

void DurableDirectory::remove_tree(const std::string& name) const {
  struct stat status {};
  if (::fstatat(descriptor(), name.c_str(), &status, AT_SYMLINK_NOFOLLOW) != 0) {
    if (errno == ENOENT) return;
    throw_os_error("look at it", path_ / name, errno);
  }
  if (!S_ISDIR(status.st_mode)) return remove_file(name);
  {
    const DurableDirectory tree = existing_child(name);
    for (const auto& entry : tree.names()) tree.remove_tree(entry);
  }
  if (after_signals([&] { return os_->unlink(descriptor(), name.c_str(), AT_REMOVEDIR); }) != 0) {
    throw_os_error("remove this directory", path_ / name, errno);
  }
}

void DurableDirectory::remove_tree_quietly(const std::string& name) const noexcept {
  try {
    remove_tree(name);
  } catch (const std::exception&) {
    // Swept at the next start, which says so if it cannot.
  }
}

bool DurableDirectory::has(const std::string& name) const {
  struct stat status {};
  return ::fstatat(descriptor(), name.c_str(), &status, AT_SYMLINK_NOFOLLOW) == 0;
}

}  // namespace fiona::marketplace
