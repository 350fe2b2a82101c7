#define BOOST_DLL_USE_STD_FS
#include "plugin_library.hpp"

#include <dlfcn.h>
#include <elf.h>
#include <fmt/format.h>
#include <google/protobuf/descriptor.h>

#include <algorithm>
#include <boost/dll/shared_library.hpp>
#include <cstdint>
#include <cstring>
#include <fstream>
#include <optional>
#include <set>
#include <system_error>
#include <vector>

#include "fiona/describe.hpp"
#include "fiona/error.hpp"
#include "names.hpp"

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

/// The step for what another library's code keeps out of this process.
std::string own_process(const std::string& name, const std::filesystem::path& path) {
  return "load " + (name.starts_with(kTypedByPath) ? path.string() : name) +
         " in GROUP: a group is a process of its own";
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

/// What stands in the namespace of its package.
std::vector<std::string> symbols_of(const google::protobuf::FileDescriptorProto& file) {
  std::vector<std::string> names;
  for (const auto& one : file.message_type()) names.push_back(one.name());
  for (const auto& one : file.service()) names.push_back(one.name());
  for (const auto& one : file.extension()) names.push_back(one.name());
  for (const auto& one : file.enum_type()) {
    names.push_back(one.name());
    for (const auto& value : one.value()) names.push_back(value.name());
  }
  for (std::string& name : names) name = file.package().empty() ? name : file.package() + "." + name;
  return names;
}

/// How long a library is at least, by what of it is loaded; 0: it is no ELF file of this size.
std::uint64_t least_size_of(const std::filesystem::path& path) {
  Elf64_Ehdr head{};
  std::ifstream file(path, std::ios::binary);
  if (!file.read(reinterpret_cast<char*>(&head), sizeof head) || std::memcmp(head.e_ident, ELFMAG, SELFMAG) != 0)
    return 0;
  std::uint64_t least = 0;
  for (int i = 0; i < head.e_phnum; ++i) {
    Elf64_Phdr part{};
    file.seekg(static_cast<std::streamoff>(head.e_phoff + static_cast<std::uint64_t>(i) * sizeof part));
    if (!file.read(reinterpret_cast<char*>(&part), sizeof part)) return std::max(least, head.e_phoff + sizeof part);
    if (part.p_type == PT_LOAD) least = std::max(least, part.p_offset + part.p_filesz);
  }
  return least;
}

/// The loader maps what is not there, and whoever touches it is ended.
void require_whole(const std::string& name, const std::filesystem::path& path) {
  std::error_code ignored;
  const std::uint64_t least = least_size_of(path), size = std::filesystem::file_size(path, ignored);
  if (ignored || size >= least) return;
  refuse(name, path,
         {.what = "its file ends before its code does",
          .expected = fmt::format("{} bytes or more", least),
          .found = fmt::format("{} bytes", size),
          .next = "build it or install it again"});
}

const std::string kThrows = "a static constructor of it throws: ";

/// `dlopen` says that nothing is thrown; but static constructors are called, and throw through it. It is called as if
/// it had not said so. Null: the loader refuses.
void* open_library(const std::filesystem::path& path) {
  void* (*volatile const open)(const char*, int) = &::dlopen;
  return open(path.c_str(), RTLD_NOW | RTLD_LOCAL);
}

/// By this process, under this name: it is not opened again then.
bool is_open(const std::filesystem::path& path) {
  void* const handle = ::dlopen(path.c_str(), RTLD_NOW | RTLD_NOLOAD);
  if (handle) ::dlclose(handle);
  return handle != nullptr;
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
  require_whole(name, file.path());
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
  std::set<std::string> shared;
  for (const auto& file : files) {
    const bool opens = !libraries_.contains(file.path()) && !is_open(file.path());
    for (const auto& proto : file.descriptors().file()) {
      shared.insert(proto.name());
      if (opens) require_new(name, path, proto);
    }
  }
  for (const auto& proto : interface.descriptors().file()) {
    if (is_platform_proto(proto.name())) {
      refuse(name, path,
             {.what = "its proto file '" + proto.name() + "' is one of the platform's",
              .expected = "protos under a path that begins with the publisher's id",
              .next = "ask the publisher to rename the file and its package"});
    }
    if (!shared.contains(proto.name()) && !is_open(path)) require_new(name, path, proto);
  }
}

/// To this process: what another library has registered, be it one that could not be opened to the end, stays, and
/// protobuf ends a process that gets a file or a name again.
void PluginLibraries::require_new(const std::string& name, const std::filesystem::path& path,
                                  const google::protobuf::FileDescriptorProto& proto) const {
  const auto& known = *google::protobuf::DescriptorPool::generated_pool();
  std::string what = "its proto file '" + proto.name() + "'";
  const auto* brought = known.FindFileByName(proto.name());
  for (const std::string& symbol : symbols_of(proto)) {
    if (brought) break;
    brought = known.FindFileContainingSymbol(symbol);
    if (brought) what = fmt::format("'{}' of {}", symbol, what);
  }
  if (!brought) return;
  const auto owner = proto_owners_.find(brought->name());
  const std::string who = is_platform_proto(brought->name()) ? "the platform"
                          : owner == proto_owners_.end()     ? "a library that could not be loaded"
                          : owner->second == name            ? "another version of it"
                                                             : "plugin '" + owner->second + "'";
  refuse(name, path,
         {.what = what + " has already been brought by " + who + ", and protobuf ends a process that gets it twice",
          .next = own_process(name, path)});
}

/// A library finds those that it was opened with, whatever is installed now.
void PluginLibraries::require_needed(const std::string& name, const Files& files) const {
  for (const auto& file : files) {
    if (libraries_.contains(file.path())) continue;
    refuse(
        name, files.rbegin()->path(),
        {.what = "it was opened here with another version of " + file.package() + ", and a library is never unloaded",
         .next = own_process(name, files.rbegin()->path())});
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
        for (const auto& proto : file->descriptors().file()) proto_owners_.emplace(proto.name(), file->package());
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
    require_needed(name, files);
    if (!own.blake2b().empty() || time_of(own.path()) == known->second->written) return *known->second;
    refuse(name, own.path(),
           {.what = "the file has changed since it was loaded, and a library is never unloaded",
            .next = own_process(name, own.path())});
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
