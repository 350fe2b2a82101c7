// fiona-tuf: a client of any TUF repository, so that the workflow can be tried from outside.
#include <fcntl.h>

#include <boost/program_options.hpp>
#include <fiona/error.hpp>
#include <fiona/trust/tuf_client.hpp>
#include <iostream>

#include "../src/files.hpp"

namespace {

namespace options = boost::program_options;

constexpr const char* kUsage =
    "fiona-tuf --metadata-dir DIR init TRUSTED_ROOT_FILE\n"
    "fiona-tuf --metadata-dir DIR --metadata-url URL refresh\n"
    "fiona-tuf --metadata-dir DIR --metadata-url URL --target-name NAME --target-base-url URL --target-dir DIR "
    "download\n";

options::options_description described() {
  options::options_description flags;
  const auto text = [] { return options::value<std::string>(); };
  flags.add_options()("metadata-dir", text(), "where trusted metadata is kept")(
      "metadata-url", text(), "the repository's metadata: http, https, file or a directory")(
      "target-name", text(), "the target to download")("target-base-url", text(), "the repository's target files")(
      "target-dir", text(), "where to put the target")("help,h", "this text")("version", "the version of this program");
  return flags;
}

options::variables_map parsed(int count, char** arguments) {
  options::options_description all = described();
  all.add_options()("command", options::value<std::string>())("file", options::value<std::string>());
  options::positional_options_description words;
  words.add("command", 1).add("file", 1);
  options::variables_map flags;
  options::store(options::command_line_parser(count, arguments).options(all).positional(words).run(), flags);
  return flags;
}

std::string needed(const options::variables_map& flags, const std::string& name, const std::string& shown) {
  if (flags.count(name)) return flags[name].as<std::string>();
  throw fiona::Error(fiona::ErrorCode::Usage,
                     fiona::ErrorText{.what = shown + " is missing", .next = "fiona-tuf --help"});
}

std::string needed(const options::variables_map& flags, const std::string& name) {
  return needed(flags, name, "--" + name);
}

void init(const options::variables_map& flags) {
  const std::filesystem::path path = needed(flags, "file", "the file with the trusted root");
  const auto file = fiona::marketplace::open_regular(AT_FDCWD, path, path);
  if (!file) {
    throw fiona::Error(fiona::ErrorCode::NotFound,
                       fiona::ErrorText{.what = "there is no such file",
                                        .where = path.string(),
                                        .next = "see what is there: ls " + path.parent_path().string()});
  }
  const std::string root = fiona::marketplace::read_all(file, fiona::tuf::Limits{}.root_bytes, path);
  fiona::tuf::Client::trust(needed(flags, "metadata-dir"), root);
}

fiona::tuf::ClientOptions chosen(const options::variables_map& flags) {
  fiona::tuf::ClientOptions options{.trusted = needed(flags, "metadata-dir"),
                                    .metadata = needed(flags, "metadata-url")};
  if (flags.count("target-base-url")) options.targets = flags["target-base-url"].as<std::string>();
  return options;
}

void download(const options::variables_map& flags) {
  const std::string name = needed(flags, "target-name"), to = needed(flags, "target-dir");
  needed(flags, "target-base-url");
  fiona::tuf::Client client{chosen(flags)};
  client.refresh();
  client.download(client.target(name), to);
}

void run(const options::variables_map& flags) {
  const std::string command = needed(flags, "command", "the command");
  if (command == "init") return init(flags);
  if (command == "refresh") return fiona::tuf::Client{chosen(flags)}.refresh();
  if (command == "download") return download(flags);
  throw fiona::Error(fiona::ErrorCode::Usage, fiona::ErrorText{.what = "there is no command " + command,
                                                               .expected = "init, refresh or download",
                                                               .next = "fiona-tuf --help"});
}

}  // namespace

int main(int count, char** arguments) {
  try {
    const options::variables_map flags = parsed(count, arguments);
    if (flags.count("help")) {
      std::cout << kUsage << described();
    } else if (flags.count("version")) {
      std::cout << "fiona-tuf " FIONA_VERSION "\n";
    } else {
      run(flags);
    }
    return 0;
  } catch (const options::error& error) {
    std::cerr << "fiona-tuf: " << error.what() << "\n  next: fiona-tuf --help\n";
  } catch (const std::exception& error) {
    std::cerr << "fiona-tuf: " << error.what() << "\n";
  }
  return 1;
}
