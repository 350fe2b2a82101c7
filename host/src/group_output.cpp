#include "group_output.hpp"

#include <fcntl.h>
#include <fmt/format.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>

#include "fiona/error.hpp"

namespace fiona::host {
namespace {

std::string inert(std::string line) {
  std::replace_if(
      line.begin(), line.end(), [](char c) { return c < ' ' || c > '~'; }, '?');
  return line;
}

}  // namespace

GroupOutput::GroupOutput() {
  int ends[2];
  if (::pipe2(ends, O_CLOEXEC) != 0) {
    throw Error(ErrorCode::Failed,
                {.what = "the system gives no pipe",
                 .found = std::strerror(errno),
                 .next = "fiona doctor; end what holds many descriptors, or raise the limit: ulimit -n"});
  }
  read_end_ = os::Descriptor(ends[0]);
  write_end_ = os::Descriptor(ends[1]);
  ::fcntl(ends[0], F_SETFL, O_NONBLOCK);
  ::fcntl(ends[0], F_SETPIPE_SZ,
          static_cast<int>(kMostRead));  // a smaller one, where the user has had his share, does too
}

std::string GroupOutput::take(Time now) {
  std::string text;
  char buffer[16 * 1024];
  while (text.size() < kMostRead) {
    const ssize_t got = ::read(read_end_.get(), buffer, sizeof buffer);
    if (got <= 0) break;
    text.append(buffer, static_cast<std::size_t>(got));
  }
  keep(text);
  return limited(std::move(text), now);
}

void GroupOutput::keep(const std::string& text) {
  for (const char c : text) {
    if (c != '\n') {
      if (unfinished_.size() < kLongestLine) unfinished_ += c;
      continue;
    }
    if (!unfinished_.empty()) lines_.push_back(std::exchange(unfinished_, {}));
    if (lines_.size() > kKeptLines) lines_.pop_front();
  }
}

/// Whole chunks: what is dropped is said once there is room again.
std::string GroupOutput::limited(std::string text, Time now) {
  const std::chrono::duration<double> since = now - std::exchange(counted_, now);
  const double earned = std::min<double>(since.count(), 10) * kBytesPerSecond;
  allowance_ = std::min(kBurst, allowance_ + static_cast<std::size_t>(earned));
  if (text.size() > allowance_) {
    dropped_ += text.size() - allowance_;
    text.resize(allowance_);
  }
  allowance_ -= text.size();
  if (dropped_ > told_dropped_ && allowance_ > 0) {
    text += fmt::format("\n({} bytes more were written, and dropped)\n", dropped_ - told_dropped_);
    told_dropped_ = dropped_;
  }
  return text;
}

std::string GroupOutput::last_lines() const {
  std::string text;
  for (const auto& line : lines_) text += (text.empty() ? "" : " | ") + inert(line);
  if (!unfinished_.empty()) text += (text.empty() ? "" : " | ") + inert(unfinished_);
  return text;
}

}  // namespace fiona::host
