#pragma once

#include <functional>
#include <optional>
#include <string>

#include "fiona/control.pb.h"
#include "fiona/error.hpp"

namespace fiona::host {

/// An Error on its way between processes.
control::Failure failure_of(const Error& error);
/// The exception being handled, as a Failure. Call inside a catch block.
control::Failure failure_of_exception();
/// The other way round.
Error error_of(const control::Failure& failure);
[[noreturn]] void throw_failure(const control::Failure& failure);
/// Does a piece of work. What it throws is a fault of the host, which goes on: a line for people.
std::optional<std::string> fault_of(const std::function<void()>& work);
/// Of what does not go as one message between host, group and console.
Error too_large(const google::protobuf::MessageLite& message);
/// The text of what went wrong at a load: there is no instance afterwards that one could look at.
ErrorText without_instance(ErrorText text, const std::string& instance);

}  // namespace fiona::host
