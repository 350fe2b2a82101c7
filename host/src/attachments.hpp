#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <map>
#include <string>

#include "fiona/control.pb.h"
#include "groups.hpp"
#include "model.hpp"

namespace fiona::host {

/// Wires whose client is a process that no host has started (docs/wire-protocol.md): which connection holds them, and
/// in which group they end. All functions [control thread].
class Attachments {
 public:
  using OnEvent = std::function<void(const wire::GroupMessage&)>;

  /// `on_event` is given a WireLost for each wire that ends before its owner lets go of it; `end` is to follow.
  Attachments(Groups& groups, OnEvent on_event) : groups_(groups), on_event_(std::move(on_event)) {}

  /// Throws Error NotAllowed where the owner, a connection, holds as many as it may.
  void require_room(std::uint64_t owner) const;
  /// The client's end of a new wire of this number, to a provider in this group. Throws Error if the group refuses.
  control::Attached open(std::uint64_t owner, const control::Attach& request, const ServiceContract& contract,
                         Group& group, std::uint64_t wire);
  /// Throws Error NotFound where the owner holds no such wire.
  void detach(std::uint64_t owner, std::uint64_t wire);
  /// The owner has gone.
  void detach_all(std::uint64_t owner);
  /// Forgets a wire, if it is one of these: it has ended in its group. With its last wire a client's links end.
  void end(std::uint64_t wire);
  /// The group has gone.
  void lose(const std::string& group, const std::string& reason);
  /// Another version of the instance serves: whoever is outside asks for a wire to that one.
  void lose_to(const std::string& instance);

  /// Clients that have links to this host's processes.
  std::size_t clients() const;
  /// Those of a port, which is of this instance.
  void add_clients(const std::string& instance, control::PortStatus& port) const;

 private:
  struct Attachment {
    std::uint64_t owner = 0;
    std::string peer;  ///< the client's name towards the provider's process
    control::PortName provider;
    std::string group;  ///< the provider's
    control::AttachedClient client;
  };

  void tell_lost(std::uint64_t wire, const std::string& reason) const;

  Groups& groups_;
  const OnEvent on_event_;
  std::map<std::uint64_t, Attachment> attachments_;  ///< by wire
};

/// What the provider that is asked for promises. Throws Error where there is no such port, or the client was written
/// for another service.
ServiceContract contract_for(const control::Attach& request, const Model& model);

}  // namespace fiona::host
