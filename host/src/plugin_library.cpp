#define BOOST_DLL_USE_STD_FS
#include "plugin_library.hpp"

#include <dlfcn.h>

#include <boost/dll/shared_library.hpp>
#include <optional>
#include <system_error>
#include <vector>

#include "fiona/describe.hpp"
#include "fiona/error.hpp"

namespace fiona::host {

struct PluginLibraries::Library {
  boost::dll::shared_library handle;
  std::optional<Plugin> plugin;  ///< none while its entry has not been accepted
  std::string owner;
  std::filesystem::file_time_type written;
};

namespace {

[[noreturn]] void refuse(const std::string& name, const std::filesystem::path& path, ErrorText text) {
  text.what = "plugin '" + name + "' cannot be loaded: " + text.what;
  text.where = path.string();
  throw Error(ErrorCode::Failed, std::move(text));
}

const std::string kThrows = "a static constructor of it throws: ";

/// `dlopen` says that nothing is thrown; but static constructors are called, and throw through it. It is called as if
/// it had not said so. Null: the loader refuses.
void* open_library(const std::filesystem::path& path) {
  void* (*volatile const open)(const char*, int) = &::dlopen;
  return open(path.c_str(), RTLD_NOW | RTLD_LOCAL);
}

boost::dll::shared_library load(const std::string& name, const std::filesystem::path& path) {
  if (!std::filesystem::exists(path)) {
    refuse(name, path, {.what = "its library is missing", .next = "market install " + name});
  }
  std::error_code error;
  boost::dll::shared_library library;
  ::dlerror();
  try {
    if (open_library(path)) {
      library.load(path, error, boost::dll::load_mode::rtld_now | boost::dll::load_mode::rtld_local);
    } else {
      error = std::make_error_code(std::errc::executable_format_error);
    }
  } catch (...) {
    refuse(name, path, {.what = kThrows + fiona::detail::reason_of_exception(), .next = "tell the publisher"});
  }
  if (!error) return library;
  // Boost.DLL has only "bad file descriptor" to say; the loader itself names the symbol or file.
  const char* loader = ::dlerror();
  refuse(name, path,
         {.what = "the system's loader refuses it",
          .found = loader ? loader : error.message(),
          .next = "ask the publisher for a build for this system, or install what is missing"});
}

}  // namespace

std::string PluginLibraries::tried(const std::filesystem::path& path) {
  try {
    open_library(path);  // why it cannot be, is asked when it is opened
  } catch (...) {
    return "+" + kThrows + fiona::detail::reason_of_exception();
  }
  return "+";
}

PluginLibraries::PluginLibraries() = default;

PluginLibraries::~PluginLibraries() {
  // Handed over to the process: closing would run destructors under protobuf's registered descriptors.
  static auto& of_process = *new std::vector<std::unique_ptr<Library>>;
  for (auto& [path, library] : libraries_) of_process.push_back(std::move(library));
}

void PluginLibraries::check_before_opening(const std::string& name, const std::filesystem::path& path,
                                           const Interface& interface) const {
  if (interface.abi() != kAbiTag) {
    refuse(name, path,
           {.what = "it was built for another SDK or compiler",
            .expected = kAbiTag,
            .found = interface.abi().empty() ? "no ABI tag" : interface.abi(),
            .next = "install a build of it for this version of FIONA"});
  }
  for (const auto& file : interface.descriptors().file()) {
    const auto owner = proto_owners_.find(file.name());
    if (owner != proto_owners_.end() && owner->second != name) {
      refuse(name, path,
             {.what = "its proto file '" + file.name() + "' has already been brought by plugin '" + owner->second +
                      "', and protobuf ends a process that gets it twice",
              .next = "load " + name + " in GROUP: a group is a process of its own"});
    }
    if (is_platform_proto(file.name())) {
      refuse(name, path,
             {.what = "its proto file '" + file.name() + "' is one of the platform's",
              .expected = "protos under a path that begins with the publisher's id",
              .next = "ask the publisher to rename the file and its package"});
    }
  }
}

PluginLibraries::Library& PluginLibraries::opened(const std::string& name, const std::filesystem::path& path,
                                                  const Interface& interface) {
  if (const auto known = libraries_.find(path); known != libraries_.end()) {
    std::error_code ignored;
    if (std::filesystem::last_write_time(path, ignored) == known->second->written) return *known->second;
    refuse(name, path,
           {.what = "the file has changed since it was loaded, and a library is never unloaded",
            .next = "load " + name + " in GROUP: a group is a process of its own"});
  }
  check_before_opening(name, path, interface);
  auto library = std::make_unique<Library>();
  library->owner = name;
  library->written =
      std::filesystem::exists(path) ? std::filesystem::last_write_time(path) : std::filesystem::file_time_type{};
  library->handle = load(name, path);
  for (const auto& file : interface.descriptors().file()) proto_owners_.emplace(file.name(), name);
  return *libraries_.emplace(path, std::move(library)).first->second;
}

const Plugin& PluginLibraries::open(const std::string& name, const std::filesystem::path& path,
                                    const Interface& interface) {
  Library& library = opened(name, path, interface);
  if (library.plugin) return *library.plugin;
  if (!library.handle.has(kPluginEntrySymbol)) {
    refuse(name, path,
           {.what = "it has no entry",
            .expected = std::string("the symbol ") + kPluginEntrySymbol,
            .next = "FIONA_PLUGIN(plugin) { plugin.add<Class>(\"name\"); } defines it"});
  }
  const PluginEntry* const found = library.handle.get<const PluginEntry*()>(kPluginEntrySymbol)();
  if (!found) refuse(name, path, {.what = "its entry is null", .next = "tell the publisher"});
  const PluginEntry& entry = *found;
  if (entry.size < sizeof(PluginEntry) || entry.edge_version != kPluginEdgeVersion ||
      std::string_view(entry.abi) != kAbiTag) {
    refuse(name, path,
           {.what = "the library is not the one that its interface describes",
            .expected = kAbiTag,
            .found = entry.abi,
            .next = "install the package again"});
  }
  if (!entry.declare) {
    refuse(name, path, {.what = "its entry has no function that names its components", .next = "tell the publisher"});
  }
  Plugin plugin;
  entry.declare(plugin);
  return library.plugin.emplace(std::move(plugin));
}

}  // namespace fiona::host
