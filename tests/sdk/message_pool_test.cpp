// What a pool of messages keeps, and gives out.
#include <gtest/gtest.h>

#include <atomic>
#include <deque>
#include <thread>
#include <vector>

#include "fiona/message.hpp"
#include "fiona/sdk_test/objects.fiona.hpp"

namespace fiona::sdk_test {
namespace {

TEST(MessagePool, GivesAMessageBackClearedWhenItsLastOwnerLetGo) {
  MessagePool<Number> pool;
  auto first = pool.acquire();
  first->set_value(7);
  const Number* place = first.get();
  auto second_owner = first;
  first.reset();
  EXPECT_NE(pool.acquire().get(), place) << "it still has an owner";
  second_owner.reset();
  const auto again = pool.acquire();
  EXPECT_EQ(again.get(), place);
  EXPECT_EQ(again->value(), 0U);
}

TEST(MessagePool, MessagesMayOutliveIt) {
  std::shared_ptr<Number> message;
  {
    MessagePool<Number> pool;
    message = pool.acquire();
  }
  message->set_value(3);
  EXPECT_EQ(message->value(), 3U);
}

TEST(MessagePool, OneThatIsOnlyLookedAtFromAfarIsNotGivenOutAgain) {
  MessagePool<Number> pool;
  auto first = pool.acquire();
  const std::weak_ptr<Number> looked_at = first;
  first.reset();
  EXPECT_EQ(looked_at.lock(), nullptr);
  const auto second = pool.acquire();
  EXPECT_EQ(looked_at.lock(), nullptr) << "the count of its owners is still that of its first use";
}

TEST(MessagePool, KeepsAsManySmallOnesAsItsBoundHolds) {
  ObjectPool pool(Number::default_instance());
  const std::size_t fit = ObjectPool::kKeptBytes / ObjectPool::kMessageCost;
  std::vector<std::shared_ptr<Object>> taken;
  for (std::size_t i = 0; i < fit + 100; ++i) taken.push_back(pool.acquire());
  EXPECT_EQ(pool.idle(), 0U);
  taken.clear();
  EXPECT_EQ(pool.idle(), fit);
}

TEST(MessagePool, CountsOneAsLargeAsItHasEverBeen) {
  ObjectPool pool(Number::default_instance());
  const auto fill = [](Object& object, std::size_t bytes) {
    static_cast<Number&>(object).mutable_payload()->assign(bytes, 'x');
  };
  std::vector<std::shared_ptr<Object>> taken;
  for (int i = 0; i < 3; ++i)
    fill(*taken.emplace_back(pool.acquire()), ObjectPool::kKeptBytes / 2 - ObjectPool::kMessageCost - 64);
  taken.clear();
  EXPECT_EQ(pool.idle(), 2U);
  for (int i = 0; i < 2; ++i) fill(*taken.emplace_back(pool.acquire()), 1);
  for (int i = 0; i < 2; ++i) taken.push_back(pool.acquire());
  taken.clear();
  EXPECT_EQ(pool.idle(), 2U) << "they have the memory of what they were";
}

TEST(MessagePool, KeepsNoMoreOfManyThatComeBackWhileOthersAreTaken) {
  ObjectPool pool(Number::default_instance());
  const std::size_t fit = ObjectPool::kKeptBytes / (1024 * 1024);
  std::deque<std::shared_ptr<Object>> out;
  for (int i = 0; i < 60; ++i) {
    out.push_back(pool.acquire());
    static_cast<Number&>(*out.back()).mutable_payload()->assign(1024 * 1024, 'x');
  }
  while (out.size() > 2) {
    for (int i = 0; i < 2; ++i) out.pop_front();
    out.push_back(pool.acquire());
    EXPECT_LE(pool.idle(), 2 * fit);
  }
}

TEST(MessagePool, IsSharedByThreadsThatTakeAndLetGo) {
  MessagePool<Number> pool;
  constexpr std::uint32_t kTimes = 20'000;
  std::atomic<int> spoilt{0};
  const auto use = [&] {
    std::vector<std::shared_ptr<Number>> held;
    for (std::uint32_t i = 1; i <= kTimes; ++i) {
      held.push_back(pool.acquire());
      if (held.back()->value() != 0) ++spoilt;
      held.back()->set_value(i);
      if (held.size() == 7) held.erase(held.begin(), held.begin() + 1 + i % 6);
    }
  };
  std::thread other(use);
  use();
  other.join();
  EXPECT_EQ(spoilt, 0);
  EXPECT_LE(pool.idle(), 14U) << "none was made while another was idle";
}

}  // namespace
}  // namespace fiona::sdk_test
