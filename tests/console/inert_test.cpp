#include <gtest/gtest.h>

#include "grammar.hpp"
#include "inert.hpp"
#include "output.hpp"
#include "table.hpp"

namespace fiona::console {
namespace {

TEST(Inert, OrdinaryTextInAnyScriptStays) {
  for (const char* text : {"plain", "Straße", "日本語", "مرحبا", "µ°Ω€", "🚶 e\u0301"}) EXPECT_EQ(inert(text), text);
}

TEST(Inert, EscapeSequencesBecomeVisible) {
  EXPECT_EQ(inert("\x1b[2J\x1b]0;title\x07"), "\\u{1b}[2J\\u{1b}]0;title\\u{7}");
}

TEST(Inert, EveryControlCharacterBecomesVisible) {
  for (char32_t code = 0; code < 0xa0; ++code) {
    if (code >= 0x20 && code < 0x7f) continue;
    std::string text;
    append_utf8(text, code);
    EXPECT_TRUE(inert(text).starts_with("\\")) << static_cast<int>(code);
  }
}

TEST(Inert, BidirectionalAndInvisibleCharactersBecomeVisible) {
  for (const char32_t code : {0x202aU, 0x202eU, 0x2066U, 0x2069U, 0x200bU, 0x200fU, 0x061cU, 0xfeffU, 0xadU, 0x2028U,
                              0x2029U, 0xe0041U, 0x3164U, 0xfe0fU}) {
    std::string text;
    append_utf8(text, code);
    EXPECT_TRUE(inert(text).starts_with("\\u{")) << std::hex << static_cast<unsigned>(code);
  }
}

TEST(Inert, LinesCannotBeForged) { EXPECT_EQ(inert("a\nerror: b\r"), "a\\nerror: b\\u{d}"); }

TEST(Inert, LinesStayWhereTheyAreMeant) { EXPECT_EQ(inert_lines("a\nb\tc"), "a\nb\\tc"); }

TEST(Inert, BytesThatAreNoUtf8BecomeVisible) {
  EXPECT_EQ(inert("\xff\xc0\xaf"), "\\x{ff}\\x{c0}\\x{af}");
  EXPECT_EQ(inert("\xe2\x82"), "\\x{e2}\\x{82}");
  EXPECT_EQ(inert("\xed\xa0\x80"), "\\x{ed}\\x{a0}\\x{80}");
}

TEST(Inert, StacksOfCombiningMarksAreCut) {
  std::string text = "e";
  for (int i = 0; i < 10; ++i) append_utf8(text, 0x301);
  EXPECT_NE(inert(text).find("\\u{301}"), std::string::npos);
}

TEST(Inert, DoingItTwiceChangesNothing) {
  const std::string once = inert("\x1b\\u{1b}\n\xff");
  EXPECT_EQ(inert(once), once);
}

TEST(DisplayWidth, CountsColumns) {
  EXPECT_EQ(display_width("abc"), 3U);
  EXPECT_EQ(display_width("é"), 1U);
  EXPECT_EQ(display_width("e\u0301"), 1U);
  EXPECT_EQ(display_width("日本"), 4U);
}

TEST(Tables, AlignColumnsByWidthWithTwoBlanksBetween) {
  Table table({"name", "rate"});
  table.add({"日本", "5 Hz"});
  table.add({"walk-x", ""});
  EXPECT_EQ(table.lines(), (std::vector<std::string>{"name    rate", "日本    5 Hz", "walk-x  -"}));
}

TEST(Tables, OnATerminalTextsAreBrokenBetweenWordsEachInItsColumn) {
  Table table({"name", "summary"});
  table.add({"steps", "Steps with length and direction from three sensors"});
  table.add({"map", "Maps"});
  EXPECT_EQ(table.lines(true, 30),
            (std::vector<std::string>{"name   summary", "steps  Steps with length and", "       direction from three",
                                      "       sensors", "map    Maps"}));
  EXPECT_EQ(table.lines(true, 80).size(), 3U);
}

TEST(Tables, RowsThatNoBreakingMakesFitAreParagraphs) {
  Table table({"package", "provides"});
  table.add({"fiona/step-heading", "OrientationProvider, StepProvider"});
  table.add({"fiona/map-server", "LevelMap"});
  EXPECT_EQ(table.lines(true, 32), (std::vector<std::string>{"package   fiona/step-heading",
                                                             "provides  OrientationProvider,", "          StepProvider",
                                                             "", "package   fiona/map-server", "provides  LevelMap"}));
}

TEST(Tables, ACellCannotBreakOutOfItsLine) {
  Table table({"a"});
  table.add({"x\ny\x1b[1m"});
  EXPECT_EQ(table.lines()[1], "x\\ny\\u{1b}[1m");
}

struct Said {
  std::string out;
  std::string err;
  Output output{[this](Stream stream, std::string_view lines) { (stream == Stream::Out ? out : err) += lines; }};
};

TEST(Output, EveryObjectForProgramsSaysFionaOne) {
  Said said;
  said.output.manner.json = true;
  Table table({"instance", "rate"});
  table.add({"walk", {"50 Hz", 50.0}});
  said.output.table(table, "nothing");
  said.output.done("wired");
  said.output.text("for people");
  EXPECT_EQ(said.out, "{\"fiona\":1,\"instance\":\"walk\",\"rate\":50.0}\n{\"done\":\"wired\",\"fiona\":1}\n");
}

TEST(Output, ObjectsAreAsciiWhateverTheyHold) {
  Said said;
  said.output.manner.json = true;
  said.output.object({{"a", "\x1b\xff\u202e\x7f"}});
  for (const char c : said.out) EXPECT_TRUE(c == '\n' || (c >= 0x20 && c < 0x7f));
}

TEST(Output, QuietLeavesConfirmationsOutAndKeepsAnswers) {
  Said said;
  said.output.manner.quiet = true;
  said.output.done("wired");
  said.output.remark("by the way");
  said.output.text("answer");
  EXPECT_EQ(said.out, "answer\n");
  EXPECT_EQ(said.err, "");
}

TEST(Output, AnErrorShowsTheLineAndACaret) {
  Said said;
  const WordLine line = split_line("lod x", "a.fiona");
  said.output.error(LineError(line, {1, 1}, {.what = "there is no verb 'lod'", .next = "help", .near = {"load"}}));
  EXPECT_EQ(said.err, "error: a.fiona:1:1: there is no verb 'lod'\n  lod x\n  ^\n  did you mean: load\n  next: help\n");
}

TEST(Output, AnErrorForProgramsIsAnObjectWithItsCode) {
  Said said;
  said.output.manner.json = true;
  said.output.error(Error(ErrorCode::NotFound, {.what = "no", .near = {"a"}}));
  EXPECT_EQ(said.out, "{\"error\":{\"code\":3,\"near\":[\"a\"],\"what\":\"no\"},\"fiona\":1}\n");
}

}  // namespace
}  // namespace fiona::console
