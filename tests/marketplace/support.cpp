#include "support.hpp"

#include "../../marketplace/src/index_file.hpp"

#include <elf.h>
#include <gtest/gtest.h>
#include <stdlib.h>
#include <unistd.h>
#include <zstd.h>

#include <cstdio>
#include <cstring>
#include <fiona/plugin.hpp>
#include <fstream>
#include <iterator>

namespace fiona::marketplace {

InstallResult install(std::string_view request, const Marketplace& from, const std::filesystem::path& store,
                      const InstallOptions& options) {
  const std::string name = from.resolve(request).package;
  const Plan plan = plan_install({std::string(request)}, from, Store{store}, options.platform);
  EXPECT_TRUE(apply(plan, {&from}, store, options)) << "somebody else has changed the store";
  const auto step = std::ranges::find(plan.steps, name, &PlanStep::package);
  InstalledPackage package = Store{store}.find(name);
  if (step == plan.steps.end()) return {InstallOutcome::AlreadyInstalled, package, package.manifest.version()};
  const InstallOutcome outcome = step->kind == StepKind::Repair    ? InstallOutcome::Repaired
                                 : step->kind == StepKind::Install ? InstallOutcome::Installed
                                                                   : InstallOutcome::Replaced;
  return {outcome, package, step->previous_version};
}

InstalledPackage remove(std::string_view name, const std::filesystem::path& store, const InstallOptions& options) {
  InstalledPackage package = Store{store}.find(name);
  EXPECT_TRUE(apply(plan_remove({std::string(name)}, Store{store}), {}, store, options));
  return package;
}

}  // namespace fiona::marketplace

namespace fiona::marketplace::testing {

namespace filesystem = std::filesystem;

// In memory where there is such a place: the tests kill and fail thousands of installations, and a disk that
// syncs each would only be waited for.
Scratch::Scratch() {
  const filesystem::path memory = "/dev/shm";
  const bool usable = ::access(memory.c_str(), W_OK | X_OK) == 0;
  std::string name = (usable ? memory : filesystem::path(::testing::TempDir())) / "marketplace-XXXXXX";
  if (!::mkdtemp(name.data())) throw std::runtime_error("no directory for the test");
  path_ = filesystem::canonical(name);
}

Scratch::~Scratch() {
  std::error_code ignored;
  filesystem::remove_all(path_, ignored);
}

void write_file(const filesystem::path& path, std::string_view content) {
  filesystem::create_directories(path.parent_path());
  std::ofstream(path, std::ios::binary) << content;
}

std::string file_content(const filesystem::path& path) {
  std::ifstream file(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(file), {}};
}

std::map<std::string, std::string> snapshot(const filesystem::path& root) {
  std::map<std::string, std::string> tree;
  for (const auto& entry : filesystem::recursive_directory_iterator(root)) {
    const auto status = entry.symlink_status();
    std::string& text = tree[entry.path().lexically_relative(root).string()];
    text =
        std::to_string(static_cast<int>(status.type())) + " " + std::to_string(static_cast<int>(status.permissions()));
    if (entry.is_symlink())
      text += " -> " + filesystem::read_symlink(entry.path()).string();
    else if (entry.is_regular_file())
      text += " " + file_content(entry.path());
  }
  return tree;
}

std::string library_bytes(std::string_view body) {
  Elf64_Ehdr header{};
  std::memcpy(header.e_ident, ELFMAG, SELFMAG);
  header.e_type = ET_DYN;
  header.e_machine = this_architecture() == "x86_64" ? EM_X86_64 : EM_AARCH64;
  return std::string(reinterpret_cast<const char*>(&header), sizeof header) + std::string(body);
}

PackageSource plugin_source(const filesystem::path& scratch, const std::string& name, const std::string& version,
                            std::string_view body, const std::string& more) {
  const filesystem::path directory = scratch / ("source-" + name + "-" + version);
  write_file(directory / ("lib" + name + ".so"), library_bytes(body));
  write_file(directory / "share/data/map.osm", "<osm/>");
  write_file(directory / "share/help.txt", "help");
  PackageSource source;
  source.manifest = "publisher: 'acme' name: '" + name + "' version: '" + version +
                    "' summary: 'Counts steps' license: 'Apache-2.0' " + more;
  source.interface = "abi: '" + std::string(kAbiTag) + "' components { name: '" + name +
                     "' ports { name: 'steps' direction: PROVIDES service: 'fiona.localisation.StepProvider' } }";
  source.readme = "# " + name + "\n";
  source.libraries = {directory / ("lib" + name + ".so")};
  source.share = directory / "share";
  return source;
}

void publish(const filesystem::path& package, const filesystem::path& market, bool replace) {
  const IndexEntry entry = entry_for(inspect_package(package));
  filesystem::create_directories(market);
  Index index = read_index(market).value_or(Index{});
  add_entry(index, entry, replace, market, "");
  filesystem::copy_file(package, market / entry.file(), filesystem::copy_options::overwrite_existing);
  write_file(market / kIndexFile, index.SerializeAsString());
}

void publish_plugin(const filesystem::path& scratch, const filesystem::path& market, const std::string& name,
                    const std::string& version, std::string_view body, const std::string& more) {
  const filesystem::path file = scratch / (name + "-" + version + ".fpk");
  pack_to(file, plugin_source(scratch, name, version, body, more));
  publish(file, market);
}

Error error_of(const std::function<void()>& call) {
  try {
    call();
  } catch (const Error& error) {
    return error;
  }
  ADD_FAILURE() << "nothing was thrown";
  return Error(ErrorCode::Failed, "nothing was thrown");
}

std::string compress(std::string_view bytes, int window_log) {
  ZSTD_CCtx* context = ZSTD_createCCtx();
  ZSTD_CCtx_setParameter(context, ZSTD_c_checksumFlag, 1);
  if (window_log) ZSTD_CCtx_setParameter(context, ZSTD_c_windowLog, window_log);
  std::string out(ZSTD_compressBound(bytes.size()) + 64, '\0');
  ZSTD_inBuffer in{bytes.data(), bytes.size(), 0};
  ZSTD_outBuffer target{out.data(), out.size(), 0};
  // In a stream the frame does not know its size, so the window is written as asked for.
  if (window_log) {
    ZSTD_compressStream2(context, &target, &in, ZSTD_e_continue);
    ZSTD_compressStream2(context, &target, &in, ZSTD_e_flush);
  }
  ZSTD_compressStream2(context, &target, &in, ZSTD_e_end);
  ZSTD_freeCCtx(context);
  out.resize(target.pos);
  return out;
}

std::string decompress(std::string_view bytes) {
  std::string out(std::size_t{16} << 20, '\0');
  const std::size_t size = ZSTD_decompress(out.data(), out.size(), bytes.data(), bytes.size());
  if (ZSTD_isError(size)) throw std::runtime_error(ZSTD_getErrorName(size));
  out.resize(size);
  return out;
}

std::string raw(const RawHeader& header) {
  std::string block(512, '\0');
  const auto put = [&](std::size_t at, std::string_view text) { block.replace(at, text.size(), text); };
  const auto octal = [](std::uint64_t value, int digits) {
    char text[32];
    std::snprintf(text, sizeof text, "%0*llo", digits, static_cast<unsigned long long>(value));
    return std::string(text) + " ";
  };
  put(0, std::string_view(header.path).substr(0, 100));
  put(100, octal(header.mode, 6));
  put(108, octal(0, 6));
  put(116, octal(0, 6));
  put(124, octal(header.size, 11));
  put(136, octal(0, 11));
  put(148, "        ");
  block[156] = header.type;
  put(157, std::string_view(header.link).substr(0, 100));
  put(257, std::string_view("ustar\00000", 8));
  put(329, octal(0, 6));
  put(337, octal(0, 6));
  unsigned sum = 0;
  for (const char c : block) sum += static_cast<unsigned char>(c);
  char text[8];
  std::snprintf(text, sizeof text, "%06o", sum);
  put(148, std::string_view(text, 7));
  block[155] = ' ';
  return block;
}

std::string raw_file(const RawHeader& header, std::string_view content) {
  std::string piece = raw(header) + std::string(content);
  piece.resize((piece.size() + 511) / 512 * 512);
  return piece;
}

std::vector<std::string> pieces_of(const std::string& package) {
  const std::string tar = decompress(package);
  std::vector<std::string> pieces;
  for (std::size_t at = 0; at + 512 <= tar.size() && tar[at] != '\0';) {
    const std::uint64_t size = std::stoull(tar.substr(at + 124, 11), nullptr, 8);
    const std::size_t length = 512 + (size + 511) / 512 * 512;
    pieces.push_back(tar.substr(at, length));
    at += length;
  }
  return pieces;
}

std::string joined(const std::vector<std::string>& pieces) {
  std::string tar;
  for (const auto& piece : pieces) tar += piece;
  return tar + std::string(1024, '\0');
}

}  // namespace fiona::marketplace::testing
