// fiona-walks DIR: the names of the test walks of a recording, one a line.
#include <exception>
#include <iostream>

#include "fiona/error.hpp"
#include "fiona/tool.hpp"
#include "fiona/walk/dataset.hpp"

int main(int argc, char** argv) {
  if (argc != 2) {
    std::cerr << "usage: fiona-walks DIR\n";
    return static_cast<int>(fiona::ErrorCode::Usage);
  }
  return fiona::run_tool([&] {
    for (const auto& name : fiona::walk::Dataset::open(argv[1]).walk_names()) std::cout << name << "\n";
    return 0;
  });
}
