#pragma once

namespace fiona::bench {

/// From a marketplace directory of 5,000 packages, two versions each, of which each requires three others, to the plan
/// for one that needs a chain of 50. Seconds.
double plan_s();

/// `fiona market install` of a package of 5 MB in a local directory, from start to end, less what a shell script takes
/// that hashes it, unpacks it, hashes and syncs each file and the directories, and renames. Milliseconds.
double install_beyond_script_ms();

}  // namespace fiona::bench
