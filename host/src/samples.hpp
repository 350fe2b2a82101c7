#pragma once

#include <cstdint>

#include "fiona/time.hpp"
#include "fiona/wire.pb.h"

namespace fiona::host {

/// A value as who watches or reads it is told, without the descriptors of its type. `start`: of the system's clock.
control::Sample sample_of(const wire::Tapped& tapped, TimePoint start);

/// What one watcher has missed: what his tap has left out, and what was lost on the way from it.
class Gaps {
 public:
  /// False: it was on its way from where the tap was opened before, and others have come from where it is now.
  bool takes(const wire::Tapped& next);
  /// Values that are missing right before this one. Of a tap that was opened anew, as of another version
  /// of the instance, it begins anew.
  std::uint64_t before(const wire::Tapped& next);

 private:
  std::uint64_t opening_ = 0;         ///< of the value before, as are the next
  std::uint64_t newest_opening_ = 0;  ///< of all that were taken
  std::uint64_t number_ = 0;
  std::uint64_t skipped_ = 0;
};

}  // namespace fiona::host
