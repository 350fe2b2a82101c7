// Promise R7: rewiring under load is exact. Ten tickers, over several processes, and ten witnesses; a model of who was
// wired to whom, in which order, says what each witness may have heard. FIONA_REWIRES sets how many rewires; FIONA_SEED
// which.
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <chrono>
#include <filesystem>
#include <iostream>
#include <random>

#include <fmt/format.h>
#include <fmt/ranges.h>

#include "campaign.hpp"
#include "engine.hpp"
#include "fiona/result.hpp"
#include "mailbox.hpp"

namespace fiona::conformance {
namespace {

constexpr int kTickers = 10;
constexpr int kWitnesses = 10;
constexpr int kQuiet = 2;  ///< of the witnesses: ask nothing, so that eight ask
constexpr int kPeriod_ms = 10;
/// That a run may keep, and a rewire: a leak of 256 bytes a rewire is more than both in a full form.
constexpr double kKept_mib = 1;
constexpr double kKept_bytes = 128;

class Rewire : public testing::TestWithParam<Transport> {
 protected:
  Rewire() {
    for (int i = 0; i < kTickers; ++i) system.load_in(place_of(i), "ticker", ticker(i), "source=" + std::to_string(i));
    for (int i = 0; i < kWitnesses; ++i) system.load_client("witness", witness(i));
    for (int i = 0; i < kWitnesses; ++i) {
      rewire(i, "samples", i % kTickers);
      if (i < kQuiet) continue;
      rewire(i, "echo", i % kTickers);
      system.set(witness(i), "asks=true");
    }
  }
  static std::string ticker(int i) { return fmt::format("t{}", i); }
  static std::string witness(int i) { return fmt::format("w{}", i); }
  /// Of a ticker: over each transport some are in the process of the witnesses, so that wires move from it to others,
  /// between others, and back.
  static std::string place_of(int ticker) {
    switch (GetParam()) {
      case Transport::Process: return "";
      case Transport::Ipc: return std::array{"near", "next", "far"}[static_cast<std::size_t>(ticker) % 3];
      default: return std::array{"", "near", "far", "far/beside"}[static_cast<std::size_t>(ticker) % 4];
    }
  }

  /// As a console would ask for it; milliseconds until it is answered.
  double rewire(int client, const std::string& port, int provider) {
    control::Transact request;
    auto& wire = *request.add_changes()->mutable_wire();
    *wire.mutable_client() = host::port_of({witness(client), port});
    *wire.mutable_provider() = host::port_of({ticker(provider), port == "echo" ? "echo" : "samples"});
    if (port == "samples") history[static_cast<std::size_t>(client)].push_back(static_cast<std::uint64_t>(provider));
    const auto before = wired.find({client, port});
    if (before != wired.end() && place_of(before->second) != place_of(provider)) ++moved;
    wired[{client, port}] = provider;
    const auto begun = Steady::now();
    control::Reply answered;
    engine.transact("campaign", request, [&answered](const control::Reply& reply) { answered = reply; });
    if (!answered.has_done()) ADD_FAILURE() << answered.failure().what();
    lost += answered.done().lost();
    return std::chrono::duration<double, std::milli>(Steady::now() - begun).count();
  }
  /// What was heard is what the model allows: runs without a gap, each under a wiring of its own, in their order.
  void check_samples(int client, const Seen& testimony) {
    EXPECT_EQ(testimony.number("backward"), 0U) << witness(client) << ": duplicates, or out of order";
    const auto& wired = history[static_cast<std::size_t>(client)];
    std::size_t at = 0;
    for (const Seen& run : testimony.messages("runs")) {
      while (at < wired.size() && wired[at] != run.number("source")) ++at;
      ASSERT_LT(at, wired.size()) << witness(client) << " heard ticker " << run.number("source") << " from sample "
                                  << run.number("first")
                                  << " on, to which it was not wired then: something was lost, or came from elsewhere";
      ++at;
    }
  }
  void check_questions(int client, const Seen& testimony) {
    const auto outcomes = testimony.numbers("outcomes");
    const std::uint64_t ok = outcomes.empty() ? 0 : outcomes.front();
    EXPECT_EQ(testimony.number("open"), 0U) << witness(client);
    EXPECT_EQ(testimony.number("wrong"), 0U) << witness(client);
    EXPECT_EQ(ok, testimony.number("asked"))
        << witness(client) << ": all providers live, so no question may fail; outcomes "
        << fmt::format("{}", fmt::join(outcomes, ", "));
    asked += testimony.number("asked");
  }

  host::Mailbox<std::function<void()>> work;
  RunningSystem system{GetParam()};
  Pulse pulse;
  host::Engine engine{system.system(), system.directory() / "journal",
                      [this](std::function<void()> job) { work.push(std::move(job)); }};
  std::map<std::size_t, std::vector<std::uint64_t>> history;  ///< tickers, by witness, in the order of wiring
  std::map<std::pair<int, std::string>, int> wired;           ///< tickers, by port of a witness
  int moved = 0;                                              ///< wires, to another process
  std::uint64_t lost = 0;
  std::uint64_t asked = 0;
};

TEST_P(Rewire, UnderLoadLosesNothingDoublesNothingAndMixesNothing) {
  const int rewires = number_from("FIONA_REWIRES", 300);
  const int warm_up = std::max(kWarmUp, rewires / 10);
  const int seed = number_from("FIONA_SEED", static_cast<int>(std::random_device{}() % 1'000'000));
  RecordProperty("seed", seed);
  std::mt19937 random(static_cast<unsigned>(seed));
  const auto pick = [&random](int below) { return std::uniform_int_distribution<int>(0, below - 1)(random); };
  std::vector<double> took_ms;
  Holdings warm;
  double started_gap_ms = 0;
  for (int i = 0; i < rewires + warm_up; ++i) {
    if (i == warm_up) {
      warm = holdings(processes(system));
      // Of how a system starts this does not tell: libraries are opened, links made.
      for (int w = 0; w < kWitnesses; ++w)
        started_gap_ms =
            std::max(started_gap_ms, Seen(*ask(system, witness(w) + ".testify", "manner=gap")).real("longest_gap_ms"));
    }
    const bool question = pick(2) == 0;
    const int client = question ? kQuiet + pick(kWitnesses - kQuiet) : pick(kWitnesses);
    took_ms.push_back(rewire(client, question ? "echo" : "samples", pick(kTickers)));
    // Now and then time enough for samples to come, mostly none.
    system.serve_groups(std::chrono::milliseconds(pick(4)));
  }
  Holdings after;
  try {
    system.eventually(
        "what has ended is let go of, and the journal has been synced",
        [&] {
          after = holdings(processes(system));
          return after.descriptors <= warm.descriptors && after.sockets <= warm.sockets;
        },
        std::chrono::seconds(5));
  } catch (const std::exception&) {  // told below
  }

  for (int i = kQuiet; i < kWitnesses; ++i) system.set(witness(i), "asks=false");
  for (int i = 0; i < kTickers; ++i) system.set(ticker(i), "period_ms=10000");
  system.eventually("all questions have ended", [&] {
    for (int i = kQuiet; i < kWitnesses; ++i) {
      if (Seen(*ask(system, witness(i) + ".testify")).number("open") > 0) return false;
    }
    return true;
  });
  std::uint64_t answered = 0;
  for (int i = 0; i < kTickers; ++i) answered += Seen(*ask(system, ticker(i) + ".report")).number("answered");
  double longest_gap_ms = 0;
  std::uint64_t heard = 0;
  for (int i = 0; i < kWitnesses; ++i) {
    const auto testimony = ask(system, witness(i) + ".testify");
    check_samples(i, *testimony);
    check_questions(i, *testimony);
    longest_gap_ms = std::max(longest_gap_ms, Seen(*testimony).real("longest_gap_ms"));
    for (const Seen& run : Seen(*testimony).messages("runs")) heard += run.number("count");
    EXPECT_EQ(system.port(witness(i) + ".samples").dropped(), 0U);
  }
  EXPECT_EQ(answered, asked) << "each question is answered by one provider, once";
  EXPECT_EQ(lost, 0U);
  EXPECT_GT(heard, 0U);
  EXPECT_GT(moved, GetParam() == Transport::Process ? -1 : rewires / 2) << "wires go from process to process";
  EXPECT_GT(std::filesystem::file_size(system.directory() / "journal"), static_cast<std::uintmax_t>(rewires));
  EXPECT_LE(after.descriptors, warm.descriptors);
  EXPECT_LE(after.sockets, warm.sockets);
  EXPECT_LE(after.threads, warm.threads);
  const double grown_mib = after.memory_mib() - warm.memory_mib();
  const double most_mib = kKept_mib + rewires * kKept_bytes / (1024.0 * 1024.0);
  if (!kKeepsWhatIsFreed) {
    EXPECT_LE(grown_mib, most_mib) << "what a rewire leaves behind";
  }

  std::sort(took_ms.begin(), took_ms.end());
  const bool full = rewires >= 10'000;
  const double p50_ms = took_ms[took_ms.size() / 2], p99_ms = took_ms[took_ms.size() * 99 / 100];
  EXPECT_LE(p50_ms, allowed(5, full));
  EXPECT_LE(p99_ms, allowed(GetParam() == Transport::Tcp ? 250 : 50, full) + pulse.longest_ms());
  // A sample passes through threads of two processes, which beside other load each stand still for as long.
  EXPECT_LE(longest_gap_ms, kPeriod_ms + allowed(20 + pulse.longest_ms(), full));
  std::cout << fmt::format(
      "{} rewires (seed {}), {} to another process: {} questions, {} samples; rewire p50 {:.2f} ms, p99 {:.2f} ms; "
      "longest gap between samples {:.1f} ms (period {} ms), {:.1f} ms before; memory {:+.2f} MiB (bound {:.2f}), "
      "descriptors {:+d}; the "
      "machine stood still for up to {:.1f} ms\n",
      took_ms.size(), seed, moved, asked, heard, p50_ms, p99_ms, longest_gap_ms, kPeriod_ms, started_gap_ms, grown_mib,
      most_mib, after.descriptors - warm.descriptors, pulse.longest_ms());
}

INSTANTIATE_TEST_SUITE_P(Over, Rewire, testing::Values(Transport::Process, Transport::Ipc, Transport::Tcp),
                         [](const auto& tested) { return to_string(tested.param); });

}  // namespace
}  // namespace fiona::conformance
