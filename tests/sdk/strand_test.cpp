// What runs: strands, inboxes, tasks, coroutines, and virtual time that does not depend on threads.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <time.h>

#include <atomic>
#include <deque>
#include <functional>
#include <future>
#include <map>
#include <numeric>
#include <random>
#include <thread>

#include "fiona/local_wire.hpp"
#include "fiona/pool.hpp"
#include "fiona/push.hpp"
#include "fiona/sdk_test/objects.fiona.hpp"
#include "fiona/send.hpp"
#include "fiona/testing/inline_executor.hpp"
#include "support.hpp"

namespace fiona::sdk_test {
namespace {

using namespace std::chrono_literals;
using ::testing::ElementsAre;
using ::testing::IsEmpty;

// ---- virtual time ---------------------------------------------------------------------------------------------

/// Puts at irregular whole milliseconds, so that several producers often speak in the same instant.
class Producer final : public Component {
 public:
  using Component::Component;
  void on_mode(std::string_view mode) override {
    if (mode == kModeActive) next_.at(now());
  }

 private:
  void put_next() {
    Number number;
    number.set_value(++count_);
    numbers_.put(std::move(number));
    state_ = state_ * 1664525 + 1013904223 + name().back();
    next_.at(now() + std::chrono::milliseconds(1 + (state_ >> 16) % 4));
  }
  std::uint32_t state_ = 7;
  std::uint64_t count_ = 0;
  Provides<Numbers> numbers_{*this, "numbers"};
  Timer next_{*this, &Producer::put_next};
};

/// Passes on what it hears, in the same instant.
class Relay final : public Component {
 public:
  using Component::Component;

 private:
  void on_left(const Number& number) { pass_on(2 * number.value()); }
  void on_right(const Number& number) { pass_on(2 * number.value() + 1); }
  void pass_on(std::uint64_t value) {
    Number number;
    number.set_value(value);
    out_.put(std::move(number));
  }
  Requires<Numbers> left_{*this, "left", &Relay::on_left};
  Requires<Numbers> right_{*this, "right", &Relay::on_right};
  Provides<Numbers> out_{*this, "out"};
};

/// Writes down what comes in, in the order in which it comes.
class Recorder final : public Component {
 public:
  using Component::Component;
  const std::vector<std::string>& log() const { return log_; }

 private:
  void on_a(const Number& number) { note("a", number); }
  void on_b(const Number& number) { note("b", number); }
  void on_c(const Number& number) { note("c", number); }
  void tick() { log_.push_back("tick " + std::to_string(to_milliseconds(now()))); }
  void note(const std::string& port, const Number& number) {
    log_.push_back(port + " " + std::to_string(number.value()) + " " + std::to_string(to_milliseconds(now())));
  }
  std::vector<std::string> log_;
  Requires<Numbers> a_{*this, "a", &Recorder::on_a};
  Requires<Numbers> b_{*this, "b", &Recorder::on_b};
  Requires<Numbers> c_{*this, "c", &Recorder::on_c};
  Task ticker_{*this, "ticker", 10ms, &Recorder::tick};
};

void wire(Hull& client, std::string_view in, Hull& provider, std::string_view out) {
  auto& required = dynamic_cast<RequiredPort&>(*client.find_port(in));
  auto& provided = dynamic_cast<detail::PushProvider&>(*provider.find_port(out));
  const std::string name = required.full_name() + "<" + provided.full_name();
  const auto end = required.end_for(provided.full_name());
  end->set_connection(Connection::Connected, provided.full_name());
  provided.attach(std::make_shared<LocalWire>(name, end, 1));
}

/// Three producers, two relays, one recorder, for 500 virtual milliseconds on so many threads.
std::vector<std::string> log_of_run(std::size_t threads) {
  VirtualClock clock;
  Pool pool(threads);
  KeptEvents events;
  Made<Producer> one("one", pool, clock, events), two("two", pool, clock, events), three("three", pool, clock, events);
  Made<Relay> near("near", pool, clock, events), far("far", pool, clock, events);
  Made<Recorder> recorder("recorder", pool, clock, events);
  wire(near.hull, "left", one.hull, "numbers");
  wire(near.hull, "right", two.hull, "numbers");
  wire(far.hull, "left", near.hull, "out");
  wire(far.hull, "right", three.hull, "numbers");
  wire(recorder.hull, "a", near.hull, "out");
  wire(recorder.hull, "b", far.hull, "out");
  wire(recorder.hull, "c", three.hull, "numbers");
  for (Hull* hull : {&recorder.hull, &near.hull, &far.hull, &one.hull, &two.hull, &three.hull}) {
    hull->set_mode(kModeActive, kLimit);
  }
  std::promise<void> done;
  clock.stop_at(TimePoint(500ms), [&] {
    clock.hold();
    done.set_value();
  });
  clock.release();
  if (done.get_future().wait_for(kLimit) != std::future_status::ready) throw std::runtime_error("time does not go on");
  return recorder->log();
}

TEST(VirtualClock, OrderOfDeliveriesDoesNotDependOnTheNumberOfThreads) {
  const auto expected = log_of_run(1);
  ASSERT_GT(expected.size(), 1000U);
  for (const std::size_t threads : {2, 8}) {
    for (int run = 0; run < 5; ++run) ASSERT_EQ(log_of_run(threads), expected) << threads << " threads, run " << run;
  }
}

TEST(VirtualClock, StandsWhileHeld) {
  VirtualClock clock;
  testing::InlineExecutor executor;
  KeptEvents events;
  Made<Producer> producer("one", executor, clock, events);
  producer.hull.set_mode(kModeActive, kLimit);
  executor.help();
  EXPECT_EQ(clock.now(), TimePoint{});
  EXPECT_EQ(producer.hull.find_port("numbers")->counters().messages, 0U)
      << "even what is due at zero waits for release";
}

/// A run goes on beside calls, changes of mode and waits, each of which lets time run until it is answered.
TEST(VirtualClock, KeepsItsPaceThoughOthersComeAndGoWhileTimeRuns) {
  VirtualClock clock;
  clock.set_speed(1);
  std::atomic<bool> over{false};
  clock.stop_at(TimePoint(20ms), [&over] { over = true; });
  clock.release();
  const auto end = std::chrono::steady_clock::now() + 10s;
  while (!over && std::chrono::steady_clock::now() < end) {
    clock.release();
    clock.hold();
  }
  EXPECT_TRUE(over);
  clock.stop();
}

TEST(VirtualClock, CancelledStopDoesNotRun) {
  VirtualClock clock;
  bool ran = false;
  const auto stop = clock.stop_at(TimePoint(1s), [&] { ran = true; });
  clock.stop_at(TimePoint(2s), [&] { clock.hold(); });
  clock.cancel_stop(stop);
  clock.release();
  EXPECT_FALSE(ran);
  EXPECT_EQ(clock.now(), TimePoint(2s));
}

// ---- inboxes --------------------------------------------------------------------------------------------------

class Receiver final : public Component {
 public:
  using Component::Component;
  std::chrono::milliseconds takes{0};  ///< a message, of the machine's time
  std::function<void()> in_mode = [] {};
  std::vector<std::string> entered;
  void on_mode(std::string_view mode) override {
    in_mode();
    entered.emplace_back(mode);
  }
  std::function<void(std::uint64_t)> meanwhile = [](std::uint64_t) {};
  const std::vector<std::uint64_t>& seen() const { return seen_; }

 private:
  void on_number(const Number& number) {
    std::this_thread::sleep_for(takes);
    seen_.push_back(number.value());
    meanwhile(number.value());
  }
  std::vector<std::uint64_t> seen_;
  Requires<Numbers> each_{*this, "each", &Receiver::on_number};
  Requires<Numbers> newest_{*this, "newest", &Receiver::on_number, {.delivery = Delivery::Newest}};
  Provides<Orders> orders_{*this, "orders", &Receiver::on_number};
};

/// A message that says it is this large.
Parcel parcel(std::uint64_t value, std::size_t bytes) {
  auto number = std::make_shared<Number>();
  number->set_value(value);
  return {Envelope{std::move(number), value, TimePoint{}, bytes}, nullptr};
}

Inbox& inbox_of(Hull& hull, std::string_view port) {
  Port* found = hull.find_port(port);
  if (auto* provided = dynamic_cast<ProvidedPort*>(found)) return *provided->inbox();
  return *dynamic_cast<RequiredPort&>(*found).inbox();
}

class Inboxes : public ::testing::Test {
 protected:
  Inboxes() { receiver.hull.set_mode(kModeActive, kLimit); }

  Inbox& inbox(std::string_view port) { return inbox_of(receiver.hull, port); }
  PortCounters& counters(std::string_view port) { return receiver.hull.find_port(port)->counters(); }

  static constexpr std::size_t kMebibyte = 1024 * 1024;
  testing::InlineExecutor executor;
  VirtualClock clock;
  KeptEvents events;
  Made<Receiver> receiver{"receiver", executor, clock, events};
};

TEST_F(Inboxes, OfAVirtualClockAreServedInAnOrderThatDoesNotDependOnTheMachinesSpeed) {
  receiver->takes = 5ms;
  for (const std::uint64_t value : {1, 2, 3, 4}) inbox("each").push(parcel(value, 1));
  inbox("orders").push(parcel(5, 1));
  executor.help();
  EXPECT_THAT(receiver->seen(), ElementsAre(1, 2, 3, 4, 5));
}

TEST(InboxesInTime, WhoseHandlerTakesLongerThanATurnAreServedOneMessageATurn) {
  testing::InlineExecutor executor;
  SystemClock clock;
  KeptEvents events;
  Made<Receiver> receiver{"receiver", executor, clock, events};
  receiver.hull.set_mode(kModeActive, kLimit);
  receiver->takes = 3ms;
  for (const std::uint64_t value : {1, 2, 3}) inbox_of(receiver.hull, "each").push(parcel(value, 1));
  for (const std::uint64_t value : {11, 12}) inbox_of(receiver.hull, "orders").push(parcel(value, 1));
  executor.help();
  EXPECT_THAT(receiver->seen(), ElementsAre(1, 11, 2, 12, 3));
  clock.stop();
}

TEST_F(Inboxes, FullPushInboxLosesItsOldestCounted) {
  for (std::uint64_t value = 1; value <= 10; ++value)
    EXPECT_EQ(inbox("each").push(parcel(value, kMebibyte)), Outcome::Ok);
  executor.help();
  EXPECT_THAT(receiver->seen(), ElementsAre(8, 9, 10));
  EXPECT_EQ(counters("each").dropped, 7U);
  EXPECT_EQ(counters("each").messages, 3U);
}

TEST_F(Inboxes, FullPushInboxLosesItsOldestOneByOneHoweverManyThereAre) {
  constexpr std::uint64_t kFit = 10 * ParcelQueue::kBlock / 3, kPut = 3 * kFit;
  constexpr std::size_t kBytes = Inbox::kMaxBytes / kFit - Inbox::cost_of(0);
  std::vector<std::uint64_t> youngest;
  for (std::uint64_t value = 1; value <= kPut; ++value) {
    inbox("each").push(parcel(value, kBytes));
    if (value > kPut - kFit) youngest.push_back(value);
  }
  EXPECT_EQ(inbox("each").depth(), kFit);
  executor.help();
  EXPECT_EQ(receiver->seen(), youngest);
  EXPECT_EQ(counters("each").dropped, kPut - kFit);
}

TEST_F(Inboxes, QueueOfBlocksIsOneInOrderWhateverIsTakenFromIt) {
  ParcelQueue queue;
  ParcelQueue::Block taken;
  std::deque<std::uint64_t> expected;
  std::mt19937 chance(7);
  std::uint64_t next = 0;
  const auto expect_next = [&](const Parcel& parcel) {
    ASSERT_EQ(parcel.envelope.sequence, expected.front());
    expected.pop_front();
  };
  for (int i = 0; i < 2000; ++i) {
    for (auto more = chance() % 100; more > 0; --more) {
      queue.push(parcel(++next, 1));
      expected.push_back(next);
    }
    ASSERT_EQ(queue.size(), expected.size());
    for (auto fewer = chance() % 50; fewer > 0 && !queue.empty(); --fewer) expect_next(queue.pop());
    if (chance() % 2 == 0) continue;
    queue.take(taken);
    ASSERT_LE(taken.size(), ParcelQueue::kBlock);
    while (!taken.empty()) expect_next(taken.pop());
    if (chance() % 20 > 0) continue;
    std::uint64_t sum = 0;
    queue.for_each([&sum](const Parcel& one) { sum += one.envelope.sequence; });
    ASSERT_EQ(sum, std::accumulate(expected.begin(), expected.end(), std::uint64_t{0}));
    queue.clear();
    expected.clear();
  }
  EXPECT_GT(next, 50'000U);
}

TEST_F(Inboxes, FullSendInboxRefusesTheNewestAndLosesNothing) {
  std::vector<Outcome> outcomes;
  for (std::uint64_t value = 1; value <= 5; ++value) outcomes.push_back(inbox("orders").push(parcel(value, kMebibyte)));
  executor.help();
  EXPECT_THAT(outcomes, ElementsAre(Outcome::Ok, Outcome::Ok, Outcome::Ok, Outcome::Rejected, Outcome::Rejected));
  EXPECT_THAT(receiver->seen(), ElementsAre(1, 2, 3));
  EXPECT_EQ(counters("orders").dropped, 0U);
}

TEST_F(Inboxes, RoomComesBackWhenMessagesHaveBeenHandled) {
  for (std::uint64_t value = 1; value <= 9; ++value) {
    EXPECT_EQ(inbox("orders").push(parcel(value, kMebibyte)), Outcome::Ok) << value;
    if (value % 3 == 0) executor.help();
  }
  EXPECT_EQ(receiver->seen().size(), 9U);
}

TEST_F(Inboxes, MessageLargerThanTheBoundPassesAlone) {
  EXPECT_EQ(inbox("orders").push(parcel(1, 3 * Inbox::kMaxBytes)), Outcome::Ok);
  EXPECT_EQ(inbox("orders").push(parcel(2, 1)), Outcome::Rejected);
  executor.help();
  EXPECT_THAT(receiver->seen(), ElementsAre(1));
}

TEST_F(Inboxes, NewestKeepsOneAndCountsTheSuperseded) {
  for (std::uint64_t value = 1; value <= 10; ++value) inbox("newest").push(parcel(value, 10));
  executor.help();
  EXPECT_THAT(receiver->seen(), ElementsAre(10));
  EXPECT_EQ(counters("newest").superseded, 9U);
}

TEST_F(Inboxes, NewestHandlerHasTheNewestThoughItsTurnEndsBetweenTwo) {
  std::uint64_t put = 1;
  int late = 0;
  receiver->meanwhile = [&](std::uint64_t value) {
    late += value < put ? 1 : 0;
    if (put > 2000) return;
    inbox("newest").push(parcel(++put, 10));
    receiver.hull.strand().post([&] { inbox("newest").push(parcel(++put, 10)); });
  };
  inbox("newest").push(parcel(put, 10));
  executor.help();
  EXPECT_EQ(late, 0);
  EXPECT_EQ(receiver->seen().size() + counters("newest").superseded, put);
}

TEST_F(Inboxes, WhatIsLargeIsLostOldestFirstThoughTheHandlerIsAtWork) {
  receiver->meanwhile = [this](std::uint64_t value) {
    for (std::uint64_t more = 4; value == 1 && more <= 6; ++more) inbox("each").push(parcel(more, kMebibyte));
  };
  for (std::uint64_t value = 1; value <= 3; ++value) inbox("each").push(parcel(value, kMebibyte));
  executor.help();
  EXPECT_THAT(receiver->seen(), ElementsAre(1, 4, 5, 6));
  EXPECT_EQ(counters("each").dropped, 2U);
}

TEST_F(Inboxes, WhatWaitedInOneModeReachesNoOtherThoughBothChangesComeAtOnce) {
  const auto made = [](const std::optional<Error>& error) { EXPECT_FALSE(error); };
  for (const std::string_view port : {"each", "newest", "orders"}) inbox(port).push(parcel(1, 10));
  receiver.hull.change_mode(kModeNeutral, kLimit, made);
  receiver.hull.change_mode(kModeActive, kLimit, made);
  executor.help();
  EXPECT_THAT(receiver->seen(), IsEmpty());
  for (const std::string_view port : {"each", "newest", "orders"}) EXPECT_EQ(counters(port).not_active, 1U) << port;
}

TEST_F(Inboxes, ClosedStrandTakesNothing) {
  receiver.hull.strand().close();
  EXPECT_EQ(inbox("each").push(parcel(1, 10)), Outcome::Disconnected);
}

// ---- strands --------------------------------------------------------------------------------------------------

class Strands : public ::testing::Test {
 protected:
  ~Strands() override { clock.stop(); }

  SystemClock clock;
  Pool pool{2};
  std::shared_ptr<Strand> strand = std::make_shared<Strand>("strand", pool, clock);

  /// Occupies the strand until the returned promise is kept.
  std::promise<void> occupy() {
    std::promise<void> release;
    auto begun = std::make_shared<std::promise<void>>();
    strand->post([begun, blocked = release.get_future().share()] {
      begun->set_value();
      blocked.wait();
    });
    begun->get_future().wait();
    return release;
  }
};

TEST_F(Strands, CallReturnsAtItsDeadlineAndItsWorkIsSkipped) {
  auto release = occupy();
  std::atomic<bool> ran = false;
  EXPECT_FALSE(strand->call([&ran] { ran = true; }, 20ms));
  release.set_value();
  EXPECT_TRUE(strand->call([] {}, kLimit)) << "the strand is free again";
  EXPECT_FALSE(ran);
}

TEST_F(Strands, CallThrowsWhatItsWorkThrows) {
  EXPECT_THROW(strand->call([] { throw Error(ErrorCode::Usage, "no"); }, kLimit), Error);
  EXPECT_TRUE(strand->call([] {}, kLimit));
}

TEST_F(Strands, CallThatWaitsReturnsWhenTheStrandIsClosed) {
  auto release = occupy();
  auto waiting = std::async(std::launch::async, [this] { return strand->call([] {}, 10 * kLimit); });
  while (strand->waiting_jobs() == 0) std::this_thread::yield();
  strand->close();
  EXPECT_EQ(waiting.wait_for(kLimit), std::future_status::ready);
  EXPECT_FALSE(waiting.get());
  EXPECT_FALSE(strand->call([] {}, kLimit));
  EXPECT_FALSE(strand->post([] {}));
  release.set_value();
}

bool comes_true(const std::function<bool()>& fits) {
  const auto end = std::chrono::steady_clock::now() + kLimit;
  while (!fits()) {
    if (std::chrono::steady_clock::now() > end) return false;
    std::this_thread::sleep_for(1ms);
  }
  return true;
}

/// Of the calling thread.
std::chrono::nanoseconds cpu_time() {
  timespec time{};
  ::clock_gettime(CLOCK_THREAD_CPUTIME_ID, &time);
  return std::chrono::seconds(time.tv_sec) + std::chrono::nanoseconds(time.tv_nsec);
}

void compute(std::chrono::nanoseconds time) {
  const auto end = cpu_time() + time;
  while (cpu_time() < end) {
  }
}

TEST_F(Strands, CpuTimeIsWhatWorkTookOfACpuAndNotWhatItWaited) {
  ASSERT_TRUE(strand->call([] { std::this_thread::sleep_for(50ms); }, kLimit));
  ASSERT_TRUE(comes_true([this] { return strand->busy_time() >= 50ms; }));
  EXPECT_LT(strand->cpu_time(), 25ms);
  std::this_thread::sleep_for(100ms);  // of more than ten runs a second only some are measured
  ASSERT_TRUE(strand->call([] { compute(50ms); }, kLimit));
  EXPECT_TRUE(comes_true([this] { return strand->cpu_time() >= 50ms; }));
}

TEST_F(Strands, CpuTimeOfManyShortRunsIsThatOfThoseMeasuredForAll) {
  std::chrono::nanoseconds spent{0};
  const clock_t begun = ::clock();  // of the whole process
  for (int run = 0; run < 20'000; ++run) {
    ASSERT_TRUE(strand->call(
        [&spent] {
          const auto begin = cpu_time();
          compute(5us);
          spent += cpu_time() - begin;
        },
        kLimit));
  }
  const std::chrono::duration<double> of_all{static_cast<double>(::clock() - begun) / CLOCKS_PER_SEC};
  // What a run costs beside its work counts too.
  EXPECT_TRUE(comes_true([&] { return strand->cpu_time() > spent * 0.7; }))
      << to_seconds(strand->cpu_time()) << " of " << spent.count() * 1e-9;
  EXPECT_LT(strand->cpu_time(), of_all * 1.5) << "for those that were measured may have been the dear ones";
}

TEST_F(Strands, PiecesOfWorkNeverOverlapAndKeepTheirOrder) {
  std::vector<int> order;  // without a lock: ThreadSanitizer is the judge
  for (int i = 0; i < 5000; ++i) strand->post([&order, i] { order.push_back(i); });
  ASSERT_TRUE(strand->call([] {}, kLimit));
  ASSERT_EQ(order.size(), 5000U);
  EXPECT_TRUE(std::is_sorted(order.begin(), order.end()));
}

TEST_F(Strands, WhoseWorkTakesLongLetOthersHaveTheThreadAfterEachPiece) {
  Pool thread(1);
  const auto slow = std::make_shared<Strand>("slow", thread, clock);
  const auto quick = std::make_shared<Strand>("quick", thread, clock);
  std::atomic<bool> ends{false};
  std::atomic<int> begun{0};
  std::function<void()> again = [&] {
    ++begun;
    std::this_thread::sleep_for(3ms);
    if (!ends) slow->post([&again] { again(); });
  };
  slow->post([&again] { again(); });
  for (int i = 0; i < 10; ++i) {
    const int before = begun;
    int then = 0;
    EXPECT_TRUE(quick->call([&] { then = begun; }, kLimit));
    EXPECT_LE(then - before, 2) << "the one that runs may have ended, and the next one begun, before it was there";
  }
  ends = true;
  EXPECT_TRUE(slow->call([] {}, kLimit));
}

TEST_F(Strands, TimersOfTheSystemClockComeInTheirOrder) {
  std::promise<void> done;
  std::vector<int> order;
  const auto start = clock.now();
  clock.schedule(start + 20ms, strand, [&] { order.push_back(2); });
  clock.schedule(start + 30ms, strand, [&] { done.set_value(); });
  clock.schedule(start + 10ms, strand, [&] { order.push_back(1); });
  clock.cancel(clock.schedule(start + 15ms, strand, [&] { order.push_back(3); }));
  ASSERT_EQ(done.get_future().wait_for(kLimit), std::future_status::ready);
  EXPECT_THAT(order, ElementsAre(1, 2));
}

TEST_F(Strands, TimersOfAllTimesLeaveTheOthersTheirs) {
  std::promise<void> past, later;
  clock.schedule(TimePoint::max(), strand, [] { ADD_FAILURE(); });
  clock.schedule(TimePoint::max() - 1ns, strand, [] { ADD_FAILURE(); });
  clock.schedule(TimePoint::min(), strand, [&] { past.set_value(); });
  clock.schedule(clock.now() + 20ms, strand, [&] { later.set_value(); });
  EXPECT_EQ(past.get_future().wait_for(kLimit), std::future_status::ready);
  EXPECT_EQ(later.get_future().wait_for(kLimit), std::future_status::ready);
}

// ---- tasks ----------------------------------------------------------------------------------------------------

/// A clock that work can move: what a slow machine does to a task.
class ManualClock final : public Clock {
 public:
  TimePoint now() const override { return now_; }
  TimePoint start() const override { return TimePoint{}; }
  TimerId schedule(TimePoint at, const std::shared_ptr<Strand>& strand, Job job) override {
    pending_.emplace(at, std::pair(strand, std::move(job)));
    return 0;
  }
  void cancel(TimerId) override { pending_.clear(); }

  void pass(Duration duration) { now_ += duration; }
  /// Goes to the next timer and posts its job.
  void next() {
    auto due = pending_.extract(pending_.begin());
    now_ = std::max(now_, due.key());
    due.mapped().first->post(std::move(due.mapped().second));
  }

 private:
  TimePoint now_{};
  std::multimap<TimePoint, std::pair<std::shared_ptr<Strand>, Job>> pending_;
};

/// Changes of mode for which there is less time than they take.
class LateChanges : public ::testing::Test {
 protected:
  LateChanges() {
    receiver.hull.set_mode(kModeActive, kLimit);
    receiver->entered.clear();
  }
  void ask_for_neutral(Duration deadline) {
    receiver.hull.change_mode(kModeNeutral, deadline, [this](const std::optional<Error>& error) {
      refusal = error ? error->text().what : "none";
    });
    executor.help();
  }

  ManualClock clock;
  testing::InlineExecutor executor;
  KeptEvents events;
  Made<Receiver> receiver{"receiver", executor, clock, events};
  std::string refusal;
};

TEST_F(LateChanges, OneThatIsMadeTooLateIsTakenBack) {
  receiver->in_mode = [this] { clock.pass(20ms); };
  ask_for_neutral(5ms);
  EXPECT_EQ(refusal, "'receiver' did not change its mode to neutral in time: it took longer, and goes back to active");
  EXPECT_THAT(receiver->entered, ElementsAre("neutral", "active"));
  EXPECT_EQ(receiver.hull.mode(), kModeActive);
  ask_for_neutral(kLimit);
  EXPECT_EQ(refusal, "none");
}

TEST_F(LateChanges, OneThatIsReachedTooLateIsNotMade) {
  receiver.hull.strand().post([this] { clock.pass(20ms); });
  ask_for_neutral(5ms);
  EXPECT_EQ(refusal, "'receiver' did not change its mode to neutral in time: a handler ran until then");
  EXPECT_THAT(receiver->entered, IsEmpty());
}

class Worker final : public Component {
 public:
  using Component::Component;
  Duration work_takes{};
  std::vector<std::int64_t> runs_at_ms;

 private:
  void work() {
    runs_at_ms.push_back(to_milliseconds(now()));
    dynamic_cast<ManualClock&>(hull().clock()).pass(work_takes);
  }
  Task task_{*this, "task", 100ms, &Worker::work};
};

TEST(Task, PeriodsThatPassWhileItWorksAreOverrunsNotMadeUpForAndTheGridIsKept) {
  ManualClock clock;
  testing::InlineExecutor executor;
  KeptEvents events;
  Made<Worker> worker("worker", executor, clock, events);
  worker.hull.set_mode(kModeActive, kLimit);
  const auto run_once = [&](Duration takes) {
    worker->work_takes = takes;
    clock.next();
    executor.help();
  };
  run_once(250ms);
  run_once(100ms);
  run_once(0ms);
  EXPECT_THAT(worker->runs_at_ms, ElementsAre(100, 400, 500));
  EXPECT_EQ(worker.hull.tasks().front()->overruns(), 2U);
  EXPECT_EQ(worker.hull.tasks().front()->runs(), 3U);
}

// ---- coroutines -----------------------------------------------------------------------------------------------

/// Says when it is gone.
struct Witness {
  explicit Witness(int& count) : gone(&count) {}
  Witness(const Witness&) = delete;
  Witness& operator=(const Witness&) = delete;
  ~Witness() { ++*gone; }
  int* gone;
};

class Coroutines final : public Component {
 public:
  using Component::Component;
  std::string caught;

  Async<int> refuse() {
    throw std::runtime_error("refused");
    co_return 0;
  }
  Async<> catch_it() {
    try {
      co_await refuse();
    } catch (const std::runtime_error& error) {
      caught = error.what();
    }
  }
  Async<> let_it_pass() { co_await refuse(); }
};

class Coroutine : public ::testing::Test {
 protected:
  void spawn(Async<> work) {
    made.hull.strand().call([this, &work] { made.hull.spawn(std::move(work), [] {}); }, kLimit);
    executor.help();
  }
  VirtualClock clock;
  testing::InlineExecutor executor;
  KeptEvents events;
  Made<Coroutines> made{"coroutines", executor, clock, events};
};

TEST_F(Coroutine, ExceptionReachesWhoAwaits) {
  spawn(made->catch_it());
  EXPECT_EQ(made->caught, "refused");
  EXPECT_EQ(made.hull.mode(), "init");
}

TEST_F(Coroutine, ExceptionThatNobodyCatchesFailsTheInstance) {
  spawn(made->let_it_pass());
  EXPECT_EQ(made.hull.mode(), "failed");
  EXPECT_EQ(made.hull.reason(), "refused");
  EXPECT_THAT(events.modes(), ElementsAre("coroutines failed: refused"));
}

/// Waits for ever; what it holds is told through a reference that outlives the component.
class Waiter final : public Component {
 public:
  using Component::Component;
  Async<> wait_for_ever(int& gone) {
    const Witness witness(gone);
    co_await std::suspend_always();
  }
};

TEST(CoroutineLife, CoroutineThatNeverEndsIsDestroyedWithItsInstance) {
  VirtualClock clock;
  testing::InlineExecutor executor;
  KeptEvents events;
  int gone = 0;
  {
    Made<Waiter> made("waiter", executor, clock, events);
    made.hull.strand().call([&] { made.hull.spawn(made->wait_for_ever(gone), [] {}); }, kLimit);
    EXPECT_EQ(gone, 0);
  }
  EXPECT_EQ(gone, 1);
}

/// Waits again and again for what does not come.
class Patient final : public Component {
 public:
  using Component::Component;
  std::vector<Outcome> outcomes;
  Async<> wait(int times, Duration within) {
    for (int i = 0; i < times; ++i) outcomes.push_back((co_await numbers.wait_update(within)).outcome());
  }
  Requires<Numbers> numbers{*this, "numbers"};
};

TEST(CoroutineLife, WaitsThatHaveEndedLeaveNothingBehind) {
  VirtualClock clock;
  testing::InlineExecutor executor;
  KeptEvents events;
  Made<Patient> made("patient", executor, clock, events);
  made->numbers.end_for("silent.port")->set_connection(Connection::Connected, "for the test");
  made.hull.set_mode(kModeActive, kLimit);
  made.hull.strand().call([&] { made.hull.spawn(made->wait(10'000, 1ms), [] {}); }, kLimit);
  clock.stop_at(clock.now() + 10'000ms, [&clock] { clock.hold(); });
  clock.release();
  executor.help();
  ASSERT_EQ(std::count(made->outcomes.begin(), made->outcomes.end(), Outcome::Timeout), 10'000);
  made.hull.strand().call([&] { made.hull.spawn(made->wait(1, 1h), [] {}); }, kLimit);
  made->numbers.inbox()->push(Parcel{Envelope{std::make_shared<const Number>(), 1, clock.now(), 0}, nullptr});
  EXPECT_EQ(made.hull.strand().waiting_jobs(), 1U) << "for the one that waits";
  executor.help();
  EXPECT_EQ(made->outcomes.back(), Outcome::Ok);
}

// ---- life -----------------------------------------------------------------------------------------------------

TEST(Hull, ShutDownGivesUpOnAHandlerThatHangsAndSaysSo) {
  SystemClock clock;
  std::promise<void> release;
  std::unique_ptr<Component> left;  // what the hull lets go of, so that the test can end it after the handler
  {
    Pool pool(1);
    KeptEvents events;
    Hull hull("stuck", {pool, clock, events, {}});
    hull.create([&left](Hull& owner) {
      left = std::make_unique<Waiter>(owner);
      return std::unique_ptr<Component>(left.get());
    });
    std::promise<void> begun;
    hull.strand().post([&, blocked = release.get_future().share()] {
      begun.set_value();
      blocked.wait();
    });
    begun.get_future().wait();
    EXPECT_EQ(hull.shut_down(20ms), "its handler");
    release.set_value();
  }
}

}  // namespace
}  // namespace fiona::sdk_test
