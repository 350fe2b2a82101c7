// doctor and paths: where everything is, and whether it can work.
#include <langinfo.h>
#include <sys/resource.h>
#include <unistd.h>

#include <algorithm>
#include <clocale>
#include <cstdio>
#include <cstring>
#include <functional>
#include <memory>

#include <fmt/format.h>

#include <fiona/marketplace/open.hpp>
#include <fiona/marketplace/store.hpp>
#include <fiona/trust/host_keys.hpp>

#include "../locations.hpp"
#include "verbs.hpp"

#ifndef FIONA_VERSION
#error "the build passes the project's version"
#endif

namespace fiona::console::verbs {
namespace {

namespace fs = std::filesystem;

fs::path store_directory(const Session& session) {
  return session.options.store.empty() ? marketplace::Store::default_directory() : session.options.store;
}

/// What a check found: nothing wrong, or what is, and the line that mends it.
struct Finding {
  bool ok = true;
  std::string state;
  std::string next{};
};
struct Check {
  std::string name;
  std::function<Finding()> look;
};

Finding look_at_programs() {
  const fs::path host = sibling_program("fiona-host");
  const fs::path group = host.parent_path() / "fiona-group";
  if (::access(group.c_str(), X_OK) == 0) return {true, host.parent_path().string()};
  return {false, group.string() + " is missing", "build or install `fiona-group` beside `fiona`"};
}

Finding look_at_store(const fs::path& directory) {
  const marketplace::Store store(directory);
  const auto installed = store.installed();
  for (const auto& package : installed) store.verify(package);
  return {true, fmt::format("{} packages, each file as its hash says", installed.size())};
}

Finding look_at_marketplace() {
  const auto market = marketplace::open_marketplace({}, {.ask_network = false});
  return {true, fmt::format("{} packages in {}, signed", market.index().entries_size(), market.source())};
}

Finding look_at_keys() {
  const trust::KeyDirectory keys;
  const auto allowed = keys.allowed();
  if (!keys.has_pair()) return {true, "none: hosts speak to nobody over tcp"};
  static_cast<void>(keys.pair());
  return {true, fmt::format("a pair, {} hosts and {} consoles may connect", allowed.size(), keys.consoles().size())};
}

/// Each wire to another process and each console takes one.
Finding look_at_open_files() {
  constexpr rlim_t kEnough = 1024;
  rlimit limit{};
  ::getrlimit(RLIMIT_NOFILE, &limit);
  if (limit.rlim_cur >= kEnough) return {true, fmt::format("{} at a time", limit.rlim_cur)};
  return {false, fmt::format("only {} at a time", limit.rlim_cur), fmt::format("ulimit -n {}", kEnough)};
}

/// In a shared memory file system: what a host's groups speak through lies there.
Finding look_at_runtime_directory() {
  const fs::path directory = runtime_directory();
  constexpr std::uintmax_t kEnough = 1U << 20U;
  std::error_code problem;
  const auto space = fs::space(directory, problem);
  if (!problem && space.available < kEnough)
    return {false, directory.string() + " is full", "df " + directory.string()};
  return {true, directory.string()};
}

Finding look_at_locale() {
  std::setlocale(LC_CTYPE, "");
  const std::string coding = ::nl_langinfo(CODESET);
  if (coding == "UTF-8") return {true, coding};
  return {false, coding + ": names that are not ASCII are shown and edited wrongly", "export LC_ALL=C.UTF-8"};
}

Finding look_at_host(Session& session, const RunningHost& running) {
  ControlClient client(session.reactor, {running.socket}, session.options.timeout);
  control::Request request;
  request.mutable_snapshot();
  const control::System system = client.call(std::move(request)).system();
  if (system.version() != FIONA_VERSION)
    return {false, fmt::format("runs {}, this is {}", system.version(), FIONA_VERSION),
            "end it with quit and run it again"};
  return {true, fmt::format("answers, {} instances", system.instances_size())};
}

/// As a group puts it up, in a process of its own.
Finding look_at_sandbox() {
  const std::string program = (sibling_program("fiona-host").parent_path() / "fiona-group").string();
  const std::unique_ptr<FILE, int (*)(FILE*)> output(::popen(("'" + program + "' --probe").c_str(), "r"), &::pclose);
  std::vector<std::string> found;
  std::vector<std::string> missing;
  char line[300];
  while (output && std::fgets(line, sizeof line, output.get())) {
    const std::string text(line, std::strcspn(line, "\n"));
    (text.find(": missing: ") == std::string::npos ? found : missing).push_back(text);
  }
  if (found.empty()) return {false, "cannot be probed", "build or install `fiona-group` beside `fiona`"};
  const bool holds = std::none_of(missing.begin(), missing.end(), [](const std::string& layer) {
    return layer.starts_with("mounts") || layer.starts_with("privileges") || layer.starts_with("seccomp");
  });
  found.insert(found.end(), missing.begin(), missing.end());
  return {holds, fmt::format("{}", fmt::join(found, "; ")),
          holds ? "" : "packages of others are refused here but with unconfined; sysctl user.max_user_namespaces"};
}

std::vector<Check> all_checks(Session& session) {
  std::vector<Check> checks{
      {"programs", look_at_programs},
      {"run-time directory", look_at_runtime_directory},
      {"store", [&session] { return look_at_store(store_directory(session)); }},
      {"marketplace", look_at_marketplace},
      {"keys", look_at_keys},
      {"open files", look_at_open_files},
      {"sandbox", look_at_sandbox},
      {"character coding", look_at_locale},
  };
  try {
    for (const RunningHost& running : running_hosts())
      checks.push_back({"host " + running.name, [&session, running] { return look_at_host(session, running); }});
  } catch (const Error&) {
    // told by the check of the run-time directory
  }
  return checks;
}

Finding done(const Check& check) {
  try {
    return check.look();
  } catch (const Error& error) {
    const std::string& where = error.text().where;
    return {false, error.text().what + (where.empty() ? "" : ": " + where), error.text().next};
  }
}

}  // namespace

void doctor(Session& session, const Line&) {
  Table table({"check", "state", "found", "next"});
  int wrong = 0;
  for (const Check& check : all_checks(session)) {
    const Finding finding = done(check);
    if (!finding.ok) ++wrong;
    table.add({check.name, finding.ok ? "ok" : "wrong", finding.state, finding.next});
  }
  session.out.table(table, "");
  if (wrong > 0)
    throw Error(ErrorCode::Failed, ErrorText{.what = fmt::format("{} of the checks found something wrong", wrong),
                                             .next = "the lines above say what mends it"});
}

void paths(Session& session, const Line&) {
  const auto or_problem = [](const std::function<fs::path()>& get) {
    try {
      return get().string();
    } catch (const Error& error) {
      return "- " + error.text().what;
    }
  };
  Table table({"what", "path", "set by"});
  table.add({"programs", or_problem([] { return sibling_program("fiona-host").parent_path(); }), ""});
  table.add({"sockets of hosts", or_problem(runtime_directory), "XDG_RUNTIME_DIR"});
  table.add({"store", store_directory(session).string(), "--store, FIONA_STORE"});
  table.add({"marketplace", marketplace::Marketplace::default_directory().string(), "--from, FIONA_MARKET"});
  table.add({"keys of hosts", trust::KeyDirectory().path().string(), "FIONA_KEYS"});
  table.add({"history of the prompt", history_file().string(), "XDG_STATE_HOME"});
  table.add({"journals of hosts", journal_file("NAME").string(), "XDG_STATE_HOME"});
  session.out.table(table, "");
}

}  // namespace fiona::console::verbs
