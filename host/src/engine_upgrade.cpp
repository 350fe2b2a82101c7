// Upgrades: another version is made beside the one that serves, checked, given its wires, watched, and taken back if it
// is not fit. Each of these takes time, and nobody waits for it but who has asked.
#include <fmt/format.h>

#include <algorithm>

#include "engine_transaction.hpp"
#include "failure.hpp"
#include "fiona/error.hpp"

namespace fiona::host {

/// One that has taken over, and may be taken back.
struct Engine::Watched {
  std::string instance;
  std::string version;  ///< of the one that stands by
  std::chrono::steady_clock::time_point until{};
  TransactionPtr transaction;
  Waits::Answer answer;
  control::Reply reply;
};

/// What goes on on the control thread, unless the engine has gone by then.
template <class Work>
Waits::Answer Engine::then(Work work) {
  return [later = later_, alive = std::weak_ptr(self_), work = std::move(work)](control::Reply reply) {
    later([alive, work, reply = std::move(reply)]() mutable {
      const auto self = alive.lock();
      if (!self || !*self) return;
      if (reply.has_ended())
        *reply.mutable_failure() =
            failure_of(Error(ErrorCode::Failed, {.what = "the run has ended", .next = "fiona run, and upgrade again"}));
      work(**self, reply);
    });
  };
}

/// Each step once the one before has been answered with Done.
template <class Step>
Waits::Answer Engine::then_with(const TransactionPtr& transaction, Step step) {
  return then([transaction, step](Engine& engine, const control::Reply& reply) {
    if (reply.has_failure()) return engine.upgrade_failed(transaction, reply.failure());
    engine.try_upgrade(transaction, [&] { step(engine); });
  });
}

template <class Step>
void Engine::try_upgrade(const TransactionPtr& transaction, Step step) {
  try {
    step();
  } catch (...) {
    upgrade_failed(transaction, failure_of_exception());
  }
}

void Engine::begin_upgrade(const TransactionPtr& transaction) {
  end_watch(transaction->steps.front().upgrade().instance(), "another upgrade of it has begun meanwhile");
  const auto taken = [transaction](Engine& engine) { engine.take_over(transaction); };
  const auto made = [transaction, taken](Engine& engine) {
    engine.system_.check_upgrade(engine.then_with(transaction, taken));
  };
  try_upgrade(transaction,
              [&] { system_.begin_upgrade(transaction->steps.front().upgrade(), then_with(transaction, made)); });
}

void Engine::take_over(const TransactionPtr& transaction) {
  const control::Upgrade& upgrade = transaction->steps.front().upgrade();
  const std::string before = system_.model().instance(upgrade.instance()).package->version;
  transaction->done = system_.take_over(upgrade.watch_ms() > 0);
  transaction->at = transaction->steps.size();
  if (!system_.stands_by(upgrade.instance())) return finish(transaction);
  const auto watched = std::make_shared<Watched>(Watched{
      .instance = upgrade.instance(),
      .version = before,
      .until =
          std::chrono::steady_clock::now() + std::chrono::milliseconds(static_cast<std::int64_t>(upgrade.watch_ms())),
      .transaction = transaction,
      .answer = std::move(transaction->answer),
      .reply = {}});
  transaction->answer = [watched](control::Reply reply) { watched->reply = std::move(reply); };
  watched_[watched->instance] = watched;
  watch(watched);  // first: what waits in the queue may be about it
  finish(transaction);
  transaction->answer = nullptr;  // each would keep the other
}

void Engine::watch(const WatchedPtr& watched) {
  const std::chrono::duration<double, std::milli> left = watched->until - std::chrono::steady_clock::now();
  if (left.count() <= 0) return end_watch(watched->instance, "");
  const auto looked = [watched](Engine& engine, const control::Reply& reply) { engine.looked(watched, reply); };
  try {
    system_.watch_upgrade(watched->instance, left.count(), then(looked));
  } catch (...) {
    control::Reply reply;
    *reply.mutable_failure() = failure_of_exception();
    looked(*this, reply);
  }
}

void Engine::looked(const WatchedPtr& watched, const control::Reply& reply) {
  const auto known = watched_.find(watched->instance);
  if (known == watched_.end() || known->second != watched) return;  // it has ended otherwise
  system_.end_watch(watched->instance);
  if (!system_.stands_by(watched->instance))
    return end_watch(watched->instance, "it was unloaded, or the other has ended");
  if (reply.has_done()) return watch(watched);
  take_back(watched, reply.failure());
}

/// It is answered, and nothing stands by any more.
void Engine::end_watch(const std::string& instance, const std::string& warning) {
  const auto node = watched_.extract(instance);
  if (node.empty()) return;
  const WatchedPtr watched = node.mapped();
  system_.end_watch(instance);
  if (warning.empty() || !system_.stands_by(instance)) system_.leave_to_supervision(instance);
  if (!warning.empty()) watched->reply.mutable_done()->add_warnings("it was not watched to the end: " + warning);
  watched->answer(watched->reply);
}

/// A change like any other, in its turn: what was changed meanwhile stays.
void Engine::take_back(const WatchedPtr& watched, const control::Failure& why) {
  watched_.erase(watched->instance);
  auto transaction = std::make_shared<Transaction>();
  transaction->author = "upgrade";
  transaction->reason = why.what();
  auto& upgrade = *transaction->request.add_changes()->mutable_upgrade();
  upgrade.set_instance(watched->instance);
  upgrade.set_version(watched->version);
  upgrade.set_watch_ms(0);
  transaction->answer =
      then([watched, why](Engine& engine, const control::Reply& reply) { engine.told_back(*watched, why, reply); });
  try {
    enqueue(std::move(transaction));
  } catch (...) {
    control::Reply reply;
    *reply.mutable_failure() = failure_of_exception();
    told_back(*watched, why, reply);
  }
}

void Engine::told_back(const Watched& watched, const control::Failure& why, const control::Reply& reply) {
  const std::string bad = watched.transaction->steps.front().upgrade().version();
  const bool is_back = reply.has_done();
  if (!is_back) system_.leave_to_supervision(watched.instance);
  control::Reply told;
  *told.mutable_failure() = failure_of(
      Error(ErrorCode::ComponentFailed,
            {.what = fmt::format("'{}' {} was {}", watched.instance, bad,
                                 is_back ? fmt::format("taken back: {} serves again", watched.version)
                                         : fmt::format("to be taken back, which failed: {}", reply.failure().what())),
             .where = watched.instance,
             .found = why.what(),
             .next = "tell the publisher; market rollback, so that it is not loaded anew"}));
  watched.answer(told);
}

/// Nothing has been changed: the one that served serves. Nobody watches it any more, so that nothing is to stand by for
/// it, and it is started again as any other.
void Engine::upgrade_failed(const TransactionPtr& transaction, const control::Failure& why) {
  system_.drop_candidate();
  const control::Upgrade& upgrade = transaction->steps.front().upgrade();
  if (!watched_.contains(upgrade.instance())) system_.leave_to_supervision(upgrade.instance());
  const Error cause = error_of(why);
  ErrorText text = cause.text();
  text.found = text.what + (text.found.empty() ? "" : ": " + text.found);
  text.what =
      fmt::format("'{}' was not upgraded to {}: the version before goes on", upgrade.instance(), upgrade.version());
  if (text.where.empty()) text.where = upgrade.instance();
  if (text.next.empty() || text.next == "show " + upgrade.instance()) text.next = "tell the publisher";
  transaction->failure = failure_of(Error(cause.code(), std::move(text)));
  finish(transaction);
}

}  // namespace fiona::host
