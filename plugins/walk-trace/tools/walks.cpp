// fiona-walks DIR: the names of the test walks of a recording, one a line.
#include <exception>
#include <iostream>
#include <string>

#include "fiona/error.hpp"
#include "fiona/tool.hpp"
#include "fiona/walk/dataset.hpp"

int main(int argc, char** argv) {
  const bool help = argc == 2 && (argv[1] == std::string("--help") || argv[1] == std::string("-h"));
  if (help || argc != 2) {
    (help ? std::cout : std::cerr)
        << "usage: fiona-walks DIR\nThe names of the test walks of a recording, one a line.\n";
    return help ? 0 : static_cast<int>(fiona::ErrorCode::Usage);
  }
  return fiona::run_tool([&] {
    for (const auto& name : fiona::walk::Dataset::open(argv[1]).walk_names()) std::cout << name << "\n";
    return 0;
  });
}
