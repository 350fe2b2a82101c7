#pragma once

#include <chrono>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "fiona/component.hpp"
#include "fiona/hull.hpp"
#include "fiona/sdk_test/objects.pb.h"

namespace fiona::sdk_test {

/// Far more than any step of these tests takes: reached only when something hangs.
constexpr std::chrono::seconds kLimit(20);

inline Number numbered(std::uint64_t value) {
  Number number;
  number.set_value(value);
  return number;
}

/// Keeps what an instance told its surroundings.
class KeptEvents final : public HullEvents {
 public:
  void mode_changed(const std::string& instance, const std::string& mode, const std::string& reason) override {
    const std::lock_guard lock(mutex_);
    modes_.push_back(instance + " " + mode + (reason.empty() ? "" : ": " + reason));
  }
  void run_ended(const std::string&, int, const std::string&) override {}
  void logged(const std::string&, LogLevel, std::string_view) override {}
  void asked(const std::string&, std::uint64_t, const control::Request&) override {}
  std::vector<std::string> modes() const {
    const std::lock_guard lock(mutex_);
    return modes_;
  }

 private:
  mutable std::mutex mutex_;
  std::vector<std::string> modes_;
};

/// A component in its hull, shut down at the end.
template <class C>
class Made {
 public:
  Made(std::string name, Executor& executor, Clock& clock, HullEvents& events)
      : hull(std::move(name), {executor, clock, events, {}}) {
    hull.create([this](Hull& owner) {
      auto made = std::make_unique<C>(owner);
      component = made.get();
      return made;
    });
  }
  ~Made() {
    // A hull leaves a component that it cannot end to its caller; here nothing of it runs any more.
    if (hull.shut_down(std::chrono::seconds(5))) delete component;
  }
  C* operator->() const { return component; }

  Hull hull;
  C* component = nullptr;
};

}  // namespace fiona::sdk_test
