#pragma once

#include <map>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "fiona/control.pb.h"
#include "grammar.hpp"

namespace fiona::console {

/// Where completion gets living names from.
class Names {
 public:
  virtual ~Names() = default;
  /// The running system; nothing where no host answers in time.
  virtual const control::System* system() = 0;
  virtual std::vector<std::string> plugins() = 0;
  virtual std::vector<std::string> packages() = 0;
  /// That packages, installed or of the marketplace, provide or require.
  virtual std::vector<std::string> services() = 0;
  /// Of the component that a `load` of this plugin makes.
  virtual std::vector<std::string> parameters(const std::string& plugin) = 0;
  /// Of what a push service says, or of an object, by full name; nested ones by path.
  virtual std::vector<std::string> fields(const std::string& type) = 0;
  /// Paths that begin with the text, directories with a `/` at the end.
  virtual std::vector<std::string> files(std::string_view begin) = 0;
};

struct Completion {
  std::size_t start = 0;                  ///< where in the line the word begins that is completed
  std::vector<std::string> candidates{};  ///< whole words, sorted, all beginning with what is typed
};

/// Takes away what stands before the verb, `--host main ls`: those options that have a value. Nothing: what follows is
/// the value of the last of them.
std::optional<std::map<std::string, std::string>> take_global_options(WordLine& words);

/// What could stand at the end of the typed text, by the forms of its verb.
Completion complete(std::string_view typed, Names& names);

/// The placeholders that completion knows; a form that uses another one has no completion there.
std::vector<std::string> completed_placeholders();

}  // namespace fiona::console
