#pragma once

#include "engine.hpp"

namespace fiona::host {

/// Steps that are made in their order; after a failure, those that take back what has been made.
struct Engine::Transaction {
  std::string author;
  Asker asker{};
  Rights rights{};
  control::Transact request;
  bool is_undo = false;
  std::uint64_t undoes = 0;
  std::string reason{};  ///< why it is made, where nobody asked for it
  Waits::Answer answer;
  std::optional<std::chrono::steady_clock::time_point> expires;

  std::vector<control::Change> steps;
  std::vector<control::Change> reverse;
  std::vector<std::string> warnings;
  Model before;
  std::uint64_t entry = 0;
  std::size_t at = 0;
  bool takes_back = false;
  control::Done done;
  std::optional<control::Failure> failure;
  std::vector<std::string> not_taken_back;

  /// A change of mode alone: it may take long, has nothing to take back, and holds up nobody.
  bool is_aside() const { return steps.size() == 1 && steps.front().has_state(); }
};

}  // namespace fiona::host
