#pragma once

#include <string_view>

#include "fiona/time.hpp"

namespace fiona {

/// How a push subscription receives: the newest value only, or each one in order through a bounded queue.
enum class Delivery { Newest, Each };

/// What becomes of the open requests of a query client whose port is rewired: they end on the old provider, are put to
/// the new one (only where the service is idempotent), or end with Disconnected.
enum class AtRewire { Finish, Redirect, Fail };

/// What an author may say of a port beyond its service.
struct PortOptions {
  bool optional = false;  ///< the component can do without: no white spot, no complaint
  std::string_view doc = {};
  Delivery delivery = Delivery::Each;
  AtRewire at_rewire = AtRewire::Finish;
  /// Of a push: what was true longer ago than this reaches neither handler nor caller, and is counted as dropped. Zero:
  /// whatever comes is delivered, with its `origin`.
  Duration max_age{};
  std::string_view activity = {};  ///< the port works in the main modes that have it; empty: in all
};

}  // namespace fiona
