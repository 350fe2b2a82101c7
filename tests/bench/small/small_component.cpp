// The least that a plugin can be, without messages of its own: what loading it costs is what loading costs.
#include <fiona/plugin.hpp>

#include "fiona/localisation.fiona.hpp"

namespace fiona::bench {

class Small final : public Component {
 public:
  using Component::Component;

 private:
  Provides<localisation::LocationProvider> location_{*this, "location"};
};

}  // namespace fiona::bench

FIONA_PLUGIN(plugin) { plugin.add<fiona::bench::Small>("small", "does nothing"); }
