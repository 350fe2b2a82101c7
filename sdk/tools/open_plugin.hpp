#pragma once

#include <dlfcn.h>

#include <filesystem>
#include <string>

#include "fiona/error.hpp"
#include "fiona/plugin.hpp"

namespace fiona::tools {

/// Opens a library as its author has built it, in this process, which is for nothing else; it stays open. Throws Error.
inline Plugin open_plugin(const std::string& library) {
  void* handle = dlopen(std::filesystem::absolute(library).c_str(), RTLD_NOW | RTLD_LOCAL);
  if (!handle) {
    throw Error(ErrorCode::Failed, {.what = "the library does not load", .where = library, .found = dlerror()});
  }
  auto* symbol = dlsym(handle, kPluginEntrySymbol);
  if (!symbol) {
    throw Error(ErrorCode::Failed, {.what = "the library is no FIONA plugin",
                                    .where = library,
                                    .expected = std::string("the symbol ") + kPluginEntrySymbol,
                                    .next = "add FIONA_PLUGIN(plugin) { plugin.add<Class>(\"name\"); }"});
  }
  const auto* entry = reinterpret_cast<const PluginEntry* (*)()>(symbol)();
  if (std::string_view(entry->abi) != kAbiTag) {
    throw Error(ErrorCode::Failed, {.what = "the plugin was built for another SDK",
                                    .where = library,
                                    .expected = kAbiTag,
                                    .found = entry->abi,
                                    .next = "build it again with this SDK"});
  }
  Plugin plugin;
  entry->declare(plugin);
  return plugin;
}

}  // namespace fiona::tools
