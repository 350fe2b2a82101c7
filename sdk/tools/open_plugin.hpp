#pragma once

#include <dlfcn.h>

#include <filesystem>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "fiona/describe.hpp"
#include "fiona/error.hpp"
#include "fiona/messages.hpp"
#include "fiona/plugin.hpp"

namespace fiona::tools {

/// Opens a library as its author has built it, in this process, which is for nothing else; it stays open. Throws Error.
inline void* open_library(const std::string& library) {
  if (void* handle = dlopen(std::filesystem::absolute(library).c_str(), RTLD_NOW | RTLD_LOCAL)) return handle;
  throw Error(ErrorCode::Failed, {.what = "the library does not load",
                                  .where = library,
                                  .found = dlerror(),
                                  .next = "link it with what the loader misses, or install that"});
}

inline void require_abi(const std::string& library, const std::string& found) {
  if (found == kAbiTag) return;
  throw Error(ErrorCode::Failed, {.what = "the library was built for another SDK",
                                  .where = library,
                                  .expected = kAbiTag,
                                  .found = found,
                                  .next = "build it again with this SDK"});
}

/// The proto files that a message library brings; none where it is something else.
inline std::set<std::string> proto_files_of(void* handle, const std::string& library) {
  std::set<std::string> files;
  if (auto* symbol = dlsym(handle, kMessagesEntrySymbol)) {
    const auto* entry = reinterpret_cast<const MessagesEntry* (*)()>(symbol)();
    require_abi(library, entry->abi);
    for (const char* const* file = entry->proto_files; *file; ++file) files.insert(*file);
  }
  return files;
}

/// Opens what a library needs beside it, which only the loader knows the order of: each is tried until all are open, or
/// none goes on. Gives the proto files that they bring.
inline std::set<std::string> open_brought(std::vector<std::string> libraries) {
  std::set<std::string> shared;
  while (!libraries.empty()) {
    const std::size_t before = libraries.size();
    std::optional<Error> why;
    std::erase_if(libraries, [&](const std::string& library) {
      try {
        shared.merge(proto_files_of(open_library(library), library));
        return true;
      } catch (const Error& error) {
        why.emplace(error);
        return false;
      }
    });
    if (libraries.size() == before) throw Error(*why);
  }
  return shared;
}

inline Plugin plugin_of(void* handle, const std::string& library) {
  auto* symbol = dlsym(handle, kPluginEntrySymbol);
  if (!symbol) {
    throw Error(ErrorCode::Failed, {.what = "the library is no FIONA plugin",
                                    .where = library,
                                    .expected = std::string("the symbol ") + kPluginEntrySymbol,
                                    .next = "add FIONA_PLUGIN(plugin) { plugin.add<Class>(\"name\"); }"});
  }
  const auto* entry = reinterpret_cast<const PluginEntry* (*)()>(symbol)();
  require_abi(library, entry->abi);
  Plugin plugin;
  entry->declare(plugin);
  return plugin;
}

/// A plugin, after the libraries that it needs beside it.
inline Plugin open_plugin(const std::string& library, const std::vector<std::string>& brought) {
  open_brought(brought);
  return plugin_of(open_library(library), library);
}

/// What a library declares, a plugin or one of messages. A plugin is known by its entry alone: what it needs beside it
/// is found in it too.
inline Interface interface_of_library(const std::string& library, const std::vector<std::string>& brought) {
  const std::set<std::string> shared = open_brought(brought);
  void* handle = open_library(library);
  const bool is_plugin = dlsym(handle, kPluginEntrySymbol) != nullptr;
  const std::set<std::string> messages = is_plugin ? std::set<std::string>{} : proto_files_of(handle, library);
  return messages.empty() ? describe(plugin_of(handle, library), shared) : describe_messages(messages, shared);
}

}  // namespace fiona::tools
