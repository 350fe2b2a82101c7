// Sound, but it brings a proto file of the name that test-components brings too.
#include <fiona/plugin.hpp>

#include "fiona/test/test.fiona.hpp"

namespace fiona::zoo {

class Clock final : public Component {
 public:
  using Component::Component;

 private:
  void tick() { ticks_.put(Tick()); }
  Provides<Ticks> ticks_{*this, "ticks"};
  Task ticker_{*this, "ticker", std::chrono::milliseconds(1), &Clock::tick};
};

}  // namespace fiona::zoo

FIONA_PLUGIN(plugin) { plugin.add<fiona::zoo::Clock>("clashing-proto"); }
