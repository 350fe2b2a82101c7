// Tasks: what starts them, what an overrun is, and the thread of a free running one.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <pthread.h>

#include <condition_variable>
#include <functional>
#include <future>
#include <memory>

#include "fiona/describe.hpp"
#include "fiona/pool.hpp"
#include "fiona/sdk_test/objects.fiona.hpp"
#include "fiona/testing/bench.hpp"
#include "support.hpp"

namespace fiona::sdk_test {
namespace {

using namespace std::chrono_literals;
using ::testing::ElementsAre;

const Task& task(const Hull& hull, std::string_view name) {
  for (const Task* one : hull.tasks()) {
    if (one->name() == name) return *one;
  }
  throw std::out_of_range(std::string(name));
}

// ---- on a port, after a task ----------------------------------------------------------------------------------

/// Writes down what runs, in its order.
class Chain final : public Component {
 public:
  using Component::Component;
  std::vector<std::string> ran;

 private:
  void on_number(const Number& number) { ran.push_back("handler " + std::to_string(number.value())); }
  void third() { ran.push_back("third"); }
  void seen() { ran.push_back("seen " + std::to_string((*slot_.latest())->value())); }
  Async<> slow() {
    ran.push_back("slow");
    static_cast<void>(co_await slot_.wait_update(100ms));
    ran.push_back("slow ends");
  }
  void next() { ran.push_back("next"); }
  void last() { ran.push_back("last"); }

  Modes modes_{*this, {{"all", {"extra"}}, {"some", {}}}};
  Requires<Numbers> numbers_{*this, "numbers", &Chain::on_number};
  Requires<Numbers> slot_{*this, "slot"};
  Provides<Orders> orders_{*this, "orders", &Chain::on_number};
  Task third_{*this, "third", on(numbers_, 3), &Chain::third};
  Task seen_{*this, "seen", on(slot_), &Chain::seen, "extra"};
  Task last_{*this, "last", after(next_), &Chain::last};  // the members' order does not matter
  Task slow_{*this, "slow", on(orders_), &Chain::slow};
  Task next_{*this, "next", after(slow_), &Chain::next, "extra"};
};

class OnPort : public ::testing::Test {
 protected:
  OnPort() { bench.start("all"); }
  std::vector<std::string> ran() { return std::exchange(bench.component().ran, {}); }
  testing::Bench<Chain> bench;
};

TEST_F(OnPort, TaskStartsAtTheFirstArrivalAndThenAtEachNthBehindItsHandler) {
  for (std::uint64_t i = 1; i <= 5; ++i) bench.put<Numbers>("numbers", numbered(i));
  EXPECT_THAT(ran(), ElementsAre("handler 1", "third", "handler 2", "handler 3", "handler 4", "third", "handler 5"));
  EXPECT_EQ(task(bench.hull(), "third").runs(), 2U);
}

TEST_F(OnPort, TaskOfAPortWithoutHandlerReadsWhatHasArrived) {
  bench.put<Numbers>("slot", numbered(7));
  bench.put<Numbers>("slot", numbered(8));
  EXPECT_THAT(ran(), ElementsAre("seen 7", "seen 8"));
}

TEST_F(OnPort, ArrivalsThatTheStrandHasNotComeToAreOverrunsAndStartItOnce) {
  Inbox& inbox = *bench.hull().find_port("slot")->inbox();
  bench.hull().strand().call(
      [&] {
        for (std::uint64_t i = 1; i <= 4; ++i)
          inbox.push({Envelope{std::make_shared<const Number>(numbered(i)), i, bench.now(), 0}, nullptr});
      },
      kLimit);
  EXPECT_THAT(ran(), ElementsAre("seen 4"));
  EXPECT_EQ(task(bench.hull(), "seen").overruns(), 3U);
}

TEST_F(OnPort, ArrivalsWhileItStillRunsAreOverruns) {
  for (std::uint64_t i = 1; i <= 3; ++i) bench.put<Orders>("orders", numbered(i));
  EXPECT_EQ(task(bench.hull(), "slow").runs(), 1U);
  EXPECT_EQ(task(bench.hull(), "slow").overruns(), 2U);
  bench.advance(100ms);
  EXPECT_THAT(ran(), ElementsAre("handler 1", "slow", "handler 2", "handler 3", "slow ends", "next", "last"));
}

TEST_F(OnPort, ArrivalsOfAnotherModeAreNotCounted) {
  bench.put<Numbers>("slot", numbered(1));
  bench.start("some");
  bench.put<Numbers>("slot", numbered(2));
  EXPECT_THAT(ran(), ElementsAre("seen 1"));
  EXPECT_EQ(task(bench.hull(), "seen").overruns(), 0U);
  bench.start("all");
  bench.put<Numbers>("slot", numbered(3));
  EXPECT_THAT(ran(), ElementsAre("seen 3"));
}

TEST_F(OnPort, TheChainEndsAtATaskThatTheModeHasNot) {
  bench.start("some");
  bench.put<Orders>("orders", numbered(1));
  bench.advance(100ms);
  EXPECT_THAT(ran(), ElementsAre("handler 1", "slow", "slow ends"));
}

TEST_F(OnPort, LateIsTheTimeFromWhatStartedIt) {
  bench.put<Orders>("orders", numbered(1));
  bench.advance(100ms);
  EXPECT_EQ(task(bench.hull(), "next").late(), 0ms);
  EXPECT_EQ(*bench.probe<double>("next.late"), 0.0);
  EXPECT_EQ(*bench.probe<std::int64_t>("last.runs"), 1);
}

TEST_F(OnPort, TheInterfaceSaysWhatStartsEachTask) {
  std::vector<std::string> all;
  for (const Task* one : bench.hull().tasks()) {
    const auto interface = interface_of(*one);
    all.push_back(interface.name() + " " + TaskStart_Name(interface.start()) + " " + interface.of() + " " +
                  std::to_string(interface.every()));
  }
  EXPECT_THAT(all, ElementsAre("third ON_PORT numbers 3", "seen ON_PORT slot 1", "last AFTER_TASK next 0",
                               "slow ON_PORT orders 1", "next AFTER_TASK slow 0"));
}

class OnProvided final : public Component {
  using Component::Component;
  void nothing() {}
  Provides<Numbers> numbers_{*this, "numbers"};
  Task task_{*this, "task", on(numbers_), &OnProvided::nothing};
};
class InACircle final : public Component {
  using Component::Component;
  void nothing() {}
  Task first_{*this, "first", after(second_), &InACircle::nothing};
  Task second_{*this, "second", after(first_), &InACircle::nothing};
};
class EachNone final : public Component {
  using Component::Component;
  void nothing() {}
  Requires<Numbers> numbers_{*this, "numbers"};
  Task task_{*this, "task", on(numbers_, 0), &EachNone::nothing};
};
class OfAnother final : public Component {
 public:
  OfAnother(Hull& hull, Port& port) : Component(hull), task_{*this, "task", on(port), &OfAnother::nothing} {}

 private:
  void nothing() {}
  Task task_;
};

template <class C>
std::string refusal() {
  try {
    testing::Bench<C> bench;
  } catch (const Error& error) {
    return error.text().what;
  }
  return "";
}

TEST(Task, ThatCanNeverStartIsRefusedWhenItsComponentIsMade) {
  EXPECT_EQ(refusal<OnProvided>(), "task 'task' is to start on port 'numbers', at which nothing arrives");
  EXPECT_EQ(refusal<InACircle>(), "task 'first' is to start after itself, by way of 'second'");
  EXPECT_EQ(refusal<EachNone>(), "task 'task' is to start at each 0th arrival");
}

TEST(Task, OnAPortOfAnotherComponentIsRefused) {
  testing::Bench<Chain> chain;
  VirtualClock clock;
  testing::InlineExecutor executor;
  KeptEvents events;
  Hull hull("other", {executor, clock, events, {}});
  try {
    hull.create([&](Hull& owner) { return std::make_unique<OfAnother>(owner, *chain.hull().find_port("slot")); });
    FAIL() << "it was taken";
  } catch (const Error& error) {
    EXPECT_EQ(error.text().what, "task 'task' is to start on a port of another component");
  }
  hull.shut_down(kLimit);
}

// ---- free running ---------------------------------------------------------------------------------------------

/// Does in its thread what the test says, and then nothing until it is asked to stop.
class Reader final : public Component {
 public:
  Reader(Hull& hull, std::function<void(const OwnThread&)> work) : Component(hull), work_(std::move(work)) {}
  std::atomic<int> followed{0};
  Provides<Numbers> numbers{*this, "numbers"};
  Requires<Numbers> slot{*this, "slot"};

 private:
  void read(const OwnThread& own) { work_(own); }
  void follow() { ++followed; }

  const std::function<void(const OwnThread&)> work_;
  Modes modes_{*this, {{"reads", {"read", "look"}}, {"looks", {"look"}}, {"rests", {}}}};
  Task read_{*this, "read", free_running, &Reader::read, "read"};
  Task follow_{*this, "follow", after(read_), &Reader::follow, "look"};
};

class FreeRunningTask : public ::testing::Test {
 protected:
  /// Shut down when the test's own variables, which the work uses, are still there.
  [[nodiscard]] std::shared_ptr<Hull> make(std::function<void(const OwnThread&)> work) {
    hull = std::make_unique<Hull>("reader", Hull::Surroundings{pool, clock, events, {}});
    hull->create([&](Hull& owner) {
      auto made = std::make_unique<Reader>(owner, std::move(work));
      reader = made.get();
      return made;
    });
    return {hull.get(), [](Hull* one) { one->shut_down(kLimit); }};
  }
  void TearDown() override { clock.stop(); }
  void until(const std::function<bool()>& holds) {
    const auto end = std::chrono::steady_clock::now() + kLimit;
    while (!holds() && std::chrono::steady_clock::now() < end) std::this_thread::yield();
    ASSERT_TRUE(holds());
  }
  static void until_asked(const OwnThread& own) {
    while (own.wait_for(1h)) continue;
  }

  SystemClock clock;
  Pool pool{2};
  KeptEvents events;
  std::unique_ptr<Hull> hull;
  Reader* reader = nullptr;
};

TEST_F(FreeRunningTask, WorksBesideTheStrandAndPostsToIt) {
  std::promise<std::pair<bool, bool>> where;
  const auto life = make([&](const OwnThread& own) {
    const bool beside = !hull->strand().is_current();
    own.post([&, beside] { where.set_value({beside, hull->strand().is_current()}); });
    until_asked(own);
  });
  hull->set_mode("reads", kLimit);
  auto known = where.get_future();
  ASSERT_EQ(known.wait_for(kLimit), std::future_status::ready);
  EXPECT_EQ(known.get(), std::pair(true, true));
}

TEST_F(FreeRunningTask, WaitsWithoutEndUntilItIsAskedToStop) {
  std::atomic<int> turns{0};
  const auto life = make([&](const OwnThread& own) {
    ++turns;
    own.wait_for(Duration::max());
  });
  hull->set_mode("reads", kLimit);
  until([&] { return turns > 0; });
  std::this_thread::sleep_for(20ms);
  hull->set_mode("looks", kLimit);
  EXPECT_EQ(turns, 1);
}

TEST_F(FreeRunningTask, AwaitsACoroutineThatGivesNothing) {
  std::promise<std::pair<bool, bool>> ended;
  const auto life = make([&](const OwnThread& own) {
    bool was_there = false;
    const bool done = own.await([this, &was_there]() -> Async<> {
      static_cast<void>(co_await reader->slot.wait_update(5ms));
      was_there = hull->strand().is_current();
    });
    ended.set_value({done, was_there});
    until_asked(own);
  });
  hull->set_mode("reads", kLimit);
  auto known = ended.get_future();
  ASSERT_EQ(known.wait_for(kLimit), std::future_status::ready);
  EXPECT_EQ(known.get(), std::pair(true, true));
}

TEST_F(FreeRunningTask, IsCalledAgainAndAgainAndItsFollowerRunsBehindIt) {
  std::atomic<int> turns{0};
  const auto life = make([&](const OwnThread&) { ++turns; });
  hull->set_mode("reads", kLimit);
  until([&] { return turns > 10 && reader->followed > 3; });
  hull->set_mode("looks", kLimit);
  EXPECT_EQ(task(*hull, "read").runs(), static_cast<std::uint64_t>(turns));
  until([&] {
    return task(*hull, "follow").runs() + task(*hull, "follow").overruns() >= static_cast<std::uint64_t>(turns);
  });
  EXPECT_EQ(task(*hull, "follow").runs() + task(*hull, "follow").overruns(), task(*hull, "read").runs());
}

TEST_F(FreeRunningTask, LeavingItsActivityAsksItToStopAndWaitsUntilItHas) {
  std::atomic<bool> asked{false};
  std::atomic<bool> may_end{false};
  const auto life = make([&](const OwnThread& own) {
    until_asked(own);
    asked = true;
    while (!may_end) std::this_thread::yield();
  });
  hull->set_mode("reads", kLimit);
  std::promise<std::string> changed;
  hull->change_mode("looks", kLimit, [&](const auto&) { changed.set_value(hull->mode()); });
  until([&] { return asked.load() && hull->pending_change(); });
  EXPECT_EQ(hull->pending_change()->blocked_by, "task 'read'");
  EXPECT_EQ(hull->mode(), "reads");
  may_end = true;
  auto mode = changed.get_future();
  ASSERT_EQ(mode.wait_for(kLimit), std::future_status::ready);
  EXPECT_EQ(mode.get(), "looks");
}

TEST_F(FreeRunningTask, StaysInEachModeThatHasItsActivity) {
  std::atomic<int> turns{0};
  const auto life = make([&](const OwnThread& own) {
    ++turns;
    until_asked(own);
  });
  hull->set_mode("reads", kLimit);
  until([&] { return turns == 1; });
  hull->set_mode("rests", kLimit);
  hull->set_mode("reads", kLimit);
  until([&] { return turns == 2; });
}

TEST_F(FreeRunningTask, ThatDoesNotReturnIsNamedAndGoesOnWhenTheChangeIsWithdrawn) {
  std::atomic<int> turns{0};
  std::atomic<bool> may_end{false};
  const auto life = make([&](const OwnThread& own) {
    ++turns;
    until_asked(own);
    while (!may_end) std::this_thread::yield();
  });
  hull->set_mode("reads", kLimit);
  until([&] { return turns == 1; });
  std::promise<std::string> refused;
  hull->change_mode("looks", 20ms,
                    [&](const std::optional<Error>& error) { refused.set_value(error ? error->text().what : ""); });
  auto refusal = refused.get_future();
  ASSERT_EQ(refusal.wait_for(kLimit), std::future_status::ready);
  EXPECT_EQ(refusal.get(), "'reader' did not change its mode to looks in time: blocked by task 'read'");
  EXPECT_EQ(hull->mode(), "reads");
  may_end = true;
  until([&] { return turns == 2; });  // asked to stop for nothing, it is called again
}

TEST_F(FreeRunningTask, ExceptionFailsTheInstanceWithItsText) {
  const auto life = make([](const OwnThread&) { throw std::runtime_error("the device is gone"); });
  hull->set_mode("reads", kLimit);
  until([&] { return hull->mode() == "failed"; });
  EXPECT_EQ(hull->reason(), "the device is gone");
}

TEST_F(FreeRunningTask, ExceptionOfAPostedJobFailsTheInstanceToo) {
  const auto life = make([](const OwnThread& own) {
    own.post([] { throw std::runtime_error("cannot be put"); });
    until_asked(own);
  });
  hull->set_mode("reads", kLimit);
  until([&] { return hull->mode() == "failed"; });
  EXPECT_EQ(hull->reason(), "cannot be put");
}

TEST_F(FreeRunningTask, WaitsWhenTheStrandIsFarBehind) {
  std::promise<void> release;
  std::atomic<std::size_t> posted{0};
  std::atomic<std::size_t> ran{0};
  const auto life = make([&](const OwnThread& own) {
    while (posted < 3 * OwnThread::kMaxPosted && own.post([&] { ++ran; })) ++posted;
    until_asked(own);
  });
  hull->set_mode("rests", kLimit);
  std::promise<void> blocked;
  hull->change_mode("reads", kLimit, [&](const auto&) {
    blocked.set_value();
    release.get_future().wait();
  });
  blocked.get_future().wait();
  until([&] { return posted == OwnThread::kMaxPosted; });
  EXPECT_EQ(ran, 0U);
  release.set_value();
  until([&] { return ran == 3 * OwnThread::kMaxPosted; });
}

TEST_F(FreeRunningTask, WaitsForACallThatItHasMadeOnTheStrand) {
  std::promise<Outcome> outcome;
  std::atomic<int> turns{0};
  const auto life = make([&](const OwnThread& own) {
    if (++turns > 1) return until_asked(own);
    const auto next = own.await([this] { return reader->slot.wait_update(1s); });
    outcome.set_value(next ? next->outcome() : Outcome::NoData);
  });
  hull->set_mode("reads", kLimit);
  auto known = outcome.get_future();
  ASSERT_EQ(known.wait_for(kLimit), std::future_status::ready);
  EXPECT_EQ(known.get(), Outcome::Unwired);
}

TEST_F(FreeRunningTask, ThatIsAskedToStopIsNotKeptByWhatItWaitsFor) {
  std::atomic<int> waits{0};
  const auto life = make([&](const OwnThread& own) {
    hull->strand().call(
        [&] {
          const auto end = reader->slot.end_for("nobody");
          end->set_connection(Connection::Connected, "for the test");
        },
        kLimit);
    ++waits;
    const auto next = own.await([this] { return reader->slot.wait_update(1h); });
    EXPECT_TRUE(!next || next->outcome() == Outcome::NotActive) << "whichever came first";
    EXPECT_FALSE(own.post([] {}));
    EXPECT_FALSE(own.wait_for(1h));
  });
  hull->set_mode("reads", kLimit);
  until([&] { return waits == 1; });
  const auto begun = std::chrono::steady_clock::now();
  EXPECT_EQ(hull->shut_down(kLimit), std::nullopt);
  EXPECT_LT(std::chrono::steady_clock::now() - begun, kLimit);
}

TEST_F(FreeRunningTask, ACallbackMayEndAReadThatBlocks) {
  const auto life = make([](const OwnThread& own) {
    std::promise<void> ended;
    const std::stop_callback end(own.stop_token(), [&] { ended.set_value(); });
    ended.get_future().wait();
  });
  hull->set_mode("reads", kLimit);
  hull->set_mode("looks", kLimit);
  EXPECT_EQ(hull->mode(), "looks");
}

/// Tells the end of the thread that has it.
struct EndOfThread {
  std::promise<void>* ended = nullptr;
  ~EndOfThread() {
    if (ended) ended->set_value();
  }
};

TEST_F(FreeRunningTask, ThatDoesNotReturnIsLeftBehindByTheShutDown) {
  std::promise<void> begun;
  std::promise<void> release;
  std::promise<void> ended;
  const auto life = make([&](const OwnThread&) {
    static thread_local EndOfThread end;
    end.ended = &ended;
    begun.set_value();
    release.get_future().wait();
  });
  hull->set_mode("reads", kLimit);
  begun.get_future().wait();
  EXPECT_EQ(hull->shut_down(1s), "its task 'read'");
  release.set_value();
  ended.get_future().wait();
  delete reader;  // which the hull has left to its thread
}

TEST_F(FreeRunningTask, IsAskedToStopThoughTheStrandHangs) {
  std::promise<void> begun;
  std::promise<void> stopped;
  std::promise<void> release;
  const auto life = make([&](const OwnThread& own) {
    begun.set_value();
    until_asked(own);
    stopped.set_value();
  });
  hull->set_mode("reads", kLimit);
  begun.get_future().wait();
  hull->strand().post([&] { release.get_future().wait(); });
  hull->fail("it hangs");
  hull->stop_threads();
  EXPECT_EQ(stopped.get_future().wait_for(kLimit), std::future_status::ready);
  release.set_value();
}

/// While it lives no thread has room for its stack.
class NoThreads {
 public:
  NoThreads() {
    ::pthread_getattr_default_np(&usual_);
    pthread_attr_t huge;
    ::pthread_attr_init(&huge);
    ::pthread_attr_setstacksize(&huge, std::size_t{1} << 47U);
    ::pthread_setattr_default_np(&huge);
    ::pthread_attr_destroy(&huge);
  }
  ~NoThreads() {
    ::pthread_setattr_default_np(&usual_);
    ::pthread_attr_destroy(&usual_);
  }
  NoThreads(const NoThreads&) = delete;
  NoThreads& operator=(const NoThreads&) = delete;

 private:
  pthread_attr_t usual_{};
};

TEST_F(FreeRunningTask, ThatGetsNoThreadIsNotWaitedForByTheShutDown) {
  const auto life = make([](const OwnThread&) {});
  {
    const NoThreads none;
    EXPECT_THROW(hull->set_mode("reads", kLimit), Error);
  }
  EXPECT_EQ(hull->reason(), "task 'read' gets no thread: Resource temporarily unavailable");
  EXPECT_EQ(hull->shut_down(100ms), std::nullopt);
}

TEST(FreeRunning, IsRefusedOnAVirtualClockWithTheReason) {
  VirtualClock clock;
  testing::InlineExecutor executor;
  KeptEvents events;
  Hull hull("reader", {executor, clock, events, {}});
  hull.create([](Hull& owner) { return std::make_unique<Reader>(owner, [](const OwnThread&) {}); });
  try {
    hull.set_mode("reads", kLimit);
    FAIL() << "it was taken";
  } catch (const Error& error) {
    EXPECT_EQ(error.code(), ErrorCode::NotAllowed);
    EXPECT_EQ(error.text().what, "'reader' cannot go to reads on a virtual clock");
    EXPECT_EQ(error.text().expected, "a mode without its task 'read'");
    EXPECT_EQ(error.text().found, "that task runs in a thread of its own, for which virtual time cannot wait");
  }
  hull.set_mode("looks", kLimit);
  EXPECT_EQ(hull.mode(), "looks");
  hull.shut_down(kLimit);
}

}  // namespace
}  // namespace fiona::sdk_test
