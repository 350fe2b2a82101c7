// What the page's server decides, keeps and tells; the page itself is tested in tests/web, in a browser.
#include "web_interface.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <boost/asio/ip/tcp.hpp>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>
#include <string>
#include <thread>

#include "../temporary_directory.hpp"
#include "attentions.hpp"
#include "fiona/testing/bench.hpp"
#include "page_calls.hpp"
#include "system_json.hpp"
#include "to_json.hpp"

namespace fiona::smart_web_interface {
namespace {

using namespace std::chrono_literals;
using nlohmann::json;
using ::testing::HasSubstr;
using ::testing::Not;

const Site kSite{{{"/", "index.html"}, {"/page.js", "page.js"}}, {"127.0.0.1:8080", "localhost:8080"}};

WebRequest call_of_page() {
  return {.method = "POST",
          .target = "/api/me",
          .host = "127.0.0.1:8080",
          .origin = "http://127.0.0.1:8080",
          .fetch_site = "same-origin",
          .content_type = "application/json",
          .authorization = "Bearer abc",
          .body = "{}"};
}

int status_of(const WebRequest& request) {
  const Route route = smart_web_interface::route(request, kSite);
  const auto* refusal = std::get_if<Refusal>(&route);
  return refusal ? refusal->status : 200;
}

TEST(WebRoute, TheOwnPagesCallIsLetThrough) {
  const Route route = smart_web_interface::route(call_of_page(), kSite);
  ASSERT_TRUE(std::holds_alternative<ApiCall>(route));
  EXPECT_EQ(std::get<ApiCall>(route).name, "me");
  EXPECT_EQ(std::get<ApiCall>(route).bearer, "abc");
}

TEST(WebRoute, WhatAnotherPageCanSendIsRefused) {
  const std::vector<std::pair<int, std::function<void(WebRequest&)>>> changes{
      {421, [](WebRequest& r) { r.host = "evil.test:8080"; }},
      {421, [](WebRequest& r) { r.host = "127.0.0.1:8081"; }},
      {421, [](WebRequest& r) { r.host = ""; }},
      {403, [](WebRequest& r) { r.origin = "https://127.0.0.1:8080"; }},
      {403, [](WebRequest& r) { r.origin = "http://evil.test"; }},
      {403, [](WebRequest& r) { r.origin = "http://localhost:8080"; }},
      {403, [](WebRequest& r) { r.origin = "null"; }},
      {403, [](WebRequest& r) { r.origin = ""; }},
      {403, [](WebRequest& r) { r.fetch_site = "cross-site"; }},
      {403, [](WebRequest& r) { r.fetch_site = "same-site"; }},
      {405, [](WebRequest& r) { r.method = "GET"; }},
      {415, [](WebRequest& r) { r.content_type = "text/plain"; }},
      {415, [](WebRequest& r) { r.content_type = "application/x-www-form-urlencoded"; }},
      {401, [](WebRequest& r) { r.authorization = ""; }},
      {401, [](WebRequest& r) { r.authorization = "Basic abc"; }},
      {404, [](WebRequest& r) { r.target = "/api/shutdown"; }},
      {404, [](WebRequest& r) { r.target = "/api/me?x=1"; }}};
  for (std::size_t i = 0; i < changes.size(); ++i) {
    WebRequest request = call_of_page();
    changes[i].second(request);
    EXPECT_EQ(status_of(request), changes[i].first) << "change " << i;
  }
}

TEST(WebRoute, OnlyTheFilesOfThePageAreServed) {
  for (const auto& [target, status] : std::map<std::string, int>{{"/", 200},
                                                                 {"/page.js", 200},
                                                                 {"/../web.db", 404},
                                                                 {"/page.js/", 404},
                                                                 {"//page.js", 404},
                                                                 {"/%70age.js", 404},
                                                                 {"", 404}}) {
    EXPECT_EQ(status_of({.method = "GET", .target = target, .host = "localhost:8080"}), status) << target;
  }
  EXPECT_EQ(status_of({.method = "POST", .target = "/", .host = "localhost:8080"}), 405);
}

TEST(WebRequestBytes, TwoHeadersOfOneNameAreNone) {
  const auto request = parse_request("GET / HTTP/1.1\r\nHost: 127.0.0.1:8080\r\nHost: evil\r\n\r\n");
  ASSERT_TRUE(request.has_value());
  EXPECT_EQ(status_of(*request), 421);
}

TEST(WebRequestBytes, WhatIsTooLargeIsNoRequest) {
  EXPECT_FALSE(parse_request("GET / HTTP/1.1\r\nX: " + std::string(kMaxHeader, 'x') + "\r\n\r\n"));
  EXPECT_FALSE(parse_request("POST / HTTP/1.1\r\nContent-Length: 70000\r\n\r\n" + std::string(70000, 'x')));
  EXPECT_FALSE(parse_request("POST / HTTP/1.1\r\nContent-Length: 10\r\n\r\nshort"));
}

std::string refusal_of(const std::string& name, const std::string& body) {
  ApiCall call{name, "", body};
  const auto read = read_call(call);
  const auto* refusal = std::get_if<Refusal>(&read);
  return refusal ? refusal->text : "";
}

TEST(PageCalls, SayWhatIsWrong) {
  EXPECT_EQ(refusal_of("login", "["), "the request is no JSON object");
  EXPECT_EQ(refusal_of("login", "[]"), "the request is no JSON object");
  EXPECT_EQ(refusal_of("login", R"({"name":"a"})"), "'password' is missing");
  EXPECT_EQ(refusal_of("login", R"({"name":1,"password":"b"})"), "'name' is no text");
  EXPECT_EQ(refusal_of("login", R"({"name":"a","password":")" + std::string(1025, 'x') + "\"}"),
            "'password' is longer than 1024 bytes");
  EXPECT_EQ(refusal_of("destination", R"({"x":1e99,"y":0,"level":0})"), "'x' is no coordinate");
  EXPECT_EQ(refusal_of("destination", R"({"x":1,"y":0})"), "'level' is missing");
  EXPECT_EQ(refusal_of("profile", R"({"use_elevator":1,"use_stairs":null,"use_outdoor_navigation":null})"),
            "'use_elevator' is neither true, false nor null");
  EXPECT_EQ(refusal_of("points", R"({"points":[1]})"), "a point is no object");
  EXPECT_EQ(refusal_of("session", R"({"token":"a"})"), "'number' is missing");
  EXPECT_EQ(refusal_of("rewire", R"({"client":"nav.location"})"), "'provider' is missing");
}

// R29: what a page may ask for, at each of the ten levels.
TEST(PageCalls, TakeTheLevelsThatConsolesTake) {
  const std::vector<std::pair<int, PageCall>> calls{
      {0, OpenSession{}}, {0, FollowEvents{}}, {0, GetMap{}},    {0, GetMe{}},          {0, Login{}},  {0, Logout{}},
      {0, SetProfile{}},  {0, SetPoints{}},    {1, GetSystem{}}, {0, SetDestination{}}, {6, Rewire{}},
  };
  EXPECT_EQ(calls.size(), std::variant_size_v<PageCall>);
  for (const auto& [level, call] : calls) EXPECT_EQ(level_of(call), level) << call.index();
}

control::System small_system() {
  control::System system;
  system.set_host("main");
  control::InstanceStatus& nav = *system.add_instances();
  nav.set_name("nav");
  nav.set_mode("active");
  control::PortStatus& location = *nav.add_ports();
  location.set_name("location");
  location.set_direction(REQUIRES);
  location.set_service("fiona.localisation.LocationProvider");
  location.set_connection(control::CONNECTED);
  location.mutable_peer()->set_instance("ble");
  location.mutable_peer()->set_port("location");
  location.set_rate_hz(5.04);
  location.set_age_ms(-1);
  for (const char* name : {"ble", "wifi", "nav"}) {
    control::InstanceStatus& one = *system.add_instances();
    one.set_name(name);
    for (const char* service : {"fiona.localisation.LocationProvider", "fiona.localisation.StepProvider"}) {
      control::PortStatus& port = *one.add_ports();
      port.set_name(service == std::string_view("fiona.localisation.StepProvider") ? "steps" : "location");
      port.set_direction(PROVIDES);
      port.set_service(service);
    }
  }
  return system;
}

TEST(SystemJson, OffersWhoElseProvidesTheServiceAndNobodyElse) {
  const json wire = json::parse(system_json(small_system(), true))["wires"][0];
  EXPECT_EQ(wire["client"], "nav.location");
  EXPECT_EQ(wire["provider"], "ble.location");
  EXPECT_EQ(wire["service"], "LocationProvider");
  EXPECT_EQ(wire["rate"], 5.0);
  EXPECT_FALSE(wire.contains("age"));
  EXPECT_EQ(wire["fits"], json::array({"wifi.location"}));
}

TEST(SystemJson, APortWithAlternativesOfItsOwnIsOfferedNobody) {
  control::System system = small_system();
  system.mutable_instances(0)->mutable_ports(0)->add_providers();
  system.mutable_instances(0)->mutable_ports(0)->add_providers();
  EXPECT_EQ(json::parse(system_json(system, true))["wires"][0]["fits"], json::array());
}

TEST(SystemJson, APortThatIsNotWiredHasNoProvider) {
  control::System system = small_system();
  system.mutable_instances(0)->mutable_ports(0)->clear_peer();
  const json wire = json::parse(system_json(system, false))["wires"][0];
  EXPECT_TRUE(wire["provider"].is_null());
  EXPECT_EQ(wire["fits"], json::array({"ble.location", "wifi.location"}));
}

TEST(PageCalls, LeaveNoPasswordInTheBody) {
  ApiCall call{"login", "", R"({"name":"anna","password":"canary"})"};
  const auto read = read_call(call);
  EXPECT_EQ(std::get<Login>(std::get<PageCall>(read)).password, "canary");
  EXPECT_THAT(call.body, Not(HasSubstr("canary")));
}

TEST(LocationJson, TheEllipseHoldsTheWalkerWith95Percent) {
  localisation::CommLocation location;
  localisation::CommPosition& position = *location.mutable_position();
  for (const double value : {4.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.1}) position.add_confidence(value);
  const json ellipse = json::parse(location_json(location, TimePoint{}))["ellipse"];
  EXPECT_NEAR(ellipse["major"].get<double>(), 2 * std::sqrt(5.991464547), 1e-6);
  EXPECT_NEAR(ellipse["minor"].get<double>(), std::sqrt(5.991464547), 1e-6);
  EXPECT_NEAR(ellipse["angle"].get<double>(), 0, 1e-9);
}

TEST(LocationJson, SaysWhenTheWalkerWasThere) {
  const TimePoint measured(std::chrono::milliseconds(1'700'000'000'123));
  EXPECT_EQ(json::parse(location_json({}, measured))["measured"], 1'700'000'000'123);
}

TEST(LocationJson, ACovarianceThatIsNoneGivesNoEllipse) {
  for (const std::vector<double>& covariance : std::vector<std::vector<double>>{
           {}, {1, 2, 0, 2, 1, 0, 0, 0, 1}, {-1, 0, 0, 0, 1, 0, 0, 0, 1}, {NAN, 0, 0, 0, 1, 0, 0, 0, 1}}) {
    localisation::CommLocation location;
    for (const double value : covariance) location.mutable_position()->add_confidence(value);
    EXPECT_FALSE(json::parse(location_json(location, TimePoint{})).contains("ellipse"));
  }
}

TEST(LocationJson, IsValidOnlyWhereBothSayItAndNumbersAreFinite) {
  localisation::CommLocation location;
  location.set_is_valid(true);
  EXPECT_FALSE(json::parse(location_json(location, TimePoint{}))["valid"]);
  location.mutable_position()->set_is_valid(true);
  EXPECT_TRUE(json::parse(location_json(location, TimePoint{}))["valid"]);
  location.mutable_position()->set_x(NAN);
  EXPECT_FALSE(json::parse(location_json(location, TimePoint{}))["valid"]);
}

TEST(MapJson, HasTheEntrancesAndNoOtherDoors) {
  navigation::CommLevelMap map;
  map.add_doors()->set_name("to the cellar");
  navigation::MapDoor& entrance = *map.add_doors();
  entrance.set_entrance(true);
  entrance.set_x(1.234);
  entrance.set_level(1);
  EXPECT_EQ(json::parse(map_json(map))["entrances"], json::array({{{"x", 1.23}, {"y", 0.0}, {"level", 1.0}}}));
}

TEST(Board, ASlowReaderSkipsWhatWasReplaced) {
  Board board;
  std::uint64_t seen = 0;
  board.set("a", "1");
  board.set("b", "1");
  board.set("a", "2");
  const auto news = board.since(seen);
  ASSERT_EQ(news.size(), 2U);
  EXPECT_EQ(news[0].topic + news[0].text, "b1");
  EXPECT_EQ(news[1].topic + news[1].text, "a2");
  board.set("a", "2");
  EXPECT_TRUE(board.since(seen).empty()) << "nothing has changed";
}

hmi::Instruction passing(std::uint32_t number) {
  hmi::Instruction one;
  one.set_number(number);
  one.set_kind(hmi::Instruction::ATTENTION);
  one.set_text("You are passing statue.");
  return one;
}

std::vector<int> numbers_in(const std::string& list) {
  std::vector<int> numbers;
  for (const json& one : json::parse(list)) numbers.push_back(one["number"]);
  return numbers;
}

TEST(Attentions, StandBesideEachOtherUntilTheyAreNoNewsAnyMore) {
  Attentions attentions;
  const TimePoint begin{1h};
  EXPECT_EQ(attentions.json(begin), "[]");
  attentions.add(passing(1), begin);
  attentions.add(passing(2), begin + 5s);
  EXPECT_EQ(numbers_in(attentions.json(begin + 5s)), (std::vector{1, 2}));
  EXPECT_EQ(numbers_in(attentions.json(begin + 8s)), std::vector{2});
  EXPECT_EQ(attentions.json(begin + 13s), "[]");
}

TEST(Attentions, OneThatWasToldLongAgoIsNoNewsToWhoComesLate) {
  Attentions attentions;
  attentions.add(passing(1), TimePoint{1h});
  EXPECT_EQ(attentions.json(TimePoint{2h}), "[]");
}

TEST(Attentions, AreFewHoweverManyAreTold) {
  Attentions attentions;
  for (std::uint32_t i = 1; i <= 100; ++i) attentions.add(passing(i), TimePoint{1h});
  EXPECT_EQ(numbers_in(attentions.json(TimePoint{1h})), (std::vector{97, 98, 99, 100}));
}

constexpr const char* kNumber = "0123456789abcdef0123456789abcdef";  // of a page
constexpr const char* kOtherNumber = "0123456789abcdef0123456789abcdee";

class PageSessionsTest : public ::testing::Test {
 protected:
  PageSessionsTest() { begin(); }
  void begin(Duration time = 1h) {
    pages_.reset();
    store_.reset();
    store_ = std::make_unique<records::RecordStore>(folder_.path / "web.db", "pages");
    pages_ = std::make_unique<PageSessions>(*store_, now_, time);
  }
  std::string open() { return pages_->open(pages_->make_token(now_), kNumber, now_, 1h).value(); }

  tests::TemporaryDirectory folder_;
  TimePoint now_{24h};
  std::unique_ptr<records::RecordStore> store_;
  std::unique_ptr<PageSessions> pages_;
};

TEST_F(PageSessionsTest, ATokenOpensOneSession) {
  const std::string token = pages_->make_token(now_);
  EXPECT_EQ(token.size(), 32U);
  const auto session = pages_->open(token, kNumber, now_, 1h);
  ASSERT_TRUE(session);
  EXPECT_EQ(session->size(), 64U);
  EXPECT_TRUE(pages_->is_open(*session, now_));
  EXPECT_FALSE(pages_->open(token, kOtherNumber, now_, 1h));
  EXPECT_FALSE(pages_->open(token, "", now_, 1h));
  EXPECT_FALSE(pages_->open("", kNumber, now_, 1h));
  EXPECT_NE(open(), *session) << "another token, from the same page";
}

TEST_F(PageSessionsTest, APageWhoseAnswerWasLostGetsItsSessionAgain) {
  const std::string token = pages_->make_token(now_);
  const auto session = pages_->open(token, kNumber, now_, 1h);
  ASSERT_TRUE(session);
  EXPECT_EQ(pages_->open(token, kNumber, now_ + 9min, 1h), session);
  EXPECT_FALSE(pages_->is_open(*session, now_ + 1h)) << "it goes on for longer";
  EXPECT_FALSE(pages_->open(token, kNumber, now_ + 10min, 1h));
}

TEST_F(PageSessionsTest, ASessionThatHasEndedIsNotOpenedAgain) {
  const std::string token = pages_->make_token(now_);
  ASSERT_TRUE(pages_->open(token, kNumber, now_, 1min));
  EXPECT_FALSE(pages_->open(token, kNumber, now_ + 1min, 1min));
}

TEST_F(PageSessionsTest, LinksThatWereUsedTakeNoPlaceOfOneThatWasNot) {
  const std::string token = pages_->make_token(now_);
  now_ += 1s;
  for (std::size_t i = 0; i < PageSessions::kMaxTokens; ++i) open();
  EXPECT_TRUE(pages_->open(token, kNumber, now_, 1h));
}

TEST_F(PageSessionsTest, ATokenIsGoodForTenMinutes) {
  const std::string token = pages_->make_token(now_);
  EXPECT_FALSE(pages_->open(token, kNumber, now_ + 10min, 1h));
}

TEST_F(PageSessionsTest, SessionsAndTheirUsersSurviveARestart) {
  const std::string session = open();
  PageUser user;
  user.set_name("anna");
  user.set_session(std::string(16, 's'));
  ASSERT_TRUE(pages_->set_user(session, user, now_));
  begin();
  EXPECT_TRUE(pages_->is_open(session, now_));
  EXPECT_EQ(pages_->user(session, now_)->name(), "anna");
  EXPECT_FALSE(pages_->is_open(session, now_ + 1h));
  EXPECT_FALSE(pages_->user(std::string(64, '0'), now_));
}

TEST_F(PageSessionsTest, AClockThatIsALittleBehindEndsNoSession) {
  const std::string session = open();
  now_ -= 1min;
  begin();
  EXPECT_TRUE(pages_->is_open(session, now_));
  EXPECT_FALSE(pages_->is_open(session, now_ + 1h)) << "it goes on for longer than one may";
  now_ += 1min;
  begin();
  EXPECT_TRUE(pages_->is_open(session, now_));
}

TEST_F(PageSessionsTest, ATimeThatWasSetShorterHoldsForSessionsOfBeforeToo) {
  const std::string session = open();
  begin(10min);
  EXPECT_TRUE(pages_->is_open(session, now_ + 9min));
  EXPECT_FALSE(pages_->is_open(session, now_ + 10min));
}

TEST_F(PageSessionsTest, TheFileOpensNoPageAndNamesNoUser) {
  const std::string session = open();
  PageUser user;
  user.set_name("canary-name");
  user.set_session("canary-number---");
  pages_->set_user(session, user, now_);
  for (const auto& entry : std::filesystem::directory_iterator(folder_.path)) {
    std::ifstream in(entry.path(), std::ios::binary);
    const std::string bytes((std::istreambuf_iterator<char>(in)), {});
    EXPECT_THAT(bytes, Not(HasSubstr("canary"))) << entry.path();
    EXPECT_THAT(bytes, Not(HasSubstr(session))) << entry.path();
  }
}

TEST_F(PageSessionsTest, OneTooManyEndsTheOldest) {
  const std::string first = open();
  now_ += 1s;
  for (std::size_t i = 0; i < PageSessions::kMaxSessions; ++i) open();
  EXPECT_FALSE(pages_->is_open(first, now_));
  const std::string token = pages_->make_token(now_);
  now_ += 1s;
  for (std::size_t i = 0; i < PageSessions::kMaxTokens; ++i) pages_->make_token(now_);
  EXPECT_FALSE(pages_->open(token, kNumber, now_, 1h));
}

class WebInterfaceTest : public PageSessionsTest {
 protected:
  WebInterfaceTest() {
    for (const char* file : {"index.html", "page.js", "page.css", "icon.svg"})
      std::ofstream(folder_.path / file) << "content";
  }
  std::unique_ptr<testing::Bench<WebInterface>> bench() const {
    auto made = std::make_unique<testing::Bench<WebInterface>>("web", folder_.path);
    made->set("database", (folder_.path / "bench.db").string());
    return made;
  }
};

TEST_F(WebInterfaceTest, AnAddressThatIsNotOneIsRefused) {
  for (const char* address : {"0.0.0.0", "::", "224.0.0.1", "fe80::1%eth0", "localhost", "", "127.0.0.1:80"}) {
    const auto one = bench();
    one->set("address", address);
    EXPECT_THROW(one->start(), Error);
    EXPECT_THAT(one->reason(), HasSubstr("the page is not served at such an address")) << address;
  }
}

TEST_F(WebInterfaceTest, AnAddressThatIsNotThisMachinesIsRefused) {
  const auto one = bench();
  one->set("address", "192.0.2.7");  // for documentation: RFC 5737
  EXPECT_THROW(one->start(), Error);
  EXPECT_THAT(one->reason(), HasSubstr("cannot listen at 192.0.2.7: Cannot assign requested address"));
}

// Where nothing can be served the authority has been looked at before.
TEST_F(WebInterfaceTest, DevicesThatHaveToBePairedAgainAreTold) {
  for (const auto& [age, told] : std::map<std::chrono::hours, bool>{{24h, false}, {24h * 3000, true}}) {
    const auto file = folder_.path / (told ? "old.db" : "young.db");
    {
      records::RecordStore store(file, "pages");
      LocalAuthority(store, std::chrono::system_clock::now() - age);
    }
    const auto one = bench();
    one->set("database", file.string());
    one->set("address", "192.0.2.7");
    EXPECT_THROW(one->start(), Error);
    EXPECT_EQ(::testing::Value(one->log(), ::testing::Contains(HasSubstr("devices have to be paired again"))), told);
  }
}

TEST_F(WebInterfaceTest, AClockThatIsBehindEndsNoSession) {
  std::string bearer;
  const auto ahead = std::chrono::system_clock::now() + 24h * 365;
  {
    records::RecordStore store(folder_.path / "bench.db", "pages");
    LocalAuthority(store, ahead);
    PageSessions pages(store, TimePoint(24h * 7300), 24h);
    bearer = pages.open(pages.make_token(TimePoint(24h * 7300)), kNumber, TimePoint(24h * 7300), 24h).value();
  }
  const auto one = bench();
  one->set("address", "192.0.2.7");
  EXPECT_THROW(one->start(), Error);
  EXPECT_THAT(one->reason(), HasSubstr("the clock is wrong"));
  records::RecordStore store(folder_.path / "bench.db", "pages");
  EXPECT_TRUE(PageSessions(store, TimePoint(24h * 7300), 24h).is_open(bearer, TimePoint(24h * 7300)));
}

TEST_F(WebInterfaceTest, ThePortOfTheLastStartIsTakenAgainAndAnotherWhereItIsTaken) {
  const auto port = [](const std::vector<std::string>& log) {
    for (const std::string& line : log) {
      const auto at = line.find("http://127.0.0.1:");
      if (at != std::string::npos) return line.substr(at, line.find(';') - at);
    }
    return std::string();
  };
  auto first = bench();
  first->start();
  const std::string at = port(first->log());
  EXPECT_NE(at, "");
  first.reset();
  auto again = bench();
  again->start();
  EXPECT_EQ(port(again->log()), at);
  const auto beside = bench();
  beside->start();
  EXPECT_EQ(beside->mode(), "active");
  EXPECT_NE(port(beside->log()), at);
  EXPECT_THAT(beside->log().front(), HasSubstr("another port than last time, pages that are open do not find it"));
}

/// A call of a page over the network, whose answer comes while the bench goes on.
class CallOfPage {
 public:
  CallOfPage(const std::string& origin, const std::string& name, const std::string& bearer,
             const json& body = json::object()) {
    const std::string host = origin.substr(std::string("http://").size());
    stream_.expires_after(20s);
    stream_.connect(host.substr(0, host.find(':')), host.substr(host.find(':') + 1));
    const std::string text = body.dump();
    stream_ << "POST /api/" << name << " HTTP/1.1\r\nHost: " << host << "\r\nOrigin: " << origin
            << "\r\nContent-Type: application/json\r\nAuthorization: Bearer " << bearer
            << "\r\nContent-Length: " << text.size() << "\r\nConnection: close\r\n\r\n"
            << text << std::flush;
  }
  bool is_answered() { return !stream_ || stream_.socket().available() > 0; }
  json answer() {
    skip_head();
    return json::parse(stream_);
  }
  /// The newest of a topic, of a stream that has just begun.
  json news(const std::string& topic) {
    skip_head();
    for (std::string line; std::getline(stream_, line);) {
      if (line != "event: " + topic) continue;
      std::getline(stream_, line);
      return json::parse(line.substr(std::string("data: ").size()));
    }
    return nullptr;
  }

 private:
  void skip_head() {
    for (std::string line; std::getline(stream_, line) && line != "\r";) continue;
  }

  boost::asio::ip::tcp::iostream stream_;
};

/// With a page that is open.
class OpenPageTest : public WebInterfaceTest {
 protected:
  OpenPageTest() {
    {
      records::RecordStore store(folder_.path / "bench.db", "pages");
      PageSessions pages(store, bench_->now(), 24h);
      bearer_ = pages.open(pages.make_token(bench_->now()), kNumber, bench_->now(), 24h).value();
    }
    bench_->start();
    const std::string& told = bench_->log().back();  // "the page is at http://127.0.0.1:4711; …"
    const auto begin = told.find("http://");
    origin_ = told.substr(begin, told.find(';') - begin);
  }
  CallOfPage call(const std::string& name, const json& body = json::object()) {
    return CallOfPage(origin_, name, bearer_, body);
  }
  json answer_to(CallOfPage& call) {
    for (int i = 0; i < 4000 && !call.is_answered(); ++i) {
      bench_->advance(0s);
      std::this_thread::sleep_for(5ms);
    }
    return call.answer();
  }
  json status() { return call("events").news("status"); }
  WireEnd& wire(const char* port) {
    return *dynamic_cast<RequiredPort&>(*bench_->hull().find_port(port)).end_for("bench");
  }

  std::unique_ptr<testing::Bench<WebInterface>> bench_ = bench();
  std::string bearer_;
  std::string origin_;
};

TEST_F(OpenPageTest, APlaceThatComesSeldomIsNoneThatIsLost) {
  for (int second = 0; second < 3; ++second) {  // as over a wire `every 5`
    bench_->put<localisation::LocationProvider>("location", {});
    for (int quarter = 0; quarter < 4; ++quarter) {
      bench_->advance(250ms);
      EXPECT_EQ(status()["location"], "connected") << second << " s and " << quarter << " quarters";
    }
  }
}

TEST_F(OpenPageTest, AProviderOfThePlaceThatIsSilentIsToldThoughTheMapServerDoesNotAnswer) {
  bench_->put<localisation::LocationProvider>("location", {});
  wire("location").set_lease(false, "has been silent for 600 ms");
  bench_->advance(250ms);
  EXPECT_EQ(status()["location"], "lost");
  wire("location").set_lease(true, {});
  bench_->advance(250ms);
  EXPECT_EQ(status()["location"], "connected");
}

TEST_F(OpenPageTest, WhoLogsInIsCalledAsTheLoginSaysThoughNobodyIsAskedAboutSessions) {
  wire("sessions").set_connection(Connection::Unwired, "on the bench");
  bench_->answer_with<security::AuthenticationProvider>("login", [](const auto&) {
    security::CommAuthenticationResponse response;
    response.set_access_granted(true);
    response.set_session(std::string(16, 's'));
    response.set_user_name("ada");
    return response;
  });
  bench_->answer_with<hmi::ProfileProvider>("profile", [](const auto& request) {
    hmi::CommUserProfileReply reply;
    reply.set_authentication_level(request.user_name() == "ada" ? 3 : 0);
    return reply;
  });
  CallOfPage login = call("login", {{"name", "Ada"}, {"password", "secret"}});
  const json told = answer_to(login);
  EXPECT_EQ(told["user"], "ada");
  EXPECT_EQ(told["profile"]["level"], 3);
}

/// An authenticator whose answer about one session can be held back.
struct HeldSessions final : Sink {
  Outcome deliver(Parcel parcel) override {
    const auto& request = static_cast<const security::CommSessionRequest&>(*parcel.envelope.object);
    if (request.session() != held) return answer(parcel, "anna");
    asked.push_back(std::move(parcel));
    return Outcome::Ok;
  }
  /// Empty: the session has ended.
  static Outcome answer(const Parcel& parcel, const std::string& user) {
    auto session = std::make_shared<security::CommSession>();
    session->set_is_valid(!user.empty());
    session->set_user_name(user);
    parcel.reply->answer(Outcome::Ok, {}, std::move(session));
    return Outcome::Ok;
  }
  std::string held;
  std::vector<Parcel> asked;
};

class LoggedInTest : public OpenPageTest {
 protected:
  LoggedInTest() {
    bench_->answer_with<security::AuthenticationProvider>("login", [this](const auto&) {
      security::CommAuthenticationResponse response;
      response.set_access_granted(true);
      response.set_session(std::string(16, ++sessions_begun_));
      return response;
    });
    bench_->answer_with<hmi::ProfileProvider>("profile", [](const auto&) { return hmi::CommUserProfileReply(); });
    wire("sessions").set_target(sessions_);
    EXPECT_EQ(log_in()["user"], "anna");
  }
  json log_in() {
    CallOfPage login = call("login", {{"name", "anna"}, {"password", "secret"}});
    return answer_to(login);
  }
  json me() {
    CallOfPage asked = call("me");
    return answer_to(asked);
  }
  /// From now on the authenticator keeps its answers about the first session back.
  void hold_answers() { sessions_->held = std::string(16, '\1'); }
  void await_question() {
    for (int i = 0; i < 4000 && sessions_->asked.empty(); ++i) {
      bench_->advance(0s);
      std::this_thread::sleep_for(5ms);
    }
    EXPECT_EQ(sessions_->asked.size(), 1U);
  }

  char sessions_begun_ = 0;
  const std::shared_ptr<HeldSessions> sessions_ = std::make_shared<HeldSessions>();
};

TEST_F(LoggedInTest, AUserWhoseSessionHasEndedIsAGuestAndIsTold) {
  hold_answers();
  CallOfPage asked = call("me");
  await_question();
  HeldSessions::answer(sessions_->asked.at(0), "");
  const json told = answer_to(asked);
  EXPECT_TRUE(told["user"].is_null());
  EXPECT_EQ(told["notice"], "Your session has ended: log in again.");
  EXPECT_TRUE(me()["user"].is_null());
}

TEST_F(LoggedInTest, ASessionThatHasEndedLogsOutNobodyWhoHasLoggedInMeanwhile) {
  hold_answers();
  CallOfPage asked = call("me");
  await_question();
  EXPECT_EQ(log_in()["user"], "anna");
  HeldSessions::answer(sessions_->asked.at(0), "");
  const json told = answer_to(asked);
  EXPECT_EQ(told["user"], "anna");
  EXPECT_EQ(told["notice"], "");
  EXPECT_EQ(me()["user"], "anna");
}

}  // namespace
}  // namespace fiona::smart_web_interface
