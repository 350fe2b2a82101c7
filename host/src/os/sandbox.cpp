#include "os/sandbox.hpp"

#include <linux/capability.h>
#include <sched.h>
#include <sys/prctl.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <functional>
#include <system_error>

namespace fiona::os {
namespace detail {

std::string enter_own_network() {
  if (::unshare(CLONE_NEWNET) != 0) throw std::system_error(errno, std::generic_category(), "unshare");
  return "no interfaces";
}

std::string drop_privileges() {
  const auto require = [](long result, const char* what) {
    if (result != 0) throw std::system_error(errno, std::generic_category(), what);
  };
  for (int capability = 0; ::prctl(PR_CAPBSET_READ, capability) >= 0; ++capability) {
    ::prctl(PR_CAPBSET_DROP, capability);  // who has none to drop any with has none
  }
  ::prctl(PR_CAP_AMBIENT, PR_CAP_AMBIENT_CLEAR_ALL, 0, 0, 0);
  __user_cap_header_struct header{_LINUX_CAPABILITY_VERSION_3, 0};
  const __user_cap_data_struct none[2]{};
  require(::syscall(SYS_capset, &header, none), "capset");
  require(::prctl(PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0), "no_new_privs");
  require(::prctl(PR_SET_DUMPABLE, 0, 0, 0, 0), "dumpable");
  return "no capabilities, no new ones, not dumpable";
}

}  // namespace detail

std::vector<SandboxLayer> confine(const Reach& reach) {
  std::vector<SandboxLayer> layers;
  const auto put_up = [&layers](const std::string& name, const std::function<std::string()>& layer) {
    try {
      layers.push_back({name, layer(), ""});
    } catch (const std::system_error& error) {
      layers.push_back({name, "", error.what()});
    }
  };
  put_up("mounts", [&] { return detail::enter_namespaces(reach); });
  if (!reach.network) put_up("network", detail::enter_own_network);
  put_up("privileges", detail::drop_privileges);
  put_up("landlock", [&] { return detail::restrict_by_landlock(reach); });
  put_up("seccomp", [&] { return detail::filter_system_calls(reach); });  // last: it forbids what the others do
  return layers;
}

bool is_needed_layer(std::string_view name) { return name == "mounts" || name == "privileges" || name == "seccomp"; }

const SandboxLayer* missing_wall(const std::vector<SandboxLayer>& layers) {
  const auto missing = std::find_if(layers.begin(), layers.end(), [](const SandboxLayer& layer) {
    return is_needed_layer(layer.name) && !layer.missing.empty();
  });
  return missing == layers.end() ? nullptr : &*missing;
}

}  // namespace fiona::os
