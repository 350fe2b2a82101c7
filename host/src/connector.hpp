#pragma once

#include <algorithm>
#include <cstdint>
#include <functional>
#include <string>
#include <vector>

#include "fiona/error.hpp"
#include "groups.hpp"
#include "model.hpp"

namespace fiona::host {

/// Opens and cuts wires, in each process that they go through: between two hosts that lead and are led these are the
/// hosts' own as well. All functions [control thread].
class Connector {
 public:
  /// A wire as it is; the model says what it is meant to be. One to each provider of a port with alternatives.
  struct Wire {
    control::PortName provider{};
    std::uint64_t id = 0;  ///< 0: it waits for its provider
    bool local = false;
    std::string reason{};               ///< why it waits, or was lost
    std::vector<std::string> relays{};  ///< groups that pass it on
    bool failed = false;                ///< its provider has: it waits until that is loaded again

    bool is_open() const { return id != 0 && reason.empty(); }
    /// It did not open.
    void waits_for(const Error& error) {
      reason = error.text().what;
      failed = error.code() == ErrorCode::ComponentFailed;
    }
  };
  struct Surroundings {
    const Model& model;
    Groups& groups;
    /// Of an instance that lives; throws Error Unreachable otherwise.
    std::function<Group&(const std::string& instance, const Model& model)> group_of;
    /// The host that a group is on; empty: this one.
    std::function<std::string(const std::string& group)> host_of;
    /// The host's own process.
    std::function<Group&(const std::string& host)> main_of;
  };
  explicit Connector(Surroundings around) : around_(std::move(around)) {}

  /// Make before break: the client's side lets go of the wire `replaces` once the new one is open; what that costs is
  /// added to `done`. `resumes`: what the one before has missed since it was lost is counted. Throws Error if it does
  /// not open: then all is as before.
  Wire connect(const control::PortName& client, const control::PortName& provider, const Model& model,
               std::uint64_t replaces, control::Done& done, bool resumes = false);
  void disconnect(const control::PortName& client, const Wire& wire, const std::string& reason);
  static void add_cost(control::Done& done, const wire::Switched& switched, std::uint32_t wires);

  /// Of the next wire: a number is used once.
  std::uint64_t new_number() { return next_++; }
  /// Those below are in use, or another's.
  void number_from(std::uint64_t first) { next_ = std::max(next_, first); }

 private:
  wire::GroupMessage open_along(const std::vector<Group*>& path, wire::WireRequire require, std::uint32_t prescale,
                                bool ahead, std::vector<std::string>& relays);
  std::vector<Group*> way(Group& client, Group& provider) const;
  std::string known_as(const Group& who, const Group& at) const;
  Links::Endpoint endpoint_for(const Group& at, const Group& to) const;

  const Surroundings around_;
  std::uint64_t next_ = 1;
};

}  // namespace fiona::host
