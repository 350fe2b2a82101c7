#include "evidence.hpp"

#include <algorithm>
#include <array>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <sstream>
#include <vector>

#include <fmt/format.h>

#include "os/process.hpp"

namespace fiona::conformance {

/// Not by the stream's buffer itself, which throws where the process goes meanwhile.
std::string content_of(const std::filesystem::path& file) {
  std::ostringstream text;
  text << std::ifstream(file, std::ios::binary).rdbuf();
  return text.str();
}

namespace {

namespace fs = std::filesystem;

/// A field of proc_pid_status(5), such as "State"; empty where the process has gone.
std::string field_of(const fs::path& task, const std::string& name) {
  std::ifstream file(task / "status");
  for (std::string line; std::getline(file, line);) {
    if (line.starts_with(name + ":\t")) return line.substr(name.size() + 2);
  }
  return "";
}

std::vector<pid_t> children_of(pid_t process) {
  std::vector<pid_t> all;
  std::error_code gone;
  for (const auto& one : fs::directory_iterator("/proc", gone)) {
    const std::string name = one.path().filename();
    if (name.find_first_not_of("0123456789") != std::string::npos) continue;
    if (field_of(one.path(), "PPid") == std::to_string(process)) all.push_back(std::stoi(name));
  }
  return all;
}

std::string words_of(const fs::path& process) {
  std::string words = content_of(process / "cmdline");
  std::replace(words.begin(), words.end(), '\0', ' ');
  return words;
}

/// What it waits for: the kernel's function, and all that have led to it where this user may know.
std::string wait_of(const fs::path& task) {
  std::string path;
  std::ifstream file(task / "stack");
  for (std::string line; std::getline(file, line);) path += " < " + line.substr(line.rfind(' ') + 1);
  return content_of(task / "wchan") + path;
}

std::string threads_of(const fs::path& process) {
  std::string text;
  std::error_code gone;
  for (const auto& task : fs::directory_iterator(process / "task", gone)) {
    text += fmt::format("    thread {} {}: {}, in {}\n", task.path().filename().string(), field_of(task.path(), "Name"),
                        field_of(task.path(), "State"), wait_of(task.path()));
  }
  return text;
}

/// Short of what gdb says of the libraries that it reads.
std::string frames_of(pid_t process) {
  if (os::program_in_path("gdb").empty()) return "";
  const std::string command =
      fmt::format("timeout 20 gdb -p {} -batch -nx -ex 'thread apply all bt 12' 2>/dev/null", process);
  std::FILE* const said = ::popen(command.c_str(), "r");
  if (!said) return "";
  std::string text;
  std::array<char, 4096> line{};
  while (std::fgets(line.data(), line.size(), said)) {
    const std::string_view words(line.data());
    if (words.starts_with("#") || words.starts_with("Thread ")) text += "    " + std::string(words.substr(0, 240));
    if (words.size() > 240) text += "\n";
  }
  ::pclose(said);
  return text;
}

void describe(pid_t process, std::string& text) {
  const fs::path folder = "/proc/" + std::to_string(process);
  text += fmt::format("process {} of {}: {}\n", process, field_of(folder, "PPid"), words_of(folder));
  text += threads_of(folder) + frames_of(process);
  for (const pid_t child : children_of(process)) describe(child, text);
}

}  // namespace

std::string evidence_of(pid_t process) {
  std::string text;
  describe(process, text);
  return text;
}

}  // namespace fiona::conformance
