#pragma once

#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "fiona/component.hpp"
#include "fiona/hull.hpp"

namespace fiona::sdk_test {

/// Keeps what an instance told its surroundings.
class KeptEvents final : public HullEvents {
 public:
  void mode_changed(const std::string& instance, const std::string& mode, const std::string& reason) override {
    const std::lock_guard lock(mutex_);
    modes_.push_back(instance + " " + mode + (reason.empty() ? "" : ": " + reason));
  }
  void run_ended(const std::string&, int, const std::string&) override {}
  void logged(const std::string&, LogLevel, std::string_view) override {}
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
    if (!hull.shut_down(std::chrono::seconds(5))) delete component;
  }
  C* operator->() const { return component; }

  Hull hull;
  C* component = nullptr;
};

}  // namespace fiona::sdk_test
