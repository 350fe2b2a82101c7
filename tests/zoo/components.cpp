// The components of the zoo: each library of it that gets as far as making one carries them all.
#include <fiona/plugin.hpp>

#include <stdexcept>

#include "fiona/localisation.fiona.hpp"

namespace fiona::zoo {

class Steps : public Component {
 public:
  using Component::Component;

 private:
  Provides<localisation::StepProvider> steps_{*this, "steps"};
};

/// Does in its constructor what belongs into `on_start`.
class ThrowsInFactory final : public Steps {
 public:
  explicit ThrowsInFactory(Hull& hull) : Steps(hull) { throw std::runtime_error("the antenna is not plugged in"); }
};

class FailsOnStart final : public Steps {
 public:
  using Steps::Steps;
  void on_start() override {
    throw Error(ErrorCode::NotFound, {.what = "there is no step counter on this machine", .next = "plug one in"});
  }
};

}  // namespace fiona::zoo

FIONA_PLUGIN(plugin) {
  plugin.add<fiona::zoo::ThrowsInFactory>("throws-in-factory");
  plugin.add<fiona::zoo::FailsOnStart>("fails-on-start");
  plugin.add<fiona::zoo::Steps>("lies");
}
