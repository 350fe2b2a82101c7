#include "delivery_log.hpp"

#include <fmt/format.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <iostream>
#include <tuple>

#include "fiona/error.hpp"

namespace fiona::host {

DeliveryLog::DeliveryLog(std::filesystem::path file) : file_(std::move(file)), out_(std::fopen(file_.c_str(), "we")) {
  if (out_) return;
  throw Error(ErrorCode::NotAllowed, {.what = "the delivery log cannot be written",
                                      .where = file_.string(),
                                      .found = std::strerror(errno),
                                      .next = "name a file in a folder that the host may write to"});
}

/// What was delivered last is written now: whoever asked for the log would take it for whole.
DeliveryLog::~DeliveryLog() {
  write();
  if (std::fclose(out_.release()) != 0) note_failure();
  if (failure_.empty() || told_) return;
  std::cerr << fmt::format("the delivery log {} cannot be written: {}; it is not whole: make room, then run it again\n",
                           file_.string(), failure_);
}

void DeliveryLog::begin_anew() {
  const std::lock_guard lock(mutex_);
  lines_.clear();
  const bool is_written = std::fflush(out_.get()) == 0;
  std::rewind(out_.get());
  // A device or a pipe has no beginning.
  if (!is_written || (::ftruncate(::fileno(out_.get()), 0) != 0 && errno != EINVAL)) note_failure();
}

void DeliveryLog::delivered(TimePoint at, std::string_view wire, std::uint64_t sequence, std::string_view what) {
  const std::lock_guard lock(mutex_);
  at_ = at;
  lines_.push_back({std::string(wire), sequence, std::string(what)});
}

void DeliveryLog::round(TimePoint at) {
  const std::lock_guard lock(mutex_);
  if (at != at_ || lines_.size() >= kMaxLines) write();
}

void DeliveryLog::write() {
  std::sort(lines_.begin(), lines_.end(), [](const Line& a, const Line& b) {
    return std::tie(a.wire, a.sequence, a.what) < std::tie(b.wire, b.sequence, b.what);
  });
  const std::int64_t ns = at_.time_since_epoch().count();
  std::string text;
  for (const Line& line : lines_) {
    fmt::format_to(std::back_inserter(text), "{}.{:09} {} {} {}\n", ns / 1'000'000'000, ns % 1'000'000'000, line.wire,
                   line.sequence, line.what);
  }
  lines_.clear();
  const bool written = std::fwrite(text.data(), 1, text.size(), out_.get()) == text.size();
  // What stayed in memory would be found to have no room only when nobody waits for time any more.
  if (!written || std::fflush(out_.get()) != 0) note_failure();
}

void DeliveryLog::note_failure() {
  if (failure_.empty()) failure_ = std::strerror(errno);
}

std::string DeliveryLog::failure() const {
  const std::lock_guard lock(mutex_);
  told_ = told_ || !failure_.empty();
  return failure_;
}

}  // namespace fiona::host
