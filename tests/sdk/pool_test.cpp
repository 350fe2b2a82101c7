#include "fiona/pool.hpp"

#include <gtest/gtest.h>
#include <sys/eventfd.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <barrier>
#include <chrono>
#include <functional>
#include <future>
#include <latch>
#include <memory>
#include <semaphore>
#include <thread>
#include <utility>
#include <vector>

#include "support.hpp"

namespace fiona::sdk_test {
namespace {

using namespace std::chrono_literals;

class Work final : public Runnable {
 public:
  explicit Work(std::function<void()> work) : work_(std::move(work)) {}
  void run() override { work_(); }

 private:
  const std::function<void()> work_;
};

void submit(Pool& pool, std::function<void()> work) { pool.submit(std::make_shared<Work>(std::move(work))); }

/// What becomes readable, and stays so until it is read.
class Bell {
 public:
  Bell() : descriptor_(::eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK)) {}
  ~Bell() { ::close(descriptor_); }
  int descriptor() const { return descriptor_; }
  void ring() const { ASSERT_EQ(::eventfd_write(descriptor_, 1), 0); }
  void silence() const {
    eventfd_t rung = 0;
    ::eventfd_read(descriptor_, &rung);
  }

 private:
  const int descriptor_;
};

TEST(Pool, RunsEachPieceOfWorkOnceWhoeverSubmitsIt) {
  constexpr int kEach = 20'000;
  std::vector<std::atomic<int>> runs(4 * kEach);
  std::latch all(4 * kEach);
  Pool pool(3);
  std::vector<std::jthread> submitters;
  for (int s = 0; s < 4; ++s) {
    submitters.emplace_back([&, s] {
      for (int i = 0; i < kEach; ++i) {
        submit(pool, [&, n = static_cast<std::size_t>(s * kEach + i)] {
          ++runs[n];
          all.count_down();
        });
      }
    });
  }
  submitters.clear();
  all.wait();
  EXPECT_TRUE(std::all_of(runs.begin(), runs.end(), [](const auto& count) { return count == 1; }));
}

TEST(Pool, RunsWhatIsToRunSoonOnceAndNotAtOnce) {
  Pool pool(2);
  for (int round = 0; round < 3; ++round) {
    std::atomic<int> runs{0};
    std::latch both(2);
    const auto begun = std::chrono::steady_clock::now();
    std::chrono::steady_clock::time_point first{};
    for (int i = 0; i < 2; ++i) {
      pool.submit_soon(std::make_shared<Work>([&] {
        if (++runs == 1) first = std::chrono::steady_clock::now();
        both.count_down();
      }));
    }
    both.wait();
    EXPECT_GE(first - begun, 500us);
    std::latch next(1);  // what would run twice has done so before this
    pool.submit_soon(std::make_shared<Work>([&] { next.count_down(); }));
    next.wait();
    EXPECT_EQ(runs, 2);
  }
}

TEST(Pool, HasAllItsThreadsAtWorkWhenThereIsWorkForAll) {
  Pool pool(4);
  std::barrier all_four(4);
  std::latch done(4);
  for (int round = 0; round < 4; ++round) {
    submit(pool, [&] {
      all_four.arrive_and_wait();
      done.count_down();
    });
  }
  done.wait();
}

TEST(Pool, RunsWhatWorkSubmitsOnTheSameThreadOnceThatEnds) {
  Pool pool(2);
  int same = 0;
  for (int round = 0; round < 100; ++round) {
    std::promise<std::thread::id> first;
    std::promise<std::thread::id> second;
    submit(pool, [&] {
      submit(pool, [&] { second.set_value(std::this_thread::get_id()); });
      first.set_value(std::this_thread::get_id());
    });
    same += first.get_future().get() == second.get_future().get() ? 1 : 0;
  }
  EXPECT_GE(same, 75) << "but where the machine takes the processor from it in between";
}

TEST(Pool, WakesAnotherThreadForWhatWasSubmittedByWorkThatGoesOnEachTime) {
  struct Round {
    std::counting_semaphore<2> has_run{0};
    std::promise<void> ends;
  };
  Pool pool(2);
  for (int i = 0; i < 5; ++i) {
    const auto round = std::make_shared<Round>();
    submit(pool, [&pool, round] {
      submit(pool, [round] { round->has_run.release(); });
      round->has_run.acquire();
      round->ends.set_value();
    });
    const bool ended = round->ends.get_future().wait_for(kLimit) == std::future_status::ready;
    if (!ended) round->has_run.release();  // or the pool would wait for it for ever
    ASSERT_TRUE(ended) << i;
  }
}

TEST(Pool, WakesAnotherThreadForTheSecondPieceThatWorkSubmits) {
  Pool pool(2);
  std::barrier both(2);
  std::latch done(2);
  submit(pool, [&] {
    for (int i = 0; i < 2; ++i) {
      submit(pool, [&] {
        both.arrive_and_wait();
        done.count_down();
      });
    }
  });
  done.wait();
}

TEST(Pool, CallsAgainForADescriptorThatStaysReadable) {
  Pool pool(2);
  const Bell bell;
  std::atomic<int> calls{0};
  std::promise<void> third;
  const auto watch = pool.watch(bell.descriptor(), [&] {
    if (++calls < 3) return;
    bell.silence();
    if (calls == 3) third.set_value();
  });
  bell.ring();
  EXPECT_EQ(third.get_future().wait_for(kLimit), std::future_status::ready);
}

TEST(Pool, LooksAtDescriptorsThoughWorkNeverEnds) {
  std::atomic<bool> ends{false};
  std::function<void()> again;
  Pool pool(1);
  again = [&] {
    if (!ends) submit(pool, again);
  };
  submit(pool, again);
  const Bell bell;
  std::promise<void> called;
  const auto watch = pool.watch(bell.descriptor(), [&] {
    bell.silence();
    called.set_value();
  });
  bell.ring();
  EXPECT_EQ(called.get_future().wait_for(kLimit), std::future_status::ready);
  ends = true;
}

TEST(Pool, LooksAtDescriptorsAfterEachPieceOfWorkThatTakesLong) {
  std::atomic<bool> ends{false};
  std::atomic<int> begun{0};
  std::function<void()> again;
  Pool pool(1);
  again = [&] {
    ++begun;
    std::this_thread::sleep_for(2ms);
    if (!ends) submit(pool, again);
  };
  submit(pool, again);
  submit(pool, again);
  const Bell bell;
  std::atomic<int> before{0};
  std::counting_semaphore<> called{0};
  std::atomic<int> most{0};
  const auto watch = pool.watch(bell.descriptor(), [&] {
    bell.silence();
    most = std::max(most.load(), begun - before);
    called.release();
  });
  for (int i = 0; i < 10; ++i) {
    before = begun.load();
    bell.ring();
    ASSERT_TRUE(called.try_acquire_for(kLimit));
  }
  EXPECT_LE(most, 2) << "the word that there is work may be heard first";
  ends = true;
}

TEST(Pool, GoesOnWithWorkWhileADescriptorsCallLasts) {
  Pool pool(2);
  const Bell bell;
  std::promise<void> entered, leave;
  const auto watch = pool.watch(bell.descriptor(), [&] {
    bell.silence();
    entered.set_value();
    leave.get_future().wait();
  });
  bell.ring();
  entered.get_future().wait();
  std::promise<void> ran;
  submit(pool, [&] { ran.set_value(); });
  EXPECT_EQ(ran.get_future().wait_for(kLimit), std::future_status::ready);
  leave.set_value();
}

TEST(Pool, RunsWhatAReceivedMessageCausesOnTheThreadThatReceivedIt) {
  constexpr int kRounds = 100;
  Pool pool(2);
  const Bell bell;
  std::atomic<int> ran{0}, same{0};
  const auto watch = pool.watch(bell.descriptor(), [&] {
    bell.silence();
    submit(pool, [&, receiver = std::this_thread::get_id()] {
      same += receiver == std::this_thread::get_id() ? 1 : 0;
      ++ran;
    });
  });
  for (int round = 1; round <= kRounds; ++round) {
    bell.ring();
    while (ran < round) std::this_thread::yield();
  }
  EXPECT_GT(same, kRounds / 2) << "another thread that is awake may come before it";
}

TEST(Pool, WaitsForACallThatRunsBeforeItLetsGoOfADescriptor) {
  Pool pool(2);
  for (int round = 0; round < 500; ++round) {
    const Bell bell;
    auto inside = std::make_unique<std::atomic<bool>>(false);
    auto watch = pool.watch(bell.descriptor(), [&] {
      *inside = true;  // of memory that is gone once the guard is
      *inside = false;
    });
    bell.ring();
    if (round % 2 == 0) std::this_thread::yield();
    watch.reset();
    EXPECT_FALSE(*inside);
    inside.reset();
  }
}

TEST(Pool, DropsWhatWaitsAtItsEndAndWaitsForWhatRuns) {
  std::atomic<bool> finished{false};
  auto waiting = std::make_shared<Work>([] {});
  std::promise<void> entered;
  {
    Pool pool(1);
    submit(pool, [&] {
      entered.set_value();
      std::this_thread::sleep_for(20ms);
      finished = true;
    });
    entered.get_future().wait();
    pool.submit(waiting);
  }
  EXPECT_TRUE(finished);
  EXPECT_EQ(waiting.use_count(), 1);
}

}  // namespace
}  // namespace fiona::sdk_test
