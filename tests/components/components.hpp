// Components that the conformance tests load as any system would: from a library, through the host.
#pragma once

#include <fiona/plugin.hpp>

#include <chrono>

#include "fiona/test/patterns.fiona.hpp"
#include "fiona/test/test.fiona.hpp"

namespace fiona::test {

using namespace std::chrono_literals;

inline std::int64_t steady_ns() { return std::chrono::steady_clock::now().time_since_epoch().count(); }

inline Duration from_ms(double ms) {
  return std::chrono::duration_cast<Duration>(std::chrono::duration<double, std::milli>(ms));
}

/// Ticks from the moment when it becomes active, as long as each tick says when the next one is.
class Paced : public Component {
 public:
  using Component::Component;
  void on_mode(std::string_view mode) override {
    if (mode == kModeActive) next_.at(now());
  }

 protected:
  virtual void tick() = 0;
  void again_after(double ms) { next_.at(now() + from_ms(ms)); }

 private:
  Timer next_{*this, &Paced::tick};
};

void add_pacing(Plugin& plugin);
void add_push(Plugin& plugin);
void add_query(Plugin& plugin);
void add_calls(Plugin& plugin);
void add_state(Plugin& plugin);
void add_tasks(Plugin& plugin);
void add_rewiring(Plugin& plugin);
void add_alternatives(Plugin& plugin);
void add_master(Plugin& plugin);
void add_silence(Plugin& plugin);
void add_standing(Plugin& plugin);
void add_monitoring(Plugin& plugin);
void add_virtual_time(Plugin& plugin);
void add_holding(Plugin& plugin);
void add_whole(Plugin& plugin);

}  // namespace fiona::test
