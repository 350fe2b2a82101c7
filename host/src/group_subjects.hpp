#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <set>
#include <string>

#include "fiona/wire.pb.h"

namespace fiona::host {

/// What a group has to tell of: the instances and wires that it holds, and what it was asked for. What it says of
/// anything else is not believed: a component may have taken its process over. One thread uses it at a time.
class GroupSubjects {
 public:
  GroupSubjects() = default;
  GroupSubjects(const GroupSubjects&) = delete;
  GroupSubjects& operator=(const GroupSubjects&) = delete;

  /// It is asked for this, under a number of its own.
  void ask(const wire::GroupRequest& request);
  /// This is its answer: what it has been rid of it tells of no more.
  void answered(const wire::GroupMessage& reply);
  /// Of a group that a host before this one has started.
  void hold(const wire::Adopted& adopted);
  /// It has told what it holds: of what else it was asked for nothing has come.
  void keep(const wire::Adopted& held);
  /// Whether the event is about one of these. What ends once has ended with it.
  bool take(const wire::GroupMessage& event);
  std::size_t instances() const { return instances_.size(); }
  /// What it was asked for, and has not answered, it does not answer any more: it may be done or not.
  void answers_no_more() { open_.clear(); }
  bool awaits_answers() const { return !open_.empty(); }
  /// It has nothing to tell of.
  bool is_empty() const;

 private:
  using Numbers = std::set<std::uint64_t>;
  using Then = std::function<void(bool done)>;

  Then following(const wire::GroupRequest& request);
  static Then unless_refused(Numbers& numbers, std::uint64_t number);
  static Then later(Numbers& numbers, std::uint64_t number);

  std::multiset<std::string> instances_;  ///< of a name the next may be made before the end of the last is told
  Numbers wires_;  ///< whose end it tells of: those that it is the client of, and of processes outside
  Numbers taps_;
  Numbers changes_;
  Numbers calls_;
  std::map<std::uint64_t, Then> open_;  ///< what follows from the answer, by request
};

/// What others say of what is not theirs, is dropped, and told at the first, second, fourth, … time.
class Disbelief {
 public:
  /// `who`: "group 'near'".
  void tell(const std::string& who, const wire::GroupMessage& event);

 private:
  std::uint64_t times_ = 0;
};

}  // namespace fiona::host
