// Somebody who watches and does not read: nobody waits for him, and he is told what he lost.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <signal.h>

#include <algorithm>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "fiona/probe.pb.h"
#include "served_host.hpp"

namespace fiona::host {
namespace {

using conformance::ServedHost;
using conformance::TestConsole;
using namespace std::chrono_literals;

class SlowWatcher : public testing::TestWithParam<std::string> {
 protected:
  void send_burst(std::int64_t values) {
    auto change = console->request();
    auto& set = *change.mutable_transact()->add_changes()->mutable_set();
    set.set_instance("gauge");
    for (const auto& [name, value] :
         {std::pair<const char*, std::int64_t>{"burst", values}, {"go", static_cast<std::int64_t>(change.id())}}) {
      auto& argument = *set.add_parameters();
      argument.set_name(name);
      argument.mutable_value()->set_integer(value);
    }
    console->send(change);
  }
  void watch(const std::string& probe) {
    auto watch = console->request();
    watch.mutable_watch()->mutable_port()->set_instance("gauge");
    watch.mutable_watch()->mutable_port()->set_port(probe);
    console->send(watch);
  }
  void send_more_than_is_read() {
    console->load("gauge", GetParam());
    watch("count");
    for (int i = 0; i < kBursts; ++i) send_burst(kBurst);
    send_burst(kLast);
  }

  static constexpr std::int64_t kBurst = 20'000;
  static constexpr int kBursts = 4;
  static constexpr std::int64_t kLast = 77;
  ServedHost host;
  std::optional<TestConsole> console{std::in_place, host};
};

TEST_P(SlowWatcher, LosesValuesCountedAndNotTheNewest) {
  send_more_than_is_read();
  std::uint64_t accounted = 0;
  std::uint64_t samples = 0;
  control::Sample last;
  while (last.sequence() < kBursts * kBurst + kLast) {
    const auto reply = console->receive();
    if (!reply.has_sample()) continue;
    last = reply.sample();
    accounted += 1 + last.skipped();
    ++samples;
    ASSERT_EQ(accounted, last.sequence());
  }
  probe::Integer value;
  ASSERT_TRUE(value.ParseFromString(last.object()));
  EXPECT_EQ(value.value(), kLast);
  EXPECT_LT(samples, accounted) << "nothing was lost: the watcher was not slow";
}

TEST_P(SlowWatcher, IsShownTheNewestBeforeTheEnd) {
  send_more_than_is_read();
  TestConsole other(host);
  other.eventually("all is set", [&] {
    auto look = other.request();
    *look.mutable_read()->mutable_probe() = conformance::port_name("gauge.count");
    return other.ask(look).sample().sequence() == kBursts * kBurst + kLast;
  });
  other.unload("gauge");
  control::Sample last;
  try {
    while (true) {
      const auto reply = console->receive();
      if (reply.has_sample()) last = reply.sample();
    }
  } catch (const Error& end) {
    EXPECT_THAT(end.what(), ::testing::HasSubstr("'gauge' was unloaded"));
  }
  EXPECT_EQ(last.sequence(), kBursts * kBurst + kLast);
}

/// Eight of 8 MB, of which each is the newest of its port. A sanitizer takes a tenth of a second for each.
TEST_P(SlowWatcher, OfMuchIsShownTheNewestAsFarAsThereIsRoom) {
  constexpr int kSources = 8;
  TestConsole other(host);
  for (int i = 0; i < kSources; ++i) {
    const std::string name = "source" + std::to_string(i);
    const std::string period_ms = FIONA_SANITIZED ? "5000" : "400";
    other.load("source", GetParam(), name, "payload=8000000 period_ms=" + period_ms);
    auto watch = console->request();
    *watch.mutable_watch()->mutable_port() = conformance::port_name(name + ".newest");
    console->send(watch);
  }
  const auto puts = [&] {
    std::vector<std::uint64_t> all;
    for (int i = 0; i < kSources; ++i) all.push_back(other.instance("source" + std::to_string(i)).ports(0).messages());
    return all;
  };
  const auto before = puts();
  other.eventually("each has put more", [&] {
    const auto now = puts();
    constexpr std::uint64_t kMore = FIONA_SANITIZED ? 1 : 3;
    return std::equal(now.begin(), now.end(), before.begin(),
                      [](std::uint64_t has, std::uint64_t had) { return has >= had + kMore; });
  });
  for (int i = 0; i < kSources; ++i) other.unload("source" + std::to_string(i));
  std::set<std::uint64_t> shown;
  for (int over = 0; over < kSources;) {
    try {
      shown.insert(console->receive().id());
    } catch (const Error&) {
      ++over;
    }
  }
  EXPECT_GE(shown.size(), 4U);
  EXPECT_LE(shown.size(), 5U) << "one was sent, and four are 32 MiB";
}

TEST(Gaps, BeginAnewWithATapThatIsOpenedAnew) {
  Gaps gaps;
  wire::Tapped tapped;
  const auto before = [&](std::uint64_t opening, std::uint64_t number, std::uint64_t skipped) {
    tapped.set_opening(opening);
    tapped.set_number(number);
    tapped.set_skipped(skipped);
    return gaps.before(tapped);
  };
  EXPECT_EQ(before(1, 1, 0), 0U);
  EXPECT_EQ(before(1, 3, 10), 11U) << "one lost, ten left out";
  EXPECT_EQ(before(2, 5, 2), 6U) << "its first four, and two left out";
  EXPECT_EQ(before(2, 6, 2), 0U);
}

TEST(Gaps, OfATapThatIsOpenedAnewTakeNothingMoreThatWasOnItsWay) {
  Gaps gaps;
  wire::Tapped first, second;
  first.set_opening(1);
  second.set_opening(2);
  EXPECT_TRUE(gaps.takes(first));
  EXPECT_TRUE(gaps.takes(second));
  EXPECT_FALSE(gaps.takes(first));
  EXPECT_TRUE(gaps.takes(second));
}

TEST(MailboxBounds, AnEndComesBehindTheNewestOfItsKey) {
  Mailbox<std::string> mailbox;
  for (int i = 0; i < 3; ++i) mailbox.push_newest(7, "value " + std::to_string(i), 8U << 20U);
  mailbox.push_last(7, "end");
  EXPECT_THAT(mailbox.take(), ::testing::ElementsAre("value 0", "value 2", "end"));
}

TEST(MailboxBounds, TheNewestOfManyAreKeptAsFarAsThereIsRoomForTheirBytes) {
  constexpr std::size_t kMiB = 1024 * 1024;
  Mailbox<std::string> mailbox;
  for (int round = 0; round < 3; ++round) {
    for (std::uint64_t key = 0; key < 100; ++key)
      mailbox.push_newest(key, std::to_string(key) + " " + std::to_string(round), kMiB);
  }
  const auto kept = mailbox.take();
  EXPECT_EQ(kept.size(), 8U + 64U) << "MiB";
  EXPECT_EQ(kept.front(), "0 0");
  EXPECT_EQ(kept.back(), "71 2") << "the first that were there, each as it was last";
  mailbox.push_newest(99, "99", kMiB);
  EXPECT_EQ(mailbox.take().size(), 1U);
}

using WatcherThatGoes = SlowWatcher;

TEST_P(WatcherThatGoes, DoesNotHoldUpTheHostThoughTheGroupThatItWatchedHangs) {
  console->load("gauge", GetParam());
  const pid_t hangs = TestConsole(host).process_of(GetParam());
  watch("level");
  console->receive();
  ASSERT_EQ(::kill(hangs, SIGSTOP), 0);
  console.emplace(host);
  const auto begun = std::chrono::steady_clock::now();
  auto ask = console->request();
  ask.mutable_journal();
  EXPECT_TRUE(console->ask(ask).has_journal());
  EXPECT_LT(std::chrono::steady_clock::now() - begun, 5s);
  EXPECT_EQ(::kill(hangs, SIGCONT), 0);
}

class ManyWatchers : public SlowWatcher {
 protected:
  /// Empty: there is one more.
  static std::string refusal(TestConsole& by, std::uint64_t& id) {
    auto watch = by.request();
    id = watch.id();
    *watch.mutable_watch()->mutable_port() = conformance::port_name("gauge.count");
    watch.mutable_watch()->mutable_condition()->set_changes(true);
    by.send(watch);
    auto look = by.request();
    look.mutable_journal();
    by.send(look);  // in order: the watch is there by now, or refused
    try {
      by.receive();
    } catch (const Error& error) {
      by.receive();
      return error.what();
    }
    return "";
  }
};

TEST_P(ManyWatchers, OfOneProbeAreRefusedOnceTheyAreTooManyForItsComponent) {
  console->load("gauge", GetParam());
  std::uint64_t last = 0;
  for (int i = 0; i < 32; ++i) ASSERT_EQ(refusal(*console, last), "") << i;
  TestConsole other(host);
  std::uint64_t further = 0;
  EXPECT_THAT(refusal(other, further), ::testing::HasSubstr("watched, or waited for, 32 times already"));
  auto stop = console->request();
  stop.mutable_unwatch()->set_watch(last);
  EXPECT_TRUE(console->ask(stop).has_done());
  EXPECT_EQ(refusal(other, further), "");
}

INSTANTIATE_TEST_SUITE_P(In, ManyWatchers, testing::Values("main", "far"), [](const auto& one) { return one.param; });
INSTANTIATE_TEST_SUITE_P(In, WatcherThatGoes, testing::Values("far"), [](const auto& one) { return one.param; });
INSTANTIATE_TEST_SUITE_P(In, SlowWatcher, testing::Values("main", "far"), [](const auto& one) { return one.param; });

}  // namespace
}  // namespace fiona::host
