#include <elf.h>
#include <fcntl.h>
#include <google/protobuf/text_format.h>
#include <zstd.h>

#include <algorithm>
#include <cstring>
#include <fiona/error.hpp>
#include <fiona/marketplace/compiled_protos.hpp>
#include <fiona/marketplace/hash.hpp>
#include <fiona/marketplace/package.hpp>

#include "decompressor.hpp"
#include "durable.hpp"
#include "files.hpp"
#include "tar_writer.hpp"

namespace fiona::marketplace {
namespace {

namespace filesystem = std::filesystem;

constexpr int kCompressionLevel = 9;

struct Member {
  std::string path;
  std::string content;
  bool executable = false;
};

[[noreturn]] void refuse(std::string what, std::string where, std::string expected = {}, std::string next = {}) {
  throw Error(ErrorCode::Failed, ErrorText{.what = std::move(what),
                                           .where = std::move(where),
                                           .expected = std::move(expected),
                                           .next = std::move(next)});
}

std::string content_of(const filesystem::path& path, std::uint64_t most) {
  const FileDescriptor file = open_regular(AT_FDCWD, path, path);
  if (!file) refuse("there is no such file", path.string());
  return read_all(file, most, path);
}

std::string architecture_of(std::string_view library, const filesystem::path& path) {
  Elf64_Ehdr header{};
  if (library.size() >= sizeof header) std::memcpy(&header, library.data(), sizeof header);
  const bool shared = std::memcmp(header.e_ident, ELFMAG, SELFMAG) == 0 && header.e_type == ET_DYN;
  if (shared && header.e_machine == EM_X86_64) return "x86_64";
  if (shared && header.e_machine == EM_AARCH64) return "aarch64";
  refuse("this is not a shared library of an architecture that packages are made for", path.string(),
         "an ELF shared object for x86_64 or aarch64", "build the plugin with fiona_add_plugin");
}

bool is_executable(const filesystem::path& path) {
  return (filesystem::status(path).permissions() & filesystem::perms::owner_exec) != filesystem::perms::none;
}

void add_share(const filesystem::path& share, std::uint64_t most, std::vector<Member>& members) {
  if (!filesystem::is_directory(share)) refuse("there is no such directory", share.string());
  for (const auto& entry : filesystem::recursive_directory_iterator(share)) {
    if (entry.is_symlink()) refuse("a package holds no links", entry.path().string(), "a regular file");
    if (entry.is_directory()) continue;
    const std::string path = "share/" + entry.path().lexically_relative(share).generic_string();
    if (const std::string fault = path_fault(path); !fault.empty()) {
      refuse("this file's path in the package " + fault, entry.path().string(), {}, "give it another name");
    }
    members.push_back({path, content_of(entry.path(), most), is_executable(entry.path())});
  }
}

void check_unpacked(const Manifest& manifest) {
  const bool packed = !manifest.library().empty() || !manifest.architecture().empty() || !manifest.abi().empty() ||
                      manifest.files_size() > 0 || manifest.offered_size() > 0 || manifest.shared_size() > 0;
  if (packed) {
    refuse("library, architecture, abi, files, offered and shared are written by packing", std::string(kManifestFile),
           {}, "take them out of the manifest");
  }
}

std::vector<Member> collect(const PackageSource& source, Manifest& manifest, const PackageLimits& limits) {
  std::vector<Member> members{{std::string(kInterfaceFile), source.interface},
                              {std::string(kReadmeFile), source.readme}};
  for (const auto& library : source.libraries) {
    members.push_back({"lib/" + library.filename().string(), content_of(library, limits.total_bytes)});
    const std::string architecture = architecture_of(members.back().content, library);
    if (manifest.architecture().empty()) {
      manifest.set_library(members.back().path);
      manifest.set_architecture(architecture);
    } else if (manifest.architecture() != architecture) {
      refuse("the libraries are made for different machines", library.string(), manifest.architecture());
    }
  }
  if (!source.share.empty()) add_share(source.share, limits.total_bytes, members);
  std::ranges::sort(members, [](const Member& a, const Member& b) { return comes_before(a.path, b.path); });
  return members;
}

void list_files(const std::vector<Member>& members, Manifest& manifest) {
  for (const auto& member : members) {
    PackageFile& file = *manifest.add_files();
    file.set_path(member.path);
    file.set_size(member.content.size());
    file.set_blake2b(blake2b(member.content));
    file.set_executable(member.executable);
  }
}

std::string compressed(const std::string& bytes) {
  const std::unique_ptr<ZSTD_CCtx, std::size_t (*)(ZSTD_CCtx*)> context{ZSTD_createCCtx(), ZSTD_freeCCtx};
  ZSTD_CCtx_setParameter(context.get(), ZSTD_c_compressionLevel, kCompressionLevel);
  ZSTD_CCtx_setParameter(context.get(), ZSTD_c_checksumFlag, 1);
  std::string out(ZSTD_compressBound(bytes.size()), '\0');
  const std::size_t size = ZSTD_compress2(context.get(), out.data(), out.size(), bytes.data(), bytes.size());
  if (ZSTD_isError(size)) refuse(std::string("could not compress the package: ") + ZSTD_getErrorName(size), {});
  out.resize(size);
  return out;
}

std::string archived(const std::string& manifest, const std::vector<Member>& members) {
  std::string tar;
  TarWriter writer{[&tar](std::string_view bytes) { tar += bytes; }};
  const auto add = [&writer](const std::string& path, const std::string& content, bool executable) {
    writer.begin(path, content.size(), executable);
    writer.write(content);
    writer.end();
  };
  add(std::string(kManifestFile), manifest, false);
  for (const auto& member : members) add(member.path, member.content, member.executable);
  writer.close();
  return tar;
}

/// What the code uses must stand where its users read it.
void check_rights(const Manifest& manifest, const Interface& interface) {
  for (const auto& component : interface.components()) {
    for (const auto& right : component.rights()) {
      if (std::find(manifest.rights().begin(), manifest.rights().end(), right) != manifest.rights().end()) continue;
      refuse(
          "component '" + component.name() + "' uses the right '" + right + "', and the manifest does not ask for it",
          std::string(kManifestFile), "rights: \"" + right + "\"");
    }
  }
}

std::string packed(const PackageSource& source, const PackageLimits& limits) {
  Manifest manifest = parse_manifest(source.manifest, std::string(kManifestFile));
  check_unpacked(manifest);
  const Interface interface = parse_interface(source.interface, std::string(kInterfaceFile));
  if (interface.planned()) {
    refuse("a planned interface has nothing to pack", std::string(kInterfaceFile), {},
           "build the component and describe it: fiona plugin describe LIBRARY");
  }
  check_rights(manifest, interface);
  const std::vector<Member> members = collect(source, manifest, limits);
  manifest.set_abi(interface.abi());
  list_protos(interface, manifest);
  list_files(members, manifest);
  check_packed_manifest(manifest, std::string(kManifestFile), limits);
  std::string text;
  google::protobuf::TextFormat::PrintToString(manifest, &text);
  if (text.size() > limits.manifest_bytes) refuse("the manifest grows too large", std::string(kManifestFile));
  return compressed(archived(text, members));
}

}  // namespace

std::string pack(const PackageSource& source, const PackageLimits& limits) {
  try {
    return packed(source, limits);
  } catch (const Error& error) {
    if (!error.text().next.empty()) throw;
    ErrorText text = error.text();
    text.next = "correct it and pack again";
    throw Error(error.code(), text);
  }
}

bool pack_to(const filesystem::path& file, const PackageSource& source, const OsCalls& os) {
  const std::string bytes = pack(source);
  const filesystem::path absolute = filesystem::absolute(file);
  const DurableDirectory directory{os, absolute.parent_path(), 0755};
  const std::string name = absolute.filename().string();
  if (const FileDescriptor old = open_regular(directory.descriptor(), name, file)) {
    if (size_of(old) == bytes.size() && read_all(old, bytes.size(), file) == bytes) return false;
  }
  directory.replace(name, bytes);
  return true;
}

}  // namespace fiona::marketplace
