// fiona-describe LIBRARY [-o FILE] [--with LIBRARY]...: writes the interface of a plugin, read from its components at
// the author's build, or of a message library.
#include <google/protobuf/text_format.h>
#include <signal.h>
#include <unistd.h>

#include <boost/program_options.hpp>
#include <fstream>
#include <iostream>
#include <string>
#include <string_view>

#include "fiona/tool.hpp"
#include "open_plugin.hpp"

namespace {

namespace options = boost::program_options;

/// A build is not to hang because a component does.
constexpr unsigned kWithin_s = 20;

void end_in_time() {
  ::signal(SIGALRM, [](int) {
    constexpr std::string_view kText =
        "fiona-describe: the plugin does not come to an end within 20 s: a constructor waits or loops, a static one or "
        "that of a component; constructors declare, on_start() opens files and devices\n";
    static_cast<void>(::write(STDERR_FILENO, kText.data(), kText.size()));
    ::_exit(1);
  });
  ::alarm(kWithin_s);
}

void describe(const std::string& library, const std::vector<std::string>& brought, const std::string& out) {
  end_in_time();
  std::string text;
  google::protobuf::TextFormat::PrintToString(fiona::tools::interface_of_library(library, brought), &text);
  if (out.empty()) {
    std::cout << text;
    return;
  }
  std::ofstream file(out, std::ios::trunc);
  file << text;
  file.close();
  if (!file)
    throw fiona::Error(fiona::ErrorCode::Failed, {.what = "the interface cannot be written",
                                                  .where = out,
                                                  .expected = "a folder that exists, may be written, and has room"});
}

void run(int argc, char** argv) {
  std::string library, out;
  std::vector<std::string> brought;
  options::options_description shown("usage: fiona-describe LIBRARY [-o FILE] [--with LIBRARY]...");
  shown.add_options()("output,o", options::value(&out), "the interface; without it, to standard output")(
      "with", options::value(&brought), "a library that it needs beside it, such as one of messages")(
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
    describe(library, brought, out);
  }
}

}  // namespace

int main(int argc, char** argv) {
  return fiona::run_tool<options::error>(
      [&] {
        run(argc, argv);
        return 0;
      },
      "  next: fiona-describe --help\n");
}
