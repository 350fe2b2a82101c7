#pragma once

#include "fiona/control.pb.h"
#include "fiona/error.hpp"

namespace fiona::host {

/// An Error on its way between processes.
control::Failure failure_of(const Error& error);
/// The exception being handled, as a Failure. Call inside a catch block.
control::Failure failure_of_exception();
/// The other way round.
[[noreturn]] void throw_failure(const control::Failure& failure);

}  // namespace fiona::host
