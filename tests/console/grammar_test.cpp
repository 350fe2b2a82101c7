#include <gtest/gtest.h>

#include "grammar.hpp"

namespace fiona::console {
namespace {

std::vector<std::string> texts(const WordLine& line) {
  std::vector<std::string> out;
  for (const auto& item : line.items)
    out.push_back(item.name ? item.name->text + "=" + item.word.text : item.word.text);
  return out;
}

using Texts = std::vector<std::string>;

control::Value value(const std::string& typed_value) {
  const WordLine line = split_line("x=" + typed_value);
  return value_of(line.items.at(0).word, line);
}

std::string error_of(const std::string& text) {
  try {
    split_script(text, "a.fiona");
  } catch (const LineError& error) {
    return std::string(error.what()) + "\n" + error.caret();
  }
  return "no error";
}

TEST(Grammar, BlanksSplitALineIntoWords) {
  EXPECT_EQ(texts(split_line("  load\ttrace-player   as walk ")), (Texts{"load", "trace-player", "as", "walk"}));
}

TEST(Grammar, ACommentEndsTheLine) { EXPECT_EQ(texts(split_line("ls # everything")), Texts{"ls"}); }

TEST(Grammar, AHashInsideAWordIsNoComment) { EXPECT_EQ(texts(split_line("show a#b")), (Texts{"show", "a#b"})); }

TEST(Grammar, ALineKeepsTheCommentRightAboveItAndAtItsEnd) {
  const auto lines =
      split_script("# the system\n\n#  the phone \n# of a visitor\nload a # seeded\nload b\n", "a.fiona");
  ASSERT_EQ(lines.size(), 2U);
  EXPECT_EQ(lines[0].comment, "the phone\nof a visitor\nseeded");
  EXPECT_EQ(lines[1].comment, "");
}

TEST(Grammar, ACommentIsCutRatherThanKeptWithoutBound) {
  std::string text;
  for (int i = 0; i < 1000; ++i) text += "# a line of ten\n";
  const auto lines = split_script(text + "load a\n", "a.fiona");
  EXPECT_LE(lines.at(0).comment.size(), 4096U);
  EXPECT_GT(lines.at(0).comment.size(), 4000U);
}

TEST(Grammar, ALineOfACommentIsEmpty) { EXPECT_TRUE(split_line("# nothing").empty()); }

TEST(Grammar, EscapesInsideQuotesAreWhatTheySay) {
  EXPECT_EQ(texts(split_line(R"(show "a \"b\" \\ \n \t \u{e9}\u{1F6B6}")")), (Texts{"show", "a \"b\" \\ \n \t é🚶"}));
}

TEST(Grammar, AQuotedKeywordIsNoKeyword) { EXPECT_FALSE(split_line("\"to\"").items[0].word.is_plain("to")); }

TEST(Grammar, ATrailingBackslashContinuesTheLine) {
  EXPECT_EQ(texts(split_line("wire nav.imu \\\n  to walk.imu")), (Texts{"wire", "nav.imu", "to", "walk.imu"}));
}

TEST(Grammar, ABackslashAtTheEndOfACommentContinuesNothing) {
  EXPECT_EQ(split_script("ls # a \\\nspots", "").size(), 2U);
}

TEST(Grammar, WindowsLineEndsAndAByteOrderMarkAreRead) {
  EXPECT_EQ(split_script("\xef\xbb\xbfls\r\nspots\r\n", "").size(), 2U);
}

TEST(Grammar, ANameAndItsValueAreOneArgument) {
  const WordLine line = split_line(R"(set a name="x y" rate=5 list=[1, "b c"])");
  EXPECT_EQ(texts(line), (Texts{"set", "a", "name=x y", "rate=5", "list=[1, \"b c\"]"}));
}

TEST(Grammar, AComparisonIsNoArgument) {
  EXPECT_EQ(texts(split_line("expect a.b.c == 5")), (Texts{"expect", "a.b.c", "==", "5"}));
}

TEST(Grammar, PlacesCountCodePointsFromOne) {
  const WordLine line = split_script("ls\n  show é walk", "f")[1];
  EXPECT_EQ(line.items[2].word.place, (Place{2, 10}));
}

TEST(Grammar, AnErrorNamesFileLineAndColumnAndPutsACaretUnderTheWord) {
  EXPECT_EQ(error_of("ls\nshow \"abc"),
            "a.fiona:2:6: this quote is never closed\n  next: close it with \" on the same line\nshow \"abc\n     ^");
}

TEST(Grammar, TheCaretStandsRightAfterCharactersThatAreShownLonger) {
  const std::string text = error_of("show \xe2\x80\xae\"");
  EXPECT_EQ(text.substr(text.find("show")), "show \\u{202e}\"\n             ^");
}

TEST(Grammar, AnUnknownEscapeIsRefused) {
  EXPECT_EQ(error_of(R"(show "\x")").substr(0, 42), "a.fiona:1:7: this escape is not known\n  ex");
}

TEST(Grammar, SurrogatesAndZeroAreNoCharacters) {
  for (const char* text :
       {R"("\u{d800}")", R"("\u{0}")", R"("\u{110000}")", R"("\u{}")", R"("\u{g}")", R"("\u65")", R"("\u{1234567}")"})
    EXPECT_NE(error_of(text).find("this is no character"), std::string::npos) << text;
}

TEST(Grammar, BytesThatAreNoUtf8AreRefusedWithTheirPlace) {
  EXPECT_NE(error_of("show \xff").find("a.fiona:1:6: this byte is not UTF-8"), std::string::npos);
}

TEST(Grammar, AControlCharacterIsRefusedWithItsName) {
  EXPECT_NE(error_of("show \x1b[2J").find("a control character (U+001B) stands in the line"), std::string::npos);
}

TEST(Grammar, AMissingValueIsRefused) {
  EXPECT_NE(error_of("set a rate= 5").find("a.fiona:1:12: no value follows rate="), std::string::npos);
}

TEST(Grammar, AnOpenBracketIsRefusedAtItsPlace) {
  EXPECT_NE(error_of("set a x=[1, {a: \"]\" }").find("a.fiona:1:9: this [ is never closed"), std::string::npos);
}

TEST(Grammar, BracketsThatCrossAreRefused) {
  EXPECT_NE(error_of("set a x=[{]}").find("this ] closes nothing"), std::string::npos);
}

TEST(Grammar, DeepNestingIsRefusedNotRecursed) {
  EXPECT_NE(error_of("set a x=" + std::string(100000, '[')).find("brackets are nested too deep"), std::string::npos);
}

TEST(Grammar, NothingAfterATrailingBackslashIsRefused) {
  EXPECT_NE(error_of("ls \\").find("the line goes on after \\, and nothing follows"), std::string::npos);
}

TEST(Grammar, ATypedLineIsOneCommand) { EXPECT_THROW(split_line("ls\nspots"), LineError); }

TEST(Grammar, ATooLongScriptIsRefused) {
  try {
    split_script(std::string((16U << 20U) + 1, ' '), "a.fiona");
    FAIL() << "it was taken";
  } catch (const Error& error) {
    EXPECT_STREQ(error.what(), "a.fiona: the script is too long\n  expected: at most 16 MiB\n  found: 16777217 bytes");
  }
}

TEST(ReadyWords, AreNeverSplitAgain) {
  EXPECT_EQ(texts(ready_words({"set", "a b", "name=x y", "#c"})), (Texts{"set", "a b", "name=x y", "#c"}));
}

TEST(ReadyWords, AnEmptyValueIsTheEmptyText) {
  const WordLine line = ready_words({"set", "a", "name="});
  EXPECT_EQ(value_of(line.items[2].word, line).text(), "");
  EXPECT_EQ(value_of(line.items[2].word, line).kind_case(), control::Value::kText);
}

TEST(ReadyWords, ListsAndNumbersAreValues) {
  const WordLine line = ready_words({"set", "a", "x=[1, 2]", "y=5ms"});
  EXPECT_EQ(value_of(line.items[2].word, line).list().values_size(), 2);
  EXPECT_EQ(value_of(line.items[3].word, line).unit(), "ms");
}

TEST(ReadyWords, ABackslashStaysABackslash) { EXPECT_EQ(ready_words({"show", "a\\b"}).items[1].word.text, "a\\b"); }

TEST(Values, AWholeNumberIsAnInteger) { EXPECT_EQ(value("-42").integer(), -42); }

TEST(Values, ANumberKeepsItsUnit) {
  EXPECT_DOUBLE_EQ(value("1.5m").number(), 1.5);
  EXPECT_EQ(value("1.5m").unit(), "m");
  EXPECT_EQ(value("9.81m/s^2").unit(), "m/s^2");
  EXPECT_EQ(value("30°").unit(), "°");
  EXPECT_EQ(value("5µs").unit(), "µs");
}

TEST(Values, AnExponentIsNoUnit) {
  EXPECT_DOUBLE_EQ(value("2e3").number(), 2000);
  EXPECT_EQ(value("2e3").unit(), "");
}

TEST(Values, AnIntegerBeyondSixtyFourBitsIsANumber) {
  EXPECT_DOUBLE_EQ(value("18446744073709551616").number(), 18446744073709551616.0);
}

TEST(Values, ANumberKeepsHowItWasTyped) { EXPECT_EQ(value("007").typed(), "007"); }

TEST(Values, AddressesDatesAndVersionsAreTexts) {
  for (const char* text : {"10.0.0.1", "2024-01-01", "1.2.3", "-", "+", ".", "a5", "1e999", "--5", "+-5"})
    EXPECT_EQ(value(text).kind_case(), control::Value::kText) << text;
}

TEST(Values, AQuotedNumberIsAText) { EXPECT_EQ(value("\"5\"").text(), "5"); }

TEST(Values, TrueAndFalseAreFlags) {
  EXPECT_TRUE(value("true").flag());
  EXPECT_EQ(value("True").kind_case(), control::Value::kText);
}

TEST(Values, AListHoldsValuesOfAnyKind) {
  const control::Value list = value(R"([1, 2.5m, "a, b", word, [true], {x: 1}])");
  ASSERT_EQ(list.list().values_size(), 6);
  EXPECT_EQ(list.list().values(1).unit(), "m");
  EXPECT_EQ(list.list().values(2).text(), "a, b");
  EXPECT_TRUE(list.list().values(4).list().values(0).flag());
  EXPECT_EQ(list.list().values(5).message(), "x: 1");
}

TEST(Values, AListWithAGapIsRefused) {
  for (const char* text : {"[1, ]", "[, 1]", "[1 2]"}) EXPECT_THROW(value(text), LineError) << text;
}

TEST(Values, AListMayBeEmptyAndNested) {
  EXPECT_EQ(value("[]").list().values_size(), 0);
  EXPECT_EQ(value("[[1], [2, 3]]").list().values(1).list().values(1).integer(), 3);
}

TEST(Values, BracesHoldProtobufText) { EXPECT_EQ(value("{a: \"}\" b: '{'}").message(), "a: \"}\" b: '{'"); }

TEST(Values, WhatIsTypedIsReadBackTheSame) {
  for (const char* text : {"5",
                           "-5",
                           "5.0",
                           "1.5m",
                           "007",
                           "2e3",
                           "true",
                           "word",
                           "\"5\"",
                           "\"true\"",
                           "\"\"",
                           "\"a b\"",
                           "\"a\\\"b\\\\c\\nd\"",
                           "\"to\"",
                           "\"-x\"",
                           "[1, \"a, b\", [x]]",
                           "{a: 1}",
                           "\"#x\"",
                           "\"a=b\"",
                           "\"=\"",
                           "é"}) {
    const control::Value first = value(text);
    EXPECT_EQ(value(typed(first)).SerializeAsString(), first.SerializeAsString()) << text << " -> " << typed(first);
  }
}

TEST(Values, ANumberWithoutItsTypingIsReadBackAsTheSameKind) {
  control::Value number;
  number.set_number(5);
  number.set_unit("m");
  EXPECT_EQ(typed(number), "5.0m");
  number.set_typed("6.0m; quit");  // from a host that lies
  EXPECT_EQ(typed(number), "5.0m");
}

TEST(Durations, HaveAUnitOfTime) {
  const WordLine line = split_line("sleep 1.5s 200ms 2min 5");
  EXPECT_DOUBLE_EQ(duration_ms(line.items[1].word, line), 1500);
  EXPECT_DOUBLE_EQ(duration_ms(line.items[2].word, line), 200);
  EXPECT_DOUBLE_EQ(duration_ms(line.items[3].word, line), 120000);
  EXPECT_THROW(duration_ms(line.items[4].word, line), LineError);
}

TEST(PortNames, AreAnInstanceAndAPort) {
  const WordLine line = split_line("watch nav.location nav nav. .x a.b.c");
  EXPECT_EQ(port_name(line.items[1].word, line).port(), "location");
  for (std::size_t i = 2; i < line.items.size(); ++i) EXPECT_THROW(port_name(line.items[i].word, line), LineError) << i;
}

TEST(Continuation, IsSeenAtTheEndOnlyAndNotInComments) {
  EXPECT_TRUE(continues("load x \\"));
  EXPECT_TRUE(continues("show \"abc\\"));
  EXPECT_FALSE(continues("load x"));
  EXPECT_FALSE(continues("ls # \\"));
}

}  // namespace
}  // namespace fiona::console
