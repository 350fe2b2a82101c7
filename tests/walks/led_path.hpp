#pragma once

#include <string>
#include <vector>

#include "announcements.hpp"
#include "measured_path.hpp"
#include "word_check.hpp"

namespace fiona::walks {

/// A published path while somebody is led along it: how far along it guidance takes them to be, and how far they are.
class LedPath {
 public:
  /// `path` must have a place. Both others must outlive it.
  LedPath(const building::Building& building, const WordCheck& check, const navigation::CommPath& path);

  void walk(const Believed& walker, const building::PathPoint& truly);
  /// What is wrong with a word on it; empty: nothing.
  std::string fault_of(const hmi::Instruction& said, const Believed& walker) const;
  /// A word that is another one than before.
  void hear(const hmi::Instruction& said) { announcements_.hear(said, believed_m_, truly_m_); }
  std::vector<Announcement> take_passed() { return announcements_.take_passed(); }

 private:
  const WordCheck& check_;
  const MeasuredPath path_;
  Announcements announcements_;
  double believed_m_ = 0.0, truly_m_ = 0.0;
};

}  // namespace fiona::walks
