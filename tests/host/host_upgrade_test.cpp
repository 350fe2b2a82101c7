// Promise R37: the host is replaced by another build of itself while its groups go on; a bad one is taken back.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fmt/format.h>
#include <google/protobuf/unknown_field_set.h>
#include <sys/stat.h>

#include <algorithm>
#include <bit>
#include <iostream>

#include "campaign.hpp"
#include "fiona/error.hpp"
#include "group.hpp"
#include "supervised_host.hpp"

namespace fiona::conformance {
namespace {

using namespace std::chrono_literals;
using testing::AllOf;
using testing::HasSubstr;
using testing::Not;

constexpr double kPeriod_ms = 10;
constexpr double kGap_ms = kPeriod_ms + 20;

ino_t file_of(const std::filesystem::path& path) {
  struct stat is {};
  return ::stat(path.c_str(), &is) == 0 ? is.st_ino : 0;
}
ino_t program_of(pid_t process) { return file_of("/proc/" + std::to_string(process) + "/exe"); }

/// FIONA as it is installed, with files that are put in the place of others as a package manager does.
class Installation {
 public:
  Installation() {
    std::filesystem::create_directory(programs());
    std::filesystem::create_symlink(os::program_directory().parent_path() / "lib", directory_.path / "lib");
    for (const char* name : {"fiona-host", "fiona-group", "fiona-supervisor"}) install(name);
  }
  std::filesystem::path programs() const { return directory_.path / "bin"; }
  std::filesystem::path host() const { return programs() / "fiona-host"; }
  /// The same program, in another file.
  void install(const std::string& name) const {
    std::filesystem::copy_file(os::program_directory() / name, directory_.path / "next");
    std::filesystem::rename(directory_.path / "next", programs() / name);
  }
  /// A host that does this, once it has told its version.
  void install_broken(const std::string& does, const std::string& when_asked = "exit 0") const {
    install_script("fiona-host", fmt::format("[ \"$1\" = --version ] && {{ {}; }}\n{}\n", when_asked, does));
  }
  void install_script(const std::string& name, const std::string& script) const {
    std::ofstream(directory_.path / "next") << "#!/bin/sh\n" + script;
    std::filesystem::permissions(directory_.path / "next", std::filesystem::perms::owner_all);
    std::filesystem::rename(directory_.path / "next", programs() / name);
  }

 private:
  TemporaryDirectory directory_;
};

/// What a witness has heard, whose type the test does not link: test.proto's Testimony.
struct Heard {
  std::uint64_t runs = 0, backward = 0;
  double longest_gap_ms = 0;
};

Heard heard_by(TestConsole& console, const std::string& witness) {
  auto call = console.request();
  *call.mutable_call()->mutable_target() = port_name(witness + ".testify");
  google::protobuf::UnknownFieldSet fields;
  fields.ParseFromString(console.ask(call).called().result().object());
  Heard heard;
  for (int i = 0; i < fields.field_count(); ++i) {
    const auto& field = fields.field(i);
    if (field.number() == 1) ++heard.runs;
    if (field.number() == 2) heard.backward = field.varint();
    if (field.number() == 7) heard.longest_gap_ms = std::bit_cast<double>(field.fixed64());
  }
  return heard;
}

class HostUpgrade : public testing::Test {
 protected:
  HostUpgrade() {
    console->load("ticker", "there", "ticker", fmt::format("period_ms={}", kPeriod_ms));
    console->load("witness", "far", "witness");
    console->load("sink", "main", "sink");
    console->change(TestConsole::wire_of("witness.samples", "ticker.samples"));
    console->change(TestConsole::wire_of("sink.each", "ticker.samples"));
    there_ = console->process_of("there");
    far_ = console->process_of("far");
    console->eventually("some have come", [&] { return messages("witness.samples") > 20; });
  }
  std::uint64_t messages(const std::string& port) { return status(port).messages(); }
  control::PortStatus status(const std::string& name) {
    const auto wanted = port_name(name);
    const auto owner = console->instance(wanted.instance());
    for (const auto& one : owner.ports()) {
      if (one.name() == wanted.port()) return one;
    }
    throw std::runtime_error("no port " + name);
  }
  /// As far as the host that is asked goes.
  void ask_for_upgrade(std::chrono::milliseconds trial) {
    auto upgrade = console->request();
    upgrade.mutable_upgrade_host()->set_watch_ms(static_cast<double>(trial.count()));
    console->ask(upgrade);
  }
  /// To the next host that answers.
  void upgrade(std::chrono::milliseconds trial = 10s) {
    const pid_t before = host.host();
    console->eventually("the last one has stood its trial", [&] {
      try {
        ask_for_upgrade(trial);
        return true;
      } catch (const Error& error) {
        if (std::string(error.what()).find("still on trial") == std::string::npos) throw;
        return false;
      }
    });
    console = host.console(before);
  }
  /// Whether the supervisor has this file open, to go back to.
  bool is_held(ino_t file) const {
    const auto open = std::filesystem::directory_iterator("/proc/" + std::to_string(host.supervisor()) + "/fd");
    return std::any_of(begin(open), end(open), [file](const auto& one) { return file_of(one.path()) == file; });
  }
  std::string refusal() {
    try {
      ask_for_upgrade(10s);
    } catch (const Error& error) {
      return std::string(error.what());
    }
    return "it was not refused";
  }
  /// The groups have not noticed, and `main` is there again.
  void expect_no_gap(const std::string& when) {
    EXPECT_EQ(console->process_of("there"), there_);
    EXPECT_EQ(console->process_of("far"), far_);
    const auto before = messages("witness.samples"), in_main = messages("sink.each");
    console->eventually("samples come", [&] {
      return messages("witness.samples") > before + 10 && messages("sink.each") > in_main + 10;
    });
    const Heard heard = heard_by(*console, "witness");
    EXPECT_EQ(heard.runs, 1U) << "something is missing";
    EXPECT_EQ(heard.backward, 0U) << "doubled, or out of order";
    EXPECT_LE(heard.longest_gap_ms, allowed(kGap_ms, false) + pulse.longest_ms());
    std::cout << fmt::format(
        "{}: longest gap {:.1f} ms (bound {:.0f} ms); the machine let no thread run for {:.1f} ms\n", when,
        heard.longest_gap_ms, kGap_ms, pulse.longest_ms());
  }

  Installation installed;
  SupervisedHost host{{}, installed.programs()};
  const ino_t first_ = file_of(installed.host());
  std::unique_ptr<TestConsole> console = host.console();
  pid_t there_ = 0, far_ = 0;
  Pulse pulse;
};

TEST_F(HostUpgrade, IsToTheFileThatIsInstalledNowAndWiresBetweenGroupsHaveNoGap) {
  ASSERT_EQ(program_of(host.host()), first_);
  installed.install("fiona-host");
  ASSERT_NE(file_of(installed.host()), first_);
  upgrade();
  EXPECT_EQ(program_of(host.host()), file_of(installed.host()));
  const auto system = console->snapshot();
  EXPECT_EQ(system.restart_reason(), "upgraded");
  EXPECT_FALSE(system.taken_back());
  expect_no_gap("upgraded");
}

TEST_F(HostUpgrade, AgainAndAgainHasNoGapAndLeavesNothing) {
  const int times = number_from("FIONA_HOST_UPGRADES", 3);
  Holdings first;
  for (int i = 1; i <= times; ++i) {
    installed.install("fiona-host");
    upgrade(1ms);
    ASSERT_EQ(program_of(host.host()), file_of(installed.host())) << i;
    ASSERT_FALSE(console->snapshot().taken_back()) << i;
    console->eventually("all are wired again",
                        [&, before = messages("sink.each")] { return messages("sink.each") > before; });
    if (i == 1) first = holdings({host.supervisor(), host.host(), there_, far_});
  }
  Holdings last;
  console->eventually("what was the last host's is closed", [&] {
    last = holdings({host.supervisor(), host.host(), there_, far_});
    return last.descriptors <= first.descriptors;
  });
  std::cout << fmt::format("{} upgrades: {:+d} descriptors, {:+d} threads, {:+.1f} MiB\n", times,
                           last.descriptors - first.descriptors, last.threads - first.threads,
                           last.resident_mib - first.resident_mib);
  EXPECT_LE(last.threads, first.threads);
  EXPECT_LE(last.resident_mib, first.resident_mib + (kKeepsWhatIsFreed ? 100 : 1));
  expect_no_gap("upgraded again and again");
}

TEST_F(HostUpgrade, GroupsThatAreStartedAfterwardsAreOfTheNewBuild) {
  const ino_t before = file_of(installed.programs() / "fiona-group");
  installed.install("fiona-group");
  installed.install("fiona-host");
  upgrade();
  console->load("sink", "later", "later");
  EXPECT_EQ(program_of(console->process_of("later")), file_of(installed.programs() / "fiona-group"));
  EXPECT_EQ(program_of(console->process_of("there")), before);
}

TEST_F(HostUpgrade, WhatCannotBeStartedIsRefusedAndTheHostGoesOn) {
  const pid_t before = host.host();
  installed.install_broken("", "echo no such library >&2; exit 3");
  EXPECT_THAT(refusal(), AllOf(HasSubstr("the host is not upgraded, and goes on"),
                               HasSubstr("fiona-host --version exited with code 3, and said: no such library")));
  installed.install_broken("", "exec sleep 60");
  EXPECT_THAT(refusal(), HasSubstr("fiona-host --version did not end within 2 s"));
  std::filesystem::permissions(installed.host(), std::filesystem::perms::owner_read);
  EXPECT_THAT(refusal(), HasSubstr("Permission denied"));
  std::filesystem::remove(installed.host());
  EXPECT_THAT(refusal(), HasSubstr("No such file or directory"));
  EXPECT_EQ(host.host(), before);
  expect_no_gap("refused four times");
}

TEST_F(HostUpgrade, ABuildThatEndsBeforeItIsReadyIsTakenBack) {
  installed.install_broken("echo 'the journal is not mine' >&3; exit 3");
  upgrade();
  EXPECT_EQ(program_of(host.host()), first_);
  const auto system = console->snapshot();
  EXPECT_TRUE(system.taken_back());
  EXPECT_EQ(system.restart_reason(),
            "the new build exited with code 3: the journal is not mine; the one before it runs again");
  expect_no_gap("taken back");
}

TEST_F(HostUpgrade, ABuildThatGivesNoSignOfLifeIsTakenBackWithinFiveSeconds) {
  installed.install_broken("exec sleep 60");
  const auto begun = Steady::now();
  upgrade();
  const std::chrono::duration<double> took = Steady::now() - begun;
  EXPECT_EQ(program_of(host.host()), first_);
  EXPECT_THAT(console->snapshot().restart_reason(), HasSubstr("the new build did not answer for 4.0 s"));
  EXPECT_LE(took.count(), allowed(5, false));
  std::cout << fmt::format("taken back {:.2f} s after it was asked for\n", took.count());
  expect_no_gap("taken back");
}

TEST_F(HostUpgrade, ABuildThatEndsWhileItIsOnTrialIsTakenBackAndNotTriedAgain) {
  installed.install("fiona-host");
  upgrade();
  ASSERT_EQ(program_of(host.host()), file_of(installed.host()));
  console = host.kill_host();
  EXPECT_EQ(program_of(host.host()), first_);
  EXPECT_TRUE(console->snapshot().taken_back());
  expect_no_gap("taken back");
  console = host.kill_host();
  EXPECT_EQ(program_of(host.host()), first_);
  EXPECT_FALSE(console->snapshot().taken_back());
}

TEST_F(HostUpgrade, ABuildThatHasStoodItsTrialIsTheOneThatIsStartedAgain) {
  installed.install("fiona-host");
  upgrade(1ms);
  const ino_t second = program_of(host.host());
  console->eventually("its file is held", [&] { return is_held(second); });
  std::filesystem::remove(installed.host());
  console = host.kill_host();
  EXPECT_EQ(program_of(host.host()), second);
  expect_no_gap("killed after its trial");
}

/// It comes into use because a host has died, and nobody has said anything of it.
TEST_F(HostUpgrade, ABuildThatNobodyHasAskedForHasATrialOfItsOwn) {
  installed.install("fiona-host");
  upgrade(1ms);
  const ino_t second = program_of(host.host());
  console->eventually("its file is held", [&] { return is_held(second); });
  installed.install("fiona-host");
  console = host.kill_host();
  ASSERT_EQ(program_of(host.host()), file_of(installed.host()));
  console = host.kill_host();
  EXPECT_EQ(program_of(host.host()), second);
  EXPECT_TRUE(console->snapshot().taken_back());
}

TEST_F(HostUpgrade, NeedsASupervisorAndTheMachinesTime) {
  console->unload("witness");
  console->unload("sink");
  console->unload("ticker");
  SupervisedHost virtual_host;
  console = virtual_host.console();
  console->change(TestConsole::set_of("host", "clock=virtual"));
  EXPECT_THAT(refusal(), HasSubstr("a run on virtual time ends with its host"));
  ServedHost alone;
  console = std::make_unique<TestConsole>(alone);
  EXPECT_THAT(refusal(), AllOf(HasSubstr("it has no supervisor that could start another one"),
                               HasSubstr("fiona run --supervised")));
}

TEST(NewGroup, OfAnotherBuildIsRefusedWithASentence) {
  const Installation installed;
  // What it says first, behind its length: a GroupMessage whose Ready has protocol 99.
  installed.install_script("fiona-group",
                           "[ \"$1\" = --template ] && exit 0\n"
                           "printf '\\004\\000\\000\\000\\052\\002\\030\\143' >&3\nexec sleep 60\n");
  SupervisedHost host{{}, installed.programs()};
  const auto console = host.console();
  try {
    console->load("sink", "far", "sink");
    ADD_FAILURE() << "it was started";
  } catch (const Error& error) {
    EXPECT_EQ(error.text().what,
              "group 'far' did not start: " + (installed.programs() / "fiona-group").string() + " is of another build");
    EXPECT_EQ(error.text().expected, fmt::format("protocol {}", host::kGroupProtocol));
    EXPECT_EQ(error.text().found, "protocol 99");
    EXPECT_EQ(error.text().next, "upgrade host");
  }
  EXPECT_EQ(console->snapshot().instances_size(), 0);
}

TEST(NewGroup, ThatCannotBeStartedLeavesNothingBehind) {
  const Installation installed;
  SupervisedHost host{{}, installed.programs()};
  const auto console = host.console();
  console->change(TestConsole::set_of("host", "clock=virtual"));
  auto confined = TestConsole::load_of("sink", "far", "sink");
  confined.mutable_load()->add_rights("confined");
  std::filesystem::permissions(installed.programs() / "fiona-group", std::filesystem::perms::owner_read);
  EXPECT_THROW(console->change(confined), Error);
  auto sleep = console->request();
  sleep.mutable_sleep()->set_duration_ms(1000);
  EXPECT_EQ(console->ask(sleep).met().after_ms(), 1000) << "no group is waited for";
  for (const auto& one : std::filesystem::recursive_directory_iterator(host.socket().parent_path()))
    EXPECT_THAT(one.path().filename(), Not(testing::StartsWith("kept.far.")));
  std::filesystem::permissions(installed.programs() / "fiona-group", std::filesystem::perms::owner_all);
  console->change(confined);
  EXPECT_EQ(console->instance("sink").mode(), "active");
}

/// A group that a host which has ended has left: its process does nothing, what it says is up to the test.
struct LeftGroup {
  os::ChildProcess process{"/bin/sleep", {"60"}, {}};
  std::pair<os::PacketSocket, os::PacketSocket> adoption = os::PacketSocket::pair();
  os::SharedMemory page{sizeof(Liveness::Page)};

  host::KeptGroup kept(const std::string& name) const {
    const auto copy = [](int one) { return os::Descriptor(::fcntl(one, F_DUPFD_CLOEXEC, 0)); };
    host::KeptGroup kept;
    kept.told.set_name(name);
    kept.told.mutable_ready()->set_protocol(host::kGroupProtocol);
    kept.told.mutable_confinement()->set_memory(1 << 30);
    kept.told.mutable_confinement()->set_threads(16);
    kept.told.mutable_confinement()->set_descriptors(64);
    kept.process = process.id();
    kept.handle = copy(process.descriptor());
    kept.adoption = copy(adoption.first.descriptor());
    kept.liveness = copy(page.descriptor());
    kept.output = os::Descriptor(::open("/dev/null", O_RDONLY | O_CLOEXEC));
    return kept;
  }
  /// To what the new host has asked.
  void answer() const {
    os::Packet packet;
    ASSERT_TRUE(adoption.second.receive_until(std::chrono::steady_clock::now() + 5s, packet));
    os::MessageStream stream(std::move(packet.descriptors.at(0)));
    wire::GroupRequest asked;
    while (!stream.next(asked)) ASSERT_TRUE(stream.receive());
    wire::GroupMessage answer;
    answer.set_id(asked.id());
    answer.mutable_adopted();
    ASSERT_TRUE(stream.send(answer));
  }
};

class AdoptedGroup : public ::testing::Test {
 protected:
  host::ChildGroup ask(host::KeptGroup kept) {
    return {std::move(kept), {.endpoint = "", .clock = clock, .parts = {}, .supervisor = &link}, [](const auto&) {}};
  }

  std::pair<os::PacketSocket, os::PacketSocket> supervisor = os::PacketSocket::pair();
  host::SupervisorLink link{std::move(supervisor.second)};
  const SystemClock clock;
};

TEST_F(AdoptedGroup, OfAnotherProtocolIsEndedWithASentence) {
  const LeftGroup left;
  auto kept = left.kept("old");
  kept.told.mutable_ready()->set_protocol(host::kGroupProtocol + 1);
  const host::ChildGroup old = ask(std::move(kept));
  EXPECT_FALSE(old.alive());
  EXPECT_EQ(old.end(), fmt::format("was ended: it speaks protocol {}, and the host that has taken over speaks {}",
                                   host::kGroupProtocol + 1, host::kGroupProtocol));
}

TEST_F(AdoptedGroup, IsNotEndedForWhatTheOnesBeforeItHaveWaited) {
  const LeftGroup silent, sound;
  host::ChildGroup first = ask(silent.kept("silent"));
  host::ChildGroup second = ask(sound.kept("sound"));
  sound.answer();
  const auto deadline = std::chrono::steady_clock::now() + 50ms;
  first.finish_adoption(deadline);
  EXPECT_EQ(first.end(), "was ended: it did not answer the new host");
  EXPECT_GE(std::chrono::steady_clock::now(), deadline);
  second.finish_adoption(deadline);
  EXPECT_TRUE(second.alive()) << second.end();
  EXPECT_TRUE(second.adopted());
}

}  // namespace
}  // namespace fiona::conformance
