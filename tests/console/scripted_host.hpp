#pragma once

#include <filesystem>
#include <functional>
#include <string>
#include <thread>
#include <vector>

#include "../temporary_directory.hpp"
#include "fiona/control.pb.h"

namespace fiona::console {

using tests::TemporaryDirectory;

/// A control server on a real unix socket that answers as a test says. It serves one client after the other, in a
/// thread.
class ScriptedHost {
 public:
  /// Gets a request, returns the replies; their ids are filled in where they are 0. No reply at all: silence.
  using Script = std::function<std::vector<control::Reply>(const control::Request&)>;

  explicit ScriptedHost(Script script);
  ScriptedHost(const ScriptedHost&) = delete;
  ScriptedHost& operator=(const ScriptedHost&) = delete;
  ~ScriptedHost();

  const std::filesystem::path& socket() const { return socket_; }

  /// Bytes sent as they are before the first answer, to see what a console makes of them.
  std::string raw_first;
  /// Whether the connection is closed after the first request.
  bool hang_up = false;

 private:
  void serve();
  void serve_client(int client);

  TemporaryDirectory directory_;
  std::filesystem::path socket_;
  Script script_;
  int listener_ = -1;
  int stop_read_ = -1;
  int stop_write_ = -1;
  std::thread thread_;
};

std::string framed(const std::string& body);

}  // namespace fiona::console
