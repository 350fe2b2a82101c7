#include "authenticator.hpp"

#include <cmath>
#include <utility>
#include <vector>

#include "fiona/records/data_directory.hpp"

namespace fiona::authenticator {
namespace {

Duration seconds(double value) { return std::chrono::duration_cast<Duration>(std::chrono::duration<double>(value)); }

std::string too_soon(Duration wait) {
  return "too many attempts: wait " + std::to_string(static_cast<long>(std::ceil(to_seconds(wait)))) +
         " s before the next one";
}

}  // namespace

void Authenticator::check(const Parameters& draft) const {
  if (!store_ || draft.database() == params_->database()) return;
  throw Error(ErrorCode::NotAllowed, {.what = "the database is in use: another one takes another start",
                                      .where = name(),
                                      .next = "unload " + name() + ", then load it with database=FILE"});
}

void Authenticator::on_start() {
  const std::string& given = params_->database();
  const std::filesystem::path file = given.empty() ? records::data_file("users.db") : std::filesystem::path(given);
  store_ = std::make_unique<records::RecordStore>(file, kDatabaseKind);
  accounts_ = std::make_unique<Accounts>(*store_);
  sessions_ = std::make_unique<Sessions>(*store_, now(), seconds(params_->session_time()));
  if (!hashes_itself_) desk_ = std::make_unique<LoginDesk>();
  read_accounts();
  if (known_.empty()) {
    log(LogLevel::Warning, "there is no user yet: fiona-users --database " + file.string() + " add NAME");
  }
  session_count_.set(sessions_->size());
}

void Authenticator::on_stop() { desk_.reset(); }

/// What is wrong with an attempt is told to who makes it only as far as it helps no one else: an unknown name, a wrong
/// password and a disabled account are one answer, after one time.
security::CommAuthenticationResponse Authenticator::checked(const LoginDesk::Attempt& attempt,
                                                            const Sessions::Bounds& bounds,
                                                            const Throttle::Rule& rule) {
  const auto name = account_name(attempt.user);
  const auto account = name ? accounts_->find(*name) : std::nullopt;
  const bool fits = verifies(account ? account->hash() : hash_of_nobody(), attempt.password);
  security::CommAuthenticationResponse response;
  if (!fits || !account || account->disabled()) {
    failed_.set(++failures_);
    return response;
  }
  response.set_session(sessions_->begin(*name, account->generation(), now(), bounds));
  response.set_user_name(*name);
  response.set_access_granted(true);
  session_count_.set(sessions_->size());
  const std::lock_guard lock(throttle_mutex_);
  throttle_.give_back(attempt.source, rule);
  return response;
}

void Authenticator::on_login(const security::CommAuthenticationRequest& request, LoginReply reply) {
  const Throttle::Rule rule{static_cast<double>(params_->attempts()), seconds(params_->attempt_period())};
  // Without a source all would share one count, and any of them could use it up for the others: they come last.
  double used = rule.attempts;
  if (!request.source().empty()) {
    const std::lock_guard lock(throttle_mutex_);
    if (const auto wait = throttle_.take(request.source(), now(), rule)) {
      refused_.set(++refusals_);
      reply.reject(too_soon(*wait));
      return;
    }
    used = throttle_.used(request.source(), rule);
  }
  const Sessions::Bounds bounds{seconds(params_->session_time()), params_->max_sessions(), params_->user_sessions()};
  // Shared by the two ways in which an attempt ends.
  const auto answer = std::make_shared<LoginReply>(std::move(reply));
  const auto check_it = [this, answer, bounds, rule](const LoginDesk::Attempt& attempt) {
    if (answer->abandoned()) return;
    try {
      answer->answer(checked(attempt, bounds, rule));
    } catch (const Error& error) {
      log(LogLevel::Error, error.what());
      answer->reject("nobody can log in now: the database of users cannot be used");
    }
  };
  LoginDesk::Attempt attempt{request.username(), Secret(request.password()),
                             request.source(),   used,
                             check_it,           [answer](const char* why) { answer->reject(why); }};
  if (hashes_itself_) return check_it(attempt);
  if (!desk_->take(std::move(attempt))) {
    refused_.set(++refusals_);
    answer->reject(LoginDesk::kCrowded);
  }
}

security::CommSession Authenticator::on_session(const security::CommSessionRequest& request) {
  security::CommSession answer;
  const auto session = sessions_->find(request.session(), now());
  if (!session) return answer;
  read_changes();  // each time: who is disabled has not one more request
  const Account* account = account_of(*session);
  if (!account) return answer;
  answer.set_is_valid(true);
  answer.set_user_name(session->user());
  answer.set_authentication_level(account->level());
  const std::int64_t left_ms = session->expires_ms() - to_milliseconds(now());
  answer.set_remaining(static_cast<std::uint32_t>(left_ms / 1000));
  return answer;
}

/// Null: the account is gone, disabled, or has had another password since.
const Account* Authenticator::account_of(const Session& session) const {
  const auto found = known_.find(session.user());
  const bool same = found != known_.end() && found->second.generation() == session.generation();
  return same && !found->second.disabled() ? &found->second : nullptr;
}

security::CommLogoutResponse Authenticator::on_logout(const security::CommSessionRequest& request) {
  security::CommLogoutResponse response;
  response.set_ended(sessions_->end(request.session()));
  session_count_.set(sessions_->size());
  return response;
}

void Authenticator::read_accounts() {
  const std::uint64_t version = store_->version();
  if (version_ == version) return;
  known_ = accounts_->all();
  version_ = version;
  trouble_.clear();
}

/// What cannot be read leaves what is known: nobody becomes more than they were.
void Authenticator::read_changes() {
  try {
    read_accounts();
  } catch (const Error& error) {
    version_.reset();
    tell(error);
  }
}

/// Sessions that have expired, and those whose account does not stand any more, take no place.
void Authenticator::look() {
  const auto open = sessions_->all();  // before the accounts are read: none is newer than what is known of its user
  read_changes();
  std::vector<std::string> ended;
  for (const auto& [name, session] : open) {
    const bool stands = !version_ || account_of(session) != nullptr;
    if (!stands || session.expires_ms() <= to_milliseconds(now())) ended.push_back(name);
  }
  try {
    sessions_->drop(ended);
  } catch (const Error& error) {
    tell(error);
  }
  session_count_.set(sessions_->size());
}

/// Once, and not at each look.
void Authenticator::tell(const Error& trouble) {
  if (trouble_ == trouble.what()) return;
  trouble_ = trouble.what();
  log(LogLevel::Error, trouble_);
}

}  // namespace fiona::authenticator
