#include <algorithm>
#include <cstring>
#include <functional>
#include <memory>
#include <optional>
#include <utility>

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <unistd.h>
#include <fiona/marketplace/install.hpp>

#include "../catalogue.hpp"
#include "../host_process.hpp"
#include "../locations.hpp"
#include "../prompt.hpp"
#include "../script.hpp"
#include "../service_manager.hpp"
#include "../system_view.hpp"
#include "../white_spots.hpp"
#include "verbs.hpp"

namespace fiona::console::verbs {
namespace {

/// The instance that a load line makes, as far as the line tells: without `as` it is the component's name.
std::string instance_of(const Line& load) {
  if (const Word* name = load.clause("as")) return name->text;
  const std::string& plugin = load.positional[0].text;
  return plugin.substr(plugin.rfind('/') + 1);
}

/// `--set walk.trace=X` replaces or adds an argument of the line that loads `walk`.
void override_parameter(std::vector<Line>& lines, const Line& run, const TypedArgument& given) {
  const std::size_t dot = given.name.text.find('.');
  if (dot == std::string::npos || dot == 0 || dot + 1 == given.name.text.size()) {
    const Word& at = given.name.text.empty() ? given.value : given.name;
    throw run.error(at, {.what = "--set does not say which parameter", .expected = "--set INSTANCE.PARAM=VALUE"});
  }
  const std::string instance = given.name.text.substr(0, dot);
  std::vector<std::string> known;
  for (Line& line : lines) {
    if (line.verb.text != "load") continue;
    known.push_back(instance_of(line));
    if (known.back() != instance) continue;
    TypedArgument changed{{given.name.text.substr(dot + 1), WordKind::Plain, line.verb.place}, given.value};
    changed.value.place = line.verb.place;  // errors show the line that takes it
    const auto same = std::find_if(line.arguments.begin(), line.arguments.end(),
                                   [&changed](const TypedArgument& old) { return old.name.text == changed.name.text; });
    if (same == line.arguments.end())
      line.arguments.push_back(std::move(changed));
    else
      same->value = std::move(changed.value);
    return;
  }
  throw run.error(
      given.name,
      {.what = fmt::format("the files load no instance '{}'", instance), .near = nearest_names(instance, known)},
      ErrorCode::NotFound);
}

std::vector<Line> lines_to_run(const Line& run, const std::filesystem::path& store) {
  std::vector<Line> lines;
  for (const Word& file : run.positional) {
    for (Line& line : read_script(system_path(file.text, store))) lines.push_back(std::move(line));
  }
  for (const Line& line : lines) {
    if (line.verb.text == "run")
      throw line.error(line.verb, {.what = "a system file cannot start a host",
                                   .next = "source FILE runs the lines of another file"});
  }
  const auto [first, last] = run.options.equal_range("--set");
  for (auto option = first; option != last; ++option) override_parameter(lines, run, option->second);
  return lines;
}

void refuse_white_spots(Session& session) {
  const std::vector<std::string> spots = strict_spots(session.snapshot());
  if (spots.empty()) return;
  throw Error(
      ErrorCode::WiringInvalid,
      ErrorText{.what = fmt::format("{} required port{} nobody: {}", spots.size(),
                                    spots.size() == 1 ? " is served by" : "s are served by", fmt::join(spots, ", ")),
                .next = "wire them, or run without --strict; `fiona spots` tells who could serve"});
}

void run_lines(Session& session, const std::vector<Line>& lines, bool strict) {
  bool checked = !strict;
  run_script(session, lines, [&session, &checked](const Line& line) {
    const auto& verb = line.verb.text;
    if (checked || (verb != "wait" && verb != "expect" && verb != "sleep" && verb != "quit")) return;
    checked = true;  // time passes from here on
    refuse_white_spots(session);
  });
  if (!checked && !session.finished) refuse_white_spots(session);
}

void end_host(Session& session, int code) {
  control::Request request;
  request.mutable_quit()->set_exit_code(code);
  session.call(std::move(request));
  session.finished = code;
}

/// Tells what started this process as a service that the system runs, and while it does gives it a sign of life: each
/// time that the host has given one.
class Service {
 public:
  explicit Service(Session& session) : session_(session) {
    manager_.tell("READY=1\nSTATUS=the system runs");
    if (manager_.watchdog_period()) beat();
  }
  Service(const Service&) = delete;
  Service& operator=(const Service&) = delete;
  ~Service() {
    manager_.tell("STOPPING=1");
    if (timer_) session_.reactor.cancel_timer(*timer_);
    if (asked_ && session_.connected()) session_.host().forget(*asked_);
  }

  /// What the one before was asked nobody answers.
  void host_is_back() { asked_.reset(); }

 private:
  void beat() {
    timer_ =
        session_.reactor.add_timer(std::chrono::steady_clock::now() + *manager_.watchdog_period(), [this] { beat(); });
    if (asked_ || !session_.connected()) return;  // it has not answered yet: no sign of life
    control::Request request;
    request.mutable_snapshot();
    asked_ = session_.host().begin(std::move(request), [this](const control::Reply&) {
      manager_.tell("WATCHDOG=1");
      session_.host().forget(*std::exchange(asked_, std::nullopt));
    });
  }

  Session& session_;
  const ServiceManager manager_;
  std::optional<std::uint64_t> timer_;
  std::optional<std::uint64_t> asked_;
};

/// The host that this process has started, and the one after it.
class StartedHost {
 public:
  StartedHost(Session& session, HostLaunch launch) : session_(session), launch_(std::move(launch)) { start(); }

  /// Whether one that has gone will be back: while its supervisor lives, and once more where that was killed.
  bool comes_back() {
    if (!launch_.supervised || host_->running()) return launch_.supervised;
    if (!host_->was_killed()) return false;
    host_->stop();
    launch_.restore = true;
    launch_.after_end = "its supervisor was killed";
    while (renewed_ < kMostRenewed) {
      ++renewed_;
      session_.out.remark("the supervisor was killed; it is started again");
      try {
        start();
        return true;
      } catch (const Error& problem) {
        session_.out.remark(problem.text().what);
        if (problem.code() != ErrorCode::Unreachable) return false;  // it says why it does not want to
      }
    }
    session_.out.remark(fmt::format("the supervisor was killed; it is left, after {} restarts", kMostRenewed));
    return false;
  }
  /// Waits for it, and connects to it. False: it does not come back.
  bool reconnect() {
    session_.lose_host();
    while (comes_back()) {
      session_.reactor.run_until([] { return false; }, std::chrono::steady_clock::now() + kRetryPeriod);
      if (!answers(launch_.socket)) continue;
      try {
        session_.connect({launch_.socket});
        session_.out.remark("the host is back");
        return true;
      } catch (const Error&) {  // it has gone again
      }
    }
    return false;
  }
  int stop() { return host_->stop(); }  ///< of the last one that there was
  bool ended_by_signal() const { return host_->ended_by_signal(); }

 private:
  static constexpr std::chrono::milliseconds kRetryPeriod{100};
  static constexpr int kMostRenewed = 3;

  void start() {
    host_ = std::make_unique<HostProcess>(session_.reactor, launch_,
                                          [this](const std::string& said) { session_.out.remark(said); });
  }

  Session& session_;
  HostLaunch launch_;
  std::unique_ptr<HostProcess> host_;
  int renewed_ = 0;
};

/// By this process's clock, where the system's has to begin anew. How the run has ended before, if it has.
control::Ended let_pass(Session& session, StartedHost& host, Service& service, double time_ms) {
  const SteadyTime begin = std::chrono::steady_clock::now();
  while (true) {
    const std::chrono::duration<double, std::milli> passed = std::chrono::steady_clock::now() - begin;
    control::Request request;
    request.mutable_sleep()->set_duration_ms(std::max(0.0, time_ms - passed.count()));
    try {
      session.host().call_waiting(std::move(request));
      return {};
    } catch (const RunEnded& ended) {
      return ended.end();
    } catch (const Error&) {
      if (session.connected() || !host.reconnect()) throw;
      service.host_is_back();
    }
  }
}

/// None: it went without a word, and does not come back; its own exit code tells.
std::optional<control::Reply> end_of_run(Session& session, StartedHost& host, Service& service) {
  while (true) {
    control::Request request;
    request.mutable_run();
    control::Reply ended;
    bool here = false;
    ControlClient& client = session.host();
    const std::uint64_t id = client.begin(std::move(request), [&ended, &here](const control::Reply& reply) {
      ended = reply;
      here = reply.has_ended() || reply.has_failure();
    });
    session.reactor.run_until([&here, &client] { return here || client.closed(); });
    client.forget(id);
    if (ended.has_failure()) throw_failure(ended.failure());
    if (here) return ended;
    if (!host.reconnect()) return std::nullopt;
    service.host_is_back();
  }
}

/// Of one that is told to end, or has ended.
void take_end(Session& session, const control::Ended& ended) {
  if (!ended.reason().empty()) session.out.remark(fmt::format("the run ended: {}", ended.reason()));
  session.finished = ended.exit_code();
  try {
    end_host(session, ended.exit_code());
  } catch (const Error& error) {
    // Somebody's `quit` ended the run, and the host is going already.
    if (error.code() != ErrorCode::Unreachable || ended.reason().empty()) throw;
  }
}

/// How it has ended while its lines ran; none: it has not.
std::optional<control::Ended> end_so_far(Session& session) {
  if (!session.connected()) return std::nullopt;
  control::Request look;
  look.mutable_sleep();
  try {
    session.host().call_waiting(std::move(look));
  } catch (const RunEnded& ended) {
    return ended.end();
  } catch (const Error&) {  // what went wrong before is to be told
  }
  return std::nullopt;
}

/// One that a component ends meanwhile has ended, whatever else the lines were about.
void run_lines_to_end(Session& session, const std::vector<Line>& lines, bool strict) {
  try {
    run_lines(session, lines, strict);
  } catch (const Error&) {
    const auto ended = end_so_far(session);
    if (!ended) throw;
    take_end(session, *ended);
  }
}

/// Lets the system run until a component ends it, somebody quits, or the time is over.
void run_headless(Session& session, StartedHost& host, const Word* duration, const Line& line) {
  Service service(session);
  control::Ended ended;
  if (duration != nullptr) {
    ended = let_pass(session, host, service, duration_ms(*duration, line.words));
  } else {
    session.out.remark("the system runs; Ctrl-C ends it");
    const auto reply = end_of_run(session, host, service);
    if (!reply) return;
    ended = reply->ended();
  }
  take_end(session, ended);
}

const std::map<std::string, std::string> kGroupLimits{{"--group-memory", "a number of MiB, 64 or more"},
                                                      {"--group-threads", "a number, 8 or more"},
                                                      {"--group-descriptors", "a number, 64 or more"},
                                                      {"--group-cpu", "a number of cores, 0.5 for example; 0: all"}};

HostLaunch launch_of(const Line& line, const Options& options) {
  HostLaunch launch;
  launch.supervised = line.has("--supervised");
  launch.program = sibling_program(launch.supervised ? "fiona-supervisor" : "fiona-host");
  launch.name = line.option("--host") != nullptr ? line.option("--host")->text
                : options.host.empty()           ? "main"
                                                 : options.host;
  launch.socket = socket_of(launch.name);
  launch.journal = journal_file(launch.name);
  launch.store = options.store;
  if (line.option("--listen") != nullptr) launch.listen = line.option("--listen")->text;
  for (const auto& [limit, expected] : kGroupLimits) {
    const Word* given = line.option(limit);
    if (given == nullptr) continue;
    const control::Value value = value_of(*given, line.words);
    const bool is_whole = value.kind_case() == control::Value::kInteger;
    if (!value.unit().empty() ||
        !(is_whole || (limit == "--group-cpu" && value.kind_case() == control::Value::kNumber)))
      throw line.error(*given, {.what = fmt::format("'{}' is no limit of a group", given->text), .expected = expected});
    launch.limits.insert(launch.limits.end(), {limit, given->text});
  }
  if (line.option("--serve") != nullptr) launch.serve = line.option("--serve")->text;
  if (line.option("--registry") != nullptr) launch.registry = line.option("--registry")->text;
  const auto [first, last] = line.options.equal_range("--peer");
  for (auto peer = first; peer != last; ++peer) {
    const auto& [name, value] = peer->second;
    launch.peers.push_back(name.text.empty() ? value.text : name.text + "=" + value.text);
  }
  launch.restore = line.has("--restore");
  if (answers(launch.socket)) {
    throw Error(ErrorCode::Failed,
                ErrorText{.what = fmt::format("a host '{}' runs already", launch.name),
                          .where = "unix:" + launch.socket.string(),
                          .next = fmt::format("end it: fiona --host {} quit; or choose another name: --host NAME",
                                              launch.name)});
  }
  return launch;
}

/// Packages that nobody has signed, in a store that is there as long as the host.
class UnsignedPackages {
 public:
  UnsignedPackages(const Line& line, HostLaunch& launch) : store_(unsigned_packages_of(launch.socket)) {
    std::error_code failure;
    std::filesystem::remove_all(store_, failure);  // of a host that was killed
    const Word* directory = line.option("--unsigned");
    if (directory == nullptr) return;
    std::vector<std::filesystem::path> packages;
    for (std::filesystem::directory_iterator entry{directory->text, failure};
         !failure && entry != std::filesystem::directory_iterator{}; entry.increment(failure)) {
      if (entry->path().extension() == ".fpk") packages.push_back(entry->path());
    }
    if (failure || packages.empty()) {
      throw line.error(*directory,
                       {.what = "there are no packages here",
                        .expected = "a directory with .fpk files",
                        .found = failure ? failure.message() : "",
                        .next = "plugin pack makes one"},
                       ErrorCode::NotFound);
    }
    std::sort(packages.begin(), packages.end());
    marketplace::install_unsigned(packages, store_);
    launch.unsigned_packages = store_;
  }
  UnsignedPackages(const UnsignedPackages&) = delete;
  UnsignedPackages& operator=(const UnsignedPackages&) = delete;
  ~UnsignedPackages() {
    std::error_code failure;
    std::filesystem::remove_all(store_, failure);
  }

 private:
  const std::filesystem::path store_;
};

/// Told to end by a signal: an end in order.
constexpr int kToldToEnd = 130;

/// "killed by signal 11 (Segmentation fault)", as a group's process is told of: a host's is in its exit code.
std::string end_text(int code, bool by_signal) {
  constexpr int kSignal = 128;
  if (by_signal)
    return fmt::format("the host ended on its own, killed by signal {} ({})", code - kSignal,
                       ::strsignal(code - kSignal));
  return code == kToldToEnd ? "the host was told to end, by a signal"
                            : fmt::format("the host ended on its own, with exit code {}", code);
}

}  // namespace

void run(Session& session, const Line& line) {
  if (session.setting != Setting::Shell)
    throw line.error(line.verb, {.what = "run starts a host and belongs to a shell",
                                 .next = "source FILE runs the lines in this host"});
  const Word* duration = line.option("--for");
  if (duration != nullptr) duration_ms(*duration, line.words);
  const std::vector<Line> lines = lines_to_run(line, session.options.store);
  HostLaunch launch = launch_of(line, session.options);
  const UnsignedPackages unsigned_packages(line, launch);
  StartedHost host(session, launch);
  session.connect({launch.socket});
  if (!line.positional.empty()) session.host().set_author(fmt::format("script {}", line.positional[0].text));
  if (line.positional.empty() && line.has("--restore")) session.host().set_author("restore");
  const bool attach = !line.has("--headless") && duration == nullptr && !session.out.manner.json &&
                      ::isatty(STDIN_FILENO) != 0 && ::isatty(STDOUT_FILENO) != 0;
  try {
    run_lines_to_end(session, lines, line.has("--strict"));
    std::function<bool()> comes_back;
    if (launch.supervised) comes_back = [&host] { return host.comes_back(); };
    if (!session.finished && attach)
      run_prompt(session, {.started_host = true, .let_run = true, .comes_back = comes_back});
    if (!session.finished && !attach) run_headless(session, host, duration, line);
  } catch (...) {
    session.disconnect();
    host.stop();
    throw;
  }
  session.disconnect();
  const int code = host.stop();
  if (!session.finished && code != 0)
    throw Error(code == kToldToEnd ? ErrorCode::Failed : ErrorCode::ComponentFailed,
                ErrorText{.what = end_text(code, host.ended_by_signal()),
                          .where = fmt::format("host {}", launch.name),
                          .next = "run --restore, for the system that it had; fiona doctor"});
  if (!session.finished) session.finished = code;
}

}  // namespace fiona::console::verbs
