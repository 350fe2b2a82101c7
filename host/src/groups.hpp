#pragma once

#include <map>
#include <memory>
#include <string>
#include <vector>

#include "group.hpp"
#include "remote_group.hpp"

namespace fiona::host {

/// The processes of a system by their names: `main`, its children, and those of the hosts that it leads. One whose
/// process has ended keeps its place until it is retired or another one takes it. All functions [control thread].
class Groups {
 public:
  using ByName = std::map<std::string, std::unique_ptr<Group>>;

  /// Null: there is none of that name.
  Group* find(const std::string& name) const;
  /// Null as well where it has ended, or its host is silent.
  Group* living(const std::string& name) const;
  /// Null unless it is a child of this process.
  ChildGroup* child(const std::string& name) const;
  MainGroup& main() const;
  const ByName& all() const { return groups_; }
  /// Those on another host.
  std::vector<RemoteGroup*> of_host(const std::string& host) const;
  /// Null unless its host is silent and may come back.
  RemoteGroup* silent(const std::string& name) const;

  /// In the place of the one of its name.
  Group& put(std::unique_ptr<Group> group);
  /// From here on there is none of that name. It ends with `end_retired`: whoever polls may hold it still.
  void retire(const std::string& name);
  void end_retired() { retired_.clear(); }
  void end_all();

  /// Ends a wire in one group. One that is on a silent host does it when that is back.
  void cut(const std::string& name, std::uint64_t wire, const std::string& reason);
  /// What they have on their way to another process is lost. Nobody waits for that.
  void tell_lost(const wire::PeerLost& lost);
  /// The same, of the one of them that listened there.
  void tell_ended(const std::string& endpoint, const std::string& reason);

 private:
  ByName groups_;
  std::vector<std::unique_ptr<Group>> retired_;
};

}  // namespace fiona::host
