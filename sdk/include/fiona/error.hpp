#pragma once

#include <concepts>
#include <cstdint>
#include <exception>
#include <span>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

namespace fiona {

/// Why a request could not be fulfilled. The number is the exit code of the `fiona` command.
enum class ErrorCode : std::uint8_t {
  Failed = 1,              ///< it was understood and did not work
  Usage = 2,               ///< it was not understood
  NotFound = 3,            ///< something it names does not exist
  WiringInvalid = 4,       ///< two ports do not fit, or white spots remain where none are allowed
  BadSignature = 5,        ///< a hash or signature does not match
  DependencyConflict = 6,  ///< versions or requirements cannot be met together
  Unreachable = 7,         ///< nobody answered within the deadline
  NotAllowed = 8,          ///< the caller lacks the right
  ComponentFailed = 9,     ///< a component threw, refused to start, or died
};

/// A request that cannot be fulfilled, told so that a person can act on it. Every field but `what` may be empty.
struct ErrorText {
  std::string what{};               ///< one sentence: what could not be done and why
  std::string where{};              ///< file:line:column, instance.port, package
  std::string expected{};           ///< what would have been right
  std::string found{};              ///< what was there instead
  std::string next{};               ///< the next step, best as a line to type
  std::vector<std::string> near{};  ///< names that resemble the one that was not found

  bool operator==(const ErrorText&) const = default;
};

/// Thrown when a request cannot be fulfilled (style: errors 2). Caught only at the edges: the console's loop,
/// the control server's loop, the instance's boundary.
class Error : public std::exception {
 public:
  Error(ErrorCode code, ErrorText text);
  /// A template, so that a braced list always means an ErrorText.
  template <std::convertible_to<std::string> S>
  Error(ErrorCode code, S&& what) : Error(code, ErrorText{.what = std::forward<S>(what)}) {}

  ErrorCode code() const noexcept { return code_; }
  const ErrorText& text() const noexcept { return text_; }

  /// The whole text as a person reads it: the sentence, then indented lines for what else is known.
  const char* what() const noexcept override { return rendered_.c_str(); }

 private:
  ErrorCode code_;
  ErrorText text_;
  std::string rendered_;
};

/// The names in `known` that resemble `typed`, best first, at most three: for "did you mean".
/// Edit distance (Damerau-Levenshtein, restricted) of at most a third of the length, or a shared prefix.
std::vector<std::string> nearest_names(std::string_view typed, std::span<const std::string> known);

}  // namespace fiona
