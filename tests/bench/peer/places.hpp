// The processes of one run of the harness as places where a host can load: the harness' own holds the host, each
// process that the harness forks becomes a group of it, or a host that it leads.
#pragma once

#include <atomic>
#include <filesystem>
#include <functional>
#include <memory>
#include <mutex>
#include <string>
#include <thread>
#include <vector>

#include "host_links.hpp"
#include "system.hpp"

namespace fiona::peer {

/// Where the run keeps sockets, keys, and what its processes tell each other. Removed by the program's first process.
const std::filesystem::path& run_directory();
/// Of the harness' own process; to be made before it forks.
void make_leader_keys();
/// Descriptors 3 and 4, where a group expects its sockets: to be called before any other is opened.
void reserve_group_descriptors();

/// A system, and the thread that serves what its groups and hosts say.
class ServedSystem {
 public:
  explicit ServedSystem(host::System::Options options);
  ~ServedSystem();

  void load(const std::string& component, const std::string& name, const std::string& group, std::uint32_t index = 0);
  void wire(const std::string& client, const std::string& provider);
  void unwire(const std::string& client);
  /// Waits until the port is connected; throws Error if it does not become so.
  void await_connected(const std::string& port);
  void await_joined(const std::string& host);
  std::string listens() const { return system_.listens(); }

 private:
  void serve();
  void await(const std::string& what, const std::function<bool(const control::System&)>& holds);

  std::mutex mutex_;
  host::System system_;
  std::atomic<bool> ends_{false};
  std::thread thread_;
};

/// This process, forked by the harness, as a group: the one who says `fiona-group` to the host passes its sockets on.
std::unique_ptr<std::thread> become_group();
/// This process, forked by the harness, as a host that the harness' own process leads.
std::unique_ptr<ServedSystem> become_led_host();
/// The host of the harness' own process, with so many places beside `main`; their names are put into `places`.
std::unique_ptr<ServedSystem> make_host(const std::string& transport, std::size_t processes,
                                        std::vector<std::string>& places);

/// The name under which this process is a place.
std::string own_place();

}  // namespace fiona::peer
