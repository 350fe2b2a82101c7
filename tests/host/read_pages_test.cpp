// What a process has read of its libraries goes, and what it has written stays.
#include "os/read_pages.hpp"

#include <gtest/gtest.h>
#include <unistd.h>

#include <cstdint>
#include <fstream>
#include <sstream>
#include <string>

#include "fiona/localisation.pb.h"

namespace fiona::os {
namespace {

using namespace std::chrono_literals;

const ReadPages::Time kBegin{1h};

/// A mapping of this process, as proc_pid_smaps(5) tells of it.
struct Mapping {
  std::uintptr_t begin = 0, end = 0;
  bool may_be_written = false;
  std::uint64_t resident_kib = 0;
};

/// The largest part of the messages' library that nobody may write to.
Mapping messages_library() {
  std::ifstream file("/proc/self/smaps");
  Mapping largest, one;
  bool ours = false;
  for (std::string line; std::getline(file, line);) {
    std::istringstream words(line);
    char dash = 0;
    std::string rights;
    if (Mapping next; words >> std::hex >> next.begin >> dash >> next.end >> rights && dash == '-') {
      one = next;
      ours = line.find("libfiona-msgs") != std::string::npos && rights.find('w') == std::string::npos;
    } else if (line.starts_with("Rss:")) {
      one.resident_kib = std::stoull(line.substr(4));
      if (ours && one.end - one.begin > largest.end - largest.begin) largest = one;
    }
  }
  return largest;
}

unsigned sum_of(const Mapping& mapping) {
  unsigned sum = 0;
  for (std::uintptr_t at = mapping.begin; at < mapping.end; at += 512)
    sum += *reinterpret_cast<const std::uint8_t*>(at);
  return sum;
}

TEST(ReadPages, AreNoLongerResidentOnceLetGoOfAndHoldTheSameWhenReadAgain) {
  ASSERT_TRUE(localisation::CommStep().IsInitialized());  // the library is there
  const Mapping before = messages_library();
  const unsigned sum = sum_of(before);
  const std::uint64_t whole_kib = messages_library().resident_kib;
  ASSERT_GE(whole_kib, (before.end - before.begin) / 1024 * 9 / 10);
  let_go_of_read_pages();
  EXPECT_LT(messages_library().resident_kib, whole_kib / 4);
  EXPECT_EQ(sum_of(before), sum);
}

TEST(ReadPages, WhatHasBeenWrittenStays) {
  static std::string written = "before";
  written = "after, and too long to lie inside of the string";
  let_go_of_read_pages();
  EXPECT_EQ(written, "after, and too long to lie inside of the string");
  EXPECT_EQ(localisation::CommStep::descriptor()->full_name(), "fiona.localisation.CommStep");
}

TEST(ReadPages, AreLetGoOfASecondAfterTheLastLibraryWasOpened) {
  ReadPages pages;
  EXPECT_GE(pages.look(0, kBegin), 1000);  // what the program came with
  EXPECT_GE(pages.look(1, kBegin + 900ms), 1000);
  EXPECT_GT(pages.look(1, kBegin + 1800ms), 0);
  EXPECT_EQ(pages.look(1, kBegin + 1900ms), -1);
}

TEST(ReadPages, NobodyIsWokenForAProcessThatRests) {
  ReadPages pages;
  pages.look(3, kBegin);
  EXPECT_EQ(pages.look(3, kBegin + 1h), -1);
  EXPECT_EQ(pages.look(3, kBegin + 2h), -1);
  EXPECT_GT(pages.look(4, kBegin + 2h), 0);
}

}  // namespace
}  // namespace fiona::os
