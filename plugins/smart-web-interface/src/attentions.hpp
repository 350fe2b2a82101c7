#pragma once

#include <chrono>
#include <cstddef>
#include <deque>
#include <string>
#include <utility>

#include "fiona/hmi.pb.h"
#include "fiona/time.hpp"
#include "to_json.hpp"

namespace fiona::smart_web_interface {

/// What a guide has just told beside the instruction that holds, for as long as it is news: it is over by the time that
/// somebody opens the page.
class Attentions {
 public:
  static constexpr auto kNews = std::chrono::seconds(8);
  static constexpr std::size_t kMost = 4;

  void add(const hmi::Instruction& attention, TimePoint told) {
    told_.emplace_back(told, instruction_json(attention));
    if (told_.size() > kMost) told_.pop_front();
  }
  /// A JSON list of those that are still news, the oldest first.
  std::string json(TimePoint now) {
    while (!told_.empty() && now - told_.front().first >= kNews) told_.pop_front();
    std::string list;
    for (const auto& [at, text] : told_) list += (list.empty() ? "" : ",") + text;
    return "[" + list + "]";
  }

 private:
  std::deque<std::pair<TimePoint, std::string>> told_;
};

}  // namespace fiona::smart_web_interface
