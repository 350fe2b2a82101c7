// Plugins that misbehave once they are opened: what each does to its group, what is said of it, and that nobody else
// notices. Those that are refused before that are in load_test.cpp.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <optional>

#include "fiona/error.hpp"
#include "system_fixture.hpp"

namespace fiona::host {
namespace {

using conformance::RunningSystem;
using testing::HasSubstr;

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
    system.load_in("", "source", "source", "period_ms=1");
    system.load_in("", "sink", "sink");
    system.wire("sink.each", "source.newest");
  }
  std::optional<Error> load(const std::string& library, const std::string& group) {
    control::Change change;
    control::Load& request = *change.mutable_load();
    request.set_plugin(std::string(ZOO_DIRECTORY) + "/lib" + library);
    request.set_instance("patient");
    request.set_group(group);
    try {
      system.system().perform(change);
    } catch (const Error& error) {
      return error;
    }
    return std::nullopt;
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

  RunningSystem system{HostOptions{}, RunningSystem::EndsHungGroups()};
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
                         testing::Values(Animal{"reads-nowhere", kSegmentation}, Animal{"overflows-stack", kSegmentation},
                                         Animal{"aborts", kAborted}, Animal{"frees-twice", kAborted},
                                         Animal{"throws-from-thread", kAborted}, Animal{"leaves-its-thread", kAborted},
                                         Animal{"exits", "group 'cage' exited with code 0"},
                                         Animal{"kills-itself", "group 'cage' killed by signal 9 (Killed)"},
                                         Animal{"loops", kStuck}, Animal{"locks-itself-out", kStuck},
                                         Animal{"ignores-sigterm", kStuck},
                                         Animal{"stops-itself", "group 'cage' was ended: it stood still for "}),
                         name_of);

// ---- they do not get as far as that ---------------------------------------------------------------------------

class ZooLoad : public ZooGroup {};

TEST_P(ZooLoad, IntoAGroupIsRefusedAndLeavesNothing) {
  const auto error = load(GetParam().library + ".so", "cage");
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
                                         Animal{"hangs-when-opened", "'patient' was stuck in its library for 2."},
                                         Animal{"blocks-in-constructor", "'patient' was stuck in its constructor for "}),
                         name_of);

class ZooTrial : public ZooGroup {};

TEST_P(ZooTrial, KeepsFromMainWhatEndsAProcessWhenItIsOpened) {
  for (int time = 0; time < 2; ++time) {
    const auto error = load(GetParam().library + ".so", "");
    ASSERT_TRUE(error.has_value()) << "it was loaded";
    EXPECT_THAT(error->text().what,
                HasSubstr("plugin 'local/" + GetParam().library + "' cannot be loaded: " + GetParam().sentence));
    EXPECT_EQ(error->text().next, "tell the publisher");
  }
  expect_others_go_on();
}

INSTANTIATE_TEST_SUITE_P(
    Each, ZooTrial,
    testing::Values(Animal{"traps-when-opened", "opening it ends the process: a static constructor killed by signal 11"},
                    Animal{"throws-when-opened", "a static constructor of it throws: a static constructor throws"},
                    Animal{"exits-when-opened", "opening it ends the process: a static constructor exited with code 0"},
                    Animal{"hangs-when-opened", "opening it does not come to an end: a static constructor hangs"}),
    name_of);

TEST_F(ZooGroup, ThatThrowsWhenItIsOpenedIsRefusedWithWhatItThrew) {
  const auto error = load("throws-when-opened.so", "cage");
  ASSERT_TRUE(error.has_value());
  EXPECT_EQ(error->text().what,
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
              HasSubstr("group 'cage' was ended: 'patient' was stuck in its destructor for 1."));
  expect_others_go_on();
}

TEST_F(ZooGroup, ThatIsStuckInAPortIsNamedWithIt) {
  system.load_in("cage", "sink", "slow", "work_ms=10000");
  system.wire("slow.newest", "source.newest");
  system.eventually("its end", [&] { return system.instance("slow").mode() == "failed"; });
  EXPECT_THAT(system.instance("slow").reason(),
              HasSubstr("group 'cage' was ended: 'slow' was stuck in newest for 1."));
}

// ---- they throw -----------------------------------------------------------------------------------------------

class ZooThrow : public ZooGroup {};

/// What is thrown in `main`: it ends the component alone.
TEST_P(ZooThrow, StaysInsideItsComponent) {
  const auto error = load("throws.so/" + GetParam().library, "");
  const bool ends_late = GetParam().library.ends_with("timer") || GetParam().library.ends_with("task") ||
                         GetParam().library.ends_with("coroutine");
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
    for (const std::string place : {"constructor", "start", "mode", "timer", "task", "coroutine", "stop"}) {
      all.push_back({what + "-in-" + place, said});
    }
  }
  return all;
}

INSTANTIATE_TEST_SUITE_P(Each, ZooThrow, testing::ValuesIn(throwing()), name_of);

}  // namespace
}  // namespace fiona::host
