// save and source: systems as files.
#include <cerrno>
#include <cstring>

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/stat.h>
#include <unistd.h>

#include "../saved_system.hpp"
#include "../script.hpp"
#include "verbs.hpp"

namespace fiona::console::verbs {
namespace {

namespace fs = std::filesystem;

[[noreturn]] void fail(const fs::path& file) {
  const int problem = errno;
  const fs::path folder = file.has_parent_path() ? file.parent_path() : fs::path(".");
  throw Error(ErrorCode::Failed,
              ErrorText{.what = fmt::format("the file cannot be written: {}", std::strerror(problem)),
                        .where = file.string(),
                        .next = "see what the folder allows, and whether the disk is full: ls -ld " + folder.string() +
                                "; df -h"});
}

/// Closes it, and with a path takes the file away.
class Opened {
 public:
  Opened(const fs::path& file, int flags, ::mode_t mode = 0, fs::path fleeting = {})
      : descriptor_(::open(file.c_str(), flags | O_WRONLY | O_CLOEXEC, mode)), fleeting_(std::move(fleeting)) {}
  Opened(const Opened&) = delete;
  Opened& operator=(const Opened&) = delete;
  ~Opened() {
    if (descriptor_ < 0) return;
    ::close(descriptor_);
    if (!fleeting_.empty()) ::unlink(fleeting_.c_str());
  }
  int descriptor() const { return descriptor_; }

 private:
  const int descriptor_;
  const fs::path fleeting_;
};

/// A pipe, a terminal, a device: nothing can be put in its place.
void write_into(Reactor& reactor, const fs::path& file, std::string_view text) {
  const Opened opened(file, O_NONBLOCK | O_NOCTTY);
  if (opened.descriptor() < 0 || !reactor.write_all(opened.descriptor(), text)) fail(file);
}

bool keep_mode(int descriptor, const struct stat& old) {
  [[maybe_unused]] const int kept = ::fchown(descriptor, old.st_uid, old.st_gid);  // else it is whose console this is
  return ::fchmod(descriptor, old.st_mode & 07777U) == 0;
}

/// Written beside the file and renamed, with its mode: a reader, or a power cut, sees the old text or the new one.
void replace_file(Reactor& reactor, const fs::path& file, std::string_view text) {
  struct stat old {};
  const bool is_there = ::stat(file.c_str(), &old) == 0;
  const fs::path fresh = file.string() + fmt::format(".{}.new", ::getpid());
  const Opened opened(fresh, O_CREAT | O_EXCL, is_there ? 0600 : 0666, fresh);
  const int descriptor = opened.descriptor();
  const bool sound = descriptor >= 0 && reactor.write_all(descriptor, text) &&
                     (!is_there || keep_mode(descriptor, old)) && ::fsync(descriptor) == 0 &&
                     ::rename(fresh.c_str(), file.c_str()) == 0;
  if (!sound) fail(file);
}

/// What a link leads to, also where there is nothing yet.
fs::path behind_links(fs::path file) {
  constexpr int kMostLinks = 40;
  std::error_code failure;
  for (int i = 0; i < kMostLinks && fs::is_symlink(file, failure); ++i)
    file = file.parent_path() / fs::read_symlink(file, failure);
  return file;
}

}  // namespace

void save(Session& session, const Line& line) {
  const Word& name = line.positional[0];
  if (name.text.empty())
    throw line.error(name, {.what = "the name of the file is empty", .expected = "FILE, or - for standard output"});
  const control::System system = session.snapshot();
  const std::string text = saved_system(system);
  const std::string saved =
      fmt::format("saved {} instance{}", system.instances_size(), system.instances_size() == 1 ? "" : "s");
  if (name.text == "-") {
    session.out.text(text);
    return session.out.object({{"done", saved}, {"file", "-"}, {"text", text}});
  }
  const fs::path file = name.text;
  std::error_code failure;
  const fs::file_status status = fs::status(file, failure);
  if (fs::exists(status) && !fs::is_regular_file(status))
    write_into(session.reactor, file, text);
  else
    replace_file(session.reactor, behind_links(file), text);
  session.out.done(fmt::format("{} to {}", saved, file.string()), {{"file", file.string()}});
}

void source(Session& session, const Line& line) {
  run_script(session, read_script(named_file(line.words, line.positional[0].text)));
}

}  // namespace fiona::console::verbs
