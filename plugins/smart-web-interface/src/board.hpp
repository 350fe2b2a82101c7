#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <mutex>
#include <string>
#include <string_view>
#include <vector>

namespace fiona::smart_web_interface {

/// What all pages are shown: for each topic the newest text, and its version. A page that is slow skips what was
/// replaced meanwhile, and no queue grows. All functions [any thread].
class Board {
 public:
  struct News {
    std::string topic;
    std::string text;
  };

  /// Does nothing where the text is the one that is there.
  void set(std::string_view topic, std::string text) {
    std::function<void()> tell;
    {
      const std::lock_guard lock(mutex_);
      Entry& entry = topics_[std::string(topic)];
      if (entry.version != 0 && entry.text == text) return;
      entry = {std::move(text), ++version_};
      tell = changed_;
    }
    if (tell) tell();
  }
  /// What is newer than `seen`, in the order in which it was set; `seen` is then up to date.
  std::vector<News> since(std::uint64_t& seen) const {
    const std::lock_guard lock(mutex_);
    std::map<std::uint64_t, News> found;
    for (const auto& [topic, entry] : topics_) {
      if (entry.version > seen) found.emplace(entry.version, News{topic, entry.text});
    }
    seen = version_;
    std::vector<News> news;
    for (auto& [version, one] : found) news.push_back(std::move(one));
    return news;
  }
  /// Called after each change, on whichever thread made it.
  void on_change(std::function<void()> changed) {
    const std::lock_guard lock(mutex_);
    changed_ = std::move(changed);
  }

 private:
  struct Entry {
    std::string text{};
    std::uint64_t version = 0;
  };
  mutable std::mutex mutex_;
  std::map<std::string, Entry> topics_;
  std::uint64_t version_ = 0;
  std::function<void()> changed_;
};

}  // namespace fiona::smart_web_interface
