// save and source: systems as files.
#include <cerrno>
#include <cstring>

#include <fcntl.h>
#include <fmt/format.h>
#include <unistd.h>

#include "../saved_system.hpp"
#include "../script.hpp"
#include "verbs.hpp"

namespace fiona::console::verbs {
namespace {

namespace fs = std::filesystem;

/// Written beside the file and renamed: a reader, or a power cut, sees the old text or the new one.
void replace_file(const fs::path& file, std::string_view text) {
  const fs::path fresh = file.string() + fmt::format(".{}.new", ::getpid());
  const auto fail = [&fresh, &file] {
    const int problem = errno;
    ::unlink(fresh.c_str());
    throw Error(ErrorCode::Failed,
                ErrorText{.what = fmt::format("the file cannot be written: {}", std::strerror(problem)),
                          .where = file.string(),
                          .next = "see what the folder allows, and whether the disk is full: ls -ld " +
                                  file.parent_path().string() + "; df -h"});
  };
  const int descriptor = ::open(fresh.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0666);
  if (descriptor < 0) fail();
  bool sound = true;
  while (sound && !text.empty()) {
    const ssize_t written = ::write(descriptor, text.data(), text.size());
    sound = written > 0 || (written < 0 && errno == EINTR);
    if (written > 0) text.remove_prefix(static_cast<std::size_t>(written));
  }
  sound = sound && ::fsync(descriptor) == 0;
  const int problem = errno;
  ::close(descriptor);
  errno = problem;
  if (!sound || ::rename(fresh.c_str(), file.c_str()) != 0) fail();
}

}  // namespace

void save(Session& session, const Line& line) {
  const control::System system = session.snapshot();
  const std::string text = saved_system(system);
  const fs::path file = line.positional[0].text;
  replace_file(file, text);
  session.out.done(fmt::format("saved {} instance{} to {}", system.instances_size(),
                               system.instances_size() == 1 ? "" : "s", file.string()),
                   {{"file", file.string()}});
}

void source(Session& session, const Line& line) {
  run_script(session, read_script(named_file(line.words, line.positional[0].text)));
}

}  // namespace fiona::console::verbs
