// Groups that are not sandboxed are copies of one process.
#include "os/process_template.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <signal.h>
#include <sys/ptrace.h>
#include <sys/wait.h>
#include <unistd.h>

#include <chrono>
#include <filesystem>
#include <fstream>
#include <optional>

#include "evidence.hpp"
#include "system_fixture.hpp"

namespace fiona::conformance {
namespace {

using testing::HasSubstr;
using testing::Not;

std::string words_of(pid_t process) { return content_of("/proc/" + std::to_string(process) + "/cmdline"); }

/// The child of this process that the groups are copies of.
std::optional<pid_t> template_process() {
  const std::string id = std::to_string(::getpid());
  std::ifstream file("/proc/" + id + "/task/" + id + "/children");
  for (pid_t one = 0; file >> one;) {
    if (words_of(one).find("--template") != std::string::npos) return one;
  }
  return std::nullopt;
}

/// Where protobuf lies in a process.
std::string place_in(pid_t process) {
  std::ifstream file("/proc/" + std::to_string(process) + "/maps");
  for (std::string line; std::getline(file, line);) {
    if (line.find("libprotobuf.so") != std::string::npos) return line.substr(0, line.find('-'));
  }
  return "nowhere";
}

class GroupCopies : public testing::Test {
 protected:
  void SetUp() override {
    if (!os::kCopiesProcesses) GTEST_SKIP() << "under ThreadSanitizer each group is a process that was started anew";
    system.load_in("first", "source", "source", "period_ms=5");
    ASSERT_TRUE(template_process());
  }
  /// Loads another group's instance, and shows that it works.
  void load_second() {
    system.load_in("second", "sink", "sink");
    system.wire("sink.each", "source.newest");
    system.eventually("messages come", [&] { return system.port("sink.each").messages() > 3; });
  }
  RunningSystem system;
};

TEST_F(GroupCopies, HaveAllThingsInThePlacesWhereTheirTemplateHasThem) {
  load_second();
  const std::string place = place_in(*template_process());
  EXPECT_EQ(place_in(system.group("first").process()), place);
  EXPECT_EQ(place_in(system.group("second").process()), place);
}

TEST_F(GroupCopies, AreShownToPeopleWithTheirOwnWords) {
  load_second();
  EXPECT_THAT(words_of(system.group("second").process()), HasSubstr(std::string("--name\0second", 13)));
}

/// What is not used of the room for its words tells a copy from a program that was started.
TEST_F(GroupCopies, AreNotWhatIsNotTrusted) {
  control::Change change;
  control::Load& request = *change.mutable_load();
  request.set_plugin(std::string(TEST_COMPONENTS_LIBRARY) + "/sink");
  request.set_instance("stranger");
  request.set_group("cage");
  request.add_rights("confined");
  system.system().perform(change);
  const std::string room(16, '\0');
  EXPECT_THAT(words_of(system.group("first").process()), HasSubstr(room));
  const std::string cage = words_of(system.group("cage").process());
  EXPECT_THAT(cage, HasSubstr(std::string("--name\0cage", 11)));
  EXPECT_THAT(cage, Not(HasSubstr(room)));
}

TEST_F(GroupCopies, AreMadeAlsoOnceTheirTemplateHasDied) {
  const pid_t first = *template_process();
  ::kill(first, SIGKILL);
  load_second();
  system.load_in("third", "sink", "other");
  ASSERT_TRUE(template_process());
  EXPECT_NE(*template_process(), first);
  EXPECT_EQ(place_in(system.group("third").process()), place_in(*template_process()));
}

TEST_F(GroupCopies, DoNotWaitForATemplateThatWasStopped) {
  const pid_t stopped = *template_process();
  ::kill(stopped, SIGSTOP);
  load_second();
  EXPECT_NE(template_process(), stopped);
}

TEST_F(GroupCopies, GoOnWithoutTheirTemplateOfWhichNothingIsLeft) {
  load_second();
  const std::string place = "/proc/" + std::to_string(*template_process());
  ::kill(*template_process(), SIGKILL);
  system.eventually("it is reaped", [&] {
    system.system().watch_groups();
    return !std::filesystem::exists(place);
  });
  const auto before = system.port("sink.each").messages();
  system.eventually("more come", [&] { return system.port("sink.each").messages() > before + 3; });
}

TEST_F(GroupCopies, AreToldHowTheyEndedAsAnyOtherGroup) {
  ::kill(system.group("first").process(), SIGKILL);
  system.eventually("told",
                    [&] { return system.instance("source").reason().find("killed by signal 9") != std::string::npos; });
}

TEST_F(GroupCopies, TakeTheirTemplateWithThemWhenTheLastOfThemEnds) {
  system.unload("source");
  system.eventually("nothing is left", [] { return !template_process(); });
}

TEST(ChildProcess, ThatIsKilledAndDoesNotGoIsNotWaitedFor) {
  auto held = std::make_unique<os::ChildProcess>("/bin/sleep", std::vector<std::string>{"100"},
                                                 std::vector<std::pair<int, int>>{});
  int told[2];
  ASSERT_EQ(::pipe(told), 0);
  const pid_t holder = ::fork();
  if (holder == 0) {  // one that a debugger holds is not gone before that has looked
    const char holds = ::ptrace(PTRACE_SEIZE, held->id(), nullptr, nullptr) == 0 ? 'y' : 'n';
    static_cast<void>(::write(told[1], &holds, 1));
    while (true) ::pause();
  }
  char holds = 'n';
  static_cast<void>(::read(told[0], &holds, 1));
  const auto begun = std::chrono::steady_clock::now();
  if (holds == 'y') held.reset();
  EXPECT_LT(std::chrono::steady_clock::now() - begun, std::chrono::seconds(5));
  ::kill(holder, SIGKILL);
  ::waitpid(holder, nullptr, 0);
  for (const int one : told) ::close(one);
  if (holds != 'y') GTEST_SKIP() << "this user may hold no other process";
}

}  // namespace
}  // namespace fiona::conformance
