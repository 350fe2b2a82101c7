#include "fiona/plugin.hpp"

#include "authenticator.hpp"

FIONA_PLUGIN(plugin) {
  plugin.add<fiona::authenticator::Authenticator>("authenticator",
                                                  "checks names and passwords, and says whose a session is");
}
