#define BOOST_DLL_USE_STD_FS
#include "plugin_library.hpp"

#include <dlfcn.h>
#include <elf.h>

#include <algorithm>
#include <boost/dll/shared_library.hpp>
#include <cstdint>
#include <cstring>
#include <fstream>
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

#if defined(__x86_64__)
constexpr std::uint16_t kOurMachine = EM_X86_64;
#elif defined(__aarch64__)
constexpr std::uint16_t kOurMachine = EM_AARCH64;
#endif

/// What the code of a library runs on (ELF, e_machine); 0: it is no ELF file of this size.
std::uint16_t machine_of(const std::filesystem::path& path) {
  Elf64_Ehdr head{};
  std::ifstream file(path, std::ios::binary);
  if (!file.read(reinterpret_cast<char*>(&head), sizeof head)) return 0;
  return std::memcmp(head.e_ident, ELFMAG, SELFMAG) == 0 ? head.e_machine : 0;
}

std::string machine_name(std::uint16_t machine) {
  switch (machine) {
    case EM_X86_64: return "x86-64";
    case EM_AARCH64: return "arm64";
    case EM_386: return "x86, 32 bits";
    case EM_ARM: return "arm, 32 bits";
    case EM_RISCV: return "RISC-V";
    default: return "machine " + std::to_string(machine);
  }
}

void require_machine(const std::string& name, const std::filesystem::path& path) {
  const std::uint16_t its = machine_of(path);
  if (its == 0 || its == kOurMachine) return;  // what is no library the loader has words for
  refuse(name, path,
         {.what = "it was built for another machine",
          .expected = machine_name(kOurMachine),
          .found = machine_name(its),
          .next = "install a build of it for this machine"});
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
  require_machine(name, file.path());
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
  for (const auto& file : files) {
    for (const auto& proto : file.protos()) require_not_brought(name, files, proto);
  }
  for (const auto& file : interface.descriptors().file()) {
    require_not_brought(name, files, file.name());
    if (is_platform_proto(file.name())) {
      refuse(name, path,
             {.what = "its proto file '" + file.name() + "' is one of the platform's",
              .expected = "protos under a path that begins with the publisher's id",
              .next = "ask the publisher to rename the file and its package"});
    }
  }
}

/// By a library that is none of these: another plugin's, or of another version of what these belong to.
void PluginLibraries::require_not_brought(const std::string& name, const Files& files, const std::string& proto) const {
  const auto owner = proto_owners_.find(proto);
  if (owner == proto_owners_.end()) return;
  const auto is_its = [&](const wire::LibraryFile& file) { return file.path() == owner->second.library; };
  if (std::any_of(files.begin(), files.end(), is_its)) return;
  const std::string who =
      owner->second.plugin == name ? "another version of it" : "plugin '" + owner->second.plugin + "'";
  refuse(name, files.rbegin()->path(),
         {.what = "its proto file '" + proto + "' has already been brought by " + who +
                  ", and protobuf ends a process that gets it twice",
          .next = "load " + name + " in GROUP: a group is a process of its own"});
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
        for (const auto& proto : file->protos()) proto_owners_.emplace(proto, Owner{file->package(), file->path()});
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
  for (const auto& file : interface.descriptors().file()) proto_owners_.emplace(file.name(), Owner{name, own.path()});
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
