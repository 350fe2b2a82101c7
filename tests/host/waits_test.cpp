// Requests that are answered when something has happened.
#include "waits.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <condition_variable>
#include <mutex>

#include "fiona/pool.hpp"

namespace fiona::host {
namespace {

/// What has been answered to one request.
class Answers {
 public:
  Waits::Answer hear() {
    return [this](control::Reply reply) {
      const std::lock_guard lock(mutex_);
      all_.push_back(std::move(reply));
      changed_.notify_all();
    };
  }
  void await_one() {
    std::unique_lock lock(mutex_);
    changed_.wait(lock, [this] { return !all_.empty(); });
  }
  std::vector<control::Reply> all() {
    const std::lock_guard lock(mutex_);
    return all_;
  }

 private:
  std::mutex mutex_;
  std::condition_variable changed_;
  std::vector<control::Reply> all_;
};

class Work : public testing::Test {
 protected:
  static std::optional<control::Reply> nothing(const wire::GroupMessage&) { return std::nullopt; }
  void begin(double within_ms, const std::function<void()>& begin) {
    waits.work(1, 7, within_ms, begin, nothing, failure_reply(ErrorCode::Unreachable, {.what = "too late"}),
               answers.hear());
  }
  SystemClock clock;
  Pool pool{2};
  Answers answers;
  Waits waits{clock, pool};
};

TEST_F(Work, ThatCannotBeBegunIsRefusedAndNotAnswered) {
  const auto fail = [] { throw Error(ErrorCode::Failed, {.what = "no"}); };
  EXPECT_THROW(begin(60'000, fail), Error);
  EXPECT_EQ(answers.all().size(), 0U);
}

/// Who is asked may take longer to begin than whoever asks waits.
TEST_F(Work, WhoseTimeIsOverBeforeItCannotBeBegunIsAnsweredAndNotRefused) {
  EXPECT_NO_THROW(begin(1, [this] {
    answers.await_one();
    throw Error(ErrorCode::Unreachable, {.what = "it does not answer"});
  }));
  ASSERT_EQ(answers.all().size(), 1U);
  EXPECT_EQ(answers.all().front().id(), 7U);
  EXPECT_EQ(answers.all().front().failure().what(), "too late");
}

}  // namespace
}  // namespace fiona::host
