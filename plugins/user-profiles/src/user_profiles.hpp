#pragma once

#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "fiona/component.hpp"
#include "fiona/hmi.fiona.hpp"
#include "fiona/navigation.fiona.hpp"
#include "fiona/objects/session_user.hpp"
#include "fiona/records/record_store.hpp"
#include "fiona/security.fiona.hpp"
#include "fiona/user_profiles/params.pb.h"
#include "fiona/user_profiles/profile.pb.h"

namespace fiona::user_profiles {

/// What is known of the building: nothing where nobody has its map.
struct Building {
  std::vector<navigation::MapLevel> levels;
  std::vector<double> x_m, y_m;  ///< of the corners of its rooms: the least and the greatest
};

/// Keeps what each user can and wants on the way, and gives it to whoever carries the user's session.
class UserProfiles final : public Component {
 public:
  using Component::Component;

 private:
  using Parameters = user_profiles::Parameters;

  void on_start() override;
  void check(const Parameters& draft) const;

  Async<hmi::CommUserProfileReply> on_profile(const hmi::CommUserProfileRequest& request);
  Async<hmi::CommUserProfileReply> on_update(const hmi::CommUserProfileUpdate& request);
  Async<hmi::PointsOfAttentionReply> on_points(const hmi::RequestPointsOfAttention& request);

  Async<std::optional<security::SessionUser>> known_user(std::string name, std::string session, const char* what);
  Async<Building> building();
  Async<hmi::CommUserProfileReply> answer(std::optional<security::SessionUser> user);
  void keep(const std::string& user, const hmi::CommUserProfileUpdate& request);
  Profile profile_of(const std::string& user) const;

  Params<Parameters> params_{*this, &UserProfiles::check};
  Requires<security::SessionProvider> sessions_{
      *this, "sessions", {.optional = true, .doc = "whose a session is; without it there are guests only"}};
  Requires<navigation::LevelMap> levels_{
      *this, "levels", {.optional = true, .doc = "the building's levels: its maps, and where points can be"}};
  Provides<hmi::ProfileProvider> profile_{*this, "profile", &UserProfiles::on_profile};
  Provides<hmi::ProfileUpdate> update_{*this, "update", &UserProfiles::on_update};
  Provides<hmi::PointsOfAttention> points_{*this, "points", &UserProfiles::on_points};

  std::unique_ptr<records::RecordStore> store_;
  Building building_;
  TimePoint building_at_{};  ///< when it was asked for
};

}  // namespace fiona::user_profiles
