#pragma once

#include <chrono>
#include <filesystem>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "catalogue.hpp"
#include "control_client.hpp"
#include "output.hpp"
#include "reactor.hpp"
#include "shape.hpp"

namespace fiona::console {

class WatchList;

/// Where a line comes from; a few verbs behave by it.
enum class Setting {
  Shell,   ///< one line, then the process ends: `watch` stays until it is over
  Prompt,  ///< a person types more: `watch` goes on above the prompt
  Script,  ///< a system file: likewise
};

/// What the process was told about which host and how to talk.
struct Options {
  std::string at;    ///< "unix:PATH", "ADDRESS:PORT=KEY", a known name; empty: found in the run-time directory
  std::string host;  ///< its name; empty: the one that runs
  std::filesystem::path store;  ///< empty: the user's
  std::chrono::milliseconds timeout{2000};
  bool control = false;  ///< over tcp: all that the key may, and not only to look
};

/// Changes that were collected, each with the line that asked for it.
struct Batch {
  std::vector<control::Change> changes{};
  std::vector<Line> lines{};
};

/// One console: the connection to a host, made when first needed, and what is said.
class Session {
 public:
  Session(Reactor& reactor, Output& output, Options options);
  ~Session();

  Reactor& reactor;
  Output& out;
  Options options;
  Setting setting = Setting::Shell;
  std::optional<Batch> batch;  ///< collects changes instead of making them, from `begin` to `commit`
  bool planning = false;       ///< transactions are tried only
  bool is_guest = false;       ///< a person types to a host that somebody else has started
  /// Puts a question to whoever types; nothing: nobody is there.
  std::function<std::optional<bool>(const std::string& question)> ask;
  std::optional<int> finished;  ///< the exit code once `quit` was typed

  /// The connection; one that has ended is made again, to the same host and no other. Throws fiona::Error (Unreachable)
  /// with the next step where that does not run.
  ControlClient& host();

  /// The connection if a host can be found, for verbs that know more with one.
  ControlClient* host_if_running();

  /// What could be loaded here: installed, in the marketplace, and unsigned where the host was started with such.
  Catalogue catalogue();
  /// The store of those, of the host that this console speaks to or would; empty: there is none.
  std::filesystem::path unsigned_packages();

  /// What is watched goes on there.
  void connect(const Endpoint& endpoint);
  void disconnect();
  /// Until it is connected again, where what is watched goes on.
  void lose_host();
  /// "the host has gone", and why, if that is known.
  std::string farewell() const { return client_ ? client_->farewell() : "the host has gone"; }
  bool connected() const { return client_ != nullptr && !client_->closed(); }

  control::Reply call(control::Request request) { return host().call(std::move(request)); }
  control::System snapshot();

  WatchList& watches() { return *watches_; }

  /// Runs one line by the table of verbs. Throws what it throws; `finished` tells of `quit`.
  void run(const WordLine& words);
  void run(const Line& line);

 private:
  Endpoint endpoint() const;

  std::optional<Endpoint> endpoint_;  ///< of the first connection
  std::unique_ptr<ControlClient> client_;
  std::unique_ptr<WatchList> watches_;
};

}  // namespace fiona::console
