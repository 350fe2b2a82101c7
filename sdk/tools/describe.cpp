// fiona-describe LIBRARY [-o FILE]: writes the interface of a plugin, read from its components at the author's build.
#include <dlfcn.h>
#include <google/protobuf/text_format.h>

#include <boost/program_options.hpp>
#include <filesystem>
#include <fstream>
#include <iostream>
#include <string>

#include "fiona/describe.hpp"

namespace {

namespace options = boost::program_options;

const fiona::PluginEntry& open_entry(const std::string& library) {
  void* handle = dlopen(std::filesystem::absolute(library).c_str(), RTLD_NOW | RTLD_LOCAL);
  if (!handle) {
    throw fiona::Error(fiona::ErrorCode::Failed,
                       {.what = "the library does not load", .where = library, .found = dlerror()});
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

void describe(const std::string& library, const std::string& out) {
  fiona::Plugin plugin;
  open_entry(library).declare(plugin);
  std::string text;
  google::protobuf::TextFormat::PrintToString(fiona::describe(plugin), &text);
  if (out.empty()) {
    std::cout << text;
    return;
  }
  std::ofstream file(out, std::ios::trunc);
  file << text;
  file.close();
  if (!file) throw fiona::Error(fiona::ErrorCode::Failed, {.what = "the interface cannot be written", .where = out});
}

void run(int argc, char** argv) {
  std::string library, out;
  options::options_description shown("usage: fiona-describe LIBRARY [-o FILE]");
  shown.add_options()("output,o", options::value(&out), "the interface; without it, to standard output")(
      "help,h", "this text")("version", "the version of this program");
  options::options_description all;
  all.add(shown).add_options()("library", options::value(&library)->required());
  options::positional_options_description places;
  places.add("library", 1);
  options::variables_map given;
  options::store(options::command_line_parser(argc, argv).options(all).positional(places).run(), given);
  if (given.count("help")) {
    std::cout << shown;
  } else if (given.count("version")) {
    std::cout << "fiona-describe " FIONA_VERSION "\n";
  } else {
    options::notify(given);
    describe(library, out);
  }
}

}  // namespace

int main(int argc, char** argv) {
  try {
    run(argc, argv);
    return 0;
  } catch (const fiona::Error& error) {
    std::cerr << "error: " << error.what() << "\n";
    return static_cast<int>(error.code());
  } catch (const options::error& error) {
    std::cerr << "error: " << error.what() << "\n  next: fiona-describe --help\n";
    return static_cast<int>(fiona::ErrorCode::Usage);
  } catch (const std::exception& error) {
    std::cerr << "error: " << error.what() << "\n";
    return static_cast<int>(fiona::ErrorCode::Failed);
  }
}
