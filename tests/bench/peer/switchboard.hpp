// Where the harness' threads meet the components that run in the same process. The program has one, which the plugin
// finds by the symbol's name; a component registers under its instance's name once it has been started.
#pragma once

#include <algorithm>
#include <atomic>
#include <chrono>
#include <condition_variable>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <stdexcept>
#include <string>
#include <string_view>

namespace fiona::peer {

/// Longer than a run of the harness, which ends one after 12 s.
constexpr std::chrono::seconds kRunEnds{15};

/// How many messages of this size the publisher may be ahead of its slowest consumer, so that none is lost: the peers'
/// queues hold 1000 on either side, and one of our wires 4 MiB, among them what its consumer is at.
constexpr std::uint64_t window_of(std::size_t bytes) {
  return std::clamp<std::uint64_t>(2 * 1024 * 1024 / std::max<std::size_t>(bytes, 1), 2, 2000);
}

/// Publishes for the harness, on the harness' thread: the component's strand has been lent to it.
class Publisher {
 public:
  virtual ~Publisher() = default;
  virtual void prepare(std::string_view data) = 0;
  virtual void send(std::string_view header) = 0;
};

/// Asks for the harness, and waits for the answer.
class Asker {
 public:
  virtual ~Asker() = default;
  virtual void call(std::string_view question) = 0;
};

/// What the harness wants to be called with; may be replaced while messages come.
class Ear {
 public:
  using OnData = std::function<void(std::string_view)>;
  void set(OnData on_data) {
    const std::lock_guard lock(mutex_);
    on_data_ = std::move(on_data);
  }
  void hear(std::string_view data) {
    const std::lock_guard lock(mutex_);
    if (on_data_) on_data_(data);
  }

 private:
  std::mutex mutex_;
  OnData on_data_;
};

/// How far the consumers are that have said so.
class Gate {
 public:
  void seen(std::size_t consumer, std::uint64_t number) {
    {
      const std::lock_guard lock(mutex_);
      seen_[consumer] = std::max(seen_[consumer], number);
    }
    moved_.notify_all();
  }
  /// Waits until message `number` may be put; the highest number that may be put then. A consumer that has gone does
  /// not hold up the publisher for ever: what it loses is the harness' to count.
  std::uint64_t room_for(std::uint64_t number, std::uint64_t window) {
    std::unique_lock lock(mutex_);
    const auto slowest = [this] {
      auto least = UINT64_MAX;
      for (const auto& [consumer, seen] : seen_) least = std::min(least, seen);
      return least;
    };
    moved_.wait_for(lock, std::chrono::seconds(2), [&] { return seen_.empty() || slowest() + window >= number; });
    return seen_.empty() ? number : std::max(number, slowest() + window);
  }

 private:
  std::mutex mutex_;
  std::condition_variable moved_;
  std::map<std::size_t, std::uint64_t> seen_;
};

class Switchboard {
 public:
  /// [strand] Gives the strand to the harness' thread: returns when the run is over.
  void lend(const std::string& instance, Publisher& publisher) {
    std::unique_lock lock(mutex_);
    publishers_[instance] = &publisher;
    changed_.notify_all();
    changed_.wait_for(lock, kRunEnds, [this] { return over_; });
    publishers_.erase(instance);
  }
  void start(const std::string& instance, Asker* asker = nullptr) {
    const std::lock_guard lock(mutex_);
    started_[instance] = asker;
    changed_.notify_all();
  }

  Publisher& publisher(const std::string& instance) { return *wait_for(publishers_, instance); }
  Asker& asker(const std::string& instance) { return *wait_for(started_, instance); }
  void await(const std::string& instance) { wait_for(started_, instance); }
  /// The same for the one who hears and the one who wants to.
  Ear& ear(const std::string& instance) {
    const std::lock_guard lock(mutex_);
    return ears_[instance];
  }
  Gate& gate() { return gate_; }
  void end() {
    const std::lock_guard lock(mutex_);
    over_ = true;
    changed_.notify_all();
  }

 private:
  template <class T>
  T* wait_for(const std::map<std::string, T*>& all, const std::string& instance) {
    std::unique_lock lock(mutex_);
    if (!changed_.wait_for(lock, kRunEnds, [&] { return all.contains(instance); })) {
      throw std::runtime_error("there is no instance " + instance);
    }
    return all.at(instance);
  }

  std::mutex mutex_;
  std::condition_variable changed_;
  std::map<std::string, Publisher*> publishers_;
  std::map<std::string, Asker*> started_;
  std::map<std::string, Ear> ears_;
  Gate gate_;
  bool over_ = false;
};

constexpr const char* kSwitchboardSymbol = "fiona_peer_switchboard";
using SwitchboardFunction = Switchboard* (*)();

}  // namespace fiona::peer
