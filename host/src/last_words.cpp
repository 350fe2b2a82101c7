#include "last_words.hpp"

#include <fcntl.h>
#include <signal.h>
#include <string.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <fstream>
#include <string_view>

#include "fiona/strand.hpp"

namespace fiona::host {
namespace {

constexpr std::array kFatal{SIGSEGV, SIGBUS, SIGILL, SIGFPE, SIGABRT};

int words = -1;
std::filesystem::path place;
std::array<struct sigaction, kFatal.size()> before;

void write_all(std::string_view text) {
  if (::write(words, text.data(), text.size()) < 0) return;  // nobody is left to tell
}

/// Nothing but what a handler may call (signal-safety(7)). The one before takes its course: what was a fault is done
/// again when this returns, and what somebody has sent, `abort` too, is sent again.
void leave_them(int number, siginfo_t* sent, void*) {
  for (std::size_t i = 0; i < kFatal.size(); ++i) {
    if (kFatal[i] == number) ::sigaction(number, &before[i], nullptr);
  }
  if (sent->si_code <= 0) ::raise(number);
  const std::string_view instance = Strand::current_name();
  if (instance.empty()) return;
  std::array<char, 4> digits{};
  std::size_t at = digits.size();
  for (int rest = number; rest > 0 && at > 0; rest /= 10) digits[--at] = static_cast<char>('0' + rest % 10);
  write_all(std::string_view(digits.data() + at, digits.size() - at));
  write_all(" ");
  write_all(instance);
  write_all("\n");
}

}  // namespace

std::vector<LastWords> LastWords::told_in(const std::filesystem::path& file) {
  std::ifstream in(file);
  std::vector<LastWords> told;
  for (LastWords one; in >> one.signal && in.get() == ' ' && std::getline(in, one.instance);) {
    std::erase_if(told, [&](const LastWords& known) { return known.instance == one.instance; });
    told.push_back(one);
  }
  return told;
}

void LastWords::forget(const std::string& instance) {
  if (words < 0) return;
  const std::vector<LastWords> told = told_in(place);
  std::string rest;
  for (const LastWords& one : told) {
    if (one.instance != instance) rest += std::to_string(one.signal) + " " + one.instance + "\n";
  }
  const bool is_known = std::any_of(told.begin(), told.end(), [&](const auto& one) { return one.instance == instance; });
  if (is_known && ::ftruncate(words, 0) == 0) write_all(rest);
}

void LastWords::leave_in(const std::filesystem::path& file) {
  place = file;
  words = ::open(file.c_str(), O_WRONLY | O_CREAT | O_APPEND | O_CLOEXEC | O_NOFOLLOW, 0600);
  if (words < 0) return;  // then nothing is told of a death, which is no reason not to live
  struct sigaction action = {};
  action.sa_sigaction = leave_them;
  action.sa_flags = SA_SIGINFO;
  ::sigemptyset(&action.sa_mask);
  for (std::size_t i = 0; i < kFatal.size(); ++i) ::sigaction(kFatal[i], &action, &before[i]);
}

std::string LastWords::text() const {
  return "was ended by signal " + std::to_string(signal) + " (" + ::strsignal(signal) + ") while '" + instance +
         "' ran";
}

}  // namespace fiona::host
