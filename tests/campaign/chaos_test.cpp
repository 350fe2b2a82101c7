// Promise R35: a host with twenty components under load, and each second a fault by chance, while all oracles look on:
// it answers; who has nothing to do with a fault notices nothing, and does not grow; nothing comes twice or in
// another's place; each question has one outcome; no old value is shown for one of now; what was hit is back in time;
// nothing grows. FIONA_CHAOS_S sets for how long, FIONA_SEED what happens.
#include <gtest/gtest.h>
#include <signal.h>

#include <algorithm>
#include <fstream>
#include <iostream>
#include <numeric>
#include <random>
#include <set>

#include <fmt/format.h>
#include <fmt/ranges.h>

#include "campaign.hpp"
#include "evidence.hpp"
#include "fiona/error.hpp"
#include "served_host.hpp"
#include "supervised_host.hpp"

namespace fiona::conformance {
namespace {

using namespace std::chrono_literals;

/// What a host promises of one that was hit: three restarts within 30 s. More than that is left, and loaded anew here.
constexpr auto kBackWithin = 8s;
constexpr double kAnswersWithin_ms = 2000;
constexpr double kGrowth_MiB = 32;
/// Of a stream of 10 ms that no fault was about.
constexpr double kCalmGap_ms = 10 + 20;
/// Of each process of that stream, which lives through the whole run: with what an allocator holds for a while.
constexpr double kCalmGrowth_MiB = 1;
constexpr double kCalmGrowth_MiB_h = 1;

/// The wall clock of all processes that are started while it lives, as far ahead of the machine's as it was told last
/// (libfaketime). No library: they have the machine's.
class SteppedClock {
 public:
  explicit SteppedClock(const std::filesystem::path& directory) : offset_(directory / "offset") {
    for (const auto& folder : std::filesystem::directory_iterator("/usr/lib")) {
      const auto library = folder.path() / "faketime" / "libfaketime.so.1";
      if (!FIONA_SANITIZED && std::filesystem::exists(library)) library_ = library;
    }
    if (library_.empty()) return;
    step(0);
    set({{"LD_PRELOAD", library_},
         {"FAKETIME_TIMESTAMP_FILE", offset_},
         {"FAKETIME_NO_CACHE", "1"},
         {"FAKETIME_DONT_FAKE_MONOTONIC", "1"},
         // A step leaves the times of files as they are. And libfaketime changes those under a lock that all processes
         // share: one that is killed while it has it would leave every other one waiting at its next look at a file.
         {"NO_FAKE_STAT", "1"}});
  }
  ~SteppedClock() { done(); }
  SteppedClock(const SteppedClock&) = delete;
  SteppedClock& operator=(const SteppedClock&) = delete;

  bool is_there() const { return !library_.empty(); }
  /// Whoever is started from now on, by this process, has the machine's.
  void done() {
    for (const std::string& name : set_) ::unsetenv(name.c_str());
    set_.clear();
  }
  void step(long seconds) const {
    const std::filesystem::path next = offset_.string() + ".new";
    std::ofstream(next) << fmt::format("{:+}\n", seconds);
    std::filesystem::rename(next, offset_);  // whole, for whoever reads meanwhile
  }

 private:
  void set(const std::map<std::string, std::string>& variables) {
    for (const auto& [name, value] : variables) {
      ::setenv(name.c_str(), value.c_str(), 1);
      set_.push_back(name);
    }
  }
  const std::filesystem::path offset_;
  std::filesystem::path library_;
  std::vector<std::string> set_;
};

/// A host with its supervisor, as `fiona run --supervised` starts it.
class HostProcess {
 public:
  explicit HostProcess(const std::filesystem::path& directory) : directory_(directory / "host"), clock_(directory) {
    start();
    clock_.done();
  }
  const SteppedClock& clock() const { return clock_; }
  ~HostProcess() {
    lifeline_.reset();
    const auto end = Steady::now() + 30s;
    while (lives() && Steady::now() < end) std::this_thread::sleep_for(2ms);
  }
  HostProcess(const HostProcess&) = delete;
  HostProcess& operator=(const HostProcess&) = delete;

  /// The host; 0: there is none now.
  pid_t id() const {
    for (const pid_t child : SupervisedHost::children_of(supervisor_->id())) {
      std::ifstream file("/proc/" + std::to_string(child) + "/comm");
      std::string name;
      if (std::getline(file, name) && name == "fiona-host") return child;
    }
    return 0;
  }
  bool lives() const { return supervisor_->end().empty(); }
  std::string end() const { return supervisor_->end(); }
  /// What all processes are doing, and what they have said: for when nothing comes of them.
  std::string evidence() const {
    const std::string doing = evidence_of(supervisor_->id());
    return doing + end() + "\n" + last_words();  // with what has been said since
  }
  std::filesystem::path socket() const { return directory_ / "chaos.sock"; }
  std::string last_words() const {
    std::ifstream file(directory_ / "said");
    std::string text{std::istreambuf_iterator<char>(file), {}};
    return text.substr(text.size() - std::min<std::size_t>(text.size(), 4000));
  }

 private:
  void start() {
    os::require_private_directory(directory_);
    int ends[2];
    if (::pipe2(ends, O_CLOEXEC) != 0) throw std::runtime_error("no pipe");
    const os::Descriptor ready(ends[0]);
    os::Descriptor theirs(ends[1]);
    if (::pipe2(ends, O_CLOEXEC) != 0) throw std::runtime_error("no pipe");
    const os::Descriptor lifeline(ends[0]);
    lifeline_ = os::Descriptor(ends[1]);
    const os::Descriptor log(::open((directory_ / "said").c_str(), O_WRONLY | O_CREAT | O_APPEND | O_CLOEXEC, 0600));
    const std::vector<std::string> words{"--name",         "chaos",
                                         "--socket",       socket().string(),
                                         "--store",        (directory_ / "store").string(),
                                         "--threads",      "2",
                                         "--ready-fd",     "3",
                                         "--lifeline-fd",  "4",
                                         "--group-memory", FIONA_SANITIZED ? "4096" : "256"};
    supervisor_ = std::make_unique<os::ChildProcess>(
        os::program_directory() / "fiona-supervisor", words,
        std::vector<std::pair<int, int>>{{log.get(), 2}, {theirs.get(), 3}, {lifeline.get(), 4}});
    theirs.reset();
    std::string told;
    char chunk[256];
    for (ssize_t count = 0; (count = ::read(ready.get(), chunk, sizeof chunk)) > 0;)
      told.append(chunk, static_cast<std::size_t>(count));
    if (!told.starts_with("READY")) throw std::runtime_error("the host did not start: " + told + last_words());
  }

  const std::filesystem::path directory_;
  SteppedClock clock_;
  os::Descriptor lifeline_;
  std::unique_ptr<os::ChildProcess> supervisor_;
};

struct Place {
  std::string component;
  std::string name;
  std::string group;
  std::string parameters;
};

class Chaos : public testing::Test {
 protected:
  static constexpr int kTickers = 5;
  static constexpr int kWitnesses = 6;
  static constexpr int kStations = 2;

  Chaos() {
    RecordProperty("seed", static_cast<int>(seed));
    std::cout << "seed " << seed << "\n";
    for (int i = 0; i < kTickers; ++i)
      places.push_back({"ticker", fmt::format("t{}", i), fmt::format("gt{}", i), fmt::format("source={}", i)});
    for (int i = 0; i < kWitnesses; ++i)
      places.push_back({"witness", fmt::format("w{}", i), i < 2 ? "main" : fmt::format("gw{}", i), ""});
    for (int i = 0; i < kStations; ++i) {
      places.push_back({"station", fmt::format("s{}", i), fmt::format("gs{}", i), ""});
      places.push_back({"lookout", fmt::format("l{}", i), i == 0 ? "main" : "gl1", ""});
    }
    places.push_back({"source", "pours", "gp", ""});
    places.push_back({"sink", "drinks", "gd", ""});
    places.push_back({"ticker", "calm_t", "calm_a", "source=99"});
    places.push_back({"witness", "calm_w", "calm_b", ""});
    for (const Place& place : places) console->load(place.component, place.group, place.name, place.parameters);
    for (int i = 0; i < kWitnesses; ++i) wire_witness(i, i % kTickers);
    for (int i = 0; i < kStations; ++i) {
      for (const std::string port : {"timed", "samples", "echo"})
        wire(fmt::format("l{}.{}", i, port), fmt::format("s{}.{}", i, port));
    }
    wire("drinks.each", "pours.newest");
    wire("calm_w.samples", "calm_t.samples");
    wire("calm_w.echo", "calm_t.echo");
    build_version(1);
    control::Change load;
    load.mutable_load()->set_plugin((directory.path / "libversioned.so").string());
    load.mutable_load()->set_instance("x");
    load.mutable_load()->set_group("gx");
    console->change(load);
    wire("w0.samples", "x.samples");
    wire("w0.echo", "x.echo");
    for (const Place& place : places) {
      if (place.component == "witness") console->set(place.name, "asks=true");  // now that there is somebody to ask
    }
  }
  int pick(int below) { return std::uniform_int_distribution<int>(0, below - 1)(random); }
  template <class List>
  const auto& one_of(const List& list) {
    return list[static_cast<std::size_t>(pick(static_cast<int>(list.size())))];
  }
  void wire(const std::string& client, const std::string& provider) {
    console->change(TestConsole::wire_of(client, provider));
  }
  void wire_witness(int witness, int ticker) {
    wire(fmt::format("w{}.samples", witness), fmt::format("t{}.samples", ticker));
    wire(fmt::format("w{}.echo", witness), fmt::format("t{}.echo", ticker));
  }
  void build_version(int version, const std::string& behaviour = "") {
    const std::filesystem::path from(VERSIONS_DIRECTORY);
    std::filesystem::copy_file(from / "libversioned.so", directory.path / "next");
    std::filesystem::rename(directory.path / "next", directory.path / "libversioned.so");
    std::filesystem::copy_file(from / "versioned.interface.textproto", directory.path / "versioned.interface.textproto",
                               std::filesystem::copy_options::overwrite_existing);
    std::filesystem::create_directories(directory.path / "versioned.share");
    std::ofstream(directory.path / "versioned.share" / "behaviour") << "version=" << 100 + version << " " << behaviour;
  }
  /// What a fault does to a change is that it may be refused; the sentence must say why.
  void attempt(const std::function<void()>& work) {
    try {
      work();
    } catch (const Error& error) {
      ++refused;
      EXPECT_FALSE(error.text().what.empty());
    }
  }
  Told ask(const std::string& instance, const std::string& trigger, const std::string& manner = "") {
    auto request = console->request();
    *request.mutable_call()->mutable_target() = port_name(instance + "." + trigger);
    request.mutable_call()->set_within_ms(5000);
    if (!manner.empty()) add_arguments("manner=" + manner, *request.mutable_call()->mutable_arguments());
    const auto reply = console->ask(request);
    if (reply.called().outcome() != "ok")
      throw Error(ErrorCode::Failed, instance + "." + trigger + ": " + reply.called().outcome());
    return Told(reply.called().result());
  }
  pid_t process_of(const std::string& group) {
    const auto system = console->snapshot();
    for (const auto& one : system.groups()) {
      if (one.name() == group && one.alive()) return one.process();
    }
    return 0;
  }
  void signal(const std::string& group, int number) {
    if (const pid_t process = process_of(group); process > 0) ::kill(process, number);
  }

  // ---- faults
  void kill_a_group() { signal(one_of(targets()), SIGKILL); }
  void stop_for_a_moment() {
    const std::string group = one_of(targets());
    const pid_t process = process_of(group);
    if (process <= 0) return;
    ::kill(process, SIGSTOP);
    std::this_thread::sleep_for(std::chrono::milliseconds(100 + pick(300)));
    ::kill(process, SIGCONT);
  }
  void stop_for_good() { signal(one_of(targets()), SIGSTOP); }
  void rewire() { wire_witness(pick(kWitnesses), pick(kTickers)); }
  void swap() {
    const int one = pick(kTickers);
    console->change(TestConsole::swap_of(fmt::format("t{}", one), fmt::format("t{}", (one + 1) % kTickers)));
  }
  void reload() {
    const Place place = places[static_cast<std::size_t>(pick(kTickers))];
    console->unload(place.name);
    console->load(place.component, place.group, place.name, place.parameters);
  }
  void storm_of_parameters() {
    const std::string ticker = fmt::format("t{}", pick(kTickers));
    for (int i = 0; i < 100; ++i) console->set(ticker, fmt::format("period_ms={}", 5 + i % 20));
    console->set(ticker, "period_ms=10");
  }
  void slow_handler() {
    console->set("drinks", "work_ms=300");
    std::this_thread::sleep_for(500ms);
    console->set("drinks", "work_ms=0");
  }
  void full_link() {
    console->set("pours", "payload=1000000 period_ms=2");
    std::this_thread::sleep_for(500ms);
    console->set("pours", "payload=0 period_ms=5");
  }
  void guest(const std::string& animal) {
    control::Change load;
    load.mutable_load()->set_plugin(std::string(ZOO_DIRECTORY) + "/lib" + animal + ".so");
    load.mutable_load()->set_instance("guest");
    load.mutable_load()->set_group("guests");
    console->change(load);
    std::this_thread::sleep_for(200ms);
    console->unload("guest");
  }
  void hang() { guest("loops"); }
  void storm_of_allocations() { guest(FIONA_SANITIZED ? "floods-log" : "leaks"); }
  void fill_the_table_of_descriptors() { guest(FIONA_SANITIZED ? "floods-stderr" : "leaks-descriptors"); }
  void console_that_dies() {
    TestConsole other(host.socket());
    auto watch = other.request();
    *watch.mutable_watch()->mutable_port() = port_name("calm_t.samples");
    other.send(watch);
    auto wait = other.request();
    wait.mutable_sleep()->set_duration_ms(100'000);
    other.send(wait);
  }
  void console_that_does_not_read() {
    deaf = std::make_unique<TestConsole>(host.socket());
    auto watch = deaf->request();
    *watch.mutable_watch()->mutable_port() = port_name("pours.newest");
    deaf->send(watch);
  }
  void upgrade() {
    static const std::vector<std::string> kBad{"",          "",        "dies_when_opened=1", "dies_after_ms=700",
                                               "refuses=1", "silent=1"};
    build_version(1 + pick(9), one_of(kBad));
    control::Change change;
    change.mutable_upgrade()->set_instance("x");
    change.mutable_upgrade()->set_watch_ms(1500);
    console->change(std::move(change));
  }
  /// Of a host other than this one, once it answers.
  std::unique_ptr<TestConsole> console_of_host(pid_t before) const {
    for (const auto end = Steady::now() + 30s; Steady::now() < end; std::this_thread::sleep_for(1ms)) {
      if (const pid_t now = host.id(); now == 0 || now == before) continue;
      try {
        auto made = std::make_unique<TestConsole>(host.socket());
        made->snapshot();
        return made;
      } catch (const std::runtime_error&) {  // not yet
      }
    }
    throw std::runtime_error("no host came within 30 s");
  }
  /// Not so often that its supervisor leaves it: three times within 30 s.
  void kill_the_host() {
    if (Steady::now() - host_killed < 15s) {
      --made["kill the host"];
      ++made["kill"];
      return kill_a_group();
    }
    const pid_t before = host.id();
    ::kill(before, SIGKILL);
    console = console_of_host(before);
    host_killed = Steady::now();
    is_warm = false;  // another process
  }
  void step_of_the_wall_clock() {
    constexpr long kHour_s = 3600, kTenYears_s = 10L * 365 * 24 * kHour_s;
    static const std::vector<long> kSteps{kHour_s, -kHour_s, kTenYears_s, -kTenYears_s, 0};
    host.clock().step(one_of(kSteps));
  }
  struct Fault {
    const char* name;
    void (Chaos::*make)();
  };
  std::vector<Fault> faults() const {
    std::vector<Fault> all{{"kill", &Chaos::kill_a_group},
                           {"stop for a moment", &Chaos::stop_for_a_moment},
                           {"stop for good", &Chaos::stop_for_good},
                           {"rewire", &Chaos::rewire},
                           {"swap", &Chaos::swap},
                           {"reload", &Chaos::reload},
                           {"storm of parameters", &Chaos::storm_of_parameters},
                           {"slow handler", &Chaos::slow_handler},
                           {"full link", &Chaos::full_link},
                           {"hang", &Chaos::hang},
                           {"storm of allocations", &Chaos::storm_of_allocations},
                           {"all descriptors", &Chaos::fill_the_table_of_descriptors},
                           {"console that dies", &Chaos::console_that_dies},
                           {"console that does not read", &Chaos::console_that_does_not_read},
                           {"upgrade", &Chaos::upgrade},
                           {"kill the host", &Chaos::kill_the_host}};
    if (host.clock().is_there()) all.push_back({"step of the wall clock", &Chaos::step_of_the_wall_clock});
    return all;
  }
  /// Groups that a fault may hit: not those of the calm pair.
  std::vector<std::string> targets() const {
    std::vector<std::string> groups;
    for (const Place& place : places) {
      if (place.group != "main" && !place.group.starts_with("calm")) groups.push_back(place.group);
    }
    return groups;
  }

  // ---- oracles
  void expect_an_answer() {
    const auto begun = Steady::now();
    console->snapshot();
    const double took_ms = std::chrono::duration<double, std::milli>(Steady::now() - begun).count();
    longest_answer_ms = std::max(longest_answer_ms, took_ms);
    EXPECT_LE(took_ms, allowed(kAnswersWithin_ms, full)) << "of the host, to a look at the system";
  }
  void expect_calm() {
    const Told told = ask("calm_w", "testify");
    const Seen seen = told.seen();
    EXPECT_EQ(seen.number("backward"), 0U);
    EXPECT_EQ(seen.messages("runs").size(), 1U) << "there is a gap, or another's samples, where no fault was";
    const auto outcomes = seen.numbers("outcomes");
    const std::uint64_t ok = outcomes.empty() ? 0 : outcomes.front();
    EXPECT_EQ(ok + seen.number("open"), seen.number("asked")) << fmt::format("{}", fmt::join(outcomes, ", "));
    EXPECT_EQ(seen.number("wrong"), 0U);
    longest_gap_ms = std::max(longest_gap_ms, seen.real("longest_gap_ms"));
    EXPECT_LE(longest_gap_ms, allowed(kCalmGap_ms, full) + pulse.longest_ms()) << "of a stream that no fault was about";
  }
  static void expect_one_outcome_each(const Seen& seen, const std::string& witness) {
    const auto outcomes = seen.numbers("outcomes");
    const std::uint64_t ended = std::accumulate(outcomes.begin(), outcomes.end(), std::uint64_t{0});
    EXPECT_EQ(ended + seen.number("open"), seen.number("asked")) << witness;
  }
  /// Of those that are there: one that has just been hit is looked at another time.
  void expect_no_doubles_and_nothing_old() {
    for (const Place& place : places) {
      attempt([&] {
        if (place.component == "witness") {
          const Told told = ask(place.name, "testify");
          EXPECT_EQ(told.seen().number("backward"), 0U) << place.name << ": doubled, or out of order";
          EXPECT_EQ(told.seen().number("wrong"), 0U) << place.name << ": another's answer";
          expect_one_outcome_each(told.seen(), place.name);
          witnessed += told.seen().number("asked") > 0 ? 1 : 0;
        }
        if (place.component == "lookout") {
          const Told told = ask(place.name, "testify", "forget");
          EXPECT_LE(told.seen().real("oldest_shown_ms"), kTwoPeriods_ms + pulse.longest_ms())
              << place.name << " was given an old value for one of now";
          oldest_shown_ms = std::max(oldest_shown_ms, told.seen().real("oldest_shown_ms"));
        }
      });
    }
  }
  /// Questions have 2 s: once nobody asks any more, none is left without an outcome.
  void expect_no_open_questions() {
    for (const Place& place : places) {
      if (place.component == "witness") console->set(place.name, "asks=false");
    }
    for (const Place& place : places) {
      if (place.component != "witness") continue;
      std::uint64_t open = 1;
      for (const auto end = Steady::now() + 5s; open > 0 && Steady::now() < end;) {
        const Told told = ask(place.name, "testify");
        open = told.seen().number("open");
        expect_one_outcome_each(told.seen(), place.name);
      }
      EXPECT_EQ(open, 0U) << place.name << ": questions without an outcome";
    }
  }
  /// Who was not let go of when it was asked for: its group was just ending, or did not answer.
  void send_guests_away() {
    const auto system = console->snapshot();
    for (const auto& one : system.instances()) {
      if (one.name() == "guest") attempt([&] { console->unload("guest"); });
    }
  }
  /// As an operator does: what was left after too many ends is loaded anew. All must be well then.
  void heal() {
    deaf.reset();
    send_guests_away();
    for (const Place& place : places) {
      if (console->instance(place.name).reason().find("left") == std::string::npos) continue;
      console->unload(place.name);
      console->load(place.component, place.group, place.name, place.parameters);
      ++loaded_anew;
    }
    std::string ill;
    const auto end = Steady::now() + std::chrono::seconds(static_cast<int>(allowed(kBackWithin.count(), full)));
    do {
      ill = what_is_ill();
    } while (!ill.empty() && Steady::now() < end);
    EXPECT_EQ(ill, "") << "not back in time\n" << host.evidence();
  }
  std::string what_is_ill() {
    const auto system = console->snapshot();
    for (const auto& one : system.instances()) {
      if (one.mode() != "active") return fmt::format("{} is {}: {}", one.name(), one.mode(), one.reason());
      for (const auto& port : one.ports()) {
        if (port.direction() == fiona::REQUIRES && port.connection() != control::CONNECTED && !port.optional() &&
            port.connection() != control::UNWIRED)
          return fmt::format("{}.{} is not connected: {}", one.name(), port.name(), port.reason());
      }
    }
    return "";
  }
  void look_on_at(const Fault& fault, int second) {
    attempt([&] { (this->*fault.make)(); });
    ASSERT_TRUE(host.lives()) << host.end() << "\n" << host.last_words();
    expect_an_answer();
    expect_calm();
    if (second % 10 != 9) return;
    expect_no_doubles_and_nothing_old();
    heal();
  }
  Holdings held_by_host() { return holdings({host.id()}); }
  /// Of the stream that no fault is about: they live through the whole run.
  std::map<pid_t, Holdings> held_by_calm() {
    std::map<pid_t, Holdings> all;
    for (const std::string group : {"calm_a", "calm_b"}) all[process_of(group)] = holdings({process_of(group)});
    return all;
  }
  std::string expect_calm_has_not_grown(std::chrono::duration<double, std::ratio<3600>> time) const {
    std::string text;
    for (const auto& [process, before] : warm_calm) {
      const Holdings now = holdings({process});
      const double growth_mib = now.resident_mib - before.resident_mib;
      text += fmt::format("{:.1f} MiB {:+.2f}, descriptors {} {:+d}, threads {} {:+d}; ", before.resident_mib,
                          growth_mib, before.descriptors, now.descriptors - before.descriptors, before.threads,
                          now.threads - before.threads);
      EXPECT_GT(now.threads, 0) << "it has ended";
      EXPECT_LE(now.threads, before.threads);
      EXPECT_LE(now.descriptors, before.descriptors);
      if (!kKeepsWhatIsFreed) {
        EXPECT_LE(growth_mib, kCalmGrowth_MiB + kCalmGrowth_MiB_h * time.count());
      }
    }
    return text;
  }

  const unsigned seed =
      static_cast<unsigned>(number_from("FIONA_SEED", static_cast<int>(std::random_device{}() % 1'000'000)));
  std::mt19937 random{seed};
  const int seconds = number_from("FIONA_CHAOS_S", 60);
  const bool full = number_from("FIONA_CHAOS_S", 0) > 0;
  const TemporaryDirectory directory;
  HostProcess host{directory.path};
  std::unique_ptr<TestConsole> console = console_of_host(0);
  std::unique_ptr<TestConsole> deaf;
  std::vector<Place> places;
  Pulse pulse;
  std::map<std::string, int> made;
  Steady::time_point host_killed{};
  Holdings warm;
  bool is_warm = false;
  std::map<pid_t, Holdings> warm_calm;
  Steady::time_point calm_warm{};
  int refused = 0;
  int loaded_anew = 0;
  std::uint64_t witnessed = 0;
  double longest_answer_ms = 0;
  double longest_gap_ms = 0;
  double oldest_shown_ms = 0;
};

TEST_F(Chaos, HurtsNobodyButWhomItHitsAndTheyComeBack) {
  heal();
  const auto begun = Steady::now();
  for (int second = 0; second < seconds && !HasFailure(); ++second) {
    const auto all = faults();
    const Fault& fault = one_of(all);
    ++made[fault.name];
    SCOPED_TRACE(fmt::format("seed {}, second {}: {}", seed, second, fault.name));
    try {
      look_on_at(fault, second);
    } catch (const std::exception& error) {
      FAIL() << error.what() << "\n" << host.evidence();
    }
    if (second % 10 != 9) std::this_thread::sleep_until(begun + std::chrono::seconds(second + 1));
    if (!is_warm && second % 10 == 9 && second >= std::min(seconds / 3, 600)) {
      warm = held_by_host();
      is_warm = true;
      if (warm_calm.empty()) {
        warm_calm = held_by_calm();
        calm_warm = Steady::now();
      }
    }
  }
  heal();
  expect_calm();
  expect_no_doubles_and_nothing_old();
  expect_no_open_questions();
  const std::string calm_grew =
      warm_calm.empty() ? "not looked at; " : expect_calm_has_not_grown(Steady::now() - calm_warm);
  const Holdings after = held_by_host();
  EXPECT_GT(witnessed, 0U);
  if (is_warm) {
    EXPECT_LE(after.threads, warm.threads);
    EXPECT_LE(after.descriptors, warm.descriptors + 8) << "of the host; a group more has four";
  }
  if (is_warm && !kKeepsWhatIsFreed) {
    EXPECT_LT(after.resident_mib - warm.resident_mib, kGrowth_MiB);
  }
  std::vector<std::string> texts;
  for (const auto& [name, count] : made) texts.push_back(fmt::format("{} {}", count, name));
  std::cout << fmt::format(
      "{} s (seed {}): {}; {} changes were refused, {} instances loaded anew; the host answered within {:.0f} ms; "
      "longest gap of a stream of 10 ms that no fault was about {:.1f} ms; its processes {}oldest value given for "
      "one of now {:.1f} "
      "ms; "
      "the host's descriptors {} {:+d}, threads {} {:+d}, memory {:.1f} MiB {:+.1f}; the machine stood still for "
      "{:.0f} "
      "ms at most\n",
      seconds, seed, fmt::join(texts, ", "), refused, loaded_anew, longest_answer_ms, longest_gap_ms, calm_grew,
      oldest_shown_ms, warm.descriptors, after.descriptors - warm.descriptors, warm.threads,
      after.threads - warm.threads, warm.resident_mib, after.resident_mib - warm.resident_mib, pulse.longest_ms());
}

TEST(SteppedClock, OneThatIsKilledWhileItLooksAtAFileKeepsNobodyElseWaiting) {
  if (const char* how_often = std::getenv("FIONA_LOOKS")) {  // this test in the processes that it starts below
    bool there = true;
    do there = std::filesystem::exists("/");
    while (there && how_often == std::string("for ever"));
    return;
  }
  const TemporaryDirectory directory;
  const SteppedClock clock(directory.path);
  if (!clock.is_there()) GTEST_SKIP() << "no libfaketime (apt-get install libfaketime)";
  // What the processes of a system share is what the first one has handed on: here the shell.
  const std::string script =
      "looks() { FIONA_LOOKS=$1 timeout -s KILL $2 $0 --gtest_filter='SteppedClock.*' >/dev/null 2>&1; }\n"
      "for i in 1 2 3 4 5; do looks 'for ever' 0.3; done\n"
      "looks once 10\n";
  os::ChildProcess shell("/bin/sh", {"-c", script, std::filesystem::read_symlink("/proc/self/exe").string()}, {});
  for (const auto end = Steady::now() + 30s; shell.end().empty() && Steady::now() < end;)
    std::this_thread::sleep_for(2ms);
  EXPECT_EQ(shell.end(), "exited with code 0");
}

}  // namespace
}  // namespace fiona::conformance
