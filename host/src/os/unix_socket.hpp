#pragma once

#include <filesystem>
#include <string>
#include <utility>

#include "os/descriptor.hpp"

namespace fiona::os {

/// A listening unix stream socket that no second process can take over: a lock beside it (`PATH.lock`) is held as
/// long as it lives, and a socket file left by a dead owner is replaced (promises R21).
class UnixListener {
 public:
  /// The directory is made with mode 0700 if it is missing; one that others may enter or that someone else owns is
  /// refused. Throws Error NotAllowed, naming the holder, when another process has the lock.
  explicit UnixListener(const std::filesystem::path& path);
  ~UnixListener();
  UnixListener(const UnixListener&) = delete;
  UnixListener& operator=(const UnixListener&) = delete;

  int descriptor() const { return socket_.get(); }
  /// The next connection, not blocking; empty when there is none.
  Descriptor accept() const;

 private:
  const std::filesystem::path path_;
  Descriptor lock_;
  Descriptor socket_;
};

/// A connected pair of stream sockets, both closed on exec.
std::pair<Descriptor, Descriptor> socket_pair();

/// A lock that ends with this process, in a file that is made if it is missing and tells its number; none: another
/// process has it. What one that was killed has left has two seconds to let go. Throws Error Failed if there can be no
/// such file.
Descriptor try_lock(const std::filesystem::path& file);

/// Makes `directory` with mode 0700, or checks that it is ours and closed to others. Throws Error NotAllowed.
void require_private_directory(const std::filesystem::path& directory);

}  // namespace fiona::os
