#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "recording.hpp"
#include "session.hpp"
#include "types.hpp"

namespace fiona::console {

/// What one `watch` line asked for, or one port of a `record` line.
struct WatchRequest {
  control::PortName port;
  std::vector<std::string> fields;
  double every_ms = 0;
  unsigned every_nth = 1;
  std::optional<control::Condition> when;  ///< only what makes it true
  std::optional<double> for_ms;
  std::shared_ptr<Recording> into{};  ///< where samples go; none: they are printed
};

/// What the line of a `watch` says. Throws LineError at the word that does not belong.
WatchRequest watch_request(const Line& line);
/// The same of a `record`: one for each port.
std::vector<WatchRequest> record_requests(const Line& line);

/// The watches that run in this console: each prints or records its samples until it is stopped, its time is over, or
/// the host ends it. One whose group or host has been lost says so, and goes on when that is back. A recording ends
/// with its last watch.
class WatchList {
 public:
  explicit WatchList(Session& session) : session_(session) {}
  ~WatchList() {
    clear();
    if (flush_timer_) session_.reactor.cancel_timer(*flush_timer_);
  }

  /// Returns once the host watches. Throws its refusal.
  std::uint64_t start(const WatchRequest& request);
  /// Stops those that print the port, "instance.port"; all with an empty name. Returns how many.
  std::size_t stop(const std::string& port);
  /// Ends these, and leaves what they record into as it is.
  void give_up(const std::vector<std::uint64_t>& numbers);
  /// Ends the recording into the file; all with an empty name. Returns how many.
  std::size_t stop_recording(const std::string& file);
  /// Asks for all of them anew, of a host that is back.
  void resume();
  /// Forgets all without telling the host, as when it has gone.
  void clear();
  bool empty() const { return running_.empty(); }
  enum class Which { All, Timed };
  /// Until they have ended. Throws fiona::Error (Unreachable) if the host goes meanwhile.
  void wait(Which which);
  std::vector<std::string> ports() const;       ///< those that are printed
  std::vector<std::string> recordings() const;  ///< files

 private:
  struct Running {
    WatchRequest request;
    std::string name;
    std::unique_ptr<TypeSet> types;
    std::unique_ptr<google::protobuf::Message> object;
    std::optional<std::uint64_t> timer;
    std::uint64_t asked = 0;             ///< the host's number of it
    std::optional<std::uint64_t> retry;  ///< the timer, after what it looks at was lost
    std::string lost, told;              ///< why, and what has been said of it
    bool manner_json = false;
    std::uint64_t samples = 0;
    SteadyTime printed{};
  };

  void ask(std::uint64_t number, Running& watch);
  void arrived(std::uint64_t number, const control::Reply& reply);
  bool goes_on(std::uint64_t number, Running& watch, const Error& problem);
  void is_back(Running& watch);
  void stop_timers(Running& watch);
  void read(Running& watch, const control::Sample& sample);
  void print(Running& watch, const control::Sample& sample);
  void record(Running& watch, const control::Sample& sample);
  void flush_recordings();
  void abandon(const Recording& broken);
  void finish(Recording& recording);
  std::string text_of(const Running& watch, const control::Sample& sample) const;
  void check_fields(const Running& watch) const;
  void end(std::uint64_t number, bool tell_host);

  Session& session_;
  std::uint64_t last_ = 0;
  std::map<std::uint64_t, Running> running_;
  std::optional<std::uint64_t> flush_timer_;  ///< while something has come that may not be in its file
  std::optional<std::uint64_t> starting_;     ///< the one that the host has not said yet that it watches
  std::optional<Error> refused_;              ///< and why it does not
};

}  // namespace fiona::console
