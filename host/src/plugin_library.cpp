#define BOOST_DLL_USE_STD_FS
#include "plugin_library.hpp"

#include <dlfcn.h>

#include <algorithm>
#include <boost/dll/shared_library.hpp>
#include <optional>
#include <system_error>
#include <vector>

#include "fiona/describe.hpp"
#include "fiona/error.hpp"

namespace fiona::host {

struct PluginLibraries::Library {
  std::optional<SealedLibrary> sealed;  ///< as long as the library, whose name is its descriptor's
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

std::filesystem::file_time_type time_of(const std::filesystem::path& path) {
  std::error_code ignored;
  return std::filesystem::last_write_time(path, ignored);
}

/// The loader's words, with the name that a person knows.
std::string loader_words(const std::string& opened, const std::string& path) {
  const char* words = ::dlerror();
  std::string text = words ? words : "it gives no reason";
  if (const auto at = text.find(opened); at != std::string::npos) text.replace(at, opened.size(), path);
  return text;
}

}  // namespace

std::unique_ptr<PluginLibraries::Library> PluginLibraries::load(const std::string& name,
                                                                const wire::LibraryFile& file) const {
  if (!std::filesystem::exists(file.path())) {
    refuse(name, file.path(), {.what = "its library is missing", .next = "market install " + name});
  }
  auto library = std::make_unique<Library>();
  library->owner = name;
  library->written = time_of(file.path());
  if (!file.blake2b().empty() && !private_files_) library->sealed.emplace(file);
  const std::string path = library->sealed ? library->sealed->loader_path() : file.path();
  std::error_code error;
  ::dlerror();
  try {
    if (open_library(path)) {
      library->handle.load(path, error, boost::dll::load_mode::rtld_now | boost::dll::load_mode::rtld_local);
      if (!error) return library;
    }
  } catch (...) {
    const std::string reason = fiona::detail::reason_of_exception();
    keep(std::move(library));  // what has begun to run stays, under this name
    refuse(name, file.path(), {.what = kThrows + reason, .next = "tell the publisher"});
  }
  // Boost.DLL has only "bad file descriptor" to say; the loader itself names the symbol or file.
  refuse(name, file.path(),
         {.what = "the system's loader refuses it",
          .found = loader_words(path, file.path()),
          .next = "ask the publisher for a build for this system, or install what is missing"});
}

std::string PluginLibraries::tried(const Files& files) {
  try {
    open_needed("", files);
    keep(load("", *files.rbegin()));
  } catch (const Error& error) {
    // Why it cannot be opened is asked when it is; only what its own code throws counts here.
    const std::size_t thrown = error.text().what.find(kThrows);
    if (thrown != std::string::npos) return "+" + error.text().what.substr(thrown);
  }
  return "+";
}

PluginLibraries::PluginLibraries(bool private_files) : private_files_(private_files) {}

PluginLibraries::~PluginLibraries() {
  for (auto& [path, library] : libraries_) keep(std::move(library));
}

/// Handed over to the process: closing would run destructors under protobuf's registered descriptors.
void PluginLibraries::keep(std::unique_ptr<Library> library) {
  static auto& of_process = *new std::vector<std::unique_ptr<Library>>;
  of_process.push_back(std::move(library));
}

void PluginLibraries::check_before_opening(const std::string& name, const Files& files,
                                           const Interface& interface) const {
  const std::string& path = files.rbegin()->path();
  if (interface.abi() != kAbiTag) {
    refuse(name, path,
           {.what = "it was built for another SDK or compiler",
            .expected = kAbiTag,
            .found = interface.abi().empty() ? "no ABI tag" : interface.abi(),
            .next = "install a build of it for this version of FIONA"});
  }
  const auto is_shared = [&files](const std::string& proto) {
    return std::any_of(files.begin(), files.end(), [&proto](const wire::LibraryFile& file) {
      return std::find(file.protos().begin(), file.protos().end(), proto) != file.protos().end();
    });
  };
  for (const auto& file : interface.descriptors().file()) {
    const auto owner = proto_owners_.find(file.name());
    if (owner != proto_owners_.end() && owner->second != name && !is_shared(file.name())) {
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

/// Which of them needs which, only the loader knows: each is tried until all are open, or none goes on.
void PluginLibraries::open_needed(const std::string& name, const Files& files) {
  std::vector<const wire::LibraryFile*> waiting;
  for (const auto& file : files) {
    if (&file != &*files.rbegin() && !libraries_.contains(file.path())) waiting.push_back(&file);
  }
  while (!waiting.empty()) {
    const std::size_t before = waiting.size();
    std::optional<Error> why;
    std::erase_if(waiting, [&](const wire::LibraryFile* file) {
      try {
        libraries_.emplace(file->path(), load(name, *file));
        for (const auto& proto : file->protos()) proto_owners_.emplace(proto, file->package());
        return true;
      } catch (const Error& error) {
        if (error.code() != ErrorCode::Failed) throw;
        why.emplace(error);
        return false;
      }
    });
    if (waiting.size() == before) throw Error(*why);
  }
}

PluginLibraries::Library& PluginLibraries::opened(const std::string& name, const Files& files,
                                                  const Interface& interface) {
  const wire::LibraryFile& own = *files.rbegin();
  if (const auto known = libraries_.find(own.path()); known != libraries_.end()) {
    // What was installed has its hash in its path, and was compared with it.
    if (!own.blake2b().empty() || time_of(own.path()) == known->second->written) return *known->second;
    refuse(name, own.path(),
           {.what = "the file has changed since it was loaded, and a library is never unloaded",
            .next = "load " + name + " in GROUP: a group is a process of its own"});
  }
  check_before_opening(name, files, interface);
  open_needed(name, files);
  auto library = load(name, own);
  for (const auto& file : interface.descriptors().file()) proto_owners_.emplace(file.name(), name);
  return *libraries_.emplace(own.path(), std::move(library)).first->second;
}

const Plugin& PluginLibraries::open(const std::string& name, const Files& files, const Interface& interface) {
  const std::string& path = files.rbegin()->path();
  Library& library = opened(name, files, interface);
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
