#pragma once

#include "../session.hpp"
#include "../types.hpp"

#include "fiona/manifest.pb.h"

namespace fiona::console::verbs {

/// A component as its interface says: ports, parameters, and the objects that go through.
void show_component(Session& session, const fiona::ComponentInterface& component, const TypeSet& types);

}  // namespace fiona::console::verbs
