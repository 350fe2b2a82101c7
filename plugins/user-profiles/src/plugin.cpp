#include "fiona/plugin.hpp"

#include "user_profiles.hpp"

FIONA_PLUGIN(plugin) {
  plugin.add<fiona::user_profiles::UserProfiles>(
      "user-profiles", "what each user can and wants on the way: lift, stairs, outdoors, points of attention");
}
