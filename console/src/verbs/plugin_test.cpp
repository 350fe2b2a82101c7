// plugin test: the author's own tests, then what the contracts of the ports promise, then a host.
#include <algorithm>
#include <deque>
#include <fstream>
#include <thread>

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <fiona/marketplace/manifest.hpp>

#include "../author/child_program.hpp"
#include "../locations.hpp"
#include "plugin.hpp"

namespace fiona::console::verbs {
namespace {

namespace fs = std::filesystem;

constexpr std::chrono::minutes kBuilding{10};
constexpr std::chrono::hours kLongestBuild{24};
constexpr std::chrono::seconds kContract{60};
constexpr std::chrono::seconds kHostRun{20};
constexpr std::size_t kLastLines = 30;

/// Runs a step of the build. What it says is passed on, and where nobody sees that, told when it fails.
void run_step(Session& session, const std::string& what, ChildProgram child) {
  std::deque<std::string> last;
  const auto pass = [&](const std::string& line) {
    session.out.remark(line);
    last.push_back(line);
    if (last.size() > kLastLines) last.pop_front();
  };
  child.on_out = pass;
  child.on_err = pass;
  const ChildEnd end = run_child(session.reactor, child);
  if (end.ok()) return;
  const bool seen = !session.out.manner.quiet && !session.out.manner.json;
  throw Error(end.in_time ? ErrorCode::Failed : ErrorCode::Unreachable,
              {.what = fmt::format("{} {}", what, end.text()),
               .where = child.directory.string(),
               .found = seen ? "" : fmt::format("{}", fmt::join(last, "\n")),
               .next = end.in_time ? "mend what is told above" : "plugin test DIR for 30min"});
}

/// Where the SDK beside this program is, for find_package: of an installation, or of a build tree; empty: neither.
fs::path sdk_directory() {
  std::error_code problem;
  const fs::path prefix = fs::read_symlink("/proc/self/exe", problem).parent_path().parent_path();
  if (fs::exists(prefix / "cmake" / "fionaTargets.cmake", problem)) return prefix / "cmake";
  for (const fs::path& lib : {prefix / "lib", prefix / "lib64"}) {
    if (fs::exists(lib / "cmake/fiona/fionaConfig.cmake", problem)) return lib / "cmake/fiona";
    for (const auto& entry : fs::directory_iterator(lib, problem)) {
      if (fs::exists(entry.path() / "cmake/fiona/fionaConfig.cmake", problem)) return entry.path() / "cmake/fiona";
    }
  }
  return {};
}

/// One row of fiona-contract: "PORT<tab>STATE<tab>TEXT".
struct ContractRow {
  std::string what;
  std::string state;
  std::string text;
};

std::vector<ContractRow> contract_rows(Session& session, const PluginFiles& files, const std::string& component) {
  std::vector<ContractRow> rows;
  std::vector<std::string> said;
  const auto take = [&rows](const std::string& line) {
    const std::size_t first = line.find('\t');
    const std::size_t second = first == std::string::npos ? first : line.find('\t', first + 1);
    if (second != std::string::npos)
      rows.push_back({line.substr(0, first), line.substr(first + 1, second - first - 1), line.substr(second + 1)});
  };
  const auto keep = [&said](const std::string& line) {
    if (said.size() < kLastLines) said.push_back(line);
  };
  std::vector<std::string> arguments{fs::absolute(files.library).string(), component};
  arguments.insert(arguments.end(), files.brought.begin(), files.brought.end());
  const ChildEnd end = run_child(session.reactor, {.program = sibling_program("fiona-contract").string(),
                                                   .arguments = arguments,
                                                   .deadline = std::chrono::steady_clock::now() + kContract,
                                                   .on_out = take,
                                                   .on_err = keep});
  if (!end.ok() || rows.empty())
    rows.push_back({component, "wrong",
                    fmt::format("its process {}{}{}", end.text(), said.empty() ? "" : ": ", fmt::join(said, " "))});
  return rows;
}

/// Whether whoever installs it gets it in a sandbox that no right of its manifest opens.
bool is_closed(const PluginFiles& files) {
  const Manifest manifest = marketplace::parse_manifest(file_text(files.manifest), files.manifest.string());
  return std::none_of(manifest.rights().begin(), manifest.rights().end(), marketplace::opens_sandbox);
}

/// Loads each component into a host that is thrown away; what it says where one does not get there.
std::string fault_in_host(Session& session, const fs::path& library, const fiona::Interface& interface, bool confined) {
  const ScratchDirectory directory;
  const fs::path file = directory.path() / "load.fiona";
  std::ofstream lines(file);
  int number = 0;
  for (const auto& component : interface.components()) {
    const std::string name = fmt::format("it{}", ++number);
    const std::string first = component.modes().empty() ? "active" : component.modes(0).name();
    lines << fmt::format("load \"{}/{}\" as {} in {}{}\nwait {} {} for 5s\n", fs::absolute(library).string(),
                         component.name(), name, name, confined ? " with confined" : "", name, first);
  }
  lines << "quit\n";
  lines.close();
  fs::create_directory(directory.path() / "run");
  fs::permissions(directory.path() / "run", fs::perms::owner_all);
  std::vector<std::string> said;
  const auto keep = [&said](const std::string& line) {
    if (said.size() < kLastLines) said.push_back(line);
  };
  const ChildEnd end =
      run_child(session.reactor, {.program = sibling_program("fiona").string(),
                                  .arguments = {"run", file.string(), "--headless", "-q"},
                                  .environment = {{"XDG_RUNTIME_DIR", (directory.path() / "run").string()},
                                                  {"XDG_STATE_HOME", (directory.path() / "run").string()},
                                                  {"FIONA_STORE", store_of(session).directory().string()}},
                                  .deadline = std::chrono::steady_clock::now() + kHostRun,
                                  .on_err = keep});
  if (end.ok()) return "";
  return said.empty() ? "the host " + end.text() : fmt::format("{}", fmt::join(said, "\n"));
}

/// What each port promises, and a host: a row a port. How many of them are wrong.
std::size_t test_contracts(Session& session, const PluginFiles& files, Confinement confinement) {
  const fiona::Interface interface = marketplace::parse_interface(file_text(files.interface), files.interface.string());
  Table table({"component", "what", "state", "found"});
  std::size_t wrong = 0;
  for (const auto& component : interface.components()) {
    for (const ContractRow& row : contract_rows(session, files, component.name())) {
      wrong += row.state == "wrong" ? 1 : 0;
      table.add({component.name(), row.what, row.state, row.text});
    }
  }
  const bool confined = confinement == Confinement::Sandbox && is_closed(files);
  const std::string fault = fault_in_host(session, files.library, interface, confined);
  wrong += fault.empty() ? 0 : 1;
  const std::string done =
      fmt::format("loaded, each in a {} of its own, and reached their first mode", confined ? "sandbox" : "process");
  table.add({fmt::format("{} component{}", interface.components_size(), interface.components_size() == 1 ? "" : "s"),
             "a host", fault.empty() ? "ok" : "wrong", fault.empty() ? done : fault});
  session.out.table(table, "");
  return wrong;
}

}  // namespace

SteadyTime build_deadline(const Line& line) {
  const Word* typed = line.clause("for");
  const double most = std::chrono::duration<double, std::milli>(kLongestBuild).count();
  const double within = typed == nullptr ? std::chrono::duration<double, std::milli>(kBuilding).count()
                                         : std::min(duration_ms(*typed, line.words), most);
  return std::chrono::steady_clock::now() + std::chrono::milliseconds(static_cast<std::int64_t>(within));
}

void build_plugin(Session& session, const fs::path& folder, SteadyTime deadline) {
  std::error_code problem;
  if (!fs::exists(folder / "build" / "CMakeCache.txt", problem)) {
    std::vector<std::string> words{"-S", ".", "-B", "build", "-DCMAKE_BUILD_TYPE=Release"};
    if (const fs::path sdk = sdk_directory(); !sdk.empty()) words.push_back("-Dfiona_DIR=" + sdk.string());
    run_step(session, "configuring",
             {.program = "cmake",
              .arguments = words,
              .directory = folder,
              .environment = {{"FIONA_STORE", store_of(session).directory().string()}},
              .deadline = deadline});
  }
  run_step(session, "the build",
           {.program = "cmake",
            .arguments = {"--build", "build", "--parallel",
                          fmt::format("{}", std::max(1U, std::thread::hardware_concurrency()))},
            .directory = folder,
            .environment = {{"FIONA_STORE", store_of(session).directory().string()}},
            .deadline = deadline});
}

void plugin_test(Session& session, const Line& line) {
  const fs::path folder = typed_folder(line, 1);
  const SteadyTime deadline = build_deadline(line);
  const fiona::PackageKind kind = kind_of(files_of_folder(folder));
  if (!has_library(kind))
    throw line.error(line.verb, {.what = "a package of this kind has nothing to build and test",
                                 .next = fmt::format("plugin check {}", folder.string())});
  build_plugin(session, folder, deadline);
  run_step(session, "ctest",
           {.program = "ctest",
            .arguments = {"--test-dir", "build", "--output-on-failure",
                          kind == fiona::PLUGIN ? "--no-tests=error" : "--no-tests=ignore"},
            .directory = folder,
            .deadline = deadline});
  PluginFiles files = files_of_folder(folder);
  find_messages(files, store_of(session));
  if (files.library.empty())
    throw Error(ErrorCode::NotFound, {.what = "the build has made no plugin",
                                      .where = (folder / "build").string(),
                                      .expected = "NAME.interface.textproto beside libNAME.so",
                                      .next = "fiona_add_plugin(NAME …) in CMakeLists.txt makes them"});
  if (kind == fiona::MESSAGES) return session.out.done("built; its tests are met");
  const std::size_t wrong = test_contracts(session, files, confinement_of(line));
  if (wrong > 0)
    throw Error(ErrorCode::ComponentFailed, {.what = fmt::format("{} of the rows above are wrong", wrong),
                                             .where = files.library.string(),
                                             .next = "docs/patterns.md says what each pattern promises"});
  session.out.done("built; its tests and its contracts are met");
}

}  // namespace fiona::console::verbs
