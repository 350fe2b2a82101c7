// Plugins that misbehave once they are opened: what each does to its group, what is said of it, and that nobody else
// notices. Those that are refused before that are in load_test.cpp.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fcntl.h>
#include <linux/landlock.h>
#include <sched.h>
#include <signal.h>
#include <sys/resource.h>
#include <sys/socket.h>
#include <sys/syscall.h>
#include <sys/un.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <filesystem>
#include <fstream>
#include <optional>
#include <sstream>
#include <vector>

#include "../ends_as_without_sanitizer.hpp"
#include "fiona/error.hpp"
#include "os/control_group.hpp"
#include "system_fixture.hpp"
#include "trial.hpp"

namespace fiona::host {
namespace {

using namespace std::chrono_literals;
using conformance::RunningSystem;
using testing::HasSubstr;
using testing::IsSupersetOf;
using testing::StartsWith;

struct Animal {
  std::string library;
  std::string sentence;
};
void PrintTo(const Animal& animal, std::ostream* out) { *out << animal.library; }

std::string name_of(const testing::TestParamInfo<Animal>& tested) {
  std::string name = tested.param.library;
  std::erase_if(name, [](char c) { return c == '-' || c == '/'; });
  return name;
}

class ZooGroup : public testing::TestWithParam<Animal> {
 protected:
  ZooGroup() {
    tests::end_as_without_sanitizer();
    system.load_in("", "source", "source", "period_ms=1");
    system.load_in("", "sink", "sink");
    system.wire("sink.each", "source.newest");
  }
  std::optional<Error> load(const std::string& library, const std::string& group, const std::string& rights = "") {
    return load_path(std::string(ZOO_DIRECTORY) + "/lib" + library, group, rights);
  }
  std::optional<Error> load_path(const std::string& path, const std::string& group, const std::string& rights) {
    control::Change change;
    control::Load& request = *change.mutable_load();
    request.set_plugin(path);
    request.set_instance("patient");
    request.set_group(group);
    std::istringstream words(rights);
    for (std::string right; words >> right;) request.add_rights(right);
    try {
      system.system().perform(change);
    } catch (const Error& error) {
      return error;
    }
    return std::nullopt;
  }
  /// Promise R4: refused within 2 s. The machine does other things as well.
  static void expect_in_time(std::chrono::steady_clock::time_point asked) {
    const double took_s = std::chrono::duration<double>(std::chrono::steady_clock::now() - asked).count();
    const double bound_s = os::kLimitsMemory ? 3 * 2.0 : 6 * 2.0;
    std::printf("refused after %.2f s (promised 2 s, asked here %.0f s)\n", took_s, bound_s);
    EXPECT_LT(took_s, bound_s);
  }
  void await_reason(const std::string& sentence) {
    system.eventually("its end", [&] { return system.instance("patient").mode() == "failed"; });
    EXPECT_THAT(system.instance("patient").reason(), HasSubstr(sentence));
  }
  void expect_others_go_on() {
    EXPECT_EQ(system.instance("source").mode(), "active");
    const auto before = system.port("sink.each");
    system.eventually("more messages", [&] { return system.port("sink.each").messages() > before.messages() + 5; });
    EXPECT_EQ(system.port("sink.each").dropped(), before.dropped());
  }

  RunningSystem system{RunningSystem::EndsHungGroups(),
                       os::Limits{.memory = 256U << 20U, .threads = 64, .descriptors = 200, .cores = 0.5}};
};

// ---- they end their process, or have to be ended --------------------------------------------------------------

class ZooDeath : public ZooGroup {};

TEST_P(ZooDeath, OfAGroupIsSaidAndHurtsNobodyElse) {
  ASSERT_EQ(load(GetParam().library + ".so", "cage"), std::nullopt);
  await_reason(GetParam().sentence);
  expect_others_go_on();
  system.unload("patient");
}

constexpr const char* kSegmentation = "group 'cage' killed by signal 11 (Segmentation fault)";
constexpr const char* kAborted = "group 'cage' killed by signal 6 (Aborted)";
constexpr const char* kStuck = "group 'cage' was ended: 'patient' was stuck for ";

INSTANTIATE_TEST_SUITE_P(Each, ZooDeath,
                         testing::Values(Animal{"reads-nowhere", kSegmentation},
                                         Animal{"overflows-stack", kSegmentation}, Animal{"aborts", kAborted},
                                         Animal{"frees-twice", kAborted}, Animal{"throws-from-thread", kAborted},
                                         Animal{"exits", "group 'cage' exited with code 0"},
                                         Animal{"kills-itself", "group 'cage' killed by signal 9 (Killed)"},
                                         Animal{"loops", kStuck}, Animal{"locks-itself-out", kStuck},
                                         Animal{"ignores-sigterm", kStuck},
                                         Animal{"stops-itself", "group 'cage' was ended: it stood still for "}),
                         name_of);

// ---- they do not get as far as that ---------------------------------------------------------------------------

class ZooLoad : public ZooGroup {};

TEST_P(ZooLoad, IntoAGroupIsRefusedAndLeavesNothing) {
  const auto asked = std::chrono::steady_clock::now();
  const auto error = load(GetParam().library + ".so", "cage");
  expect_in_time(asked);
  ASSERT_TRUE(error.has_value()) << "it was loaded";
  EXPECT_EQ(error->text().what, "plugin 'local/" + GetParam().library + "' has ended group 'cage' while it was loaded");
  EXPECT_THAT(error->text().found, HasSubstr(GetParam().sentence));
  EXPECT_EQ(error->text().next, "tell the publisher");
  const auto snapshot = system.system().snapshot();
  EXPECT_EQ(snapshot.instances_size(), 2);
  EXPECT_EQ(snapshot.groups_size(), 1);
  expect_others_go_on();
}

INSTANTIATE_TEST_SUITE_P(Each, ZooLoad,
                         testing::Values(Animal{"traps-when-opened", "killed by signal 11 (Segmentation fault)"},
                                         Animal{"exits-when-opened", "exited with code 0"},
                                         Animal{"hangs-when-opened", "'patient' was stuck in its library for "},
                                         Animal{"blocks-in-constructor",
                                                "'patient' was stuck in its constructor for "}),
                         name_of);

class ZooTrial : public ZooGroup {};

TEST_P(ZooTrial, KeepsFromMainWhatEndsAProcessWhenItIsOpened) {
  for (int time = 0; time < 2; ++time) {
    const auto asked = std::chrono::steady_clock::now();
    const auto error = load(GetParam().library + ".so", "");
    expect_in_time(asked);
    ASSERT_TRUE(error.has_value()) << "it was loaded";
    EXPECT_THAT(error->text().what,
                HasSubstr("plugin 'local/" + GetParam().library + "' cannot be loaded: " + GetParam().sentence));
    EXPECT_EQ(error->text().next, "tell the publisher");
  }
  expect_others_go_on();
}

INSTANTIATE_TEST_SUITE_P(
    Each, ZooTrial,
    testing::Values(Animal{"traps-when-opened",
                           "opening it ends the process: a static constructor killed by signal 11"},
                    Animal{"throws-when-opened", "a static constructor of it throws: a static constructor throws"},
                    Animal{"exits-when-opened", "opening it ends the process: a static constructor exited with code 0"},
                    Animal{"hangs-when-opened", "opening it does not come to an end: a static constructor hangs"}),
    name_of);

/// A plugin beside a library of messages that it needs, both of them copies.
class ZooTrialVerdict : public testing::Test {
 protected:
  ZooTrialVerdict() {
    put("libzoo-poses.so", "messages-1/libzoo-poses.so");
    put("libpose-reader.so", "messages-1/libpose-reader.so");
  }
  void put(const std::string& name, const std::string& built) const {
    std::filesystem::remove(directory.path / name);
    std::filesystem::copy_file(std::filesystem::path(ZOO_DIRECTORY) / built, directory.path / name);
  }
  std::string verdict() {
    PluginLibraries::Files files;
    for (const std::string name : {"libzoo-poses.so", "libpose-reader.so"})
      files.Add()->set_path((directory.path / name).string());
    try {
      trials.require("zoo/pose-reader", files);
    } catch (const Error& error) {
      return error.text().what;
    }
    return "";
  }

  const conformance::TemporaryDirectory directory;
  Trials trials;
};

/// Processes that want to run all the time on the one processor that this thread, and what it starts, has meanwhile.
class Crowd {
 public:
  explicit Crowd(int many) {
    ::sched_getaffinity(0, sizeof before_, &before_);
    cpu_set_t one;
    CPU_ZERO(&one);
    for (int cpu = 0; CPU_COUNT(&one) == 0; ++cpu) {
      if (CPU_ISSET(cpu, &before_)) CPU_SET(cpu, &one);
    }
    ::sched_setaffinity(0, sizeof one, &one);
    for (int i = 0; i < many; ++i) {
      processes_.push_back(::fork());
      for (volatile bool spins = true; processes_.back() == 0 && spins;) continue;
    }
  }
  ~Crowd() {
    for (const pid_t process : processes_) ::kill(process, SIGKILL);
    for (const pid_t process : processes_) ::waitpid(process, nullptr, 0);
    ::sched_setaffinity(0, sizeof before_, &before_);
  }
  Crowd(const Crowd&) = delete;
  Crowd& operator=(const Crowd&) = delete;

 private:
  cpu_set_t before_{};
  std::vector<pid_t> processes_;
};

TEST_F(ZooTrialVerdict, DoesNotCountWhatTheTrialHasWaitedForAProcessor) {
  constexpr auto kLonger = 2 * Trials::kWithin;
  const auto begun = std::chrono::steady_clock::now();
  ASSERT_EQ(verdict(), "");
  const auto alone = std::chrono::steady_clock::now() - begun;
  put("libpose-reader.so", "messages-1/libpose-reader.so");  // another file: it is tried again
  const Crowd crowd(static_cast<int>(std::clamp<std::int64_t>(kLonger / alone, 2, 200)));
  EXPECT_EQ(verdict(), "");
}

TEST_F(ZooTrialVerdict, IsDroppedWhenTheLibraryChanges) {
  EXPECT_EQ(verdict(), "");
  put("libpose-reader.so", "libtraps-when-opened.so");
  EXPECT_THAT(verdict(), HasSubstr("opening it ends the process"));
  put("libpose-reader.so", "messages-1/libpose-reader.so");
  EXPECT_EQ(verdict(), "");
}

TEST_F(ZooTrialVerdict, IsDroppedWhenTheMessagesChangeThatItIsLinkedWith) {
  EXPECT_EQ(verdict(), "");
  put("libzoo-poses.so", "libtraps-when-opened.so");
  EXPECT_THAT(verdict(), HasSubstr("opening it ends the process"));
  put("libzoo-poses.so", "messages-1/libzoo-poses.so");
  EXPECT_EQ(verdict(), "");
}

TEST_F(ZooGroup, ThatThrowsWhenItIsOpenedIsRefusedWithWhatItThrew) {
  const auto error = load("throws-when-opened.so", "cage");
  ASSERT_TRUE(error.has_value());
  EXPECT_EQ(
      error->text().what,
      "plugin 'local/throws-when-opened' cannot be loaded: a static constructor of it throws: a static constructor "
      "throws");
}

TEST_F(ZooGroup, ThatEndsLeavesItsLastWordsInTheReason) {
  ASSERT_EQ(load("says-why.so", "cage"), std::nullopt);
  await_reason("group 'cage' killed by signal 6 (Aborted); it wrote: the lens is dirty | cannot go on");
}

TEST_F(ZooGroup, ThatBlocksInItsDestructorIsEndedAndItsUnloadSucceeds) {
  ASSERT_EQ(load("blocks-in-destructor.so", "cage"), std::nullopt);
  system.load_in("cage", "source", "other");
  system.unload("patient");
  system.eventually("its end", [&] { return system.instance("other").mode() == "failed"; });
  EXPECT_THAT(system.instance("other").reason(),
              HasSubstr("group 'cage' was ended: 'patient' was stuck in its destructor for "));
  expect_others_go_on();
}

TEST_F(ZooGroup, ThatEndsItsThreadIsNamedAndItsGroupEnded) {
  ASSERT_EQ(load("leaves-its-thread.so", "cage"), std::nullopt);
  await_reason("has ended the thread that it was called on (pthread_exit, or a cancellation)");
  system.eventually("its group's end", [&] { return !system.group("cage").alive(); });
  EXPECT_THAT(system.instance("patient").reason(), HasSubstr("group 'cage' was ended: 'patient' was stuck for "));
  EXPECT_THAT(system.instance("patient").reason(), HasSubstr("it wrote: 'patient' has ended the thread"));
  expect_others_go_on();
}

TEST_F(ZooGroup, ThatEndsItsThreadInACoroutineIsNamedAndItsGroupEnded) {
  ASSERT_EQ(load("throws.so/end-in-coroutine", "cage"), std::nullopt);
  await_reason("group 'cage' was ended: 'patient' was stuck for ");
  EXPECT_THAT(system.instance("patient").reason(), HasSubstr("it wrote: 'patient' has ended the thread"));
  expect_others_go_on();
}

TEST_F(ZooGroup, ThatEndsItsThreadWhichIsItsTasksOwnFailsAlone) {
  ASSERT_EQ(load("throws.so/end-in-own", ""), std::nullopt);
  await_reason("task 'listener' has ended its thread (pthread_exit, or a cancellation)");
  expect_others_go_on();
  system.unload("patient");
}

TEST_F(ZooGroup, ThatEndsItsThreadInItsConstructorIsRefusedAndNothingElseHappens) {
  system.load_in("cage", "source", "neighbour", "period_ms=10");
  for (const std::string group : {"", "cage"}) {
    const auto error = load("throws.so/end-in-constructor", group);
    ASSERT_TRUE(error) << group;
    EXPECT_EQ(error->code(), ErrorCode::ComponentFailed);
    EXPECT_EQ(error->text().what,
              "component 'end-in-constructor' cannot be made: it has ended the thread that it was made on "
              "(pthread_exit, or a cancellation)");
  }
  EXPECT_EQ(system.instance("neighbour").mode(), "active");
  expect_others_go_on();
}

TEST_F(ZooGroup, IsNotMainWhichRefusesAConstructorThatNeverReturns) {
  const auto error = load("blocks-in-constructor.so", "");
  ASSERT_TRUE(error);
  EXPECT_EQ(error->code(), ErrorCode::ComponentFailed);
  EXPECT_THAT(error->text().what, HasSubstr("cannot be made: it was stuck in its constructor for "));
  expect_others_go_on();
}

TEST_F(ZooGroup, ThatIsStuckInAPortIsNamedWithIt) {
  system.load_in("cage", "sink", "slow", "work_ms=10000");
  system.wire("slow.newest", "source.newest");
  system.eventually("its end", [&] { return system.instance("slow").mode() == "failed"; });
  EXPECT_THAT(system.instance("slow").reason(), HasSubstr("group 'cage' was ended: 'slow' was stuck in newest for "));
}

/// It holds its thread for as long as it likes; whoever has its name next is another one.
TEST_F(ZooGroup, ThatDoesNotComeFreeOfMainIsNotTakenForTheNextOfItsName) {
  ASSERT_EQ(load("leaves-late.so", ""), std::nullopt);
  system.unload("patient");
  system.load_in("", "source", "patient");
  system.eventually("its thread is replaced", [&] { return system.system().kept_threads() == 1; });
  EXPECT_EQ(system.instance("patient").mode(), "active");
}

// ---- they take what they can get ------------------------------------------------------------------------------

class ZooHog : public ZooGroup {};

TEST_P(ZooHog, IsBounded) {
  // A sanitizer takes memory of its own, and descriptors to look at it.
  const bool is_sanitizers = GetParam().sentence.find("memory") != std::string::npos ||
                             GetParam().sentence.find("descriptors") != std::string::npos;
  if (is_sanitizers && !os::kLimitsMemory) GTEST_SKIP() << "a sanitizer's";
  ASSERT_EQ(load(GetParam().library + ".so", "cage", "confined"), std::nullopt);
  await_reason(GetParam().sentence.substr(0, GetParam().sentence.find(" (memory)")));
  expect_others_go_on();
}

INSTANTIATE_TEST_SUITE_P(Each, ZooHog,
                         testing::Values(Animal{"takes-4-gib", "std::bad_alloc (memory)"},
                                         Animal{"leaks", "std::bad_alloc (memory)"},
                                         Animal{"starts-10000-threads", "threads, of 64 that it may have"},
                                         Animal{"keeps-descriptors", "descriptors, of 200 that it may have"},
                                         // In its words, or in the host's, who may look before it has said them.
                                         Animal{"leaks-descriptors", "descriptors"},
                                         Animal{"makes-sockets", "was ended: it made more than 16 sockets"},
                                         Animal{"forks", "it was given no process"},
                                         Animal{"floods-log", "it has said all"},
                                         Animal{"floods-stderr", "it has said all"}),
                         name_of);

/// The host's one thread waits for the constructor of another meanwhile.
TEST_F(ZooGroup, ThatStandsStillIsEndedWhileAnotherIsLoaded) {
  system.load_in("far", "source", "still");
  const pid_t process = system.group("far").process();
  auto took = std::chrono::steady_clock::duration::zero();
  std::thread watcher([&] {
    const auto begun = std::chrono::steady_clock::now();
    ::kill(process, SIGSTOP);
    while (::kill(process, 0) == 0 && std::chrono::steady_clock::now() < begun + 20s) std::this_thread::sleep_for(10ms);
    took = std::chrono::steady_clock::now() - begun;
  });
  const auto begun = std::chrono::steady_clock::now();
  EXPECT_TRUE(load("blocks-in-constructor.so", "cage"));
  const auto loaded = std::chrono::steady_clock::now() - begun;
  watcher.join();
  EXPECT_LT(took, loaded) << "0.6 s of 1.8 s, on an idle machine";
  system.eventually("it is told", [&] { return system.instance("still").mode() == "failed"; });
}

/// Its strands go on, and nothing hangs: but nobody can change it, or unload it.
TEST_F(ZooGroup, ThatDoesNotAnswerIsEnded) {
  ASSERT_EQ(load("dribbles.so", "cage"), std::nullopt);
  system.eventually(
      "its end", [&] { return system.instance("patient").mode() == "failed" && !system.group("cage").alive(); }, 90s);
  EXPECT_THAT(system.instance("patient").reason(), HasSubstr("group 'cage' was ended: it did not answer for 15 s"));
  expect_others_go_on();
}

/// In a sandbox it is given none.
TEST_F(ZooGroup, ThatMapsSharedMemoryIsEnded) {
  if (!os::kLimitsMemory) GTEST_SKIP() << "a sanitizer's";
  ASSERT_EQ(load("maps-shared-memory.so", "cage"), std::nullopt);
  await_reason("group 'cage' was ended: it took ");
  expect_others_go_on();
}

TEST_F(ZooGroup, ThatSpinsIsHeldToItsShareAndSaysSo) {
  ASSERT_EQ(load("spins.so", "cage"), std::nullopt);
  system.eventually("it has taken more", [&] { return system.group("cage").cpu() > 0.5; });
  system.eventually("it is held", [&] { return !system.group("cage").cpu_held_by().empty(); });
  const pid_t process = system.group("cage").process();
  if (system.group("cage").cpu_held_by() == "it gets no more") {
    system.eventually("it takes its share", [&] { return system.group("cage").cpu() < 0.6; });
    const auto folder = os::cpu_groups().folder / ("fiona-" + std::to_string(process));
    EXPECT_TRUE(std::filesystem::exists(folder));
    expect_others_go_on();
    system.unload("patient");
    system.eventually("nothing is left", [&] { return !std::filesystem::exists(folder); });
  } else {
    EXPECT_THAT(system.group("cage").cpu_held_by(), StartsWith("it gets what others leave, as it can have no "));
    EXPECT_EQ(::getpriority(PRIO_PROCESS, static_cast<id_t>(process)), 10);
    expect_others_go_on();
  }
}

// ---- they start programs of their own -------------------------------------------------------------------------

class ZooGroupsProgram : public ZooGroup {
 protected:
  /// Of which the reason tells.
  pid_t started() {
    system.eventually("it has started one", [&] { return system.instance("patient").mode() == "failed"; });
    const std::string reason = system.instance("patient").reason();
    constexpr std::string_view kBefore = "it has started ";
    const auto at = reason.find(kBefore);
    return at == std::string::npos ? -1 : std::stoi(reason.substr(at + kBefore.size()));
  }
  /// One that has ended has no words left, though nobody may have reaped it.
  static bool runs(pid_t program) {
    std::ifstream words("/proc/" + std::to_string(program) + "/cmdline");
    return words.peek() != std::ifstream::traits_type::eof();
  }
  void expect_gone(pid_t program) {
    system.eventually("the program is gone", [&] { return !runs(program); });
  }
};

TEST_F(ZooGroupsProgram, EndsWhenTheGroupHasEndedByItself) {
  ASSERT_EQ(load("leaves-a-program.so", "cage"), std::nullopt);
  const pid_t program = started();
  ASSERT_GT(program, 1) << system.instance("patient").reason();
  expect_gone(program);
}

TEST_F(ZooGroupsProgram, EndsWithTheGroup) {
  ASSERT_EQ(load("starts-a-program.so", "cage"), std::nullopt);
  const pid_t program = started();
  ASSERT_GT(program, 1) << system.instance("patient").reason();
  system.eventually("the program runs", [&] { return runs(program); });
  system.unload("patient");
  expect_gone(program);
}

// ---- they try to get out --------------------------------------------------------------------------------------

/// What an escape finds if it works, beside the machine's own.
class ZooEscape : public ZooGroup {
 protected:
  ZooEscape() {
    ::setenv("ZOO_SECRET", "the key", 1);
    std::ofstream(of_host(".key")) << "the key";
    ::dup2(::open(of_host(".key").c_str(), O_RDONLY | O_CLOEXEC), kLeaked);
    listen_at(of_host(".sock"), false);
    listen_at("fiona-zoo-" + std::to_string(::getpid()), true);
    listen_at(system.directory() / "main.sock", false);
  }
  ~ZooEscape() override {
    ::close(kLeaked);
    ::unsetenv("ZOO_SECRET");
    for (const char* ending : {".key", ".sock"}) std::filesystem::remove(of_host(ending));
  }
  static std::string of_host(const std::string& ending) {
    return "/var/tmp/fiona-zoo-" + std::to_string(::getpid()) + ending;
  }
  void listen_at(const std::string& path, bool is_abstract) {
    sockaddr_un address{};
    address.sun_family = AF_UNIX;
    path.copy(address.sun_path + (is_abstract ? 1 : 0), sizeof address.sun_path - 2);
    listeners.emplace_back(::socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0));
    const auto length = static_cast<socklen_t>(offsetof(sockaddr_un, sun_path) + path.size() + 1);
    ASSERT_EQ(::bind(listeners.back().get(), reinterpret_cast<const sockaddr*>(&address), length), 0) << path;
    ASSERT_EQ(::listen(listeners.back().get(), 4), 0);
  }
  std::string escapes(const std::string& rights) {
    EXPECT_EQ(load("escapes.so", "cage", rights), std::nullopt);
    system.eventually("it has tried", [&] { return system.instance("patient").mode() == "failed"; });
    return system.instance("patient").reason();
  }

  static constexpr int kLeaked = 900;
  std::vector<os::Descriptor> listeners;
};

TEST_F(ZooEscape, OutOfASandboxDoesNotSucceed) { EXPECT_THAT(escapes("confined"), StartsWith("0 of ")); }

/// It would be let in there as who runs the system.
TEST_F(ZooEscape, OutOfASandboxThatReadsWhereItsHostListensDoesNotSucceed) {
  EXPECT_THAT(escapes("confined read:" + system.directory().string()), StartsWith("0 of "));
}

/// And, where the kernel's Landlock has no scopes, abstract sockets of the user's programs: they are of the network
/// that it was granted.
TEST_F(ZooEscape, OutOfASandboxWithANetworkFindsThatAndNothingElse) {
  constexpr long kWithScopes = 6;
  const long abi = ::syscall(SYS_landlock_create_ruleset, nullptr, 0, LANDLOCK_CREATE_RULESET_VERSION);
  const std::string found = escapes("confined network");
  EXPECT_THAT(found, HasSubstr(" escapes: inet, inet datagrams, inet6"));
  EXPECT_EQ(found.find("an abstract socket") != std::string::npos, abi < kWithScopes) << "Landlock's ABI is " << abi;
  EXPECT_THAT(found, StartsWith(abi < kWithScopes ? "4 of " : "3 of ")) << found;
}

/// What is told to end is its host, which ends its groups in order.
TEST_F(ZooGroup, TakesNoNoticeOfASignalThatEndsProcesses) {
  system.load_in("cage", "source", "one", "period_ms=10");
  for (const int one : {SIGTERM, SIGINT}) ::kill(system.group("cage").process(), one);
  system.wire("sink.newest", "one.newest");
  system.eventually("messages", [&] { return system.port("sink.newest").messages() > 3; });
  EXPECT_EQ(system.instance("one").mode(), "active");
}

/// That nothing was found above is because of the sandbox.
TEST_F(ZooEscape, OutOfAGroupThatIsNoneSucceedsManyTimes) {
  const std::string found = escapes("");
  EXPECT_GE(std::stoi(found), 20) << found;
  for (const std::string sure : {"/etc/passwd", "a file of the host", "fork", "kill the host", "inet", "a unix socket",
                                 "an abstract socket", "the host's control socket", "the host's environment variables",
                                 "a file in memory", "a file where it listens"}) {
    EXPECT_THAT(found, HasSubstr(sure));
  }
}

TEST_F(ZooGroup, ThatIsASandboxSaysOfWhatItIsMade) {
  ASSERT_EQ(load("loops.so", "cage", "confined"), std::nullopt);
  std::vector<std::string> layers;
  const auto cage = system.group("cage");
  for (const auto& layer : cage.sandbox()) {
    if (layer.missing().empty()) layers.push_back(layer.name());
  }
  EXPECT_THAT(layers, IsSupersetOf({"mounts", "network", "privileges", "seccomp"}));
}

TEST_F(ZooGroup, ThatIsASandboxIsWiredAsAnyOther) {
  ASSERT_EQ(load_path(std::string(TEST_COMPONENTS_LIBRARY) + "/source", "cage", "confined"), std::nullopt);
  system.load_in("", "sink", "near");
  system.load_in("apart", "sink", "far");
  for (const std::string sink : {"near", "far"}) {
    system.wire(sink + ".each", "patient.newest");
    system.eventually("messages", [&] { return system.port(sink + ".each").messages() > 5; });
  }
}

TEST_F(ZooGroup, ThatIsASandboxTakesNoOtherPackage) {
  ASSERT_EQ(load("loops.so", "cage", "confined"), std::nullopt);
  try {
    system.load_in("cage", "source", "other");
    FAIL() << "it was loaded";
  } catch (const Error& error) {
    EXPECT_EQ(error.text().what, "group 'cage' is a sandbox, of local/loops and what that was granted");
  }
}

// ---- they throw -----------------------------------------------------------------------------------------------

class ZooThrow : public ZooGroup {};

/// What is thrown in `main`: it ends the component alone.
TEST_P(ZooThrow, StaysInsideItsComponent) {
  const auto error = load("throws.so/" + GetParam().library, "");
  const bool ends_late = GetParam().library.ends_with("timer") || GetParam().library.ends_with("task") ||
                         GetParam().library.ends_with("coroutine") || GetParam().library.ends_with("own");
  if (ends_late) {
    ASSERT_EQ(error, std::nullopt);
    await_reason(GetParam().sentence);
    system.unload("patient");
  } else if (GetParam().library.ends_with("stop")) {
    ASSERT_EQ(error, std::nullopt);
    system.unload("patient");
  } else {
    ASSERT_TRUE(error.has_value());
    EXPECT_EQ(error->code(), ErrorCode::ComponentFailed);
    EXPECT_THAT(error->text().what, HasSubstr(GetParam().sentence));
  }
  expect_others_go_on();
}

std::vector<Animal> throwing() {
  std::vector<Animal> all;
  for (const std::string what : {"std", "int", "foreign"}) {
    const std::string said = what == "std" ? "the antenna fell off" : "threw something that is not a std::exception";
    for (const std::string place : {"constructor", "start", "mode", "timer", "task", "own", "coroutine", "stop"}) {
      all.push_back({what + "-in-" + place, said});
    }
  }
  return all;
}

INSTANTIATE_TEST_SUITE_P(Each, ZooThrow, testing::ValuesIn(throwing()), name_of);

}  // namespace
}  // namespace fiona::host
