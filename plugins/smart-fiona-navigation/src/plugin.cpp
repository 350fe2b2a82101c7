#include "fiona/plugin.hpp"

#include "navigation.hpp"

FIONA_PLUGIN(plugin) {
  plugin.add<fiona::guidance::Navigation>("smart-fiona-navigation",
                                          "leads a person to a room, by what the person's profile allows");
}
