#include "web_interface.hpp"

#include <sodium.h>

#include <algorithm>
#include <cmath>
#include <fstream>
#include <nlohmann/json.hpp>

#include "fiona/hull.hpp"
#include "fiona/objects/landmark.hpp"
#include "fiona/records/data_directory.hpp"
#include "system_json.hpp"
#include "to_json.hpp"

namespace fiona::smart_web_interface {
namespace {

using nlohmann::json;

constexpr auto kDeadline = std::chrono::seconds(2);
constexpr auto kRewireDeadline = std::chrono::seconds(5);
/// Many pages that look at the system ask the host once.
constexpr auto kSystemKept = std::chrono::milliseconds(400);
/// Attempts wait for each other: see the authenticator.
constexpr auto kLoginDeadline = std::chrono::seconds(10);
constexpr const char* kNothing = "null";  // as JSON
constexpr std::string_view kAuthorityFile = "authority.crt";
constexpr std::string_view kFiles[] = {"index.html", "page.js", "page.css", "icon.svg"};

Duration seconds(double value) { return std::chrono::duration_cast<Duration>(std::chrono::duration<double>(value)); }

WebReply refusal(int status, std::string text) { return {status, text_of({{"error", std::move(text)}})}; }

std::string first_line(const std::string& text) { return text.substr(0, text.find('\n')); }

/// What an outcome means for who reads the page.
WebReply no_answer(const std::string& who, Outcome outcome, const std::string& reason) {
  if (outcome == Outcome::Unwired) return refusal(503, who + " is not part of this system");
  if (outcome == Outcome::Rejected) return refusal(409, first_line(reason));
  return refusal(503, who + " does not answer");
}

json choice(bool has, bool value) { return has ? json(value) : json(nullptr); }

json profile_json(const hmi::CommUserProfileReply& profile) {
  json points = json::array();
  for (const std::string& text : profile.landmark_list()) {
    if (const auto point = hmi::parse_landmark(text)) {
      points.push_back({{"x", point->x()}, {"y", point->y()}, {"level", point->level()}, {"name", point->name()}});
    }
  }
  return {{"level", profile.authentication_level()},
          {"use_elevator", choice(profile.has_use_elevator(), profile.use_elevator())},
          {"use_stairs", choice(profile.has_use_stairs(), profile.use_stairs())},
          {"use_outdoor_navigation", choice(profile.has_use_outdoor_navigation(), profile.use_outdoor_navigation())},
          {"points", points}};
}

std::string_view state_of(const RequiredPort& port) {
  switch (port.connection()) {
    case Connection::Connected: return "connected";
    case Connection::Waiting: return "waiting";
    case Connection::Lost: return "lost";
    default: return "unwired";
  }
}

std::string content_of(const std::filesystem::path& file) {
  std::ifstream in(file, std::ios::binary);
  return {std::istreambuf_iterator<char>(in), {}};
}

}  // namespace

void WebInterface::check(const Parameters& draft) const {
  if (!server_) return;
  if (draft.address() == params_->address() && draft.port() == params_->port() &&
      draft.database() == params_->database()) {
    return;
  }
  throw Error(ErrorCode::NotAllowed, {.what = "the page is being served: only session_time can still be changed",
                                      .where = name(),
                                      .next = "unload " + name() + ", then load it with the new parameters"});
}

void WebInterface::on_start() {
  const std::string& given = params_->database();
  store_ = std::make_unique<records::RecordStore>(
      given.empty() ? records::data_file("web.db") : std::filesystem::path(given), "pages");
  authority_.reset();
  if (!WebServer::is_loopback(params_->address())) {
    authority_ = std::make_unique<LocalAuthority>(*store_, std::chrono::system_clock::now());
    if (authority_->is_replaced()) {
      log(LogLevel::Warning, "the page's authority neared its end, and is a new one: devices have to be paired again");
    }
  }
  pages_ = std::make_unique<PageSessions>(*store_, now(), seconds(params_->session_time()));
  const auto last = store_->get("setting", "port");
  if (params_->port() != 0 || !last) {
    serve_at(static_cast<std::uint16_t>(params_->port()));
  } else {
    try {
      serve_at(static_cast<std::uint16_t>(std::stoul(*last)));
    } catch (const Error& taken) {
      log(LogLevel::Warning,
          std::string("another port than last time, pages that are open do not find it: ") + taken.what());
      serve_at(0);
    }
  }
  store_->put("setting", "port", std::to_string(server_->port()));
  tell_status();
  log(LogLevel::Info, "the page is at " + server_->url() + "; call " + name() + ".link opens it");
}

void WebInterface::on_stop() { server_.reset(); }

void WebInterface::serve_at(std::uint16_t port) {
  WebServer::Settings settings{
      .address = params_->address(),
      .port = port,
      .files = {},
      .board = board_,
      .on_call = [this](ApiCall call, std::string from,
                        Answer respond) { on_call(std::move(call), std::move(from), std::move(respond)); },
      .is_open = [this](const std::string& bearer) { return pages_->is_open(bearer, now()); }};
  for (const std::string_view file : kFiles) settings.files.emplace(file, content_of(resource(file)));
  if (authority_) {
    settings.proof = authority_->prove(params_->address(), std::chrono::system_clock::now());
    settings.files.emplace(kAuthorityFile, authority_->certificate());
  }
  server_ = std::make_unique<WebServer>(std::move(settings));
}

Link WebInterface::make_link(const None&) {
  Link link;
  // Behind '#' no browser sends it anywhere, nor does it come into a log.
  link.set_url(server_->url() + "/#" + pages_->make_token(now()));
  if (authority_) {
    link.set_authority(server_->url() + "/" + std::string(kAuthorityFile));
    link.set_fingerprint(authority_->fingerprint());
  }
  link.set_valid_for(static_cast<std::uint32_t>(std::chrono::seconds(PageSessions::kTokenTime).count()));
  return link;
}

void WebInterface::on_location(const Received<localisation::CommLocation>& location) {
  board_.set("location", location_json(*location, location.origin));
  tell_status();
}

void WebInterface::on_path(const navigation::CommPath& path) { board_.set("path", path_json(path)); }

void WebInterface::on_instruction(const Received<hmi::Instruction>& instruction) {
  // It stands beside the instruction that holds, which is still what is to be done.
  if (instruction->kind() == hmi::Instruction::ATTENTION) {
    attentions_.add(*instruction, instruction.origin);
    board_.set("attention", attentions_.json(now()));
  } else {
    const bool guides = instruction->kind() != hmi::Instruction::KIND_UNSPECIFIED;
    board_.set("instruction", guides ? instruction_json(*instruction) : kNothing);
  }
}

void WebInterface::on_map_change(const Fired<navigation::LevelMapVersion>& change) {
  told_version_ = change->version();
  if (*told_version_ != map_version_) map_version_ = 0;
}

/// What a guide has said that is gone holds no more, not even once it is back.
void WebInterface::forget_guidance() {
  if (path_.connection() != Connection::Connected) board_.set("path", path_json({}));
  if (instructions_.connection() != Connection::Connected) board_.set("instruction", kNothing);
}

void WebInterface::tell_status() {
  forget_guidance();
  board_.set("status", text_of({{"location", state_of(location_)},
                                {"path", state_of(path_)},
                                {"instructions", state_of(instructions_)},
                                {"destination", state_of(destination_)},
                                {"map", state_of(levels_)},
                                {"mapFault", map_fault()},
                                {"login", state_of(login_)},
                                {"profile", state_of(profile_)},
                                {"points", state_of(points_)}}));
}

std::string WebInterface::map_fault() const {
  return levels_.connection() == Connection::Connected ? map_fault_ : levels_.connection_reason();
}

void WebInterface::look() {
  connections_.set(server_->connections());
  board_.set("attention", attentions_.json(now()));
}

Async<> WebInterface::look_for_map() {
  if (map_change_.connection() == Connection::Connected && !activation_) {
    // With no version, which each provider's differs from: whoever serves next tells its own at once.
    const auto made = co_await map_change_.activate(EventMode::Continuous, {});
    if (made) activation_ = *made;
  }
  // Who comes after a provider that was lost may have another building.
  if (levels_.connection() != Connection::Connected) map_version_ = 0;
  if (levels_.connection() == Connection::Connected && map_version_ == 0) co_await fetch_map();
}

Async<> WebInterface::fetch_map() {
  told_version_.reset();
  const auto map = co_await levels_.query({}, kDeadline);
  map_fault_ = map ? "" : map.outcome() == Outcome::Rejected ? first_line(map.reason()) : "it does not answer";
  if (!map) co_return;
  // One that has changed on the way is asked for again.
  map_version_ = told_version_ && *told_version_ != (*map)->version() ? 0 : (*map)->version();
  map_ = std::make_shared<const std::string>(map_json(**map));
  // In words: JavaScript's numbers end at 2^53.
  board_.set("map", text_of({{"version", std::to_string((*map)->version())}}));
}

void WebInterface::on_call(ApiCall call, std::string from, Answer respond) {
  auto read = read_call(call);
  if (const auto* fault = std::get_if<Refusal>(&read)) return respond->answer(refusal(fault->status, fault->text));
  hull().strand().post([this, bearer = std::move(call.bearer), page_call = std::get<PageCall>(std::move(read)),
                        from = std::move(from), respond]() mutable {
    hull().spawn(serve(std::move(bearer), std::move(page_call), std::move(from), std::move(respond)), Job([] {}));
  });
}

Async<> WebInterface::serve(std::string bearer, PageCall call, std::string from, Answer answer) {
  int level = 0;
  if (const int needed = level_of(call); needed > 0) {
    level = co_await level_of_user(bearer);
    if (level < needed) {
      answer->answer(refusal(
          403, "this takes the access level " + std::to_string(needed) + ", and you have " + std::to_string(level)));
      co_return;
    }
  }
  if (const auto* open = std::get_if<OpenSession>(&call)) {
    const auto session = pages_->open(open->token, open->number, now(), seconds(params_->session_time()));
    answer->answer(session ? WebReply{200, text_of({{"session", *session}})}
                           : refusal(403, "this link has been used, or is too old: ask for a new one"));
  } else if (std::holds_alternative<GetMap>(call)) {
    answer->answer(map_ ? WebReply{200, *map_} : refusal(503, "there is no map yet"));
  } else if (std::holds_alternative<GetMe>(call)) {
    co_await tell_me(std::move(bearer), std::move(answer));
  } else if (auto* login = std::get_if<Login>(&call)) {
    co_await log_in(std::move(bearer), std::move(*login), std::move(from), std::move(answer));
  } else if (std::holds_alternative<Logout>(call)) {
    co_await log_out(std::move(bearer), std::move(answer));
  } else if (auto* profile = std::get_if<SetProfile>(&call)) {
    co_await set_profile(std::move(bearer), *profile, std::move(answer));
  } else if (auto* points = std::get_if<SetPoints>(&call)) {
    co_await set_points(std::move(bearer), std::move(*points), std::move(answer));
  } else if (auto* destination = std::get_if<SetDestination>(&call)) {
    co_await set_destination(std::move(bearer), std::move(*destination), std::move(answer));
  } else if (std::holds_alternative<GetSystem>(call)) {
    co_await tell_system(level, std::move(answer));
  } else if (auto* wanted = std::get_if<Rewire>(&call)) {
    co_await rewire(std::move(*wanted), std::move(answer));
  }
}

Async<> WebInterface::log_in(std::string bearer, Login login, std::string from, Answer answer) {
  security::CommAuthenticationRequest request;
  request.set_username(login.name);
  request.set_password(login.password);
  request.set_source(from);
  sodium_memzero(login.password.data(), login.password.size());
  const auto response = co_await login_.query(std::move(request), kLoginDeadline);
  if (!response) {
    answer->answer(no_answer("the log-in", response.outcome(), response.reason()));
    co_return;
  }
  if (!(*response)->access_granted()) {
    answer->answer(refusal(403, "name and password do not fit"));
    co_return;
  }
  PageUser user;
  // As the account has it: capitals are not told apart.
  user.set_name((*response)->user_name().empty() ? login.name : (*response)->user_name());
  user.set_session((*response)->session());
  pages_->set_user(bearer, user, now());
  co_await tell_me(std::move(bearer), std::move(answer));
}

Async<> WebInterface::log_out(std::string bearer, Answer answer) {
  const auto user = user_of(bearer);
  pages_->set_user(bearer, std::nullopt, now());
  std::string notice;
  if (user) {
    security::CommSessionRequest request;
    request.set_session(user->session());
    const auto ended = co_await logout_.query(std::move(request), kDeadline);
    if (!ended) notice = "You are logged out here; the session itself could not be ended.";
  }
  co_await tell_me(std::move(bearer), std::move(answer), std::move(notice));
}

/// Whether it was this user's page still: somebody may have logged in, or out, since the session was asked about.
bool WebInterface::forget_user(const std::string& bearer, const PageUser& ended) {
  const auto user = user_of(bearer);
  if (!user || user->session() != ended.session()) return false;
  return pages_->set_user(bearer, std::nullopt, now());
}

/// Who uses the page: {user, profile, notice}. A user whose session has ended is a guest, and is told.
Async<> WebInterface::tell_me(std::string bearer, Answer answer, std::string notice) {
  for (;;) {
    const auto user = user_of(bearer);
    bool has_ended = false;
    hmi::CommUserProfileRequest request;
    if (user) {
      request.set_user_name(user->name());
      request.set_session(user->session());
    }
    if (user && sessions_.connection() == Connection::Connected) {
      security::CommSessionRequest whose;
      whose.set_session(user->session());
      const auto session = co_await sessions_.query(std::move(whose), kDeadline);
      has_ended = session && !(*session)->is_valid();
    }
    if (!has_ended) {
      const auto profile = co_await profile_.query(std::move(request), kDeadline);
      has_ended = user && profile && (*profile)->session_ended();
      if (!has_ended) {
        answer->answer({200, text_of({{"user", user ? json(user->name()) : json(nullptr)},
                                      {"profile", profile ? profile_json(**profile) : json(nullptr)},
                                      {"notice", notice}})});
        co_return;
      }
    }
    if (forget_user(bearer, *user)) notice = "Your session has ended: log in again.";
  }
}

Async<> WebInterface::set_profile(std::string bearer, SetProfile profile, Answer answer) {
  const auto user = user_of(bearer);
  hmi::CommUserProfileUpdate update;
  if (user) {
    update.set_user_name(user->name());
    update.set_session(user->session());
  }
  if (profile.use_elevator) update.set_use_elevator(*profile.use_elevator);
  if (profile.use_stairs) update.set_use_stairs(*profile.use_stairs);
  if (profile.use_outdoor_navigation) update.set_use_outdoor_navigation(*profile.use_outdoor_navigation);
  const auto reply = co_await update_.query(std::move(update), kDeadline);
  if (!reply) {
    answer->answer(no_answer("the profile", reply.outcome(), reply.reason()));
    co_return;
  }
  co_await tell_me(std::move(bearer), std::move(answer));
}

Async<> WebInterface::set_points(std::string bearer, SetPoints points, Answer answer) {
  const auto user = user_of(bearer);
  hmi::RequestPointsOfAttention request;
  if (user) {
    request.set_user_name(user->name());
    request.set_session(user->session());
  }
  for (const Point& point : points.points) {
    hmi::PointOfAttention& one = *request.add_points_of_attention();
    one.set_x(point.x);
    one.set_y(point.y);
    one.set_level(point.level);
    one.set_name(point.name);
  }
  const auto reply = co_await points_.query(std::move(request), kDeadline);
  if (!reply) {
    answer->answer(no_answer("the list of points", reply.outcome(), reply.reason()));
    co_return;
  }
  std::string notice;
  for (int i = 0; i < std::min((*reply)->refused_size(), (*reply)->reason_size()); ++i) {
    const std::uint32_t which = (*reply)->refused(i);
    const std::string name = which < points.points.size() ? points.points[which].name : "";
    notice += (notice.empty() ? "" : " ") + ("'" + name + "' is not watched: " + (*reply)->reason(i) + ".");
  }
  co_await tell_me(std::move(bearer), std::move(answer), std::move(notice));
}

Async<> WebInterface::set_destination(std::string bearer, SetDestination destination, Answer answer) {
  const auto user = user_of(bearer);
  navigation::CommDestination object;
  if (user) {
    object.set_user_name(user->name());
    object.set_session(user->session());
  }
  localisation::CommPosition& to = *object.mutable_destination();
  to.set_x(destination.to.x);
  to.set_y(destination.to.y);
  to.set_z(destination.to.level);
  to.set_is_valid(true);
  const auto sent = co_await destination_.send_acknowledged(std::move(object), kDeadline);
  answer->answer(sent ? WebReply{200, "{}"} : no_answer("navigation", sent.outcome(), sent.reason()));
}

/// As the authenticator says it now; without one, or without its answer, everybody is a guest.
Async<int> WebInterface::level_of_user(std::string bearer) {
  const auto user = user_of(bearer);
  if (!user) co_return 0;
  security::CommSessionRequest request;
  request.set_session(user->session());
  const auto session = co_await sessions_.query(std::move(request), kDeadline);
  co_return session && (*session)->is_valid() ? (*session)->authentication_level() : 0;
}

Async<Result<control::System>> WebInterface::system() {
  if (system_ && now() - system_->first < kSystemKept) co_return system_->second;
  auto asked = co_await master_.system(kDeadline);
  if (asked) system_.emplace(now(), *asked);
  co_return asked;
}

Async<> WebInterface::tell_system(int level, Answer answer) {
  const auto running = co_await system();
  answer->answer(running ? WebReply{200, system_json(*running, level >= level_of(Rewire{}))}
                         : no_answer("the host", running.outcome(), running.reason()));
}

Async<> WebInterface::rewire(Rewire wanted, Answer answer) {
  const auto running = co_await system();
  const control::PortStatus* port = running ? port_of(*running, wanted.client) : nullptr;
  if (port && port->providers_size() > 1) {
    answer->answer(refusal(409, wanted.client + " has alternatives of its own: wire it in the console"));
    co_return;
  }
  WireChoice choice;
  if (port) choice.every = std::max(1U, port->prescale());
  Changes changes;
  changes.wire(wanted.client, wanted.provider, choice);
  const auto done = co_await master_.make(std::move(changes), kRewireDeadline);
  system_.reset();
  if (!done) {
    answer->answer(no_answer("the host", done.outcome(), done.reason()));
    co_return;
  }
  answer->answer({200, text_of({{"note", wanted.client + " to " + wanted.provider},
                                {"gap", std::round(done->gap_ms())},
                                {"lost", done->lost()}})});
}

}  // namespace fiona::smart_web_interface
