#include "in_use.hpp"

#include <gtest/gtest.h>

#include <atomic>
#include <chrono>
#include <memory>
#include <optional>
#include <thread>
#include <vector>

namespace fiona::host {
namespace {

using std::chrono::milliseconds;

TEST(InUse, WhereNobodyIsInsideNobodyWaits) {
  InUse use;
  { const InUse::Scope scope(use); }
  use.wait_for_end();
}

TEST(InUse, WaitsForWhoIsInside) {
  InUse use;
  std::atomic<bool> done = false;
  std::optional<InUse::Scope> scope(std::in_place, use);
  std::thread waiter([&] {
    use.wait_for_end();
    done = true;
  });
  std::this_thread::sleep_for(milliseconds(20));
  EXPECT_FALSE(done);
  scope.reset();
  waiter.join();
  EXPECT_TRUE(done);
}

TEST(InUse, UsersThatComeAndGoNeitherStarveTheWaitNorFindWhatWasDestroyedAfterIt) {
  InUse use;
  std::atomic<int*> shared = new int(0);
  std::atomic<bool> stop = false;
  std::vector<std::thread> users;
  std::atomic<int> found = 0;
  std::atomic<int> destroyed = 0;
  for (int i = 0; i < 3; ++i) {
    users.emplace_back([&] {
      while (!stop) {
        const InUse::Scope scope(use);
        const int* value = shared;
        if (*value < 0) ++destroyed;
        ++found;
      }
    });
  }
  while (found == 0) std::this_thread::yield();
  for (int i = 1; i <= 2000; ++i) {
    const std::unique_ptr<int> old(shared.exchange(new int(i)));
    use.wait_for_end();
    *old = -1;
  }
  stop = true;
  for (auto& user : users) user.join();
  delete shared.load();
  EXPECT_EQ(destroyed, 0);
}

}  // namespace
}  // namespace fiona::host
