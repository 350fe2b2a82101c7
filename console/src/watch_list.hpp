#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "session.hpp"
#include "types.hpp"

namespace fiona::console {

/// What one `watch` line asked for.
struct WatchRequest {
  control::PortName port;
  std::vector<std::string> fields;
  double every_ms = 0;
  unsigned every_nth = 1;
  std::optional<control::Condition> when;  ///< only what makes it true
  std::optional<double> for_ms;
};

/// What the line of a `watch` says. Throws LineError at the word that does not belong.
WatchRequest watch_request(const Line& line);

/// The watches that run in this console: each prints its samples until it is stopped, its time is over, or the host
/// ends it.
class WatchList {
 public:
  explicit WatchList(Session& session) : session_(session) {}
  ~WatchList() { clear(); }

  std::uint64_t start(const WatchRequest& request);
  /// Stops those of the port, "instance.port"; all with an empty name. Returns how many.
  std::size_t stop(const std::string& port);
  /// Forgets all without telling the host, as when it has gone.
  void clear();
  bool empty() const { return running_.empty(); }
  std::vector<std::string> ports() const;

 private:
  struct Running {
    WatchRequest request;
    std::string name;
    std::unique_ptr<TypeSet> types;
    std::unique_ptr<google::protobuf::Message> object;
    std::optional<std::uint64_t> timer;
    bool manner_json = false;
    std::uint64_t samples = 0;
    SteadyTime printed{};
  };

  void arrived(std::uint64_t id, const control::Reply& reply);
  void read(Running& watch, const control::Sample& sample);
  void print(Running& watch, const control::Sample& sample);
  std::string text_of(const Running& watch, const control::Sample& sample) const;
  void check_fields(const Running& watch) const;
  void end(std::uint64_t id, bool tell_host);

  Session& session_;
  std::map<std::uint64_t, Running> running_;
};

}  // namespace fiona::console
