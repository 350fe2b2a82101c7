#include <algorithm>
#include <fiona/error.hpp>
#include <fiona/marketplace/hash.hpp>
#include <fiona/marketplace/manifest.hpp>
#include <fiona/marketplace/requirement.hpp>
#include <fiona/marketplace/version.hpp>
#include <set>

#include "text_check.hpp"

namespace fiona::marketplace {
namespace {

constexpr std::string_view kLower = "abcdefghijklmnopqrstuvwxyz";
constexpr std::string_view kNameRest = "abcdefghijklmnopqrstuvwxyz0123456789-";
constexpr std::string_view kWord = "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789_";
constexpr std::size_t kPathLength = 100;  // what a plain tar header holds without an extension
constexpr std::size_t kNameLength = 64;
constexpr std::size_t kMostRelations = 256;
constexpr std::size_t kMostProtos = 256;
/// Longer nobody is left to wait for what it was to do.
constexpr std::uint32_t kLeastHang_ms = 1'000;
constexpr std::uint32_t kMostHang_ms = 10'000;

[[noreturn]] void refuse(const std::string& where, std::string what, std::string expected = {},
                         std::string found = {}) {
  throw Error(
      ErrorCode::Failed,
      ErrorText{.what = std::move(what), .where = where, .expected = std::move(expected), .found = std::move(found)});
}

void check_name(const std::string& where, const std::string& field, const std::string& name) {
  if (!is_name(name)) {
    refuse(where, field + " is not a name that a package may have",
           "at most 64 lower-case letters, digits and '-', beginning with a letter", "\"" + name + "\"");
  }
}

// Whom it needs, whom it does not bear, and which hosts.
void check_relations(const Manifest& manifest, const std::string& where) {
  if (static_cast<std::size_t>(manifest.requirements_size() + manifest.conflicts_size()) > kMostRelations)
    refuse(where, "the package has too many requirements and conflicts", "at most " + std::to_string(kMostRelations));
  for (const auto& text : manifest.requirements()) {
    if (Requirement::parse(text, where + ", requirements").package == full_name(manifest))
      refuse(where, "the package requires itself", "requirements on other packages", "\"" + text + "\"");
  }
  for (const auto& text : manifest.conflicts()) {
    const Requirement conflict = Requirement::parse(text, where + ", conflicts");
    if (conflict.package == full_name(manifest) || conflict.versions.bounds().size() > 1)
      refuse(where, "this cannot be a conflict", "another package, with one bound of versions at most",
             "\"" + text + "\"");
  }
  VersionRange::parse(manifest.host(), where + ", host");
}

void check_authors_part(const Manifest& manifest, const std::string& where) {
  check_name(where, "publisher", manifest.publisher());
  if (!is_publisher(manifest.publisher())) {
    refuse(where, "\"" + manifest.publisher() + "\" has a meaning of its own, and cannot be a publisher",
           "another name");
  }
  check_name(where, "name", manifest.name());
  if (!Version::parse(manifest.version())) {
    refuse(where, "version is not a semantic version", "MAJOR.MINOR.PATCH, such as 1.0.0 or 1.2.0-rc.1",
           "\"" + manifest.version() + "\"");
  }
  if (!PackageKind_IsValid(manifest.kind())) refuse(where, "kind is none that this version knows");
  if (manifest.summary().empty()) refuse(where, "summary is missing", "one line that says what the package is for");
  if (manifest.license().empty()) refuse(where, "license is missing", "an SPDX identifier, such as Apache-2.0");
  check_relations(manifest, where);
  const std::uint32_t hang = manifest.hang_after_ms();
  if (hang != 0 && (hang < kLeastHang_ms || hang > kMostHang_ms)) {
    refuse(where, "hang_after_ms is out of range",
           std::to_string(kLeastHang_ms) + " to " + std::to_string(kMostHang_ms) +
               " ms, or none: " + std::to_string(kLeastHang_ms),
           std::to_string(hang));
  }
}

int rank(std::string_view path) {
  if (path == kInterfaceFile) return 0;
  if (path == kReadmeFile) return 1;
  if (path.starts_with("lib/")) return 2;
  return path.starts_with("share/") ? 3 : 4;
}

std::string lower_case(std::string text) {
  for (char& c : text) c = c >= 'A' && c <= 'Z' ? static_cast<char>(c - 'A' + 'a') : c;
  return text;
}

// Two files of one name on a file system that ignores case, or a file where another needs a directory.
void check_clashes(const Manifest& manifest, const std::string& where) {
  std::set<std::string> files;
  std::set<std::string> spellings, spellings_lower;
  for (const auto& file : manifest.files()) files.insert(file.path());
  for (const auto& file : manifest.files()) {
    for (std::size_t slash = 0; slash != std::string::npos;) {
      slash = file.path().find('/', slash + 1);
      const std::string prefix = file.path().substr(0, slash);
      if (slash != std::string::npos && files.contains(prefix)) {
        refuse(where, prefix + " is listed as a file, and " + file.path() + " needs a directory there");
      }
      if (spellings.insert(prefix).second && !spellings_lower.insert(lower_case(prefix)).second) {
        refuse(where, prefix + " differs from another name only in upper and lower case");
      }
    }
  }
}

void check_file(const PackageFile& file, const std::string& where) {
  if (const std::string fault = path_fault(file.path()); !fault.empty()) {
    const bool shown = text_fault(file.path(), false).empty();
    refuse(where, "a listed file's path " + fault, {}, shown ? "\"" + file.path() + "\"" : "a path that is not text");
  }
  if (!is_blake2b(file.blake2b())) refuse(where, file.path() + " has no hash", "blake2b of 64 lower-case hex digits");
}

void check_files(const Manifest& manifest, const std::string& where, const PackageLimits& limits) {
  if (static_cast<std::size_t>(manifest.files_size()) > limits.files) {
    refuse(where, "the package has too many files", "at most " + std::to_string(limits.files),
           std::to_string(manifest.files_size()));
  }
  std::uint64_t total = 0;
  const PackageFile* previous = nullptr;
  for (const auto& file : manifest.files()) {
    check_file(file, where);
    if (previous && previous->path() == file.path()) refuse(where, file.path() + " is listed twice");
    if (previous && !comes_before(previous->path(), file.path())) {
      refuse(where, file.path() + " is listed after " + previous->path(),
             "interface.textproto, README.md, lib/…, share/…, each sorted");
    }
    previous = &file;
    const std::uint64_t most = file.path() == kInterfaceFile ? limits.interface_bytes : limits.total_bytes;
    if (file.size() > most || (total += file.size()) > limits.total_bytes) {
      refuse(where, file.path() + " makes the package larger than it may be",
             "at most " + std::to_string(most) + " bytes",
             std::to_string(file.size() > most ? file.size() : total) + " bytes");
    }
  }
  check_clashes(manifest, where);
}

bool lists(const Manifest& manifest, std::string_view path) {
  return std::ranges::any_of(manifest.files(), [&](const PackageFile& file) { return file.path() == path; });
}

void check_library(const Manifest& manifest, const std::string& where) {
  const bool wants = manifest.kind() == PLUGIN || manifest.kind() == MESSAGES;
  if (wants != !manifest.library().empty()) {
    refuse(where, wants ? "a package of this kind needs a library"
                        : "a package of kind " + PackageKind_Name(manifest.kind()) + " has no library");
  }
  if (manifest.kind() == SYSTEM && !lists(manifest, system_file(manifest))) {
    refuse(where, "a package of kind SYSTEM needs its system file", system_file(manifest));
  }
  if (wants && (!manifest.library().starts_with("lib/") || !lists(manifest, manifest.library()))) {
    refuse(where, "library does not name a listed file below lib/", {}, "\"" + manifest.library() + "\"");
  }
  if (wants != !manifest.architecture().empty() || manifest.architecture().size() > 32 ||
      manifest.architecture().find_first_not_of(kWord) != std::string::npos) {
    refuse(where, "architecture does not fit the package's kind", wants ? "x86_64 or aarch64" : "none",
           "\"" + manifest.architecture() + "\"");
  }
}

using CompiledProtos = google::protobuf::RepeatedPtrField<CompiledProto>;

void check_protos(const CompiledProtos& protos, const std::string& where) {
  if (static_cast<std::size_t>(protos.size()) > kMostProtos)
    refuse(where, "the package names too many proto files", "at most " + std::to_string(kMostProtos));
  for (const auto& proto : protos) {
    if (proto.name().empty() || !is_blake2b(proto.blake2b()))
      refuse(where, "the proto file \"" + proto.name() + "\" lacks its name or hash");
  }
}

/// Whose a proto file is, as a publisher is spelt: C++ has '_' for '-'.
std::string publisher_of(const CompiledProto& proto) {
  std::string publisher = proto.name().substr(0, proto.name().find('/'));
  std::ranges::replace(publisher, '_', '-');
  return publisher;
}

// Who was compiled with a proto file is given a library that brings it: nobody can bring another publisher's.
void check_offered(const Manifest& manifest, const std::string& where) {
  if (manifest.kind() != MESSAGES && !manifest.offered().empty())
    refuse(where, "a package of kind " + PackageKind_Name(manifest.kind()) + " offers no proto files");
  if (manifest.kind() == MESSAGES && manifest.offered().empty())
    refuse(where, "a package of kind MESSAGES offers no proto file", "fiona_add_messages(… PROTOS …)");
  for (const auto& proto : manifest.offered()) {
    if (publisher_of(proto) != manifest.publisher())
      refuse(where, "the proto file \"" + proto.name() + "\" is not under its publisher's name",
             manifest.publisher() + "/…");
  }
}

// Which package offers it is for the manifest to say, so that people see why it comes along.
void check_shared(const Manifest& manifest, const std::string& where) {
  for (const auto& proto : manifest.shared()) {
    const std::string publisher = publisher_of(proto);
    const auto is_of = [&](const std::string& text) { return text.starts_with(publisher + "/"); };
    if (std::ranges::none_of(manifest.requirements(), is_of))
      refuse(where, "it was compiled with " + proto.name() + ", and requires no package of " + publisher,
             "requirements: \"" + publisher + "/NAME\", the package that offers it");
  }
}

void check_port(const PortInterface& port, const std::string& where, const std::string& component) {
  if (port.name().empty() || port.service().empty() || port.direction() == DIRECTION_UNSPECIFIED) {
    refuse(where, "port \"" + port.name() + "\" of " + component + " lacks its name, direction or service");
  }
}

}  // namespace

Manifest parse_manifest(std::string_view text, const std::string& where) {
  Manifest manifest;
  parse_text(text, where, manifest);
  check_authors_part(manifest, where);
  return manifest;
}

Interface parse_interface(std::string_view text, const std::string& where) {
  Interface interface;
  parse_text(text, where, interface);
  std::set<std::string> components;
  for (const auto& component : interface.components()) {
    check_name(where, "a component's name", component.name());
    if (!components.insert(component.name()).second) refuse(where, "component " + component.name() + " is there twice");
    std::set<std::string> ports;
    for (const auto& port : component.ports()) {
      check_port(port, where, component.name());
      if (!ports.insert(port.name()).second) {
        refuse(where, "port " + port.name() + " of " + component.name() + " is there twice");
      }
    }
  }
  for (const auto& shared : interface.shared()) {
    const auto is_it = [&shared](const auto& file) { return file.name() == shared; };
    if (!std::ranges::any_of(interface.descriptors().file(), is_it))
      refuse(where, "the shared proto file \"" + shared + "\" has no descriptor");
  }
  return interface;
}

void check_packed_manifest(const Manifest& manifest, const std::string& where, const PackageLimits& limits) {
  if (const std::string fault = texts_fault(manifest); !fault.empty()) refuse(where, fault);
  check_authors_part(manifest, where);
  check_files(manifest, where, limits);
  for (const std::string_view needed : {kInterfaceFile, kReadmeFile}) {
    if (!lists(manifest, needed)) refuse(where, "the package has no " + std::string(needed));
  }
  check_library(manifest, where);
  check_protos(manifest.offered(), where);
  check_protos(manifest.shared(), where);
  check_offered(manifest, where);
  check_shared(manifest, where);
}

std::string path_fault(std::string_view path) {
  if (path.empty()) return "is empty";
  if (path.size() > kPathLength) return "is longer than 100 characters";
  if (path.front() == '/') return "is absolute";
  for (std::size_t begin = 0; begin <= path.size();) {
    const std::size_t slash = std::min(path.find('/', begin), path.size());
    const std::string_view element = path.substr(begin, slash - begin);
    if (element.empty()) return "has an empty element";
    if (element == "." || element == "..") return "has a \"" + std::string(element) + "\" element";
    const auto allowed = [](char c) {
      return kWord.find(c) != std::string_view::npos || std::string_view("._+@=,-").find(c) != std::string_view::npos;
    };
    if (!std::ranges::all_of(element, allowed)) return "has a character other than ASCII letters, digits and ._+@=,-";
    if (kWord.find(element.front()) == std::string_view::npos) return "has an element that begins with a sign";
    begin = slash + 1;
  }
  return rank(path) == 4 ? "is not interface.textproto, README.md, or below lib/ or share/" : "";
}

bool comes_before(std::string_view a, std::string_view b) { return rank(a) != rank(b) ? rank(a) < rank(b) : a < b; }

std::string_view library_path(std::string_view plugin) {
  constexpr std::string_view kEnding = ".so";
  if (plugin.ends_with(kEnding)) return plugin;
  const std::string_view file = plugin.substr(0, plugin.rfind('/'));
  return file.size() < plugin.size() && file.ends_with(kEnding) ? file : std::string_view{};
}

bool is_name(std::string_view text) {
  return !text.empty() && text.size() <= kNameLength && kLower.find(text.front()) != std::string_view::npos &&
         text.find_first_not_of(kNameRest) == std::string_view::npos;
}

bool is_publisher(std::string_view text) {
  constexpr std::string_view kTaken[] = {"local", "unsigned", "root", "targets", "snapshot", "timestamp"};
  return is_name(text) && std::ranges::find(kTaken, text) == std::end(kTaken);
}

std::string system_file(const Manifest& manifest) { return "share/" + manifest.name() + ".fiona"; }

bool opens_sandbox(std::string_view right) {
  if (right.find("..") != std::string_view::npos) return false;
  const std::size_t colon = right.find(':');
  const std::string_view kind = right.substr(0, colon);
  const std::string_view what = colon == std::string_view::npos ? std::string_view() : right.substr(colon + 1);
  if (kind == "system-bus" || kind == "session-bus") return is_bus_name(what);
  if (kind == "read" || kind == "write") return what.starts_with('/');
  return right == "network" || (kind == "device" && !what.empty());
}

bool is_bus_name(std::string_view text) {
  constexpr std::size_t kLongest = 255;
  const auto is_sign = [](char c) { return kWord.find(c) != std::string_view::npos || c == '-'; };
  std::size_t elements = 0;
  for (std::size_t begin = 0; begin <= text.size(); ++elements) {
    const std::size_t dot = std::min(text.find('.', begin), text.size());
    const std::string_view element = text.substr(begin, dot - begin);
    const bool begins = !element.empty() && (element.front() < '0' || element.front() > '9');
    if (!begins || !std::ranges::all_of(element, is_sign)) return false;
    begin = dot + 1;
  }
  return elements >= 2 && text.size() <= kLongest && text != "org.freedesktop.DBus";
}

std::string full_name(const Manifest& manifest) { return manifest.publisher() + "/" + manifest.name(); }

std::string_view this_architecture() {
#if defined(__x86_64__)
  return "x86_64";
#elif defined(__aarch64__)
  return "aarch64";
#else
#error "FIONA runs on x86-64 and arm64"
#endif
}

}  // namespace fiona::marketplace
