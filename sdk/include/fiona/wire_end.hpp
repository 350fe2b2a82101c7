#pragma once

#include <atomic>
#include <cstddef>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "fiona/inbox.hpp"
#include "fiona/sink.hpp"

namespace fiona {

class RequiredPort;

/// A client port's place in its life (patterns.md, rules shared by all).
enum class Connection { Unwired, Waiting, Connected, Lost };
std::string_view to_string(Connection connection);

/// The client's end of a wire: what its provider says, and how the wire is, reach the port through here. Of a port with
/// alternatives only the end that serves lets messages through. All functions [any thread].
class WireEnd final : public std::enable_shared_from_this<WireEnd> {
 public:
  WireEnd(RequiredPort& port, std::string provider) : port_(port), provider_(std::move(provider)) {}

  RequiredPort& port() const { return port_; }
  /// "instance.port"; empty: the port has not been wired.
  const std::string& provider() const { return provider_; }

  /// Of a push: into the port's inbox, if this end serves.
  Outcome push(Parcel parcel);
  /// As that of the inbox.
  void push_all(std::vector<Parcel>& parcels);
  /// As that of the inbox; while this end does not serve, whatever is asked for.
  std::optional<std::size_t> room(std::size_t cost, std::weak_ptr<const void> who, Inbox::OnRoom then);
  /// Where the messages of a send, query or event client go while this end serves; null: nowhere.
  void set_target(std::shared_ptr<Sink> target);
  /// Called by the host's wiring. What that means to waits and calls: patterns.md's table.
  void set_connection(Connection connection, std::string reason);
  /// How often the provider of a push timed produces.
  void set_cycle(Duration cycle);
  /// The provider of a connected wire is silent, or speaks again.
  void set_lease(bool held, const std::string& reason);
  /// Of an end that is to take the place of a port's only one: the port's.
  Connection connection() const;

 private:
  friend class RequiredPort;
  // guarded by the port's mutex
  bool is_live() const { return connection_ == Connection::Connected && !silence_; }
  bool is_fit() const { return is_live() && flaw_.empty(); }
  std::string unfitness() const;

  RequiredPort& port_;
  const std::string provider_;
  std::atomic<bool> open_{false};  ///< it is the port's only one: nothing has to be asked
  Connection connection_ = Connection::Unwired;
  std::string reason_ = "not wired";
  std::optional<std::string> silence_;  ///< why, of a provider that is silent
  std::string_view flaw_{};             ///< of its last object; empty: none
  bool heard_ = false;                  ///< it has said something since it was connected
  TimePoint fit_since_{};               ///< and heard
  std::shared_ptr<Sink> target_;
  std::optional<Envelope> last_;  ///< of a service that has a last value
  Duration cycle_{};              ///< of a push timed
};

}  // namespace fiona
