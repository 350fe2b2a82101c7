// Runs the suite and prints, at its end, the table of patterns and transports.
#include <gtest/gtest.h>

#include <array>
#include <cstdio>
#include <map>
#include <string>
#include <string_view>
#include <utility>

namespace {

/// What a test is about: the first of these that its name, "Suite.Sentence", contains.
constexpr std::array<std::pair<std::string_view, std::string_view>, 25> kTopics{{
    {"Alternatives", "alternatives"},
    {"State.", "state"},           {"Triggers.", "trigger"},      {"Monitoring", "monitoring"},
    {"Links.", "links"},           {"Processes.", "links"},
    {"Prescale", "push"},          {"Lease", "push"},             {"Send", "send"},
    {"Acknowledged", "send"},      {"Activation", "event"},       {"Event", "event"},
    {"Calls.Test", "event"},       {"Query", "query"},            {"Answer", "query"},
    {"Repl", "query"},             {"Refusal", "query"},          {"Receive", "query"},
    {"Received", "query"},         {"OutsideItsMode", "query"},   {"Push", "push"},
    {"Latest", "push"},            {"Subscri", "push"},           {"Calls.", "pending calls"},
    {"Patterns.", "all patterns"},
}};

std::string topic_of(const std::string& name) {
  for (const auto& [part, topic] : kTopics) {
    if (name.find(part) != std::string::npos) return std::string(topic);
  }
  return "other";
}

class PatternTable final : public testing::EmptyTestEventListener {
  struct Count {
    int passed = 0;
    int failed = 0;
    int skipped = 0;
  };

  void OnTestEnd(const testing::TestInfo& test) override {
    const std::string name = std::string(test.test_suite_name()) + "." + test.name();
    const std::size_t slash = name.rfind('/');
    Count& count = counts_[topic_of(name)][slash == std::string::npos ? "-" : name.substr(slash + 1)];
    ++(test.result()->Skipped() ? count.skipped : test.result()->Passed() ? count.passed : count.failed);
  }

  void OnTestProgramEnd(const testing::UnitTest& all) override {
    if (all.test_to_run_count() < 2) return;
    std::printf("\n%-16s", "passed/ran");
    for (const char* transport : kTransports) std::printf("%10s", transport);
    std::printf("\n");
    for (const auto& [topic, by_transport] : counts_) {
      std::printf("%-16s", topic.c_str());
      for (const char* transport : kTransports) {
        const auto found = by_transport.find(transport);
        const Count count = found == by_transport.end() ? Count{} : found->second;
        const int ran = count.passed + count.failed;
        const std::string text = ran + count.skipped == 0 ? "" : std::to_string(count.passed) + "/" + std::to_string(ran);
        std::printf("%9s%s", text.c_str(), count.failed > 0 ? "!" : " ");
      }
      std::printf("\n");
    }
  }

  static constexpr std::array<const char*, 4> kTransports{"Process", "Ipc", "Tcp", "-"};
  std::map<std::string, std::map<std::string, Count>> counts_;
};

}  // namespace

int main(int argc, char** argv) {
  testing::InitGoogleTest(&argc, argv);
  testing::UnitTest::GetInstance()->listeners().Append(new PatternTable);
  return RUN_ALL_TESTS();
}
