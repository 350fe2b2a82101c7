#pragma once

#include <optional>
#include <string>

#include "fiona/control.pb.h"
#include "fiona/trust/access.hpp"

namespace fiona::host {

class Model;

/// What a client may do, and who it is.
struct Rights {
  trust::Access level = trust::Access::Administer;   ///< of this connection
  trust::Access of_key = trust::Access::Administer;  ///< what it could have had
  std::string name{};  ///< of a component, or of a console on another machine; empty: the host's own user
  std::string key{};   ///< of a console on another machine
  bool is_remote() const { return !key.empty(); }
};

/// What a request asks for, in the word that people have for it, and the level that this takes.
struct Need {
  trust::Access level;
  std::string what;
};

/// The policy, and all of it. A transaction takes what the highest of its changes takes; one that is only tried, and
/// all else that changes nothing, is for those who look. What this host does not know is for nobody.
Need need_of(const control::Request& request);
Need need_of(const control::Transact& transact);

/// What a change takes beyond that: a parameter that names a file of this machine (`fiona.host_path`) and has another
/// value after it. Only the package knows which those are.
std::optional<Need> need_of(const Model& before, const Model& after);

/// Throws Error NotAllowed, with the level that is needed, the one that is there, and how to get more.
void require(const Rights& rights, const control::Request& request);
void require(const Rights& rights, const Need& need);

}  // namespace fiona::host
