// A system on a virtual clock does the same, delivery by delivery, whatever threads and processes it runs in.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>
#include <random>
#include <sstream>

#include "system_fixture.hpp"

namespace fiona::conformance {
namespace {

using ::testing::HasSubstr;
using ::testing::Not;
using namespace std::chrono_literals;

constexpr int kMinglers = 8;

/// In which group the n-th instance lives.
using Placement = std::function<std::string(int)>;

std::string in_main(int) { return "main"; }
std::string in_three(int n) { return std::vector<std::string>{"main", "red", "blue"}.at(static_cast<std::size_t>(n % 3)); }
std::string one_far(int n) { return n == 5 ? "red" : "main"; }
std::string in_two_groups(int n) { return n < 4 ? "red" : "blue"; }

/// Every required port of every instance goes to a provider drawn at random, now and then to one in two.
void wire_at_random(RunningSystem& system, unsigned seed) {
  std::mt19937 random(seed);
  const std::vector<std::pair<std::string, std::string>> ports{
      {"each_in", "newest"}, {"newest_in", "newest"}, {"waited_in", "newest"}, {"last_in", "last"}, {"leased_in", "leased"},
      {"timed_in", "timed"}, {"bell_in", "bell"},     {"echo_in", "echo"},     {"orders_in", "orders"}};
  for (int n = 0; n < kMinglers; ++n) {
    for (const auto& [client, provider] : ports) {
      const auto other = (static_cast<unsigned>(n) + 1 + random() % (kMinglers - 1)) % kMinglers;
      const bool push = client != "bell_in" && client != "echo_in" && client != "orders_in";
      const std::uint32_t every = push && random() % 4 == 0 ? 2 : 1;
      system.wire("m" + std::to_string(n) + "." + client, "m" + std::to_string(other) + "." + provider, every);
    }
  }
}

std::string text_of_file(const std::filesystem::path& file) {
  std::ifstream in(file);
  std::stringstream text;
  text << in.rdbuf();
  return text.str();
}

std::size_t lines_of(const std::string& text) { return static_cast<std::size_t>(std::count(text.begin(), text.end(), '\n')); }

/// The delivery log of a random system after so much of its time.
std::string deliveries(unsigned seed, std::size_t threads, const Placement& place, std::chrono::milliseconds time = 300ms) {
  const TemporaryDirectory directory;
  const auto file = directory.path / "deliveries";
  {
    RunningSystem system(threads, 5s);
    system.set("host", "clock=virtual deliveries=" + file.string());
    for (int n = 0; n < kMinglers; ++n) {
      system.load_in(place(n), "mingler", "m" + std::to_string(n), "seed=" + std::to_string(seed * 100 + static_cast<unsigned>(n)));
    }
    wire_at_random(system, seed);
    const auto reply = system.let_pass(time);
    EXPECT_TRUE(reply.has_met()) << reply.ShortDebugString();
  }
  return text_of_file(file);
}

class DeliveriesTest : public ::testing::TestWithParam<Transport> {};

/// The first line in which two logs differ, for a failure that can be read.
std::string first_difference(const std::string& a, const std::string& b) {
  std::istringstream left(a), right(b);
  std::string x, y;
  for (int line = 1;; ++line) {
    const bool more_x = static_cast<bool>(std::getline(left, x));
    const bool more_y = static_cast<bool>(std::getline(right, y));
    if (!more_x && !more_y) return "";
    if (!more_x) x.clear();
    if (!more_y) y.clear();
    if (x != y) return "line " + std::to_string(line) + ":\n  " + x + "\n  " + y;
  }
}

TEST(VirtualTimeProcess, TheDeliveryLogIsTheSameWithOneTwoAndEightThreads) {
  for (const unsigned seed : {1U, 2U, 3U}) {
    const std::string expected = deliveries(seed, 1, in_main);
    ASSERT_GT(lines_of(expected), 1000U);
    for (const std::size_t threads : {1U, 2U, 8U, 2U, 8U}) {
      EXPECT_EQ(first_difference(expected, deliveries(seed, threads, in_main)), "") << threads << " threads, seed " << seed;
    }
  }
}

TEST(VirtualTimeGroups, TheDeliveryLogIsTheSameInOneProcessAndInGroups) {
  for (const unsigned seed : {1U, 2U, 3U}) {
    const std::string expected = deliveries(seed, 2, in_main);
    ASSERT_GT(lines_of(expected), 1000U);
    for (const auto& place : {Placement(one_far), Placement(in_two_groups), Placement(in_three)}) {
      for (const std::size_t threads : {1U, 8U}) {
        EXPECT_EQ(first_difference(expected, deliveries(seed, threads, place)), "")
            << threads << " threads, seed " << seed << ", m5 in " << place(5);
      }
    }
  }
}

}  // namespace
}  // namespace fiona::conformance
