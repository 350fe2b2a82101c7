#include <gtest/gtest.h>

#include <fiona/error.hpp>
#include <fiona/marketplace/manifest.hpp>
#include <fiona/marketplace/version.hpp>

#include "support.hpp"

namespace fiona::marketplace {
namespace {

using testing::error_of;

std::string authors(const std::string& more) {
  return "publisher: 'acme' name: 'steps' version: '1.0.0' summary: 'Counts' license: 'MIT' " + more;
}

TEST(Version, PrecedenceIsThatOfTheStandardsExample) {
  const std::vector<std::string> rising{"1.0.0-alpha",  "1.0.0-alpha.1", "1.0.0-alpha.beta", "1.0.0-beta",
                                        "1.0.0-beta.2", "1.0.0-beta.11", "1.0.0-rc.1",       "1.0.0",
                                        "1.0.1",        "1.2.0",         "1.10.0",           "2.0.0"};
  for (std::size_t i = 0; i < rising.size(); ++i) {
    for (std::size_t j = 0; j < rising.size(); ++j) {
      EXPECT_EQ(*Version::parse(rising[i]) < *Version::parse(rising[j]), i < j) << rising[i] << " " << rising[j];
    }
  }
}

TEST(Version, NumbersOfAnyLengthAreComparedAsNumbers) {
  EXPECT_LT(*Version::parse("1.0.99999999999999999999"), *Version::parse("1.0.100000000000000000000"));
}

TEST(Version, BuildMetadataDoesNotCount) { EXPECT_EQ(*Version::parse("1.0.0+a"), *Version::parse("1.0.0+b")); }

TEST(Version, WhatTheStandardForbidsIsNoVersion) {
  for (const auto* text : {"", "1", "1.0", "1.0.0.0", "01.0.0", "1.0.0-", "1.0.0-01", "1.0.0-a..b", "1.0.0+", "v1.0.0",
                           "1.0.0 ", "-1.0.0", "1.0.0-\xc3\xa4"}) {
    EXPECT_FALSE(Version::parse(text)) << text;
  }
  EXPECT_FALSE(Version::parse("1.0." + std::string(64, '1')));
}

TEST(Manifest, AMistakeIsToldWithLineAndColumn) {
  const Error error = error_of([] { parse_manifest("publisher: 'acme'\nnamme: 'x'\n", "m"); });
  EXPECT_EQ(error.text().where, "m:2:6");
  EXPECT_EQ(error.text().what, "this is not a Manifest: Message type \"fiona.Manifest\" has no field named \"namme\".");
}

TEST(Manifest, AWrongVersionIsToldWithTheFormExpected) {
  const Error error = error_of(
      [] { parse_manifest("publisher: 'acme' name: 'steps' version: '1.0' summary: 'x' license: 'MIT'", "m"); });
  EXPECT_STREQ(error.what(),
               "m: version is not a semantic version\n  expected: MAJOR.MINOR.PATCH, such as 1.0.0 or 1.2.0-rc.1\n"
               "  found: \"1.0\"");
}

TEST(Manifest, ATimeAfterWhichItHangsIsOneToTenSeconds) {
  const auto asking = [](const std::string& time) {
    return parse_manifest(
        "publisher: 'acme' name: 'steps' version: '1.0.0' summary: 'x' license: 'MIT' hang_after_ms: " + time, "m");
  };
  for (const std::string good : {"0", "1000", "10000"}) EXPECT_NO_THROW(asking(good)) << good;
  for (const std::string bad : {"1", "999", "10001", "4294967295"}) {
    EXPECT_STREQ(
        error_of([&] { asking(bad); }).what(),
        ("m: hang_after_ms is out of range\n  expected: 1000 to 10000 ms, or none: 1000\n  found: " + bad).c_str());
  }
}

TEST(Manifest, AServiceOnDBusIsARightByItsWellKnownName) {
  for (const char* good : {"system-bus:org.bluez", "session-bus:org.mpris.MediaPlayer2.vlc-2", "system-bus:_a.b"})
    EXPECT_TRUE(opens_sandbox(good)) << good;
  for (const char* bad : {"system-bus", "system-bus:", "system-bus:org", "system-bus:org.*", "system-bus::1.2",
                          "system-bus:org..bluez", "system-bus:org.bluez.", "system-bus:org.1", "system-bus:a b.c",
                          "system-bus:org.freedesktop.DBus", "bus:org.bluez"}) {
    EXPECT_FALSE(opens_sandbox(bad)) << bad;
  }
  EXPECT_FALSE(opens_sandbox("system-bus:a." + std::string(254, 'b'))) << "longer than a name on D-Bus";
}

TEST(Manifest, ANameWithASlashIsRefused) {
  const Error name = error_of([] { parse_manifest("publisher: '../x'", "m"); });
  EXPECT_EQ(name.text().what, "publisher is not a name that a package may have");
}

TEST(Manifest, ATextThatWouldReachATerminalHasNoControlCharacters) {
  EXPECT_EQ(error_of([] { parse_manifest(authors("rights: '\\033[2J'"), "m"); }).text().what,
            "rights has a control or invisible character");
  EXPECT_EQ(error_of([] { parse_manifest(authors("rights: '\\342\\200\\256'"), "m"); }).text().what,
            "rights has a control or invisible character");
  EXPECT_EQ(error_of([] { parse_manifest(authors("rights: '\\300\\257'"), "m"); }).text().what, "rights is not UTF-8");
  EXPECT_NO_THROW(parse_manifest(authors("try: 'ls\\nspots'"), "m"));
}

TEST(PackagePath, OnlyHarmlessPathsAreAllowed) {
  for (const auto* path :
       {"interface.textproto", "README.md", "lib/a.so.1", "share/a/b_c/main@0.osm", "share/x=1,y+2"}) {
    EXPECT_EQ(path_fault(path), "") << path;
  }
  EXPECT_EQ(path_fault(""), "is empty");
  EXPECT_EQ(path_fault("/lib/a"), "is absolute");
  EXPECT_EQ(path_fault("lib/../../a"), "has a \"..\" element");
  EXPECT_EQ(path_fault("lib/./a"), "has a \".\" element");
  EXPECT_EQ(path_fault("lib//a"), "has an empty element");
  EXPECT_EQ(path_fault("lib/"), "has an empty element");
  EXPECT_EQ(path_fault("lib/.hidden"), "has an element that begins with a sign");
  EXPECT_EQ(path_fault("lib/a\\b"), "has a character other than ASCII letters, digits and ._+@=,-");
  EXPECT_EQ(path_fault("bin/a"), "is not interface.textproto, README.md, or below lib/ or share/");
  EXPECT_EQ(path_fault("share/" + std::string(95, 'a')), "is longer than 100 characters");
}

TEST(Interface, APortWithoutAServiceIsRefused) {
  const Error error =
      error_of([] { parse_interface("components { name: 'steps' ports { name: 'out' direction: PROVIDES } }", "i"); });
  EXPECT_STREQ(error.what(), "i: port \"out\" of steps lacks its name, direction or service");
}

}  // namespace
}  // namespace fiona::marketplace
