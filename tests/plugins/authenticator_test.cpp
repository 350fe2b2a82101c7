// Users, passwords, attempts and sessions: who gets in, who does not, and how little that tells.
#include "authenticator.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <sys/resource.h>
#include <unistd.h>

#include <algorithm>
#include <condition_variable>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <future>
#include <mutex>
#include <numeric>
#include <sstream>
#include <string>
#include <vector>

#include "../temporary_directory.hpp"
#include "fiona/testing/bench.hpp"

namespace fiona::authenticator {
namespace {

using namespace std::chrono_literals;
using security::AuthenticationProvider;
using security::CommAuthenticationRequest;
using security::CommAuthenticationResponse;
using security::CommSession;
using security::CommSessionRequest;
using testing::Bench;
using ::testing::Each;
using ::testing::ElementsAre;
using ::testing::Gt;
using ::testing::HasSubstr;
using ::testing::Lt;
using ::testing::Not;
using ::testing::StartsWith;

const char* const kPassword = "correct horse battery";

/// An answer that comes from the thread that hashes.
class Waiting final : public ReplySink {
 public:
  void answer(Outcome outcome, std::string reason, std::shared_ptr<const Object> object) override {
    const std::lock_guard lock(mutex_);
    outcome_ = outcome;
    reason_ = std::move(reason);
    object_ = std::move(object);
    told_.notify_all();
  }
  void wait() {
    std::unique_lock lock(mutex_);
    ASSERT_TRUE(told_.wait_for(lock, 60s, [this] { return outcome_.has_value(); }));
  }
  bool answered() const {
    const std::lock_guard lock(mutex_);
    return outcome_.has_value();
  }
  /// After `wait`.
  std::string reason() const { return reason_; }
  bool granted() const { return object_ && static_cast<const CommAuthenticationResponse&>(*object_).access_granted(); }
  std::string user_name() const {
    return object_ ? static_cast<const CommAuthenticationResponse&>(*object_).user_name() : std::string();
  }
  std::string session() const {
    return object_ ? static_cast<const CommAuthenticationResponse&>(*object_).session() : std::string();
  }

 private:
  mutable std::mutex mutex_;
  std::condition_variable told_;
  std::optional<Outcome> outcome_;
  std::string reason_;
  std::shared_ptr<const Object> object_;
};

/// As on the machine's clock: what hashes is a thread of its own, for which the bench's clock does not wait.
struct AuthenticatorWithDesk : Authenticator {
  explicit AuthenticatorWithDesk(Hull& hull) : Authenticator(hull, false) {}
};

class AuthenticatorTest : public ::testing::Test {
 protected:
  AuthenticatorTest() {
    records::RecordStore store(file(), kDatabaseKind);
    Accounts(store).add("anna", Secret(kPassword), 3);
  }

  std::string file() const { return folder_.path / "users.db"; }
  std::unique_ptr<Bench<AuthenticatorWithDesk>> started(int session_s = 43200, Duration at = {}) const {
    auto bench = std::make_unique<Bench<AuthenticatorWithDesk>>("auth");
    bench->set("database", file());
    bench->set("session_time", session_s);
    bench->advance(at);
    bench->start();
    return bench;
  }
  template <class Change>
  void administer(Change change) const {
    records::RecordStore store(file(), kDatabaseKind);
    Accounts accounts(store);
    change(accounts);
  }

  static std::shared_ptr<Waiting> begin_login(Bench<AuthenticatorWithDesk>& bench, const std::string& user,
                                              const std::string& password, const std::string& source = {}) {
    auto request = std::make_shared<CommAuthenticationRequest>();
    request->set_username(user);
    request->set_password(password);
    request->set_source(source);
    auto reply = std::make_shared<Waiting>();
    bench.hull().find_port("login")->inbox()->push({Envelope{request, 1, bench.now(), 0}, reply});
    bench.advance(0ms);
    return reply;
  }
  static std::shared_ptr<Waiting> login(Bench<AuthenticatorWithDesk>& bench, const std::string& user,
                                        const std::string& password, const std::string& source = {}) {
    auto reply = begin_login(bench, user, password, source);
    reply->wait();
    return reply;
  }
  static CommSession whose(Bench<AuthenticatorWithDesk>& bench, const std::string& session) {
    CommSessionRequest request;
    request.set_session(session);
    const auto answer = bench.ask<security::SessionProvider>("sessions", request);
    EXPECT_TRUE(answer.ok()) << answer.reason();
    return answer ? **answer : CommSession();
  }

  tests::TemporaryDirectory folder_;
};

TEST_F(AuthenticatorTest, TheRightPasswordGetsASessionOf128Bits) {
  const auto bench = started();
  const auto reply = login(*bench, "anna", kPassword);
  EXPECT_TRUE(reply->granted());
  EXPECT_EQ(reply->session().size(), 16U);
  const CommSession session = whose(*bench, reply->session());
  EXPECT_TRUE(session.is_valid());
  EXPECT_EQ(session.user_name(), "anna");
  EXPECT_EQ(session.authentication_level(), 3);
  EXPECT_EQ(session.remaining(), 43200U);
}

TEST_F(AuthenticatorTest, OnAVirtualClockTimeStandsUntilALoginIsAnswered) {
  Bench<Authenticator> bench("auth");
  bench.set("database", file());
  bench.start();
  CommAuthenticationRequest request;
  request.set_username("anna");
  request.set_password(kPassword);
  const TimePoint before = bench.now();
  const auto reply = bench.ask<AuthenticationProvider>("login", request);
  ASSERT_TRUE(reply.ok()) << reply.reason();
  EXPECT_TRUE((*reply)->access_granted());
  EXPECT_EQ(bench.now(), before);
}

TEST_F(AuthenticatorTest, APhonesLargeFirstLetterIsTheSameName) {
  const auto bench = started();
  const auto reply = login(*bench, "Anna", kPassword);
  EXPECT_TRUE(reply->granted());
  EXPECT_EQ(reply->user_name(), "anna") << "as the session has it";
}

TEST_F(AuthenticatorTest, AWrongPasswordAnUnknownNameAndADisabledUserAreOneAnswer) {
  administer([](Accounts& accounts) {
    accounts.add("bert", Secret(kPassword), 1);
    accounts.set_disabled("bert", true);
  });
  const auto bench = started();
  for (const auto& [user, password] : std::vector<std::pair<std::string, std::string>>{{"anna", "wrong horse battery"},
                                                                                       {"nobody", kPassword},
                                                                                       {"bert", kPassword},
                                                                                       {"", ""},
                                                                                       {"a\x1b[2J", kPassword}}) {
    const auto reply = login(*bench, user, password);
    EXPECT_FALSE(reply->granted());
    EXPECT_EQ(reply->session(), "");
    EXPECT_EQ(reply->reason(), "");
  }
  EXPECT_EQ(bench->probe<std::uint64_t>("failed_logins"), 5U);
}

TEST_F(AuthenticatorTest, TheHashOfNobodyCostsWhatOthersCost) {
  const auto parameters = [](const std::string& hash) { return hash.substr(0, hash.find('$', hash.find("p=1"))); };
  EXPECT_EQ(parameters(hash_of_nobody()), parameters(hash_of(Secret(kPassword))));
  EXPECT_EQ(hash_of_nobody().size(), hash_of(Secret(kPassword)).size());
}

TEST_F(AuthenticatorTest, ASessionThatIsNoneBelongsToNobody) {
  const auto bench = started();
  for (const std::string& bytes : {std::string(16, '\0'), std::string(16, 'x'), std::string()}) {
    const CommSession session = whose(*bench, bytes);
    EXPECT_FALSE(session.is_valid());
    EXPECT_EQ(session.authentication_level(), 0);
    EXPECT_EQ(session.user_name(), "");
  }
}

TEST_F(AuthenticatorTest, AfterLogoutASessionIsGoneForGood) {
  std::string bytes;
  {
    const auto bench = started();
    bytes = login(*bench, "anna", kPassword)->session();
    CommSessionRequest request;
    request.set_session(bytes);
    EXPECT_TRUE((*bench->ask<security::LogoutProvider>("logout", request))->ended());
    EXPECT_FALSE((*bench->ask<security::LogoutProvider>("logout", request))->ended());
    EXPECT_FALSE(whose(*bench, bytes).is_valid());
  }
  EXPECT_FALSE(whose(*started(), bytes).is_valid());
}

TEST_F(AuthenticatorTest, TheAnswerToLogoutIsTheEndOfTheSession) {
  const auto bench = started();
  const std::string bytes = login(*bench, "anna", kPassword)->session();
  CommSessionRequest request;
  request.set_session(bytes);
  const TimePoint before = bench->now();
  EXPECT_TRUE((*bench->ask<security::LogoutProvider>("logout", request))->ended());
  EXPECT_FALSE(whose(*bench, bytes).is_valid()) << "the very next request";
  EXPECT_EQ(bench->now(), before) << "neither waits for anything";
}

TEST_F(AuthenticatorTest, ASessionGoesOnAfterARestart) {
  const std::string bytes = login(*started(), "anna", kPassword)->session();
  EXPECT_EQ(whose(*started(), bytes).user_name(), "anna");
}

TEST_F(AuthenticatorTest, ASessionGoesOnAfterARestartWithAnEarlierClockOrAShorterTime) {
  const auto first = started();
  first->advance(60s);
  const std::string bytes = login(*first, "anna", kPassword)->session();
  const auto behind = started();  // its clock has just begun
  EXPECT_EQ(whose(*behind, bytes).user_name(), "anna");
  EXPECT_LE(whose(*behind, bytes).remaining(), 43200U);
}

TEST_F(AuthenticatorTest, ATimeThatWasShortenedHoldsAfterFurtherRestarts) {
  const std::string bytes = login(*started(), "anna", kPassword)->session();
  started(60);
  const auto later = started(60, 59s);
  EXPECT_LE(whose(*later, bytes).remaining(), 1U);
}

TEST_F(AuthenticatorTest, ASessionEndsAtItsTime) {
  const auto bench = started();
  bench->set("session_time", 60);
  const std::string bytes = login(*bench, "anna", kPassword)->session();
  bench->advance(59s);
  EXPECT_EQ(whose(*bench, bytes).remaining(), 1U);
  bench->advance(1s);
  EXPECT_FALSE(whose(*bench, bytes).is_valid());
  EXPECT_EQ(bench->probe<std::uint64_t>("sessions_open"), 0U);
}

TEST_F(AuthenticatorTest, OneSessionTooManyEndsTheUsersOldest) {
  const auto bench = started();
  bench->set("user_sessions", 2);
  std::vector<std::string> sessions;
  for (int i = 0; i < 3; ++i) {
    sessions.push_back(login(*bench, "anna", kPassword)->session());
    bench->advance(1s);
  }
  EXPECT_FALSE(whose(*bench, sessions[0]).is_valid());
  EXPECT_TRUE(whose(*bench, sessions[1]).is_valid());
  EXPECT_TRUE(whose(*bench, sessions[2]).is_valid());
}

TEST_F(AuthenticatorTest, AUserWhoIsDisabledRemovedOrHasAnotherPasswordIsLoggedOutAtTheNextRequest) {
  const auto bench = started();
  const std::vector<std::function<void(Accounts&)>> changes{
      [](Accounts& accounts) { accounts.set_disabled("anna", true); },
      [](Accounts& accounts) { accounts.set_password("anna", Secret("another long one")); },
      [](Accounts& accounts) { accounts.remove("anna"); }};
  for (const auto& change : changes) {
    administer([](Accounts& accounts) {
      if (accounts.find("anna")) accounts.remove("anna");
      accounts.add("anna", Secret(kPassword), 3);
    });
    const std::string bytes = login(*bench, "anna", kPassword)->session();
    EXPECT_TRUE(whose(*bench, bytes).is_valid());
    administer(change);
    EXPECT_FALSE(whose(*bench, bytes).is_valid()) << "no time has passed on the bench";
  }
}

TEST_F(AuthenticatorTest, SessionsWhoseAccountDoesNotStandAnyMoreTakeNoPlace) {
  administer([](Accounts& accounts) { accounts.add("bert", Secret(kPassword), 1); });
  const auto bench = started();
  for (const char* user : {"anna", "bert"}) login(*bench, user, kPassword);
  const std::string bytes = login(*bench, "anna", kPassword)->session();
  administer([](Accounts& accounts) {
    accounts.set_disabled("bert", true);
    accounts.set_level("anna", 2);
  });
  bench->advance(1s);
  EXPECT_EQ(bench->probe<std::uint64_t>("sessions_open"), 2U);
  EXPECT_TRUE(whose(*bench, bytes).is_valid());
  administer([](Accounts& accounts) { accounts.set_password("anna", Secret("another long one")); });
  bench->advance(1s);
  EXPECT_EQ(bench->probe<std::uint64_t>("sessions_open"), 0U);
}

TEST_F(AuthenticatorTest, WhoGetsANameThatSomebodyHadBeforeGetsNoneOfTheirSessions) {
  const auto bench = started();
  const std::string bytes = login(*bench, "anna", kPassword)->session();
  administer([](Accounts& accounts) {
    accounts.remove("anna");
    accounts.add("anna", Secret("another long one"), 9);
  });
  EXPECT_FALSE(whose(*bench, bytes).is_valid());
}

TEST_F(AuthenticatorTest, AnotherLevelHoldsForSessionsThatAreOpen) {
  const auto bench = started();
  const std::string bytes = login(*bench, "anna", kPassword)->session();
  administer([](Accounts& accounts) { accounts.set_level("anna", 1); });
  EXPECT_EQ(whose(*bench, bytes).authentication_level(), 1);
}

TEST_F(AuthenticatorTest, AUserWhoWasJustAddedHasAValidSession) {
  const auto bench = started();
  administer([](Accounts& accounts) { accounts.add("carl", Secret(kPassword), 5); });
  EXPECT_EQ(whose(*bench, login(*bench, "carl", kPassword)->session()).authentication_level(), 5);
}

TEST_F(AuthenticatorTest, ASourceThatFailsHasToWaitAndOthersDoNot) {
  const auto bench = started();
  bench->set("attempts", 2);
  for (int i = 0; i < 2; ++i) EXPECT_FALSE(login(*bench, "anna", "wrong horse", "10.0.0.1")->granted());
  EXPECT_EQ(login(*bench, "anna", kPassword, "10.0.0.1")->reason(), "too many attempts: wait 6 s before the next one");
  EXPECT_TRUE(login(*bench, "anna", kPassword, "10.0.0.2")->granted());
  bench->advance(6s);
  EXPECT_TRUE(login(*bench, "anna", kPassword, "10.0.0.1")->granted());
  EXPECT_EQ(bench->probe<std::uint64_t>("refused_logins"), 1U);
}

TEST_F(AuthenticatorTest, ASuccessTakesNoAttemptOfItsSource) {
  const auto bench = started();
  bench->set("attempts", 2);
  for (int i = 0; i < 5; ++i) EXPECT_TRUE(login(*bench, "anna", kPassword, "10.0.0.1")->granted());
}

TEST_F(AuthenticatorTest, WhoLogsInBetweenCannotGuessAtOthersForEver) {
  administer([](Accounts& accounts) { accounts.add("mallory", Secret(kPassword), 1); });
  const auto bench = started();
  bench->set("attempts", 3);
  for (int i = 0; i < 3; ++i) {
    EXPECT_TRUE(login(*bench, "mallory", kPassword, "10.0.0.1")->granted());
    EXPECT_FALSE(login(*bench, "anna", "wrong horse", "10.0.0.1")->granted());
  }
  EXPECT_EQ(login(*bench, "mallory", kPassword, "10.0.0.1")->reason(),
            "too many attempts: wait 6 s before the next one");
}

TEST_F(AuthenticatorTest, InAStormEachSourceHasTwoPlacesAndAValidLoginGetsIn) {
  const auto bench = started();
  std::vector<std::shared_ptr<Waiting>> storm;
  for (int i = 0; i < 10; ++i) {
    storm.push_back(begin_login(*bench, "anna", "wrong horse", "10.0.0.1"));
    storm.push_back(begin_login(*bench, "anna", "wrong horse", "10.0.0.2"));
  }
  const auto valid = login(*bench, "anna", kPassword, "10.0.0.3");
  EXPECT_TRUE(valid->granted());
  for (const auto& one : storm) one->wait();
  const auto refused = std::count_if(storm.begin(), storm.end(), [](const auto& one) {
    return one->reason() == "many log in at this moment: try again in a second";
  });
  // One more of each may have begun while the first was being checked.
  EXPECT_GE(refused, 12);
  EXPECT_LE(refused, 16);
}

/// Bytes resident.
std::size_t resident() {
  std::ifstream in("/proc/self/statm");
  std::size_t size = 0;
  std::size_t pages = 0;
  in >> size >> pages;
  return pages * static_cast<std::size_t>(::sysconf(_SC_PAGESIZE));
}

/// What proc(5) says in /proc/PID/stat of each thread of this process that is called so, or of each other one: a field
/// by its number there.
std::vector<int> of_threads(const std::string& name, int field, bool others = false) {
  std::vector<int> all;
  for (const auto& task : std::filesystem::directory_iterator("/proc/self/task")) {
    std::ifstream file(task.path() / "stat");
    const std::string stat((std::istreambuf_iterator<char>(file)), {});
    const std::size_t open = stat.find('(');
    const std::size_t close = stat.rfind(')');
    if (close == std::string::npos || (stat.substr(open + 1, close - open - 1) == name) == others) continue;
    std::istringstream fields(stat.substr(close + 1));
    std::string value;
    for (int i = 2; i < field; ++i) fields >> value;
    all.push_back(std::stoi(value));
  }
  return all;
}

// However many wait, from however many sources.
TEST_F(AuthenticatorTest, OneThreadHashesAndEveryOtherComesBeforeIt) {
  constexpr int kUserTime = 14;
  constexpr int kNiceness = 19;
  const auto bench = started();
  const auto others_time = [] {
    const auto times = of_threads("passwords", kUserTime, true);
    return std::accumulate(times.begin(), times.end(), 0);
  };
  const int before = others_time();
  std::vector<std::shared_ptr<Waiting>> storm;
  for (int i = 0; i < 20; ++i)
    storm.push_back(begin_login(*bench, "anna", "wrong horse", "10.0.0." + std::to_string(i)));
  storm.front()->wait();  // the thread is there
  const int usual = ::getpriority(PRIO_PROCESS, 0);
  EXPECT_THAT(of_threads("passwords", kNiceness), ElementsAre(usual + 5));
  EXPECT_THAT(of_threads("passwords", kNiceness, true), Each(Lt(usual + 5)));
  for (const auto& one : storm) one->wait();
  EXPECT_THAT(of_threads("passwords", kUserTime), ElementsAre(Gt(2 * (others_time() - before))));
}

double milliseconds_of(const std::function<void()>& what) {
  const auto begun = std::chrono::steady_clock::now();
  what();
  return std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - begun).count();
}

// A place to wait for the hash that is under way, and one's own; a machine that others use adds to each.
TEST_F(AuthenticatorTest, TenThousandWrongPasswordsKeepNobodyElseOut) {
  const auto bench = started();
  login(*bench, "anna", kPassword, "10.1.0.0");
  const std::size_t before = resident();
  std::size_t most = 0;
  std::vector<std::shared_ptr<Waiting>> storm;
  std::vector<double> valid_ms;
  double hash_ms = milliseconds_of([] {
    hash_of_nobody();
    verifies(hash_of_nobody(), Secret("wrong horse"));
  });
  for (int round = 0; round < 500; ++round) {
    for (int source = 0; source < 20; ++source)
      storm.push_back(begin_login(*bench, "anna", "wrong horse", "10.0.0." + std::to_string(source)));
    bench->advance(100ms);
    if (round % 25 != 24) continue;
    valid_ms.push_back(milliseconds_of(
        [&] { EXPECT_TRUE(login(*bench, "anna", kPassword, "10.1.0." + std::to_string(round))->granted()); }));
    most = std::max(most, resident());
    hash_ms = std::max(hash_ms, milliseconds_of([] { verifies(hash_of_nobody(), Secret("wrong horse")); }));
  }
  for (const auto& one : storm) one->wait();
  EXPECT_EQ(storm.size(), 10000U);
  EXPECT_TRUE(std::none_of(storm.begin(), storm.end(), [](const auto& one) { return one->granted(); }));
  std::sort(valid_ms.begin(), valid_ms.end());
  const double grown_mib = static_cast<double>(most - std::min(most, before)) / (1 << 20);
  std::printf(
      "10,000 wrong passwords of 20 sources: a valid login p50 %.0f, longest %.0f ms; one hash %.0f ms; "
      "memory + %.0f MiB\n",
      valid_ms[valid_ms.size() / 2], valid_ms.back(), hash_ms, grown_mib);
  EXPECT_LT(valid_ms[valid_ms.size() / 2], 5 * hash_ms);
  EXPECT_LT(grown_mib, 192);  // the hash of the storm and that of this test
}

TEST_F(AuthenticatorTest, WhoHasNotFailedTakesThePlaceOfOneWhoHas) {
  const auto bench = started();
  std::vector<std::shared_ptr<Waiting>> storm;
  for (int i = 0; i < 40; ++i)
    storm.push_back(begin_login(*bench, "anna", "wrong horse", "10.0.0." + std::to_string(i / 2)));
  EXPECT_TRUE(login(*bench, "anna", kPassword, "10.0.1.1")->granted());
  EXPECT_TRUE(std::any_of(storm.begin(), storm.end(), [](const auto& one) { return !one->answered(); }))
      << "it has waited for all of the storm";
  for (const auto& one : storm) one->wait();
}

TEST_F(AuthenticatorTest, AttemptsThatWaitWhenItEndsAreAnswered) {
  auto bench = started();
  std::vector<std::shared_ptr<Waiting>> open;
  for (int i = 0; i < 8; ++i) open.push_back(begin_login(*bench, "anna", "wrong", "10.0.0." + std::to_string(i)));
  bench.reset();
  for (const auto& one : open) EXPECT_TRUE(one->answered());
}

TEST_F(AuthenticatorTest, ADamagedDatabaseFailsTheInstanceAndSaysWhatToDo) {
  std::filesystem::resize_file(file(), 0);
  Bench<AuthenticatorWithDesk> bench("auth");
  bench.set("database", file());
  EXPECT_THROW(bench.start(), Error);
  EXPECT_EQ(bench.mode(), "failed");
  EXPECT_THAT(bench.reason(), HasSubstr("the database is empty or missing, and its key says that it was not"));
}

TEST_F(AuthenticatorTest, WithoutUsersItSaysHowToAddOne) {
  administer([](Accounts& accounts) { accounts.remove("anna"); });
  const auto bench = started();
  EXPECT_THAT(bench->log(), ElementsAre("there is no user yet: fiona-users --database " + file() + " add NAME"));
}

TEST_F(AuthenticatorTest, NeitherPasswordsNorSessionsAreInTheDatabaseOrTheLog) {
  std::string session;
  std::vector<std::string> said;
  {
    const auto bench = started();
    session = login(*bench, "anna", kPassword)->session();
    login(*bench, "anna", "canary in a mine");
    said = bench->log();
  }
  for (const auto& entry : std::filesystem::directory_iterator(folder_.path)) {
    std::ifstream in(entry.path(), std::ios::binary);
    const std::string bytes((std::istreambuf_iterator<char>(in)), {});
    EXPECT_THAT(bytes, Not(HasSubstr(kPassword))) << entry.path();
    EXPECT_THAT(bytes, Not(HasSubstr("canary"))) << entry.path();
    EXPECT_THAT(bytes, Not(HasSubstr(session))) << entry.path();
  }
  EXPECT_THAT(said, Each(Not(HasSubstr("canary"))));
}

TEST_F(AuthenticatorTest, AnotherDatabaseTakesAnotherStart) {
  const auto bench = started();
  try {
    bench->set("database", "/elsewhere.db");
    FAIL();
  } catch (const Error& error) {
    EXPECT_THAT(error.what(), HasSubstr("the database is in use: another one takes another start"));
  }
}

TEST(AccountName, IsInertWhereverItIsShown) {
  EXPECT_EQ(account_name("Anna.B-2@home"), "anna.b-2@home");
  for (const char* bad : {"", "-rf", ".anna", "an na", "anna\n", "\x1b[2J", "änna", "a/b", "a\u202e"}) {
    EXPECT_EQ(account_name(bad), std::nullopt) << bad;
  }
  EXPECT_EQ(account_name(std::string(65, 'a')), std::nullopt);
}

TEST(NewPassword, IsRefusedWhereItIsShortOrTheName) {
  const auto refusal = [](const char* password, const char* name) -> std::string {
    try {
      check_new_password(Secret(password), name);
      return "";
    } catch (const Error& error) {
      return error.what();
    }
  };
  EXPECT_EQ(refusal("pässwörd", "anna"), "");
  EXPECT_THAT(refusal("ääääääa", "anna"), HasSubstr("found: 7 characters"));
  EXPECT_THAT(refusal("annaanna", "annaanna"), HasSubstr("found: the name"));
  EXPECT_THAT(refusal("with\ttabulator", "anna"), HasSubstr("found: a control character"));
}

TEST(Throttle, RemembersABoundedNumberOfSources) {
  Throttle throttle;
  const Throttle::Rule rule{1, 1s};
  TimePoint now{};
  for (int i = 0; i < 10000; ++i) throttle.take(std::to_string(i), now += 1ns, rule);
  EXPECT_EQ(throttle.sources(), Throttle::kMaxSources);
  EXPECT_TRUE(throttle.take("9999", now, rule)) << "the newest are remembered";
}

}  // namespace
}  // namespace fiona::authenticator
