// Runs the suite and prints, at its end, the table of patterns and transports.
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cstdio>
#include <map>
#include <string>
#include <utility>
#include <vector>

#include "system_fixture.hpp"

namespace {

/// The rows of the table, in their order, and the suites that each counts. A suite that is in none is a row of its own.
const std::vector<std::pair<std::string, std::vector<std::string>>> kRows{
    {"shared rules", {"Rules", "Crowd"}},
    {"pending calls",
     {"Calls", "OwnThreadCalls", "OwnThreadFarFromItsProvider", "FarProvider", "KilledProvider", "StoppedProvider",
      "HungProvider", "HungReceiver", "ProviderThatIsCutOff", "CallsByHand", "AnsweredCallsByHand"}},
    {"accounting", {"Accounting", "AccountingVirtual", "AccountingOfTheCut", "AccountingOfTheKilled"}},
    {"send", {"Send", "SendCalls"}},
    {"query", {"Query", "QueryCalls", "QueriesThatHaveEnded"}},
    {"push newest", {"PushNewest", "Pacing", "FullPorts", "PacingOfTheKilled", "PacingOfTheWatched"}},
    {"push timed", {"PushTimed", "PushTimedVirtual"}},
    {"event", {"Event", "ArrivedEvents"}},
    {"parameter", {"Parameter", "Triggers"}},
    {"state", {"State", "StateOfHolders", "StateOfAStart", "StateOfTheKilled", "Inputs", "Unload"}},
    {"tasks", {"Tasks"}},
    {"dynamic wiring",
     {"Wiring", "ClientsOfAPort", "FailedRewire", "FailedRewireOfHosts", "Alternatives", "AlternativesVirtual",
      "Masters", "MastersThatWait", "MasterThatDies", "MasterRights", "RawMaster", "SwapThatIsWatched",
      "SwapThatIsWatchedOfOneThatDied"}},
    {"monitoring",
     {"Monitoring", "MonitoringOfAStart", "MonitoringOfAStream", "MonitoringOfAGroup", "WatchOfAGroup", "Watchers"}},
    {"links", {"Links", "Processes"}},
    {"defects", {"Defects", "DefectsOfAStart", "DefectsOfTheDeaf", "DefectsOfTheKilled"}},
};

constexpr const char* kNone = "-";  ///< of no transport

/// "Over/Calls": "pending calls".
std::string row_of(const std::string& suite) {
  const std::string name = suite.substr(suite.find('/') + 1);
  for (const auto& [row, suites] : kRows) {
    if (std::find(suites.begin(), suites.end(), name) != suites.end()) return row;
  }
  return name;
}

/// "WhatItDoes/Tcp_Group": "Tcp".
std::string transport_of(const std::string& test) {
  const std::size_t slash = test.rfind('/');
  if (slash == std::string::npos) return kNone;
  return test.substr(slash + 1, test.find('_', slash) - slash - 1);
}

class PatternTable final : public testing::EmptyTestEventListener {
  struct Count {
    int passed = 0;
    int failed = 0;
    int skipped = 0;
  };

  void OnTestEnd(const testing::TestInfo& test) override {
    Count& count = counts_[row_of(test.test_suite_name())][transport_of(test.name())];
    ++(test.result()->Skipped() ? count.skipped : test.result()->Passed() ? count.passed : count.failed);
  }

  void OnTestProgramEnd(const testing::UnitTest& all) override {
    if (all.test_to_run_count() < 2) return;
    std::printf("\n%-16s", "passed/ran");
    for (const char* transport : kTransports) std::printf("%10s", transport);
    std::printf("\n");
    for (const auto& [row, suites] : kRows) print_row(row);
    for (const auto& [row, counts] : std::map(counts_)) print_row(row);
  }

  /// Once: a row that has been printed is gone.
  void print_row(const std::string& row) {
    auto counts = counts_.extract(row);
    if (counts.empty()) return;
    std::printf("%-16s", row.c_str());
    for (const char* transport : kTransports) {
      const Count count = counts.mapped()[transport];
      const int ran = count.passed + count.failed;
      std::string text = ran > 0 ? std::to_string(count.passed) + "/" + std::to_string(ran) : "";
      if (count.skipped > 0) text += "+" + std::to_string(count.skipped) + " skipped";
      std::printf("%9s%s", text.c_str(), count.failed > 0 ? "!" : " ");
    }
    std::printf("\n");
  }

  static constexpr std::array<const char*, 4> kTransports{"Process", "Ipc", "Tcp", kNone};
  std::map<std::string, std::map<std::string, Count>> counts_;
};

}  // namespace

int main(int argc, char** argv) {
  testing::InitGoogleTest(&argc, argv);
  fiona::conformance::share_group_template();
  testing::UnitTest::GetInstance()->listeners().Append(new PatternTable);
  return RUN_ALL_TESTS();
}
