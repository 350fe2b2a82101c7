// fiona-contract on a plugin whose components each break one promise: what it says of each.
#include <gmock/gmock.h>

#include <array>
#include <cstdio>
#include <map>
#include <string>

namespace {

using testing::HasSubstr;
using testing::StartsWith;

/// Its rows, "STATE TEXT" by what they are about.
std::map<std::string, std::string> rows_of(const std::string& component) {
  const std::string command = FIONA_CONTRACT " " FIONA_PROMISE_BREAKERS " " + component + " 2>&1";
  std::map<std::string, std::string> rows;
  FILE* out = ::popen(command.c_str(), "r");
  std::array<char, 4096> line{};
  while (out != nullptr && std::fgets(line.data(), line.size(), out) != nullptr) {
    const std::string text(line.data());
    const std::size_t first = text.find('\t');
    const std::size_t second = text.find('\t', first + 1);
    if (second == std::string::npos) continue;
    rows[text.substr(0, first)] =
        text.substr(first + 1, second - first - 1) + " " + text.substr(second + 1, text.size() - second - 2);
  }
  rows["exit"] = out == nullptr ? "" : std::to_string(::pclose(out));
  return rows;
}

TEST(Promises, WhoKeepsThemIsToldSoPortByPort) {
  const auto rows = rows_of("keeps-all");
  EXPECT_EQ(rows.at("start"), "ok reaches active");
  EXPECT_EQ(rows.at("location"), "ok 20 objects in 4.00 s, every 200 ms");
  EXPECT_EQ(rows.at("exit"), "0");
  EXPECT_EQ(rows.size(), 3U);
}

TEST(Promises, ACycleIsNeitherHalvedNorDoubled) {
  EXPECT_EQ(rows_of("says-each-second-time").at("location"), "wrong every 400 ms, and its cycle is 200 ms");
  EXPECT_THAT(rows_of("says-twice-a-time").at("location"), HasSubstr(", and its cycle is 200 ms"));
}

TEST(Promises, ATimedPushThatSaysNothingBreaksItsCycle) {
  EXPECT_EQ(rows_of("says-nothing").at("location"), "wrong says nothing in 4.00 s; the service has a cycle");
}

TEST(Promises, AServiceWithALeaseIsNotSilentForLonger) {
  EXPECT_THAT(rows_of("falls-silent").at("steps"), StartsWith("wrong 4 objects in "));
  EXPECT_THAT(rows_of("falls-silent").at("steps"), HasSubstr("; in between: "));
}

TEST(Promises, ACovarianceIsSymmetricAndPositiveSemidefinite) {
  for (const char* component : {"negative-variance", "too-strong-correlation", "asymmetric-covariance"})
    EXPECT_THAT(rows_of(component).at("location"),
                AllOf(StartsWith("wrong 20 objects break a rule: "),
                      HasSubstr("position.confidence is no covariance: not symmetric and positive semi-definite")))
        << component;
}

TEST(Promises, AFieldKeepsItsSizeItsRangeAndIsANumber) {
  EXPECT_THAT(rows_of("short-covariance").at("location"), HasSubstr("position.confidence has 4 elements"));
  EXPECT_THAT(rows_of("out-of-range").at("location"), HasSubstr("orientation.yaw is 9, above 6.283185307179586"));
  EXPECT_THAT(rows_of("not-a-number").at("location"), HasSubstr("position.x is"));
  for (const char* component : {"short-covariance", "out-of-range", "not-a-number"})
    EXPECT_THAT(rows_of(component).at("location"), StartsWith("wrong 20 objects break a rule: ")) << component;
}

TEST(Promises, ARequestIsAnsweredOrRefusedWithAReason) {
  EXPECT_EQ(rows_of("never-answers").at("info"), "wrong request: timeout after 2.00 s");
  EXPECT_EQ(rows_of("drops-requests").at("info"), "wrong request: rejected, no answer after 0 ms");
  EXPECT_EQ(rows_of("refuses-with-a-reason").at("info"), "ok request: rejected, there is no such map");
}

TEST(Promises, AnAnswerKeepsTheRangesOfItsFields) {
  EXPECT_THAT(rows_of("answers-beyond-its-range").at("info"), HasSubstr("pixel_size is -1, below 0"));
}

TEST(Promises, AComponentReachesItsFirstMode) {
  const auto rows = rows_of("does-not-start");
  EXPECT_THAT(rows.at("start"), StartsWith("wrong does not reach active: "));
  EXPECT_THAT(rows.at("start"), HasSubstr("no sensor here"));
}

TEST(Promises, AComponentLivesOnWhateverItIsGiven) {
  EXPECT_THAT(rows_of("throws-after-a-while").at("life"), HasSubstr("no more"));
  EXPECT_THAT(rows_of("throws-when-sent-to").at("life"), HasSubstr("nowhere"));
  EXPECT_THAT(rows_of("fails-on-its-input").at("life"), HasSubstr("who sends?"));
}

TEST(Promises, AComponentLivesAtTheEndsOfTheRangesOfItsParameters) {
  const auto rows = rows_of("fails-at-its-limit");
  EXPECT_THAT(rows.at("parameters"), StartsWith("wrong rate may be 10, and then it fails: "));
  EXPECT_THAT(rows.at("parameters"), HasSubstr("too fast"));
}

TEST(Promises, AProcessThatEndsBeforeItsRowsIsSeenByItsEnd) {
  const auto rows = rows_of("crashes");
  EXPECT_FALSE(rows.contains("location"));
  EXPECT_NE(rows.at("exit"), "0");
}

}  // namespace
