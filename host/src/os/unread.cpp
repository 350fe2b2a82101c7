#include "os/unread.hpp"

#include <poll.h>
#include <unistd.h>

#include <algorithm>
#include <cstdint>
#include <iostream>
#include <mutex>
#include <streambuf>
#include <string>
#include <string_view>
#include <utility>

namespace fiona::os {
namespace {

/// For a reader that is slow. One who does not come in this time is not waited for again.
constexpr int kPatience_ms = 200;
/// pipe(7): where there is any room, there is for so much, and it is written as one.
constexpr std::size_t kAtOnce = 4096 - 128;  // and a line about those that were lost

class Unread final : public std::streambuf {
 protected:
  std::streamsize xsputn(const char* text, std::streamsize size) override {
    const std::lock_guard lock(mutex_);
    line_.append(text, static_cast<std::size_t>(size));
    write_lines();
    return size;
  }
  int_type overflow(int_type character) override {
    if (traits_type::eq_int_type(character, traits_type::eof())) return traits_type::not_eof(character);
    const char one = traits_type::to_char_type(character);
    xsputn(&one, 1);
    return character;
  }

 private:
  /// Those that are whole, and what would be too long for one.
  void write_lines() {
    const std::size_t end = line_.rfind('\n');
    std::size_t whole = end == std::string::npos ? 0 : end + 1;
    if (whole == 0 && line_.size() > kAtOnce) whole = line_.size();
    if (whole == 0) return;
    write(std::string_view(line_).substr(0, whole));
    line_.erase(0, whole);
  }
  void write(std::string_view text) {
    for (; !text.empty(); text.remove_prefix(std::min(kAtOnce, text.size()))) {
      const std::string_view part = text.substr(0, kAtOnce);
      if (has_room()) {
        const std::string whole = missing() + std::string(part);
        static_cast<void>(::write(STDERR_FILENO, whole.data(), whole.size()));
      } else {
        lost_ += static_cast<std::uint64_t>(std::count(part.begin(), part.end(), '\n'));
        waits_ = false;
      }
    }
  }
  bool has_room() const {
    pollfd room{STDERR_FILENO, POLLOUT, 0};
    return ::poll(&room, 1, waits_ ? kPatience_ms : 0) > 0;
  }
  /// What is to be said of those that were lost, now that there is room.
  std::string missing() {
    waits_ = true;
    const std::uint64_t lines = std::exchange(lost_, 0);
    return lines == 0 ? "" : "(" + std::to_string(lines) + " lines are missing here: nobody has read them)\n";
  }

  std::mutex mutex_;
  std::string line_;  ///< that has no end yet
  std::uint64_t lost_ = 0;
  bool waits_ = true;
};

}  // namespace

void wait_for_no_reader() {
  static Unread& unread = *new Unread;  // not destroyed: threads may speak at the very end
  std::cerr.rdbuf(&unread);
}

}  // namespace fiona::os
