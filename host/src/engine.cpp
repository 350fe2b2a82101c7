#include "engine.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <tuple>

#include "engine_transaction.hpp"
#include "failure.hpp"
#include "fiona/error.hpp"
#include "last_words.hpp"

namespace fiona::host {

namespace {

/// Waits of a transaction belong to no client: they end though it goes.
constexpr std::uint64_t kEngine = UINT64_MAX;

control::Reply reply_of(const control::Failure& failure) {
  control::Reply reply;
  *reply.mutable_failure() = failure;
  return reply;
}

/// How long two may be compared.
constexpr double kLeastWatch_ms = 100;
constexpr double kMostWatch_ms = 3'600'000;

void require_time_to_watch(const control::Replace& swap) {
  if (swap.watch_ms() >= kLeastWatch_ms && swap.watch_ms() <= kMostWatch_ms) return;
  throw Error(ErrorCode::Usage, {.what = "the time to compare is out of range",
                                 .where = swap.old(),
                                 .expected = "100ms .. 1h",
                                 .found = fmt::format("{:g} ms", swap.watch_ms())});
}

/// What a step will do that cannot be taken back, or that others will feel.
std::optional<std::string> warning_of(const control::Change& step, const Model& before) {
  if (!step.has_unload()) return std::nullopt;
  const std::string& name = step.unload().instance();
  std::vector<std::string> clients;
  for (const auto& [client, wire] : before.wires()) {
    // Who has another provider goes on with that one.
    if (wire.uses(name) && wire.providers.size() == 1 && client.first != name)
      clients.push_back(client.first + "." + client.second);
  }
  std::string text = "what '" + name + "' knows is lost: loaded again it begins anew";
  if (!clients.empty()) text += fmt::format("; these wait meanwhile: {}", fmt::join(clients, ", "));
  return text;
}

/// Of steps that are made one after the other.
std::vector<std::string> warnings_of(Model from, const std::vector<control::Change>& steps, const Packages& packages) {
  std::vector<std::string> warnings;
  for (const auto& step : steps) {
    if (auto warning = warning_of(step, from)) warnings.push_back(std::move(*warning));
    from.make(step, packages);
  }
  return warnings;
}

/// Make before break: whom somebody serves is not wired to nobody by a name that has a letter wrong. Who says
/// `unwire` before means it.
void require_somebody_serves(const Model& before, const Model& after, const control::Transact& request) {
  for (const auto& [client, wire] : after.wires()) {
    const auto unwires = [&key = client](const auto& one) {
      return one.has_unwire() && key_of(one.unwire().client()) == key;
    };
    if (std::any_of(request.changes().begin(), request.changes().end(), unwires)) continue;
    const auto old = before.wires().find(client);
    if (old == before.wires().end() || old->second == wire) continue;
    const auto is_there = [&](const control::PortName& one) { return after.find(one.instance()) != nullptr; };
    const auto serves = std::find_if(old->second.providers.begin(), old->second.providers.end(), is_there);
    if (serves == old->second.providers.end()) continue;
    if (std::any_of(wire.providers.begin(), wire.providers.end(), is_there)) continue;
    const std::string name = client.first + "." + client.second;
    const std::string& missing = wire.providers.front().instance();
    const auto near = nearest_names(missing, after.names());
    throw Error(ErrorCode::NotFound,
                {.what = "there is no instance '" + missing + "': " + name + " stays wired to " + text_of(*serves),
                 .where = name,
                 .expected = near.empty() ? "" : fmt::format("{}", fmt::join(near, ", ")),
                 .next = "unwire " + name + ", if it is to wait for it"});
  }
}

/// The host's own user names what he likes, and nobody has to look.
void require_paths(const Rights& rights, const Model& before, const Model& after) {
  if (rights.level >= trust::Access::Administer) return;
  if (const auto need = need_of(before, after)) require(rights, *need);
}

/// Which it was: a host that is started again loads the same, where it is still there. And its name, which only its
/// package tells where none was typed: that may be gone by the end of the load.
void note_identity(control::Load& load, const Model& after, const Packages& packages) {
  if (load.instance().empty()) load.set_instance(packages.find(load.plugin()).component);
  load.set_version(after.load_of(load.instance()).version());
}

void add(control::Done& total, const control::Done& one, std::size_t steps) {
  total.set_switched(total.switched() + one.switched());
  total.set_gap_ms(std::max(total.gap_ms(), one.gap_ms()));
  total.set_lost(total.lost() + one.lost());
  total.set_redirected(total.redirected() + one.redirected());
  total.mutable_warnings()->MergeFrom(one.warnings());
  total.set_note(steps == 1 ? one.note() : fmt::format("{} changes", steps));
}

}  // namespace

Engine::Engine(System& system, std::filesystem::path journal, Later later, std::optional<Journal::Told> before)
    : system_(system),
      journal_(std::move(journal), std::move(before)),
      later_(std::move(later)),
      self_(std::make_shared<Engine*>(this)) {}

Engine::~Engine() { *self_ = nullptr; }

void Engine::transact(const std::string& author, const control::Transact& request, Waits::Answer answer,
                      std::optional<std::chrono::milliseconds> within, Rights rights, Asker asker) {
  auto transaction = std::make_shared<Transaction>();
  transaction->author = author;
  transaction->asker = asker;
  transaction->rights = std::move(rights);
  transaction->request = request;
  transaction->answer = std::move(answer);
  if (within) transaction->expires = std::chrono::steady_clock::now() + *within;
  if (!compare_first(transaction)) enqueue(std::move(transaction));
}

/// False where nothing is to be compared. Everything else that can be told beforehand is told before, too.
bool Engine::compare_first(const TransactionPtr& transaction) {
  std::vector<control::Replace> swaps;
  double longest_ms = 0;
  for (const auto& change : transaction->request.changes()) {
    if (!change.has_replace() || change.replace().watch_ms() == 0) continue;
    require_time_to_watch(change.replace());
    longest_ms = std::max(longest_ms, change.replace().watch_ms());
    swaps.push_back(change.replace());
  }
  if (swaps.empty() || transaction->request.dry_run()) return false;
  Transaction trial = *transaction;
  plan(trial);
  if (trial.failure) throw_failure(*trial.failure);
  if (comparing_.size() >= kMaxComparing) {
    throw Error(ErrorCode::NotAllowed, {.what = fmt::format("{} comparisons are under way already", comparing_.size()),
                                        .next = "swap without watch"});
  }
  const auto taps = std::make_shared<std::vector<std::uint64_t>>();
  const auto ended = [later = later_, alive = std::weak_ptr(self_), transaction, taps](control::Reply reply) {
    later([alive, transaction, taps, reply = std::move(reply)] {
      const auto self = alive.lock();
      if (!self || !*self) return;
      for (const std::uint64_t tap : *taps) (*self)->system_.untap(tap);
      (*self)->compared(transaction, reply);
    });
  };
  std::tie(comparing_[transaction], *taps) = system_.compare(swaps, longest_ms, ended);
  return true;
}

void Engine::compared(const TransactionPtr& transaction, const control::Reply& reply) {
  comparing_.erase(transaction);
  if (reply.has_failure()) transaction->failure = reply.failure();
  if (reply.has_ended())
    transaction->failure = failure_of(Error(
        ErrorCode::Failed, {.what = "the run has ended: nothing was swapped", .next = "fiona run, and swap again"}));
  if (transaction->failure) return finish(transaction);
  transaction->done = reply.done();
  try {
    enqueue(transaction);
  } catch (...) {
    transaction->failure = failure_of_exception();
    finish(transaction);
  }
}

bool Engine::give_up(std::uint64_t client, std::optional<std::uint64_t> request) {
  const auto failure = failure_of(Error(
      ErrorCode::Failed, {.what = "who asked for this change has given it up: it was not made", .next = "journal"}));
  bool found = false;
  const auto is_meant = [&](const TransactionPtr& one) {
    const bool meant = one->asker.client == client && (!request || one->asker.request == *request);
    found = found || meant;
    return meant;
  };
  for (const auto& [transaction, comparison] : comparing_) {
    if (!is_meant(transaction)) continue;
    transaction->failure = failure;
    system_.end_comparison(comparison, reply_of(failure));
  }
  for (const auto& transaction : waiting_) {
    if (is_meant(transaction)) transaction->failure = failure;
  }
  return found;
}

void Engine::undo(const std::string& author, const control::Undo& request, Waits::Answer answer, Rights rights,
                  Asker asker) {
  auto transaction = std::make_shared<Transaction>();
  transaction->author = author;
  transaction->asker = asker;
  transaction->rights = std::move(rights);
  transaction->is_undo = true;
  transaction->request.set_dry_run(request.dry_run());
  transaction->answer = std::move(answer);
  enqueue(std::move(transaction));
}

/// What it takes back is decided when its turn comes: what waits before it may be the last by then.
void Engine::choose_what_to_undo(Transaction& transaction) const {
  if (const control::JournalEntry* last = journal_.last_done()) {
    *transaction.request.mutable_changes() = last->reverse();
    transaction.undoes = last->number();
    control::Transact both = transaction.request;
    both.mutable_changes()->MergeFrom(last->steps());
    Need need = need_of(both);
    need.what = "undo of " + need.what;
    try {
      require(transaction.rights, need);
    } catch (...) {
      transaction.failure = failure_of_exception();
    }
    return;
  }
  transaction.failure = failure_of(Error(ErrorCode::NotFound, {.what = "there is nothing to undo", .next = "journal"}));
}

control::JournalEntries Engine::journal(std::uint32_t last) const {
  control::JournalEntries found;
  const auto& all = journal_.entries();
  const std::size_t skipped = last == 0 || last >= all.size() ? 0 : all.size() - last;
  for (std::size_t i = skipped; i < all.size(); ++i) *found.add_entries() = all[i];
  return found;
}

void Engine::enqueue(TransactionPtr transaction) {
  if (!current_) return begin(transaction);
  const bool is_plan = transaction->request.dry_run();
  const auto alike = std::count_if(waiting_.begin(), waiting_.end(),
                                   [&](const auto& one) { return one->request.dry_run() == is_plan; });
  if (alike >= static_cast<std::ptrdiff_t>(is_plan ? kMaxPlansWaiting : kMaxWaiting)) {
    throw Error(ErrorCode::NotAllowed,
                {.what = fmt::format("{} {} wait already", alike, is_plan ? "plans" : "changes"), .next = "journal"});
  }
  waiting_.push_back(std::move(transaction));
}

/// Everything that can be told beforehand is told here, before anything is touched.
void Engine::plan(Transaction& transaction) const {
  const control::Transact& request = transaction.request;
  transaction.before = system_.model();
  Model after = request.whole() ? Model() : transaction.before;
  for (int i = 0; i < request.changes_size(); ++i) {
    try {
      if (request.dry_run() && std::max<std::size_t>(i, transaction.steps.size()) >= kMostPlanned)
        require(transaction.rights,
                {trust::Access::Compose, fmt::format("a plan of more than {} steps", kMostPlanned)});
      if (request.changes(i).has_upgrade() && !request.whole()) return plan_upgrade(transaction);
      for (auto& step : after.steps_of(request.changes(i))) {
        if (auto warning = warning_of(step, after)) transaction.warnings.push_back(std::move(*warning));
        after.make(step, system_.packages());
        if (step.has_load() && !request.whole()) note_identity(*step.mutable_load(), after, system_.packages());
        transaction.steps.push_back(std::move(step));
      }
    } catch (...) {
      transaction.failure = failure_of_exception();
      transaction.failure->set_change(static_cast<std::uint32_t>(i) + 1);
      return;
    }
  }
  try {
    require_paths(transaction.rights, transaction.before, after);
    if (!request.whole() && !transaction.is_undo) require_somebody_serves(transaction.before, after, request);
    if (request.whole()) {
      transaction.steps = Model::difference(transaction.before, after);
      transaction.warnings = warnings_of(transaction.before, transaction.steps, system_.packages());
    }
  } catch (...) {
    transaction.failure = failure_of_exception();
    return;
  }
  transaction.reverse = Model::difference(after, transaction.before);
}

/// What undoes it is an upgrade too.
void Engine::plan_upgrade(Transaction& transaction) const {
  if (transaction.request.changes_size() != 1) {
    throw Error(ErrorCode::Usage, {.what = "an upgrade is a transaction of its own", .next = "a line of its own"});
  }
  control::Change step;
  *step.mutable_upgrade() = system_.completed(transaction.request.changes(0).upgrade());
  const Model::Instance& before = transaction.before.instance(step.upgrade().instance());
  Model after = transaction.before;
  after.make(step, system_.packages());
  require_paths(transaction.rights, transaction.before, after);
  auto& back = *transaction.reverse.emplace_back().mutable_upgrade();
  back.set_instance(step.upgrade().instance());
  back.set_version(before.package->version);
  back.set_group(before.group);
  back.set_watch_ms(0);  // to what is known
  transaction.steps.push_back(std::move(step));
}

void Engine::begin(const TransactionPtr& transaction) {
  if (transaction->expires && std::chrono::steady_clock::now() > *transaction->expires) {
    transaction->failure = failure_of(Error(
        ErrorCode::Unreachable, {.what = "the changes before it took too long: it was not begun", .next = "journal"}));
  }
  if (transaction->is_undo && !transaction->failure) choose_what_to_undo(*transaction);
  if (!transaction->failure) plan(*transaction);
  if (transaction->failure) return finish(transaction);
  if (transaction->request.dry_run()) {
    control::Reply reply;
    auto& planned = *reply.mutable_planned();
    planned.mutable_steps()->Add(transaction->steps.begin(), transaction->steps.end());
    planned.mutable_reverse()->Add(transaction->reverse.begin(), transaction->reverse.end());
    planned.mutable_warnings()->Add(transaction->warnings.begin(), transaction->warnings.end());
    return transaction->answer(std::move(reply));
  }
  if (transaction->steps.empty()) {
    transaction->done.set_note("nothing to change");
    return finish(transaction);
  }
  control::JournalEntry entry;
  entry.set_author(transaction->author);
  entry.set_undoes(transaction->undoes);
  entry.set_reason(transaction->reason);
  entry.mutable_steps()->Add(transaction->steps.begin(), transaction->steps.end());
  entry.mutable_reverse()->Add(transaction->reverse.begin(), transaction->reverse.end());
  try {
    transaction->entry = journal_.begin(std::move(entry));
  } catch (...) {
    transaction->failure = failure_of_exception();
    return finish(transaction);
  }
  if (transaction->is_aside()) {
    aside_.insert(transaction);
  } else {
    current_ = transaction;
  }
  go_on(transaction);
}

/// Makes steps until one has to be waited for, or none is left.
void Engine::go_on(const TransactionPtr& transaction) {
  while (transaction->at < transaction->steps.size()) {
    const control::Change step = transaction->steps[transaction->at];
    if (step.has_upgrade()) return begin_upgrade(transaction);
    if (step.has_state() || (step.has_load() && system_.loads_later(step.load()))) return begin_step(transaction, step);
    try {
      const bool restores = transaction->is_undo || transaction->takes_back;
      add(transaction->done, system_.perform(step, restores), transaction->steps.size());
      ++transaction->at;
    } catch (...) {
      step_failed(transaction, failure_of_exception());
    }
  }
  finish(transaction);
}

/// A step for which a component may need time: nobody waits for it meanwhile.
void Engine::begin_step(const TransactionPtr& transaction, const control::Change& step) {
  const auto ended = [later = later_, alive = std::weak_ptr(self_), transaction, step](control::Reply reply) {
    later([alive, transaction, step, reply = std::move(reply)] {
      const auto self = alive.lock();
      if (!self || !*self) return;
      Engine& engine = **self;
      control::Failure failure = reply.failure();
      if (reply.has_ended()) failure.set_what("the run has ended");
      try {
        if (!reply.has_done()) throw_failure(failure);
        add(transaction->done, engine.end_step(*transaction, step, reply.done()), transaction->steps.size());
        ++transaction->at;
      } catch (...) {
        engine.step_failed(transaction, failure_of_exception());
      }
      engine.go_on(transaction);
    });
  };
  try {
    if (step.has_load()) {
      system_.begin_load(step.load(), ended);
    } else {
      system_.state(kEngine, transaction->entry, step.state(), ended);
    }
  } catch (...) {
    step_failed(transaction, failure_of_exception());
    go_on(transaction);
  }
}

control::Done Engine::end_step(const Transaction& transaction, const control::Change& step, const control::Done& done) {
  if (step.has_load()) return system_.end_load(step.load());
  // Others of its instance may have been asked for at the same time: what it takes back is the mode of now.
  Model after = system_.model();
  if (transaction.is_aside() && after.find(step.state().instance())) {
    after.make(step, system_.packages());
    journal_.set_reverse(transaction.entry, Model::difference(after, system_.model()));
  }
  system_.note_state(step.state());
  // Made beside the one that is under way: what takes that back is not to take back this.
  const bool beside = current_ && current_.get() != &transaction;
  if (beside && current_->before.find(step.state().instance())) current_->before.make(step, system_.packages());
  return done;
}

/// From here on the steps are those that take back what has been made. One that fails among these is told, and passed.
void Engine::step_failed(const TransactionPtr& transaction, const control::Failure& failure) {
  if (transaction->takes_back) {
    transaction->not_taken_back.push_back(failure.what());
    ++transaction->at;
    return;
  }
  transaction->takes_back = true;
  transaction->failure = failure;
  const bool one_by_one = !transaction->request.whole() &&
                          transaction->steps.size() == static_cast<std::size_t>(transaction->request.changes_size());
  if (one_by_one && transaction->steps.size() > 1)
    transaction->failure->set_change(static_cast<std::uint32_t>(transaction->at) + 1);
  // Of a change aside nothing has been made, and what others have made meanwhile is theirs.
  const bool aside = transaction->is_aside();
  transaction->steps = aside ? std::vector<control::Change>() : Model::difference(system_.model(), transaction->before);
  transaction->at = 0;
}

/// What could not be taken back has happened: a host that is started again is to have it so, and an undo to take it
/// back.
void Engine::note_rest(Transaction& transaction) {
  control::JournalEntry entry;
  entry.set_author(transaction.author);
  for (auto& step : Model::difference(transaction.before, system_.model())) *entry.add_steps() = std::move(step);
  for (auto& step : Model::difference(system_.model(), transaction.before)) *entry.add_reverse() = std::move(step);
  if (entry.steps().empty()) return;
  try {
    journal_.end(journal_.begin(std::move(entry)), control::JournalEntry::DONE,
                 fmt::format("could not be taken back of {}", transaction.entry), &system_.model());
  } catch (const Error& error) {
    transaction.not_taken_back.push_back(error.text().what);
  }
}

void Engine::finish(const TransactionPtr& transaction) {
  using Entry = control::JournalEntry;
  if (transaction->entry != 0) {
    const std::string reason = transaction->failure ? transaction->failure->what() : transaction->reason;
    const bool is_half_made = current_ && current_ != transaction;  // what is aside has made nothing until it ends
    try {
      journal_.end(transaction->entry, transaction->failure ? Entry::ROLLED_BACK : Entry::DONE, reason,
                   is_half_made ? nullptr : &system_.model());
    } catch (const Error& error) {
      transaction->done.add_warnings(error.text().what + ": after a restart of the host this has not happened");
    }
  }
  if (!transaction->not_taken_back.empty()) {
    note_rest(*transaction);
    transaction->failure->set_found(fmt::format("{}; and this could not be taken back: {}",
                                                transaction->failure->found(),
                                                fmt::join(transaction->not_taken_back, "; ")));
  }
  if (transaction->failure) {
    transaction->answer(reply_of(*transaction->failure));
  } else {
    for (const control::Change& step : transaction->steps) {
      if (step.has_unload()) LastWords::forget(step.unload().instance());
      if (step.has_upgrade()) LastWords::forget(step.upgrade().instance());
    }
    control::Reply reply;
    *reply.mutable_done() = transaction->done;
    reply.mutable_done()->set_entry(transaction->entry);
    transaction->answer(std::move(reply));
  }
  aside_.erase(transaction);
  if (current_ != transaction) return;
  current_.reset();
  while (!current_ && !waiting_.empty()) {
    const TransactionPtr next = std::move(waiting_.front());
    waiting_.pop_front();
    begin(next);
  }
}

}  // namespace fiona::host
