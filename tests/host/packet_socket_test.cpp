// Packets between processes, with descriptors.
#include "os/packet_socket.hpp"

#include <gtest/gtest.h>

#include <sys/resource.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

#include <chrono>

#include "os/limits.hpp"
#include "os/process.hpp"

namespace fiona::os {
namespace {

using namespace std::chrono_literals;

/// A user who is nobody else's here, and may have so few under way.
constexpr uid_t kUser = 64'321;
constexpr rlim_t kMost = 64;

/// As in a child that has the rights of a user, and not those of root, who is not counted.
enum class Found : int { Waited, NotCrowded, Spun, Sent, Other };

Found send_where_it_is_crowded() {
  const auto [from, to] = PacketSocket::pair();
  const auto [crowd, unread] = PacketSocket::pair();
  const rlimit few{kMost, kMost};
  if (::setrlimit(RLIMIT_NOFILE, &few) != 0 || (::geteuid() == 0 && ::setresuid(kUser, kUser, kUser) != 0))
    return Found::Other;
  auto sent = PacketSocket::Sent::Yes;
  for (rlim_t i = 0; i < 10 * kMost && sent == PacketSocket::Sent::Yes; ++i)
    sent = crowd.send("x", {STDIN_FILENO, STDIN_FILENO, STDIN_FILENO, STDIN_FILENO});
  if (sent != PacketSocket::Sent::Crowded) return Found::NotCrowded;
  if (from.send_within(300ms, "x", {STDIN_FILENO})) return Found::Sent;
  timespec used{};
  ::clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &used);
  return used.tv_sec == 0 && used.tv_nsec < 150'000'000 ? Found::Waited : Found::Spun;
}

TEST(PacketSocket, WaitsWithoutWorkWhereItsUserHasTooManyDescriptorsUnderWay) {
  const pid_t child = ::fork();
  if (child == 0) {
    ::alarm(10);
    ::_exit(static_cast<int>(send_where_it_is_crowded()));
  }
  int status = 0;
  ASSERT_EQ(::waitpid(child, &status, 0), child);
  ASSERT_TRUE(WIFEXITED(status)) << text_of_end(status);
  EXPECT_EQ(static_cast<Found>(WEXITSTATUS(status)), Found::Waited);
}

/// With one message more than it may have under way it leaves this process room for its own.
TEST(Stranger, HasFewerDescriptorsThanThisProcessMayHave) {
  EXPECT_EQ(descriptors_of_stranger(70), 70U);
  const std::uint64_t limit = descriptor_limit();
  if (limit >= 1024) {
    EXPECT_LE(descriptors_of_stranger(limit), limit - 300);
  }
  EXPECT_GE(descriptors_of_stranger(limit), 64U);
}

}  // namespace
}  // namespace fiona::os
