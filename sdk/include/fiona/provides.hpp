#pragma once

#include "fiona/service.hpp"
#include "fiona/task.hpp"
#include "fiona/time.hpp"

namespace fiona {

class Port;

/// The provider's side of service S, as a member of a component; the pattern's header says how it is used.
template <class S>
class Provides;

/// The client's side of service S, as a member of a component; the pattern's header says how it is used.
template <class S>
class Requires;

/// [any thread] The time on the clock of the instance that owns the port.
TimePoint owner_now(const Port& port);

}  // namespace fiona
