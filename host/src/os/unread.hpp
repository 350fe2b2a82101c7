#pragma once

namespace fiona::os {

/// From now on what this process says on standard error, line by line, waits for nobody who does not read it: where
/// there is no room for a fifth of a second it is lost, and how many lines were is told once there is room.
void wait_for_no_reader();

}  // namespace fiona::os
