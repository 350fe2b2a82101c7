#include "author/plugin_files.hpp"

#include <algorithm>
#include <fstream>
#include <iterator>
#include <optional>

#include <stdlib.h>

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <fiona/error.hpp>
#include <fiona/marketplace/compiled_protos.hpp>
#include <fiona/marketplace/manifest.hpp>
#include <fiona/marketplace/package.hpp>

#include "author/child_program.hpp"
#include "author/elf_library.hpp"
#include "locations.hpp"

namespace fiona::console {
namespace {

namespace fs = std::filesystem;

constexpr std::chrono::seconds kDescribing{10};
constexpr std::size_t kMostWords = 20;  // lines of a child that are told
constexpr std::uintmax_t kLargestText = std::uintmax_t{512} << 20;

/// Writes what is read below a directory. The paths have been checked when this is called.
class UnpackingSink final : public marketplace::PackageSink {
 public:
  explicit UnpackingSink(fs::path into) : into_(std::move(into)) {}
  void begin(const PackageFile& file) override {
    const fs::path path = into_ / file.path();
    fs::create_directories(path.parent_path());
    out_.open(path, std::ios::binary | std::ios::trunc);
  }
  void write(std::string_view bytes) override { out_.write(bytes.data(), static_cast<std::streamsize>(bytes.size())); }
  void end() override {
    out_.close();
    if (!out_)
      throw Error(ErrorCode::Failed, {.what = "the package cannot be unpacked",
                                      .where = into_.string(),
                                      .next = "make room on the disk: df -h " + into_.string()});
  }

 private:
  fs::path into_;
  std::ofstream out_;
};

}  // namespace

ScratchDirectory::ScratchDirectory() {
  std::string name = (fs::temp_directory_path() / "fiona-plugin-XXXXXX").string();
  if (::mkdtemp(name.data()) == nullptr)
    throw Error(ErrorCode::Failed, {.what = "no temporary directory can be made", .where = name, .next = "doctor"});
  path_ = name;
}

ScratchDirectory::~ScratchDirectory() {
  std::error_code ignored;
  fs::remove_all(path_, ignored);
}

std::string file_text(const fs::path& file) {
  std::error_code problem;
  const auto size = fs::file_size(file, problem);
  if (problem || !fs::is_regular_file(file, problem))
    throw Error(ErrorCode::NotFound, {.what = "there is no such file",
                                      .where = file.string(),
                                      .next = "write it; plugin new writes one of each that a plugin needs"});
  if (size > kLargestText)
    throw Error(ErrorCode::Failed, {.what = fmt::format("the file has {} bytes", size),
                                    .where = file.string(),
                                    .expected = fmt::format("at most {}", kLargestText)});
  std::ifstream in(file, std::ios::binary);
  std::string text{std::istreambuf_iterator<char>(in), std::istreambuf_iterator<char>()};
  if (!in)
    throw Error(ErrorCode::Failed, {.what = "the file cannot be read",
                                    .where = file.string(),
                                    .next = "see what it allows: ls -l " + file.string()});
  return text;
}

PluginFiles files_of_folder(const fs::path& folder) {
  std::error_code problem;
  PluginFiles files;
  files.manifest = folder / marketplace::kManifestFile;
  if (!fs::is_regular_file(files.manifest, problem))
    throw Error(ErrorCode::NotFound, {.what = "there is no plugin in this folder",
                                      .where = folder.string(),
                                      .expected = std::string(marketplace::kManifestFile),
                                      .next = "plugin new NAME makes one; else name its folder"});
  files.readme = folder / marketplace::kReadmeFile;
  for (const auto& entry : fs::directory_iterator(folder, problem)) {
    if (entry.path().extension() == ".fiona") files.system = entry.path();
  }
  if (fs::is_directory(folder / "share", problem)) files.share = folder / "share";
  if (fs::is_directory(folder / "proto", problem)) files.protos = folder / "proto";
  for (const auto& entry : fs::directory_iterator(folder / "build", problem)) {
    const std::string file = entry.path().filename().string();
    if (!file.ends_with(".interface.textproto")) continue;
    files.interface = entry.path();
    const std::string name = file.substr(0, file.find(".interface.textproto"));
    files.library = folder / "build" / fmt::format("lib{}.so", name);
    if (fs::is_directory(folder / "build" / (name + ".share"), problem))
      files.share = folder / "build" / (name + ".share");
  }
  return files;
}

PluginFiles files_of_library(const fs::path& library) {
  std::error_code problem;
  if (!fs::is_regular_file(library, problem))
    throw Error(ErrorCode::NotFound, {.what = "there is no such library",
                                      .where = library.string(),
                                      .next = "build it first; LIBRARY is the .so that the build leaves"});
  PluginFiles files;
  files.library = library;
  std::string name = library.stem().string();
  if (name.starts_with("lib")) name.erase(0, 3);
  files.interface = library.parent_path() / (name + ".interface.textproto");
  return files;
}

PluginFiles files_of_package(const fs::path& package, const fs::path& into) {
  std::ifstream in(package, std::ios::binary);
  if (!in)
    throw Error(ErrorCode::NotFound,
                {.what = "there is no such package", .where = package.string(), .next = "make it: plugin pack FOLDER"});
  UnpackingSink sink(into);
  const auto source = [&in](char* buffer, std::size_t size) {
    in.read(buffer, static_cast<std::streamsize>(size));
    return static_cast<std::size_t>(in.gcount());
  };
  const auto contents = marketplace::read_package(source, package.string(), sink);
  PluginFiles files;
  files.packed = true;
  files.manifest = into / marketplace::kManifestFile;
  files.readme = into / marketplace::kReadmeFile;
  files.interface = into / marketplace::kInterfaceFile;
  const std::string& own = contents.manifest.library();
  if (!own.empty()) files.library = into / own;
  if (contents.manifest.kind() == fiona::SYSTEM) files.system = into / marketplace::system_file(contents.manifest);
  for (const auto& file : contents.manifest.files()) {
    if (file.path().starts_with("lib/") && file.path() != own) files.brought.push_back(into / file.path());
  }
  return files;
}

void find_messages(PluginFiles& files, const marketplace::Store& store) {
  if (files.library.empty() || !fs::exists(files.library)) return;
  const auto installed = store.installed();
  const auto add = [&](const marketplace::InstalledPackage& package) {
    const auto same = [&package](const auto& known) { return known.name() == package.name(); };
    if (std::any_of(files.messages.begin(), files.messages.end(), same)) return;
    store.verify(package);
    files.messages.push_back(package);
    files.brought.push_back(package.library);
  };
  const std::vector<std::string> needed = read_elf(files.library).libraries;
  for (const auto& package : installed) {
    const std::string name = package.library.filename().string();
    if (package.manifest.kind() != fiona::MESSAGES || std::find(needed.begin(), needed.end(), name) == needed.end())
      continue;
    for (const auto& other : marketplace::messages_of(package.manifest, package.name(), installed)) add(other);
    add(package);
  }
}

Described describe_library(Reactor& reactor, const PluginFiles& files, Confinement confinement) {
  const ScratchDirectory directory;
  const fs::path out = directory.path() / "interface.textproto";
  const bool confined = confinement == Confinement::Sandbox;
  ChildProgram child{.program = sibling_program("fiona-group").string(),
                     .arguments = {"--describe", confined ? "confined" : "unconfined", out.string(),
                                   fs::absolute(files.library).string()},
                     .clean = confined,
                     .deadline = std::chrono::steady_clock::now() + kDescribing};
  for (const fs::path& brought : files.brought) child.arguments.push_back(fs::absolute(brought).string());
  std::optional<std::string> missing;  // of the sandbox: the first line
  std::vector<std::string> said;
  const auto keep = [&said](const std::string& line) {
    if (said.size() < kMostWords) said.push_back(line);
  };
  child.on_out = [&](const std::string& line) {
    if (confined && !missing)
      missing = line;
    else
      keep(line);
  };
  child.on_err = keep;
  const ChildEnd end = run_child(reactor, child);
  const std::string where = files.library.string();
  if (missing && !missing->empty())
    throw Error(ErrorCode::NotAllowed,
                {.what = "the plugin's code runs in a sandbox alone, and this system has none for it",
                 .where = where,
                 .found = *missing,
                 .next = "doctor; or, if you trust it as you trust yourself: the same line, with unconfined"});
  if (!end.ok())
    throw Error(ErrorCode::ComponentFailed,
                {.what = fmt::format("the plugin cannot be described: what reads it {}", end.text()),
                 .where = where,
                 .found = fmt::format("{}", fmt::join(said, "\n")),
                 .next = "a constructor declares ports and parameters and does nothing else: open files and devices in "
                         "on_start()"});
  Described described;
  described.text = file_text(out);
  described.interface = marketplace::parse_interface(described.text, where);
  return described;
}

}  // namespace fiona::console
