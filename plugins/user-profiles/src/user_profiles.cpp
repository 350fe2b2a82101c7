#include "user_profiles.hpp"

#include <algorithm>
#include <charconv>
#include <chrono>

#include "fiona/objects/landmark.hpp"
#include "fiona/records/data_directory.hpp"

namespace fiona::user_profiles {
namespace {

constexpr std::string_view kTable = "profile";
constexpr auto kDeadline = std::chrono::milliseconds(500);
/// A building changes with its file: hardly ever.
constexpr auto kBuildingKept = std::chrono::seconds(10);
/// Before the door one may want to be told of something, too.
constexpr double kAround_m = 20.0;

std::string number(double value) {
  char text[32];
  return {text, std::to_chars(text, text + sizeof(text), value).ptr};
}

void widen(std::vector<double>& bounds, const google::protobuf::RepeatedField<double>& by) {
  bounds.insert(bounds.end(), by.begin(), by.end());
  if (bounds.empty()) return;
  const auto [least, greatest] = std::minmax_element(bounds.begin(), bounds.end());
  bounds = {*least, *greatest};
}

bool is_around(double value, const std::vector<double>& bounds) {
  return bounds.empty() || (value >= bounds.front() - kAround_m && value <= bounds.back() + kAround_m);
}

/// Why it cannot be watched, in words for the user; empty: it can.
std::string fault_of(const hmi::PointOfAttention& point, const Building& building) {
  if (!point.has_level()) return "it is not said on which level it is";
  const auto is_its = [&](const navigation::MapLevel& level) { return level.level() == point.level(); };
  if (!building.levels.empty() && std::none_of(building.levels.begin(), building.levels.end(), is_its)) {
    return "the building has no level " + number(point.level());
  }
  if (is_around(point.x(), building.x_m) && is_around(point.y(), building.y_m)) return {};
  return "it is more than " + number(kAround_m) + " m away from the building";
}

}  // namespace

void UserProfiles::check(const Parameters& draft) const {
  if (!store_ || draft.database() == params_->database()) return;
  throw Error(ErrorCode::NotAllowed, {.what = "the database is in use: another one takes another start",
                                      .where = name(),
                                      .next = "unload " + name() + ", then load it with database=FILE"});
}

void UserProfiles::on_start() {
  const std::string& given = params_->database();
  store_ = std::make_unique<records::RecordStore>(
      given.empty() ? records::data_file("profiles.db") : std::filesystem::path(given), "profiles");
}

Profile UserProfiles::profile_of(const std::string& user) const {
  Profile profile;
  if (const auto bytes = store_->get(kTable, user)) profile.ParseFromString(*bytes);
  return profile;
}

/// Somebody in particular, for whom `what` can be kept; nobody where the session has ended.
Async<std::optional<security::SessionUser>> UserProfiles::known_user(std::string user_name, std::string session,
                                                                     const char* what) {
  auto user = co_await security::session_user(sessions_, std::move(user_name), std::move(session));
  if (user && user->name.empty()) {
    throw Error(ErrorCode::NotAllowed, {.what = std::string("a guest has no ") + what + " that could be kept",
                                        .where = name(),
                                        .next = "log in first"});
  }
  co_return user;
}

Async<Building> UserProfiles::building() {
  if (!building_.levels.empty() && now() - building_at_ < kBuildingKept) co_return building_;
  const auto map = co_await levels_.query({}, kDeadline);
  if (map) {
    building_ = {{(*map)->levels().begin(), (*map)->levels().end()}, {}, {}};
    for (const navigation::MapRoom& room : (*map)->rooms()) {
      widen(building_.x_m, room.outline().x());
      widen(building_.y_m, room.outline().y());
    }
    building_at_ = now();
  }
  co_return building_;
}

Async<hmi::CommUserProfileReply> UserProfiles::answer(std::optional<security::SessionUser> user) {
  hmi::CommUserProfileReply reply;
  if (!user) {
    reply.set_session_ended(true);
    co_return reply;
  }
  reply.set_authentication_level(user->level);
  const Building known = co_await building();
  for (const navigation::MapLevel& level : known.levels) reply.add_map_list(level.map_name());
  if (user->name.empty()) co_return reply;
  const Profile profile = profile_of(user->name);
  if (profile.has_use_elevator()) reply.set_use_elevator(profile.use_elevator());
  if (profile.has_use_stairs()) reply.set_use_stairs(profile.use_stairs());
  if (profile.has_use_outdoor_navigation()) reply.set_use_outdoor_navigation(profile.use_outdoor_navigation());
  for (const hmi::PointOfAttention& point : profile.points()) reply.add_landmark_list(hmi::landmark_text(point));
  co_return reply;
}

Async<hmi::CommUserProfileReply> UserProfiles::on_profile(const hmi::CommUserProfileRequest& request) {
  auto user = co_await security::session_user(sessions_, request.user_name(), request.session());
  auto reply = co_await answer(std::move(user));
  co_return reply;
}

Async<hmi::CommUserProfileReply> UserProfiles::on_update(const hmi::CommUserProfileUpdate& asked) {
  const hmi::CommUserProfileUpdate request = asked;  // it may be gone when the session has been checked
  auto user = co_await known_user(request.user_name(), request.session(), "profile");
  if (user) keep(user->name, request);
  auto reply = co_await answer(std::move(user));
  co_return reply;
}

void UserProfiles::keep(const std::string& user, const hmi::CommUserProfileUpdate& request) {
  Profile profile = profile_of(user);
  profile.clear_use_elevator();
  profile.clear_use_stairs();
  profile.clear_use_outdoor_navigation();
  if (request.has_use_elevator()) profile.set_use_elevator(request.use_elevator());
  if (request.has_use_stairs()) profile.set_use_stairs(request.use_stairs());
  if (request.has_use_outdoor_navigation()) profile.set_use_outdoor_navigation(request.use_outdoor_navigation());
  store_->put(kTable, user, profile.SerializeAsString());
}

Async<hmi::PointsOfAttentionReply> UserProfiles::on_points(const hmi::RequestPointsOfAttention& asked) {
  const hmi::RequestPointsOfAttention request = asked;
  const auto user = co_await known_user(request.user_name(), request.session(), "points of attention");
  if (!user) throw security::session_ended(name());
  const Building known = co_await building();
  Profile profile = profile_of(user->name);
  profile.clear_points();
  hmi::PointsOfAttentionReply reply;
  for (int i = 0; i < request.points_of_attention_size(); ++i) {
    const hmi::PointOfAttention& point = request.points_of_attention(i);
    const std::string fault = fault_of(point, known);
    if (fault.empty()) {
      *profile.add_points() = point;
    } else {
      reply.add_refused(static_cast<std::uint32_t>(i));
      reply.add_reason(fault);
    }
  }
  store_->put(kTable, user->name, profile.SerializeAsString());
  co_return reply;
}

}  // namespace fiona::user_profiles
