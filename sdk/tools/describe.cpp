// fiona-describe LIBRARY [-o FILE]: writes the interface of a plugin, read from its components at the author's build.
#include <dlfcn.h>
#include <google/protobuf/text_format.h>

#include <filesystem>
#include <fstream>
#include <iostream>
#include <string>

#include "fiona/describe.hpp"

namespace {

const fiona::PluginEntry& open_entry(const std::string& library) {
  void* handle = dlopen(std::filesystem::absolute(library).c_str(), RTLD_NOW | RTLD_LOCAL);
  if (!handle) {
    throw fiona::Error(fiona::ErrorCode::Failed, {.what = "the library does not load", .where = library, .found = dlerror()});
  }
  auto* symbol = dlsym(handle, fiona::kPluginEntrySymbol);
  if (!symbol) {
    throw fiona::Error(fiona::ErrorCode::Failed, {.what = "the library is no FIONA plugin",
                                                  .where = library,
                                                  .expected = std::string("the symbol ") + fiona::kPluginEntrySymbol,
                                                  .next = "add FIONA_PLUGIN(plugin) { plugin.add<Class>(\"name\"); }"});
  }
  const auto* entry = reinterpret_cast<const fiona::PluginEntry* (*)()>(symbol)();
  if (std::string_view(entry->abi) != fiona::kAbiTag) {
    throw fiona::Error(fiona::ErrorCode::Failed, {.what = "the plugin was built for another SDK",
                                                  .where = library,
                                                  .expected = fiona::kAbiTag,
                                                  .found = entry->abi,
                                                  .next = "build it again with this SDK"});
  }
  return *entry;
}

int run(const std::string& library, const std::string& out) {
  fiona::Plugin plugin;
  open_entry(library).declare(plugin);
  std::string text;
  google::protobuf::TextFormat::PrintToString(fiona::describe(plugin), &text);
  if (out.empty()) {
    std::cout << text;
    return 0;
  }
  std::ofstream file(out, std::ios::trunc);
  file << text;
  file.close();
  if (file) return 0;
  throw fiona::Error(fiona::ErrorCode::Failed, {.what = "the interface cannot be written", .where = out});
}

}  // namespace

int main(int argc, char** argv) {
  const bool named = argc == 4 && std::string(argv[2]) == "-o";
  if (argc != 2 && !named) {
    std::cerr << "usage: fiona-describe LIBRARY [-o FILE]\n";
    return 2;
  }
  try {
    return run(argv[1], named ? argv[3] : "");
  } catch (const fiona::Error& error) {
    std::cerr << "error: " << error.what() << "\n";
    return static_cast<int>(error.code());
  } catch (const std::exception& error) {
    std::cerr << "error: " << argv[1] << ": " << error.what() << "\n";
    return 1;
  }
}
