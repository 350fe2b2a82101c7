// Who is left alone by clients that stand still, and those clients.
#include <sys/resource.h>
#include <time.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <deque>
#include <filesystem>
#include <fstream>
#include <map>
#include <optional>
#include <string>
#include <utility>

#include "components.hpp"

namespace fiona::test {
namespace {

std::int64_t ran_ns() {
  timespec now{};
  ::clock_gettime(CLOCK_THREAD_CPUTIME_ID, &now);
  return now.tv_sec * 1'000'000'000LL + now.tv_nsec;
}

/// How often this thread has let go of its processor to wait for something.
long waits() {
  rusage used{};
  ::getrusage(RUSAGE_THREAD, &used);
  return used.ru_nvcsw;
}

/// How long each thread of the process has waited for a processor so far.
using WaitedForCpu = std::map<std::string, std::int64_t>;
WaitedForCpu waited_for_cpu() {
  WaitedForCpu all;
  std::error_code ignored;
  std::filesystem::directory_iterator thread("/proc/self/task", ignored);
  for (; thread != std::filesystem::directory_iterator(); thread.increment(ignored)) {
    std::ifstream file(thread->path() / "schedstat");
    std::int64_t ran = 0, waited = 0;
    if (file >> ran >> waited) all[thread->path().filename()] = waited;
  }
  return all;
}

/// Since then, this thread and the one of the others that has waited longest: who waits for a lock waits for its holder
/// to get a processor.
std::int64_t waited_for_cpu_since(const WaitedForCpu& before) {
  const std::string own = std::to_string(::gettid());
  std::int64_t own_ns = 0, longest_ns = 0;
  for (const auto& [thread, waited] : waited_for_cpu()) {
    const auto then = before.find(thread);
    const std::int64_t since_ns = waited - (then == before.end() ? 0 : then->second);
    thread == own ? own_ns = since_ns : longest_ns = std::max(longest_ns, since_ns);
  }
  return own_ns + longest_ns;
}

}  // namespace

/// What calls cost the thread that makes them.
class CallCost {
 public:
  template <class Call>
  void of(Call call) {
    const WaitedForCpu waited_before = waited_for_cpu();
    const std::int64_t ran_before_ns = ran_ns();
    const long waits_before = waits();
    const std::int64_t begun_ns = steady_ns();
    call();
    const std::int64_t wall_ns = steady_ns() - begun_ns;
    const std::int64_t took_ns = ran_ns() - ran_before_ns;
    longest_ns_ = std::max(longest_ns_, wall_ns);
    // Else whoever lets this machine run has taken its processor away: it has waited for nothing.
    if (waits() > waits_before)
      blocked_ns_ = std::max(blocked_ns_, wall_ns - took_ns - waited_for_cpu_since(waited_before));
    ++ran_[std::min(ran_.size() - 1, static_cast<std::size_t>(took_ns / kStep_ns))];
    ++calls_;
  }
  double longest_ms() const { return static_cast<double>(longest_ns_) / 1e6; }
  /// The longest that one waited for something that is no processor.
  double blocked_ms() const { return static_cast<double>(blocked_ns_) / 1e6; }
  double ran_p99_ms() const {
    std::uint64_t longer = calls_ / 100;
    std::size_t at = ran_.size() - 1;
    for (; at > 0 && ran_[at] <= longer; --at) longer -= ran_[at];
    return static_cast<double>((static_cast<std::int64_t>(at) + 1) * kStep_ns) / 1e6;
  }

 private:
  static constexpr std::int64_t kStep_ns = 10'000;
  std::int64_t longest_ns_ = 0;
  std::int64_t blocked_ns_ = 0;
  std::uint64_t calls_ = 0;
  std::array<std::uint64_t, 5'000> ran_{};  ///< calls by how long they ran: what is looked at must not grow by that
};

/// Puts samples and states at a pace, answers questions, and tells what these calls cost it. What is asked in the
/// manner 'held' is answered once `answers` is set, one a period.
class Supplier final : public Paced {
 public:
  using Paced::Paced;

 private:
  void tick() override {
    if (number_ < params_->count()) put();
    if (params_->answers() && !held_.empty()) {
      auto oldest = std::move(held_.front());
      held_.pop_front();
      oldest.first.mutable_payload()->resize(params_->payload());
      cost_.of([&] { oldest.second.answer(std::move(oldest.first)); });
    }
    again_after(params_->period_ms());
  }
  void put() {
    auto sample = samples_.make();
    sample->set_number(++number_);
    sample->mutable_payload()->assign(params_->payload(), 'x');
    Sample state;
    state.set_number(number_);
    cost_.of([&] { samples_.put(std::move(sample)); });
    cost_.of([&] { bell_.put(state); });
    puts_.set(number_);
  }
  void tell() {
    longest_.set(cost_.longest_ms());
    blocked_.set(cost_.blocked_ms());
    ran_p99_.set(cost_.ran_p99_ms());
  }
  void on_question(const Question& question, fiona::Reply<Reply> reply) {
    Reply answer;
    answer.set_number(question.number());
    if (question.manner() == "held") {
      held_.emplace_back(std::move(answer), std::move(reply));
    } else {
      cost_.of([&] { reply.answer(std::move(answer)); });
    }
    waiting_.set(held_.size());
  }
  std::optional<Crossing> ring(Threshold& threshold, const Sample& now) {
    Crossing crossing;
    crossing.set_number(now.number());
    crossing.set_payload(threshold.payload());
    return crossing;
  }

  std::uint64_t number_ = 0;
  CallCost cost_;
  std::deque<std::pair<Reply, fiona::Reply<Reply>>> held_;
  Params<SupplierParams> params_{*this};
  Provides<SampleNewest> samples_{*this, "samples"};
  Provides<Bell> bell_{*this, "bell", &Supplier::ring};
  Provides<Echo> echo_{*this, "echo", &Supplier::on_question};
  Probe<double> longest_{*this, "longest", {.unit = "ms", .doc = "put or answer"}};
  Probe<double> blocked_{
      *this, "blocked", {.unit = "ms", .doc = "the longest that one waited for something that is no processor"}};
  Probe<double> ran_p99_{*this, "ran_p99", {.unit = "ms", .doc = "of them, on a processor"}};
  Probe<std::uint64_t> waiting_{*this, "waiting", {.doc = "questions that are held"}};
  Probe<std::uint64_t> puts_{*this, "puts", {.doc = "so far, of a sample and a state each"}};
  Task teller_{*this, "teller", 500ms, &Supplier::tell};
};

/// Takes all that a supplier has, and counts what came of it.
class Customer final : public Component {
 public:
  using Component::Component;

 private:
  void on_change() {
    if (params_->rings() && !std::exchange(rings_asked_, true)) hull().spawn(activate(), [] {});
    for (; asked_ < params_->questions(); ++asked_) hull().spawn(ask(asked_ + 1, params_->manner()), [] {});
  }
  void on_sample(const Sample&) {}
  void on_ring(const Fired<Crossing>& crossing) {
    if (crossing->number() <= newest_ring_) disorder_.set(++disordered_);
    newest_ring_ = crossing->number();
  }
  Async<> activate() {
    Threshold threshold;
    threshold.mutable_payload()->resize(params_->payload());
    const auto id = co_await bell_.activate(EventMode::Continuous, std::move(threshold));
    activated_.set(std::string(to_string(id.outcome())));
  }
  Async<> ask(std::uint64_t number, std::string manner) {
    const std::int64_t begun_ns = steady_ns();
    Question question;
    question.set_number(number);
    question.set_manner(manner);
    const auto answer = co_await echo_.query(std::move(question), from_ms(params_->deadline_ms()));
    if (answer && (*answer)->number() != number) wrong_.set(++wrongs_);
    std::uint64_t& count = answer ? oks_ : answer.outcome() == Outcome::Rejected ? refusals_ : others_;
    ++count;
    ok_.set(oks_);
    refused_.set(refusals_);
    other_.set(others_);
    if (!answer) last_reason_.set(std::string(answer.reason()));
    longest_ms_ = std::max(longest_ms_, static_cast<double>(steady_ns() - begun_ns) / 1e6);
    longest_answer_.set(longest_ms_);
  }
  void look() {
    if (params_->asks()) hull().spawn(ask(++asked_, ""), [] {});
  }

  bool rings_asked_ = false;
  std::uint64_t asked_ = 0, oks_ = 0, refusals_ = 0, others_ = 0, wrongs_ = 0, newest_ring_ = 0, disordered_ = 0;
  double longest_ms_ = 0;
  Params<CustomerParams> params_{*this, nullptr, &Customer::on_change};
  Requires<SampleNewest> samples_{*this, "samples", &Customer::on_sample, {.optional = true}};
  Requires<Bell> bell_{*this, "bell", &Customer::on_ring, {.optional = true}};
  Requires<Echo> echo_{*this, "echo", {.optional = true}};
  Probe<std::string> activated_{*this, "activated", {.doc = "how that ended"}};
  Probe<std::uint64_t> disorder_{*this, "disorder", {.doc = "events that were no newer than one before them"}};
  Probe<std::uint64_t> ok_{*this, "ok", {.doc = "questions that were answered"}};
  Probe<std::uint64_t> refused_{*this, "refused", {.doc = "questions that were rejected"}};
  Probe<std::uint64_t> other_{*this, "other", {.doc = "questions that have ended otherwise"}};
  Probe<std::uint64_t> wrong_{*this, "wrong", {.doc = "answers to another question"}};
  Probe<std::string> last_reason_{*this, "last_reason", {.doc = "of a question without an answer"}};
  Probe<double> longest_answer_{*this, "longest_answer", {.unit = "ms"}};
  Task asker_{*this, "asker", 10ms, &Customer::look};
};

void add_standing(Plugin& plugin) {
  plugin.add<Supplier>("supplier", "supplies its clients, and tells what that costs it");
  plugin.add<Customer>("customer", "takes all that a supplier has");
}

}  // namespace fiona::test
