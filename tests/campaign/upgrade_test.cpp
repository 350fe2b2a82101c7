// Promise R37: one version takes the place of another under load, and nothing is lost, doubled or mixed: witnesses
// nearby and in another process hear and ask it all the time. FIONA_UPGRADES sets how often.
#include <algorithm>
#include <iostream>

#include <fmt/format.h>
#include <fmt/ranges.h>

#include "campaign.hpp"
#include "versions_fixture.hpp"

namespace fiona::conformance {
namespace {

constexpr double kPeriod_ms = 10;
constexpr double kGap_ms = kPeriod_ms + 20;

class UpgradeUnderLoad : public Versions {
 protected:
  UpgradeUnderLoad() {
    make(load_of("cage"));
    system.load_in("", "witness", "near");
    system.load_in("apart", "witness", "far");
    for (const std::string& witness : witnesses) {
      wire(witness + ".samples", "x.samples");
      wire(witness + ".echo", "x.echo");
      system.set(witness, "asks=true");
    }
  }
  /// One run of samples of each version, in their order; each question answered, once.
  void check(const std::string& witness, int upgrades) {
    const auto object = ask(system, witness + ".testify");
    const Seen seen(*object);
    EXPECT_EQ(seen.number("backward"), 0U) << witness << ": doubled, or out of order";
    std::uint64_t version = 0;
    for (const Seen& run : seen.messages("runs")) {
      EXPECT_EQ(run.number("source"), version + 1) << witness << " from sample " << run.number("first") << " on";
      version = run.number("source");
    }
    EXPECT_EQ(version, static_cast<std::uint64_t>(upgrades) + 1);
    const auto outcomes = seen.numbers("outcomes");
    EXPECT_EQ(outcomes.empty() ? 0 : outcomes.front(), seen.number("asked"))
        << witness << ": outcomes " << fmt::format("{}", fmt::join(outcomes, ", "));
    EXPECT_EQ(seen.number("wrong"), 0U);
    EXPECT_EQ(system.port(witness + ".samples").dropped(), 0U);
    asked += seen.number("asked");
    longest_gap_ms = std::max(longest_gap_ms, seen.real("longest_gap_ms"));
  }

  const std::vector<std::string> witnesses{"near", "far"};
  std::uint64_t asked = 0;
  double longest_gap_ms = 0;
  Pulse pulse;
};

TEST_F(UpgradeUnderLoad, LosesNothingDoublesNothingAndMixesNothing) {
  const bool full = number_from("FIONA_UPGRADES", 0) > 0;
  const int upgrades = number_from("FIONA_UPGRADES", 6);
  Times took, gaps;
  for (int i = 0; i < upgrades; ++i) {
    build(fmt::format("version={}", i + 2));
    const auto begun = Steady::now();
    const control::Done done = make(upgrade_of());
    took.add(std::chrono::duration<double, std::milli>(Steady::now() - begun).count());
    gaps.add(done.gap_ms());
    EXPECT_EQ(done.lost(), 0U);
    let_be(std::chrono::milliseconds(50));
  }
  for (const std::string& witness : witnesses) system.set(witness, "asks=false");
  system.eventually("all questions have ended", [&] {
    serve();
    return std::all_of(witnesses.begin(), witnesses.end(), [&](const std::string& one) {
      return Seen(*ask(system, one + ".testify")).number("open") == 0;
    });
  });
  for (const std::string& witness : witnesses) check(witness, upgrades);
  EXPECT_LE(longest_gap_ms, allowed(kGap_ms, full) + pulse.longest_ms());
  system.eventually("the old processes have gone", [&] {
    serve();
    return groups().size() == 3;
  });
  std::cout
      << took.text("upgrade", 5000) << "\n"
      << fmt::format(
             "{} questions, each answered once; longest gap between samples {:.1f} ms (bound {:.0f} ms), of a port "
             "without a wire {:.2f} ms; the machine stood still for {:.0f} ms at most\n",
             asked, longest_gap_ms, kGap_ms, gaps.longest(), pulse.longest_ms());
}

}  // namespace
}  // namespace fiona::conformance
