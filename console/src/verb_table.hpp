#pragma once

#include <span>
#include <string>
#include <string_view>
#include <vector>

#include <fiona/trust/access.hpp>

#include "session.hpp"
#include "shape.hpp"

namespace fiona::console {

using trust::Access;

/// One row of the table: parser, help and completion come from it.
struct Verb {
  using Handler = void (*)(Session&, const Line&);

  std::string name;
  std::vector<Shape> forms;
  std::string does;  ///< one line
  std::string more;  ///< what else there is to know; lines
  Access access;     ///< what the host asks for where the verb does the most that it can
  Handler handler;
  bool in_transaction = true;  ///< may stand between `begin` and `commit`
  bool takes_line = false;     ///< what follows is another line
};

/// All verbs, in the order in which help shows them.
const std::vector<Verb>& verb_rows();

/// The verb, or nothing.
const Verb* find_verb(std::string_view name);

/// Options that every line takes: `--json`, `--timeout T`, …, with one line of help each.
struct GlobalOption {
  OptionSlot slot;
  std::string does;
};
const std::vector<GlobalOption>& global_options();

/// The line read by the form of its verb that fits best. Throws LineError: no such verb (with near names), or the first
/// word that does not belong.
Line read_line(const WordLine& words);

}  // namespace fiona::console
