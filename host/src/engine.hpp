#pragma once

#include <chrono>
#include <cstdint>
#include <deque>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "access.hpp"
#include "journal.hpp"
#include "system.hpp"

namespace fiona::host {

/// Whose request a change is; 0: nobody's who could give it up.
struct Asker {
  std::uint64_t client = 0;
  std::uint64_t request = 0;
};

/// Changes the system, by transactions: all of the changes or none (docs/architecture.md, Changing a system). Each is
/// tried on a copy of the model first; then its steps are made one after the other, and taken back when one fails. One
/// is under way at a time, the others wait in their order. All functions [control thread].
class Engine {
 public:
  /// Transactions that may wait; further ones are refused.
  static constexpr std::size_t kMaxWaiting = 256;
  /// Those that are only tried, which take no places of theirs.
  static constexpr std::size_t kMaxPlansWaiting = 16;
  /// Steps of a plan by who could not make it.
  static constexpr std::size_t kMostPlanned = 256;
  /// Comparisons before a swap that may be under way.
  static constexpr std::size_t kMaxComparing = 16;

  /// `later` hands work to the control thread, from any thread.
  using Later = std::function<void(std::function<void()>)>;
  /// `before`: what the journal of the host before has told, which this one goes on with.
  Engine(System& system, std::filesystem::path journal, Later later,
         std::optional<Journal::Told> before = std::nullopt);
  ~Engine();

  /// Answered with Done or Planned, or with why nothing has changed. A swap that is to be watched is compared first,
  /// which holds up nobody. One that has not begun `within` is refused; none: it waits for its turn. `rights`: of who
  /// has asked, who has what the changes take by their kind; what they take beyond that is seen once they are tried.
  void transact(const std::string& author, const control::Transact& request, Waits::Answer answer,
                std::optional<std::chrono::milliseconds> within = std::nullopt, Rights rights = {}, Asker asker = {});
  /// The same; it takes what the change takes that it takes back, and what it does itself.
  void undo(const std::string& author, const control::Undo& request, Waits::Answer answer, Rights rights = {},
            Asker asker = {});
  /// What the client has asked for and has not begun is not made, and its answer says so; with a number only that
  /// request. False: there is none that can be given up.
  bool give_up(std::uint64_t client, std::optional<std::uint64_t> request = std::nullopt);
  control::JournalEntries journal(std::uint32_t last) const;
  /// No transaction is under way.
  bool is_idle() const { return !current_; }
  /// Nor a change of mode.
  bool is_at_rest() const { return is_idle() && aside_.empty(); }

 private:
  struct Transaction;
  using TransactionPtr = std::shared_ptr<Transaction>;
  struct Watched;
  using WatchedPtr = std::shared_ptr<Watched>;

  bool compare_first(const TransactionPtr& transaction);
  void compared(const TransactionPtr& transaction, const control::Reply& reply);
  void enqueue(TransactionPtr transaction);
  void begin(const TransactionPtr& transaction);
  void choose_what_to_undo(Transaction& transaction) const;
  void plan(Transaction& transaction) const;
  void plan_upgrade(Transaction& transaction) const;
  void go_on(const TransactionPtr& transaction);
  void begin_step(const TransactionPtr& transaction, const control::Change& step);
  control::Done end_step(const Transaction& transaction, const control::Change& step, const control::Done& done);
  void step_failed(const TransactionPtr& transaction, const control::Failure& failure);
  void note_rest(Transaction& transaction);
  void finish(const TransactionPtr& transaction);

  // ---- engine_upgrade.cpp
  template <class Work>
  Waits::Answer then(Work work);
  template <class Step>
  Waits::Answer then_with(const TransactionPtr& transaction, Step step);
  template <class Step>
  void try_upgrade(const TransactionPtr& transaction, Step step);
  void begin_upgrade(const TransactionPtr& transaction);
  void take_over(const TransactionPtr& transaction);
  void watch(const WatchedPtr& watched);
  void looked(const WatchedPtr& watched, const control::Reply& reply);
  void end_watch(const std::string& instance, const std::string& warning);
  void take_back(const WatchedPtr& watched, const control::Failure& why);
  void told_back(const Watched& watched, const control::Failure& why, const control::Reply& reply);
  void upgrade_failed(const TransactionPtr& transaction, const control::Failure& why);

  System& system_;
  Journal journal_;
  const Later later_;
  const std::shared_ptr<Engine*> self_;  ///< null once it is gone: what comes later finds nobody
  std::deque<TransactionPtr> waiting_;
  TransactionPtr current_;
  std::set<TransactionPtr> aside_;                     ///< changes of mode that are under way
  std::map<TransactionPtr, std::uint64_t> comparing_;  ///< with the number of the comparison
  std::map<std::string, WatchedPtr> watched_;          ///< by instance: upgrades that may be taken back
};

}  // namespace fiona::host
