// Writes fiona.1 and fiona-system.5 into the directory that is named; the build installs them.
#include <cstdio>
#include <filesystem>
#include <fstream>

#include "manual.hpp"

int main(int argc, char** argv) {
  if (argc != 2) {
    std::fputs("usage: fiona-manual DIRECTORY\n", stderr);
    return 2;
  }
  const std::filesystem::path directory = argv[1];
  std::ofstream command(directory / "fiona.1");
  std::ofstream system(directory / "fiona-system.5");
  command << fiona::console::command_manual(FIONA_VERSION);
  system << fiona::console::system_file_manual(FIONA_VERSION);
  command.close();
  system.close();
  if (command && system) return 0;
  std::fprintf(stderr, "fiona-manual: %s cannot be written\n", directory.c_str());
  return 1;
}
