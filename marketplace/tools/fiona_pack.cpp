// fiona-pack: makes a package from an author's files, and publishes packages into a marketplace directory.
#include <fcntl.h>

#include <boost/program_options.hpp>
#include <chrono>
#include <fiona/error.hpp>
#include <fiona/marketplace/keeper.hpp>
#include <fiona/marketplace/package.hpp>
#include <fiona/tool.hpp>

#include <iostream>

#include "../src/files.hpp"

namespace {

namespace filesystem = std::filesystem;
namespace options = boost::program_options;
using fiona::marketplace::PackageSource;

constexpr std::chrono::days kTenYears{3650};

constexpr const char* kUsage =
    "fiona-pack --manifest FILE --interface FILE --readme FILE [--library FILE]... [--share DIR] -o OUT.fpk\n"
    "fiona-pack --publish FILE... --to DIR --keys DIR\n";

options::options_description described() {
  options::options_description flags;
  const auto text = [] { return options::value<std::string>(); };
  const auto texts = [] { return options::value<std::vector<std::string>>()->multitoken(); };
  flags.add_options()("manifest", text(), "the author's manifest.textproto")(
      "interface", text(), "what fiona plugin describe wrote")("readme", text(), "README.md")(
      "library", texts(), "shared libraries; the first is the plugin's own")(
      "share", text(), "directory of data files")("output,o", text(), "the package to write")(
      "publish", texts(), "makes a build's own marketplace of exactly these packages, signed with keys of its own")(
      "to", text(), "the marketplace directory; DIR.root.json is what to trust it by")(
      "keys", text(), "where its keys are, made if they are missing (mode 0600)")("help,h", "this text")(
      "version", "the version of this program");
  return flags;
}

std::string needed(const options::variables_map& flags, const std::string& name) {
  if (flags.count(name)) return flags[name].as<std::string>();
  throw fiona::Error(fiona::ErrorCode::Usage,
                     fiona::ErrorText{.what = "--" + name + " is missing", .next = "fiona-pack --help"});
}

std::string content(const filesystem::path& path) {
  const auto file = fiona::marketplace::open_regular(AT_FDCWD, path, path);
  if (!file) {
    throw fiona::Error(fiona::ErrorCode::NotFound,
                       fiona::ErrorText{.what = "there is no such file",
                                        .where = path.string(),
                                        .next = "see what is there: ls " + path.parent_path().string()});
  }
  return fiona::marketplace::read_all(file, std::uint64_t{16} << 20, path);
}

void pack(const options::variables_map& flags) {
  PackageSource source;
  source.manifest = content(needed(flags, "manifest"));
  source.interface = content(needed(flags, "interface"));
  source.readme = content(needed(flags, "readme"));
  if (flags.count("library")) {
    for (const auto& library : flags["library"].as<std::vector<std::string>>()) source.libraries.push_back(library);
  }
  if (flags.count("share")) source.share = flags["share"].as<std::string>();
  fiona::marketplace::pack_to(needed(flags, "output"), source);
}

void publish(const options::variables_map& flags) {
  std::vector<filesystem::path> packages;
  for (const auto& package : flags["publish"].as<std::vector<std::string>>()) packages.emplace_back(package);
  fiona::marketplace::KeeperOptions how{.keys = fiona::tuf::SigningKeys{needed(flags, "keys")}};
  // It comes with a program, and is replaced with it: its metadata does not have to end before.
  how.lifetimes = {.root = kTenYears, .targets = kTenYears, .online = kTenYears};
  fiona::marketplace::make_market(packages, needed(flags, "to"), how);
}

int run(int count, char** arguments) {
  options::variables_map flags;
  options::store(options::parse_command_line(count, arguments, described()), flags);
  if (flags.count("help")) {
    std::cout << kUsage << described();
  } else if (flags.count("version")) {
    std::cout << "fiona-pack " FIONA_VERSION "\n";
  } else {
    flags.count("publish") ? publish(flags) : pack(flags);
  }
  return 0;
}

}  // namespace

int main(int count, char** arguments) {
  return fiona::run_tool<options::error>([&] { return run(count, arguments); }, "  next: fiona-pack --help\n");
}
