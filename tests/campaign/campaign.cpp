#include "campaign.hpp"

#include <dirent.h>
#include <unistd.h>

#include <cstdlib>
#include <fstream>
#include <string>

namespace fiona::conformance {

int number_from(const char* variable, int otherwise) {
  const char* text = std::getenv(variable);
  return text && *text ? std::atoi(text) : otherwise;
}

std::vector<pid_t> processes(host::System& system) {
  std::vector<pid_t> all;
  const auto snapshot = system.snapshot();
  for (const auto& group : snapshot.groups()) all.push_back(group.process());
  return all;
}

Holdings holdings(const std::vector<pid_t>& processes) {
  Holdings all;
  for (const pid_t id : processes) {
    const std::string process = "/proc/" + std::to_string(id);
    if (DIR* directory = ::opendir((process + "/fd").c_str())) {
      while (::readdir(directory)) ++all.descriptors;
      ::closedir(directory);
    }
    long pages = 0, resident = 0;
    std::ifstream(process + "/statm") >> pages >> resident;
    all.resident_mib += static_cast<double>(resident * ::sysconf(_SC_PAGESIZE)) / (1024.0 * 1024.0);
  }
  return all;
}

}  // namespace fiona::conformance
