// The form of TUF metadata: canonical JSON, times, patterns, and what is refused.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fiona/error.hpp>

#include "tuf/metadata.hpp"

namespace fiona::tuf {
namespace {

using ::testing::HasSubstr;

std::string canonical_of(std::string_view text) { return canonical(parse_json(text, "a file")); }

std::string fault_of(std::string_view text) {
  try {
    parse_json(text, "a file");
    return {};
  } catch (const Error& error) {
    return error.what();
  }
}

TEST(CanonicalJson, NamesAreSortedAndBlanksGone) {
  EXPECT_EQ(canonical_of(R"( { "b" : [ 1 , -2 ] , "a" : { } } )"), R"({"a":{},"b":[1,-2]})");
}

TEST(CanonicalJson, NamesAreSortedByBytesNotByLetters) {
  EXPECT_EQ(canonical_of("{\"a\":1,\"B\":2,\"\u00e4\":3,\"_\":4}"), "{\"B\":2,\"_\":4,\"a\":1,\"\u00e4\":3}");
}

TEST(CanonicalJson, OnlyQuoteAndBackslashAreEscaped) {
  EXPECT_EQ(canonical_of(R"(["a\"b\\c\/d\n\u0001\u00e9"])"), "[\"a\\\"b\\\\c/d\n\x01\u00e9\"]");
}

TEST(CanonicalJson, WordsAreAsTheyAre) { EXPECT_EQ(canonical_of("[true,false,null]"), "[true,false,null]"); }

TEST(CanonicalJson, WholeNumbersOf64BitsAreKept) {
  EXPECT_EQ(canonical_of("[9223372036854775807,-9223372036854775808,18446744073709551615]"),
            "[9223372036854775807,-9223372036854775808,18446744073709551615]");
}

TEST(CanonicalJson, FractionsAreRefused) {
  EXPECT_THAT(fault_of("[1.5]"), HasSubstr("a number that is not an integer"));
}
TEST(CanonicalJson, NumbersAbove64BitsAreRefused) {
  EXPECT_THAT(fault_of("[18446744073709551616]"), HasSubstr("a number that is not an integer of 64 bits"));
}
TEST(CanonicalJson, NumbersThatNothingHoldsAreRefused) {
  EXPECT_THAT(fault_of("[1e744]"), HasSubstr("a number that is not an integer of 64 bits"));
}
TEST(CanonicalJson, NamesThatStandTwiceAreRefused) {
  EXPECT_THAT(fault_of(R"({"a":{"b":1,"b":1}})"), HasSubstr("an object in it has 'b' twice"));
}
TEST(CanonicalJson, TheSameNameInTwoObjectsIsFine) { EXPECT_EQ(fault_of(R"([{"a":1},{"a":1}])"), ""); }
TEST(CanonicalJson, BytesThatAreNotUtf8AreRefused) { EXPECT_THAT(fault_of("[\"\xff\"]"), HasSubstr("breaks at byte")); }
TEST(CanonicalJson, WhatFollowsTheEndIsRefused) { EXPECT_THAT(fault_of("{} {}"), HasSubstr("breaks at byte")); }

TEST(MetadataTime, IsReadAndWritten) {
  EXPECT_EQ(time_text(parse_time("2032-02-29T23:59:59Z", "a file")), "2032-02-29T23:59:59Z");
}

class WrongTime : public ::testing::TestWithParam<const char*> {};
TEST_P(WrongTime, IsRefused) { EXPECT_THROW(parse_time(GetParam(), "a file"), Error); }
INSTANTIATE_TEST_SUITE_P(Texts, WrongTime,
                         ::testing::Values("", "2030-01-01", "2030-01-01T00:00:00", "2030-02-30T00:00:00Z",
                                           "2030-01-01T24:00:00Z", "2030-01-01T00:00:60Z", "2030-01-01 00:00:00Z",
                                           "2030-01-01T00:00:00+", "203o-01-01T00:00:00Z", "2030-13-01T00:00:00Z"));

struct PatternCase {
  const char* pattern;
  const char* path;
  bool matches;
};
class PathPattern : public ::testing::TestWithParam<PatternCase> {};
TEST_P(PathPattern, MatchesAsInAShell) {
  EXPECT_EQ(matches_pattern(GetParam().pattern, GetParam().path), GetParam().matches)
      << GetParam().pattern << " " << GetParam().path;
}
INSTANTIATE_TEST_SUITE_P(
    Specification, PathPattern,
    ::testing::Values(
        PatternCase{"targets/*.tgz", "targets/foo.tgz", true}, PatternCase{"targets/*.tgz", "targets/foo.txt", false},
        PatternCase{"foo-version-?.tgz", "foo-version-2.tgz", true},
        PatternCase{"foo-version-?.tgz", "foo-version-alpha.tgz", false}, PatternCase{"*.tgz", "foo.tgz", true},
        PatternCase{"*.tgz", "targets/foo.tgz", false}, PatternCase{"foo.tgz", "foo.tgz", true},
        PatternCase{"foo.tgz", "foo.tgz2", false}, PatternCase{"*", "", true}, PatternCase{"", "", true},
        PatternCase{"", "a", false}, PatternCase{"a/*", "a/", true}, PatternCase{"a/*", "a", false},
        PatternCase{"a*c*e", "abcde", true}, PatternCase{"a*c*e", "abcd", false}, PatternCase{"*a*", "bab", true},
        PatternCase{"**", "x", true}, PatternCase{"*/*/x", "a/b/x", true}, PatternCase{"*/x", "a/b/x", false},
        PatternCase{"[a-c]x", "bx", true}, PatternCase{"[!a-c]x", "bx", false}, PatternCase{"[]]", "]", true},
        PatternCase{"[a", "[a", true}, PatternCase{"a\\*", "a\\b", true}));

TEST(PathPatterns, ManyStarsCostNoMoreThanTheProductOfTheLengths) {
  std::string pattern;
  for (int i = 0; i < 500; ++i) pattern += "*a";
  EXPECT_FALSE(matches_pattern(pattern + "b", std::string(1000, 'a')));
}

}  // namespace
}  // namespace fiona::tuf
