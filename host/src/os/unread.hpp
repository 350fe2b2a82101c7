#pragma once

namespace fiona::os {

/// What is opened later is not taken for standard input, output or error where whoever started this has closed them.
void open_standard_streams();

/// From now on what this process says on standard error, line by line, waits for nobody who does not read it: where
/// there is no room for a fifth of a second it is lost, and how many lines were is told once there is room.
void wait_for_no_reader();

}  // namespace fiona::os
