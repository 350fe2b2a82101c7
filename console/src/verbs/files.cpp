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

/// A pipe, a terminal, a device: nothing can be put in its place.
void write_into(Reactor& reactor, const fs::path& file, std::string_view text) {
  const int descriptor = ::open(file.c_str(), O_WRONLY | O_NONBLOCK | O_NOCTTY | O_CLOEXEC);
  if (descriptor < 0) fail(file);
  bool sound = false;
  try {
    sound = reactor.write_all(descriptor, text);
  } catch (...) {
    ::close(descriptor);
    throw;
  }
  const int problem = errno;
  ::close(descriptor);
  errno = problem;
  if (!sound) fail(file);
}

/// Written beside the file and renamed, with its mode: a reader, or a power cut, sees the old text or the new one.
void replace_file(Reactor& reactor, const fs::path& file, std::string_view text) {
  struct stat old {};
  const bool is_there = ::stat(file.c_str(), &old) == 0;
  const fs::path fresh = file.string() + fmt::format(".{}.new", ::getpid());
  const int descriptor = ::open(fresh.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, is_there ? 0600 : 0666);
  if (descriptor < 0) fail(file);
  bool sound = reactor.write_all(descriptor, text);
  if (is_there && ::fchown(descriptor, old.st_uid, old.st_gid) != 0) errno = 0;  // it is who writes it now
  sound = sound && (!is_there || ::fchmod(descriptor, old.st_mode & 07777U) == 0) && ::fsync(descriptor) == 0;
  const int problem = errno;
  ::close(descriptor);
  errno = problem;
  if (sound && ::rename(fresh.c_str(), file.c_str()) == 0) return;
  const int why = errno;
  ::unlink(fresh.c_str());
  errno = why;
  fail(file);
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
