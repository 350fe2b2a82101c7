// fiona-planner-bench [SECONDS [FOLDER]]: the symbolic planner on each problem of FOLDER ($FIONA_DATA/pddl, else
// ../shared/data/pddl), one line each, in a process of its own: time, memory, and cost as a ratio to the optimum, where
// A* finds that within SECONDS (5). Every plan is executed by a validator that shares nothing with the planner. Exit
// code 1 if any goal is short.
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <string>
#include <tuple>
#include <vector>

#include "plan_validator.hpp"
#include "planner.hpp"

namespace {

namespace fs = std::filesystem;
using fiona::planning::PlanAnswer;

constexpr double kMostSeconds = 5;
constexpr double kMostMib = 512;
constexpr double kMostRatio = 2;

struct Figures {
  bool solved = false;
  bool valid = false;
  double cost = 0;
  double seconds = 0;
  double rss_mib = 0;
};

std::string content(const fs::path& file) {
  std::ifstream stream(file, std::ios::binary);
  return {std::istreambuf_iterator<char>(stream), {}};
}

bool is_valid(const std::string& domain, const std::string& problem, const PlanAnswer& answer) {
  fiona::testing::PlanText plan;
  for (const auto& step : answer.steps) {
    std::string line = "(" + step.action;
    for (const std::string& argument : step.arguments) line += " " + argument;
    plan.push_back(line + ")");
  }
  const auto validation = fiona::testing::validate(domain, problem, plan);
  return validation.error.empty() && std::abs(validation.cost - answer.cost) < 1e-6;
}

Figures measure(const std::string& domain, const std::string& problem, bool optimal, double seconds) {
  const auto begin = std::chrono::steady_clock::now();
  const auto answer = fiona::planning::plan(
      {.domain = domain,
       .problem = problem,
       .optimal = optimal,
       .time_bound = std::chrono::duration_cast<std::chrono::nanoseconds>(std::chrono::duration<double>(seconds)),
       .memory_bound = static_cast<std::size_t>(kMostMib) << 20});
  Figures figures;
  figures.seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
  rusage usage{};
  ::getrusage(RUSAGE_SELF, &usage);
  figures.rss_mib = static_cast<double>(usage.ru_maxrss) / 1024;
  figures.solved = answer.outcome == PlanAnswer::Outcome::Solved;
  figures.cost = answer.cost;
  figures.valid = figures.solved && is_valid(domain, problem, answer);
  return figures;
}

/// In a child, whose memory is that of this planning.
Figures measure_apart(const std::string& domain, const std::string& problem, bool optimal, double seconds) {
  int ends[2];
  if (::pipe(ends) != 0) return {};
  const pid_t child = ::fork();
  if (child == 0) {
    const Figures figures = measure(domain, problem, optimal, seconds);
    ::_exit(::write(ends[1], &figures, sizeof figures) == sizeof figures ? 0 : 1);
  }
  ::close(ends[1]);
  Figures figures;
  if (::read(ends[0], &figures, sizeof figures) != sizeof figures) figures = {};
  ::close(ends[0]);
  int status = 0;
  ::waitpid(child, &status, 0);
  return figures;
}

bool report(const std::string& name, const Figures& soon, const Figures& best) {
  const bool in_time = soon.valid && soon.seconds <= kMostSeconds && soon.rss_mib <= kMostMib;
  std::printf("%-62s %6.2f s <= %.0f, %4.0f MiB <= %.0f   %-5s  cost %7.6g", name.c_str(), soon.seconds, kMostSeconds,
              soon.rss_mib, kMostMib, in_time ? "ok" : "short", soon.cost);
  bool cheap = true;
  if (best.solved) {
    cheap = best.valid && soon.cost <= kMostRatio * best.cost;
    std::printf(", optimum %7.6g after %6.2f s, ratio %.2f <= %.0f   %s\n", best.cost, best.seconds,
                best.cost > 0 ? soon.cost / best.cost : 1.0, kMostRatio, cheap ? "ok" : "short");
  } else {
    std::printf(", optimum not found in %.0f s\n", best.seconds);
  }
  std::fflush(stdout);
  return in_time && cheap;
}

std::vector<fs::path> instances_of(const fs::path& folder) {
  std::vector<fs::path> all;
  for (const auto& entry : fs::recursive_directory_iterator(folder))
    if (entry.path().filename().string().starts_with("instance-")) all.push_back(entry.path());
  std::sort(all.begin(), all.end(), [](const fs::path& a, const fs::path& b) {
    const auto key = [](const fs::path& path) {
      return std::tuple(path.parent_path(), path.filename().string().size(), path.filename());
    };
    return key(a) < key(b);
  });
  return all;
}

}  // namespace

int main(int argc, char** argv) {
  const double optimal_seconds = argc > 1 ? std::atof(argv[1]) : 5;
  const char* data = std::getenv("FIONA_DATA");
  const fs::path folder = argc > 2 ? fs::path(argv[2]) : fs::path(data ? data : "../shared/data") / "pddl";
  if (!fs::exists(folder)) {
    std::printf("planner: no planning problems at %s: set FIONA_DATA\n", folder.c_str());
    return 0;
  }
  bool ok = true;
  for (const fs::path& path : instances_of(folder)) {
    const std::string domain = content(path.parent_path() / "domain.pddl"), problem = content(path);
    const Figures soon = measure_apart(domain, problem, false, kMostSeconds);
    const Figures best = measure_apart(domain, problem, true, optimal_seconds);
    ok &= report((path.parent_path().filename() / path.stem()).string(), soon, best);
  }
  return ok ? 0 : 1;
}
