// Plugins that are broken on purpose: each refusal is one clear sentence, and leaves nothing half done.
#include <gmock/gmock.h>
#include <google/protobuf/text_format.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <filesystem>
#include <fstream>
#include <iostream>
#include <optional>
#include <sstream>

#include "../temporary_directory.hpp"
#include "fiona/error.hpp"
#include "plugin_library.hpp"
#include "system_fixture.hpp"

namespace fiona::host {
namespace {

using conformance::RunningSystem;
using testing::HasSubstr;

std::string zoo_library(const std::string& name) { return std::string(ZOO_DIRECTORY) + "/lib" + name + ".so"; }

std::optional<Error> error_of_load(RunningSystem& system, const std::string& library, const std::string& group = "") {
  control::Change change;
  control::Load& request = *change.mutable_load();
  request.set_plugin(library);
  request.set_instance("patient");
  request.set_group(group);
  try {
    system.system().perform(change);
  } catch (const Error& error) {
    return error;
  }
  return std::nullopt;
}

void expect_good_plugin_runs(RunningSystem& system) {
  system.load_provider("source", "source", "period_ms=1");
  system.load_client("sink", "sink");
  system.wire("sink.each", "source.newest");
  system.eventually("messages", [&] { return system.port("sink.each").messages() >= 3; });
}

struct Refusal {
  std::string library;
  ErrorCode code;
  std::string what;
  std::string found;
  std::string next;
};

void PrintTo(const Refusal& refusal, std::ostream* out) { *out << refusal.library; }

class Zoo : public testing::TestWithParam<Refusal> {
 protected:
  void expect_refused(const std::string& group) {
    const auto error = error_of_load(system, zoo_library(GetParam().library), group);
    ASSERT_TRUE(error.has_value()) << "it was loaded";
    EXPECT_EQ(error->code(), GetParam().code);
    EXPECT_THAT(error->text().what, HasSubstr(GetParam().what));
    EXPECT_THAT(error->text().found, HasSubstr(GetParam().found));
    EXPECT_THAT(error->text().next, HasSubstr(GetParam().next));
    EXPECT_FALSE(error->text().where.empty());
  }
  RunningSystem system;
};

TEST_P(Zoo, IsRefusedWithOneClearSentenceTheFirstTimeAndTheSecond) {
  expect_refused("");
  expect_refused("");
}

TEST_P(Zoo, LeavesNoInstanceAndAGoodPluginStillRuns) {
  expect_refused("");
  EXPECT_EQ(system.system().snapshot().instances_size(), 0);
  expect_good_plugin_runs(system);
}

TEST_P(Zoo, IsRefusedInAGroupAndTheGroupDoesNotStay) {
  expect_refused("cage");
  const auto snapshot = system.system().snapshot();
  EXPECT_EQ(snapshot.instances_size(), 0);
  ASSERT_EQ(snapshot.groups_size(), 1);
  EXPECT_EQ(snapshot.groups(0).name(), "main");
}

INSTANTIATE_TEST_SUITE_P(
    Each, Zoo,
    testing::Values(
        Refusal{"missing-symbol", ErrorCode::Failed,
                "plugin 'local/missing-symbol' cannot be loaded: the system's loader refuses it",
                "undefined symbol: fiona_zoo_absent_function", "ask the publisher for a build for this system"},
        Refusal{"no-entry", ErrorCode::Failed, "plugin 'local/no-entry' cannot be loaded: it has no entry", "",
                "FIONA_PLUGIN(plugin)"},
        Refusal{"null-entry", ErrorCode::Failed, "plugin 'local/null-entry' cannot be loaded: its entry is null", "",
                "tell the publisher"},
        Refusal{"null-declare", ErrorCode::Failed, "its entry has no function that names its components", "",
                "tell the publisher"},
        Refusal{"other-abi", ErrorCode::Failed, "it was built for another SDK or compiler", "fiona9.9-cxxabi9999",
                "install a build of it for this version of FIONA"},
        Refusal{"other-library", ErrorCode::Failed, "the library is not the one that its interface describes",
                "fiona9.9-cxxabi9999", "install the package again"},
        Refusal{"other-strings", ErrorCode::Failed,
                "plugin 'local/other-strings' cannot be loaded: the system's loader refuses it",
                "undefined symbol: _ZNK5fiona9Component4nameEv", "ask the publisher for a build for this system"},
        Refusal{"throws-in-factory", ErrorCode::ComponentFailed,
                "component 'throws-in-factory' cannot be made: the antenna is not plugged in", "",
                "tell the publisher"},
        Refusal{"fails-on-start", ErrorCode::ComponentFailed,
                "'patient' failed: there is no step counter on this machine", "", "plug one in"},
        Refusal{
            "lies", ErrorCode::Failed,
            "component 'lies' is not what its package says: it provides steps (fiona.localisation.StepProvider); its "
            "interface says: provides strides (fiona.localisation.StepProvider)",
            "", "install the package again"}),
    [](const auto& tested) {
      std::string name = tested.param.library;
      std::erase(name, '-');
      return name;
    });

TEST(Load, ProtoFileOfAnotherPluginIsRefusedBeforeTheLibraryIsOpened) {
  RunningSystem system;
  system.load_provider("source", "source");
  const auto error = error_of_load(system, zoo_library("clashing-proto"));
  ASSERT_TRUE(error.has_value());
  EXPECT_EQ(error->code(), ErrorCode::Failed);
  EXPECT_THAT(error->text().what, HasSubstr("its proto file 'fiona/test/test.proto' has already been brought by plugin "
                                            "'local/test-components', and protobuf ends a process that gets it twice"));
  EXPECT_EQ(error->text().next,
            "load " + std::string(ZOO_DIRECTORY) + "/libclashing-proto.so in GROUP: a group is a process of its own");
}

TEST(Load, ProtoFileOfAnotherPluginIsNoObstacleInAGroupOfItsOwn) {
  RunningSystem system;
  system.load_provider("source", "source");
  EXPECT_FALSE(error_of_load(system, zoo_library("clashing-proto"), "apart").has_value());
  system.eventually("ticks", [&] { return system.port("patient.ticks").messages() >= 3; });
}

TEST(Load, ContractOfAPluginInAGroupIsItsOwnAndNotThatOfAFileOfTheSameName) {
  RunningSystem system;
  system.load_client("sink", "sink");
  ASSERT_FALSE(error_of_load(system, zoo_library("clashing-proto"), "apart").has_value());
  try {
    system.wire("sink.each", "patient.ticks");
    FAIL() << "wired";
  } catch (const Error& error) {
    EXPECT_EQ(
        error.text().what,
        "sink.each requires SampleNewest (push newest, Sample); patient.ticks provides Ticks (push newest, Tick)");
  }
}

/// A plugin and the messages that it needs, each in several versions. What is opened stays in the process: each claim
/// is made in one of its own.
class SharedMessages : public testing::Test {
 protected:
  SharedMessages() { GTEST_FLAG_SET(death_test_style, "threadsafe"); }

  /// This version of the plugin, beside that version of the messages.
  static std::string opened(PluginLibraries& libraries, int plugin, int messages) {
    const auto interface = interface_of(plugin);
    PluginLibraries::Files files;
    files.Add()->set_path(directory_of(messages) + "libzoo-poses.so");
    files[0].set_package("zoo/poses");
    *files[0].mutable_descriptors() = interface_of(messages).descriptors();
    files.Add()->set_path(directory_of(plugin) + "libpose-reader.so");
    try {
      libraries.open("zoo/reader-" + std::to_string(plugin), files, interface);
    } catch (const Error& error) {
      return error.text().what;
    }
    return "opened";
  }
  [[noreturn]] static void end_with(const std::string& text) {
    std::cerr << text << "\n";
    ::_exit(7);
  }

 private:
  static std::string directory_of(int version) {
    return std::string(ZOO_DIRECTORY) + "/messages-" + std::to_string(version) + "/";
  }
  static Interface interface_of(int version) {
    std::stringstream text;
    text << std::ifstream(directory_of(version) + "pose-reader-" + std::to_string(version) + ".interface.textproto")
                .rdbuf();
    Interface interface;
    if (!google::protobuf::TextFormat::ParseFromString(text.str(), &interface)) throw std::runtime_error("unreadable");
    return interface;
  }
};

TEST_F(SharedMessages, AreOpenedOnceForAllWhoNeedThem) {
  EXPECT_EXIT(
      {
        PluginLibraries libraries;
        end_with(opened(libraries, 1, 1) + " " + opened(libraries, 1, 1));
      },
      testing::ExitedWithCode(7), "opened opened");
}

TEST_F(SharedMessages, OfAnotherVersionAreRefusedToTheNextWhoNeedsThem) {
  EXPECT_EXIT(
      {
        PluginLibraries libraries;
        opened(libraries, 1, 1);
        end_with(opened(libraries, 2, 2));
      },
      testing::ExitedWithCode(7),
      "its proto file 'fiona/zoo/pose.proto' has already been brought by plugin 'zoo/poses'");
}

TEST_F(SharedMessages, ThatHaveMovedToAnotherFileAreRefusedToo) {
  EXPECT_EXIT(
      {
        PluginLibraries libraries;
        opened(libraries, 1, 1);
        end_with(opened(libraries, 3, 3));
      },
      testing::ExitedWithCode(7),
      "'fiona.zoo.Pose' of its proto file 'fiona/zoo/place.proto' has already been brought by plugin 'zoo/poses'");
}

TEST_F(SharedMessages, OfAnotherVersionAreNotTakenForThoseThatAPluginWasOpenedWith) {
  EXPECT_EXIT(
      {
        PluginLibraries libraries;
        opened(libraries, 1, 1);
        end_with(opened(libraries, 1, 2));
      },
      testing::ExitedWithCode(7),
      "it was opened here with another version of zoo/poses, and a library is never unloaded");
}

/// A folder with a copy of the good plugin, to be spoilt.
class CopiedPlugin : public testing::Test {
 protected:
  CopiedPlugin() {
    const std::filesystem::path built(TEST_COMPONENTS_LIBRARY);
    std::filesystem::copy_file(built.parent_path() / "test-components.interface.textproto", interface());
    std::filesystem::copy_file(built, library());
  }

  std::filesystem::path library() const { return directory.path / "libcopy.so"; }
  std::filesystem::path interface() const { return directory.path / "copy.interface.textproto"; }
  std::string component() const { return library().string() + "/source"; }

  tests::TemporaryDirectory directory;
  RunningSystem system;
};

TEST_F(CopiedPlugin, WithoutLibraryIsMissing) {
  std::filesystem::remove(library());
  const auto error = error_of_load(system, component());
  ASSERT_TRUE(error.has_value());
  EXPECT_EQ(error->text().what, "plugin 'local/copy' cannot be loaded: its library is missing");
  EXPECT_EQ(error->text().where, library().string());
}

TEST_F(CopiedPlugin, WithoutInterfaceSaysWhoWritesIt) {
  std::filesystem::remove(interface());
  const auto error = error_of_load(system, component());
  ASSERT_TRUE(error.has_value());
  EXPECT_EQ(error->code(), ErrorCode::NotFound);
  EXPECT_EQ(error->text().what, "plugin 'copy' has no readable interface beside it");
  EXPECT_THAT(error->text().next, HasSubstr("fiona_add_plugin()"));
}

TEST_F(CopiedPlugin, TruncatedLibraryIsRefusedInTheLoadersWords) {
  std::filesystem::resize_file(library(), 30);
  const auto error = error_of_load(system, component());
  ASSERT_TRUE(error.has_value());
  EXPECT_THAT(error->text().found, HasSubstr("file too short"));
}

TEST_F(CopiedPlugin, LibraryThatEndsAmidItsCodeIsRefusedBeforeItIsOpened) {
  std::filesystem::resize_file(library(), 200'000);  // what debuggers read may be most of the file
  const auto error = error_of_load(system, component());
  ASSERT_TRUE(error.has_value());
  EXPECT_EQ(error->text().what, "plugin 'local/copy' cannot be loaded: its file ends before its code does");
  EXPECT_EQ(error->text().found, "200000 bytes");
}

TEST_F(CopiedPlugin, LibraryForAnotherMachineIsRefusedWithBothNames) {
  std::fstream file(library(), std::ios::in | std::ios::out | std::ios::binary);
  file.seekp(18);  // e_machine
  file.put(static_cast<char>(0xf3)).put(0);
  file.close();
  const auto error = error_of_load(system, component());
  ASSERT_TRUE(error.has_value());
  EXPECT_EQ(error->text().what, "plugin 'local/copy' cannot be loaded: it was built for another machine");
  EXPECT_EQ(error->text().found, "RISC-V");
  EXPECT_EQ(error->text().next, "install a build of it for this machine");
}

TEST_F(CopiedPlugin, TextInPlaceOfALibraryIsRefusedInTheLoadersWords) {
  std::ofstream(library(), std::ios::trunc) << std::string(4096, 'x');
  const auto error = error_of_load(system, component());
  ASSERT_TRUE(error.has_value());
  EXPECT_THAT(error->text().found, HasSubstr("invalid ELF header"));
}

TEST_F(CopiedPlugin, UnknownComponentIsToldTheNearestName) {
  const auto error = error_of_load(system, library().string() + "/sourc");
  ASSERT_TRUE(error.has_value());
  EXPECT_EQ(error->code(), ErrorCode::NotFound);
  EXPECT_EQ(error->text().what, "plugin 'local/copy' has no component 'sourc'");
  EXPECT_THAT(error->text().near, testing::Contains("source"));
}

TEST_F(CopiedPlugin, RebuiltSinceItWasLoadedIsRefusedAndTheInstanceRunsOn) {
  control::Change change;
  control::Load& first = *change.mutable_load();
  first.set_plugin(component());
  first.set_instance("first");
  first.set_group("apart");  // this process may have the protos of the original
  first.mutable_parameters()->Add()->set_name("period_ms");
  first.mutable_parameters(0)->mutable_value()->set_integer(1);
  system.system().perform(change);
  std::filesystem::last_write_time(library(), std::filesystem::file_time_type::clock::now() + std::chrono::hours(1));
  const auto error = error_of_load(system, component(), "apart");
  ASSERT_TRUE(error.has_value());
  EXPECT_THAT(error->text().what,
              HasSubstr("the file has changed since it was loaded, and a library is never unloaded"));
  const auto before = system.port("first.newest").messages();
  system.eventually("goes on", [&] { return system.port("first.newest").messages() > before; });
}

TEST(Load, TakenNameIsRefusedAndSaysWhoHasIt) {
  RunningSystem system;
  system.load_provider("source", "source");
  try {
    system.load_provider("sink", "source");
    FAIL() << "loaded twice";
  } catch (const Error& error) {
    EXPECT_EQ(error.code(), ErrorCode::Usage);
    EXPECT_EQ(error.text().what, "there is an instance 'source' already");
    EXPECT_THAT(error.text().next, HasSubstr("unload source"));
  }
  EXPECT_EQ(system.instance("source").component(), "source");
}

TEST(Load, WrongParameterLoadsNothing) {
  RunningSystem system;
  try {
    system.load_provider("source", "source", "period_ms=0.01");
    FAIL() << "loaded";
  } catch (const Error& error) {
    EXPECT_EQ(error.code(), ErrorCode::Usage);
    EXPECT_EQ(error.text().what, "refused: period_ms is 0.01, below 0.1 ms");
    EXPECT_EQ(error.text().next, "'source' was not loaded: correct that, then load it again");
  }
  EXPECT_EQ(system.system().snapshot().instances_size(), 0);
  expect_good_plugin_runs(system);
}

}  // namespace
}  // namespace fiona::host
