#pragma once

#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "attentions.hpp"
#include "board.hpp"
#include "fiona/component.hpp"
#include "fiona/hmi.fiona.hpp"
#include "fiona/localisation.fiona.hpp"
#include "fiona/master.hpp"
#include "fiona/navigation.fiona.hpp"
#include "fiona/options.pb.h"
#include "fiona/records/record_store.hpp"
#include "fiona/security.fiona.hpp"
#include "fiona/smart_web_interface/params.pb.h"
#include "local_authority.hpp"
#include "page_calls.hpp"
#include "page_sessions.hpp"
#include "web_server.hpp"

namespace fiona::smart_web_interface {

/// Shows a page with the building, the walker, the way and its steps; takes destinations, log-ins and profiles from it.
class WebInterface final : public Component {
 public:
  using Component::Component;

 private:
  using Parameters = smart_web_interface::Parameters;
  using Answer = std::shared_ptr<Responder>;

  void on_start() override;
  void on_stop() override;
  void serve_at(std::uint16_t port);
  void check(const Parameters& draft) const;
  Link make_link(const None&);

  void on_location(const Received<localisation::CommLocation>& location);
  void on_path(const navigation::CommPath& path);
  void on_instruction(const Received<hmi::Instruction>& instruction);
  void on_map_change(const Fired<navigation::LevelMapVersion>& change);
  void look();
  Async<> look_for_map();
  Async<> fetch_map();
  void forget_guidance();
  void tell_status();
  std::string map_fault() const;

  /// [the server's thread]
  void on_call(ApiCall call, std::string from, std::shared_ptr<Responder> respond);
  Async<> serve(std::string bearer, PageCall call, std::string from, Answer answer);
  Async<> log_in(std::string bearer, Login login, std::string from, Answer answer);
  Async<> log_out(std::string bearer, Answer answer);
  Async<> set_profile(std::string bearer, SetProfile profile, Answer answer);
  Async<> set_points(std::string bearer, SetPoints points, Answer answer);
  Async<> set_destination(std::string bearer, SetDestination destination, Answer answer);
  bool forget_user(const std::string& bearer, const PageUser& ended);
  Async<> tell_me(std::string bearer, Answer answer, std::string notice = {});
  Async<> tell_system(int level, Answer answer);
  Async<> rewire(Rewire wanted, Answer answer);
  Async<Result<control::System>> system();
  Async<int> level_of_user(std::string bearer);
  std::optional<PageUser> user_of(const std::string& bearer) const { return pages_->user(bearer, now()); }

  Params<Parameters> params_{*this, &WebInterface::check};
  Requires<localisation::LocationProvider> location_{
      *this,
      "location",
      &WebInterface::on_location,
      {.optional = true, .doc = "where the walker is", .delivery = Delivery::Newest}};
  Requires<navigation::PathProvider> path_{
      *this,
      "path",
      &WebInterface::on_path,
      {.optional = true, .doc = "the way to the destination", .delivery = Delivery::Newest}};
  Requires<hmi::InstructionProvider> instructions_{
      *this, "instructions", &WebInterface::on_instruction, {.optional = true, .doc = "what the walker is to do next"}};
  Requires<navigation::DestinationProvider> destination_{
      *this, "destination", {.optional = true, .doc = "takes the destination that was picked"}};
  Requires<navigation::LevelMap> levels_{
      *this, "levels", {.optional = true, .doc = "rooms, walls and entrances of the building"}};
  Requires<navigation::LevelMapChange> map_change_{*this,
                                                   "map_change",
                                                   &WebInterface::on_map_change,
                                                   {.optional = true, .doc = "tells that the map is another one"}};
  Requires<security::AuthenticationProvider> login_{
      *this, "login", {.optional = true, .doc = "checks who logs in; without it there are guests only"}};
  Requires<security::SessionProvider> sessions_{
      *this, "sessions", {.optional = true, .doc = "whether who logged in still is"}};
  Requires<security::LogoutProvider> logout_{*this, "logout", {.optional = true, .doc = "ends a session"}};
  Requires<hmi::ProfileProvider> profile_{*this, "profile", {.optional = true, .doc = "the user's profile"}};
  Requires<hmi::ProfileUpdate> update_{*this, "update", {.optional = true, .doc = "sets the user's preferences"}};
  Requires<hmi::PointsOfAttention> points_{
      *this, "points", {.optional = true, .doc = "sets the points that the user is told of"}};
  Master master_{*this};
  Trigger<None, Link> link_{
      *this, "link", &WebInterface::make_link, {.doc = "an address that opens the page, once, within ten minutes"}};
  Probe<std::uint64_t> connections_{*this, "connections", {.doc = "open connections of pages"}};
  /// A provider whose process has died is back after a tenth of a second: whoever trusted it meanwhile is to know.
  Task status_{*this, "status", std::chrono::milliseconds(50), &WebInterface::tell_status};
  Task look_{*this, "look", std::chrono::milliseconds(250), &WebInterface::look};
  /// Its own: a map server that does not answer is to hold up nothing else.
  Task map_task_{*this, "map", std::chrono::milliseconds(250), &WebInterface::look_for_map};

  Board board_;
  Attentions attentions_;
  std::unique_ptr<records::RecordStore> store_;
  std::unique_ptr<PageSessions> pages_;
  std::unique_ptr<LocalAuthority> authority_;  ///< null where only this machine is served
  std::unique_ptr<WebServer> server_;
  std::shared_ptr<const std::string> map_;       ///< as JSON; null: there is none yet
  std::uint64_t map_version_ = 0;                ///< 0: it is to be asked for
  std::optional<std::uint64_t> told_version_{};  ///< of a map that has changed since it was asked for
  std::string map_fault_;                        ///< why the newest request for it gave none
  std::optional<ActivationId> activation_;
  std::optional<std::pair<TimePoint, control::System>> system_;  ///< as it was a moment ago
};

}  // namespace fiona::smart_web_interface
