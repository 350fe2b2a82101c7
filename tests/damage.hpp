// Promise R13: files that are damaged by chance. FIONA_DAMAGES says how often each, FIONA_SEED how.
#pragma once

#include <gtest/gtest.h>

#include <algorithm>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <random>
#include <string>

namespace fiona::tests {

/// Cuts and flipped bits of a file's content, and whether each is dealt with in time.
class Damage {
 public:
  explicit Damage(int short_form) : times_(from("FIONA_DAMAGES", short_form)) {
    std::printf("each %d times, FIONA_SEED=%d\n", times_, seed_);
  }
  ~Damage() { std::printf("dealt with within %.0f ms (bound %.0f ms)\n", 1000 * longest_s_, 1000 * kWithin_s); }
  Damage(const Damage&) = delete;
  Damage& operator=(const Damage&) = delete;

  int times() const { return times_; }
  std::string cut(const std::string& whole) { return whole.substr(0, random_() % whole.size()); }
  std::string flipped(std::string whole) {
    char& byte = whole[random_() % whole.size()];
    byte = static_cast<char>(byte ^ (1 << random_() % 8));
    return whole;
  }
  template <class F>
  auto in_time(F open) {
    const auto begun = std::chrono::steady_clock::now();
    auto result = open();
    const double took_s = std::chrono::duration<double>(std::chrono::steady_clock::now() - begun).count();
    longest_s_ = std::max(longest_s_, took_s);
    EXPECT_LE(took_s, kWithin_s);
    return result;
  }

 private:
  static int from(const char* variable, int otherwise) {
    const char* text = std::getenv(variable);
    return text && *text ? std::atoi(text) : otherwise;
  }
  static constexpr double kWithin_s = 2;
  const int times_;
  const int seed_ = from("FIONA_SEED", static_cast<int>(std::random_device{}() % 1'000'000));
  std::mt19937 random_{static_cast<unsigned>(seed_)};
  double longest_s_ = 0;
};

}  // namespace fiona::tests
