// The author's side without a build: names, the files of a new plugin, libraries read and not loaded.
#include <gmock/gmock.h>

#include <fstream>
#include <set>

#include <fiona/marketplace/manifest.hpp>

#include "author/child_program.hpp"
#include "author/elf_library.hpp"
#include "author/plugin_check.hpp"
#include "author/plugin_template.hpp"

namespace fiona::console {
namespace {

using namespace std::chrono_literals;
using testing::Contains;
using testing::HasSubstr;
using testing::Not;

SteadyTime soon(std::chrono::milliseconds time) { return std::chrono::steady_clock::now() + time; }

TEST(NewPlugin, PortsAreNamedByTheirServices) {
  EXPECT_EQ(port_name_of("LocationProvider"), "location");
  EXPECT_EQ(port_name_of("GetIMUService"), "imu");
  EXPECT_EQ(port_name_of("RFSignalRSSIService"), "rf_signal_rssi");
  EXPECT_EQ(port_name_of("PointObjectDetected"), "point_object");
  EXPECT_EQ(port_name_of("SatelliteInView"), "satellite_in_view");
}

TEST(NewPlugin, ANameIsOneOfPackagesAndOfCpp) {
  EXPECT_EQ(plugin_name_fault("step-counter2"), "");
  for (const char* name : {"", "2steps", "Steps", "step_counter", "steps-", "step--counter", "class", "co--", "std"})
    EXPECT_NE(plugin_name_fault(name), "") << name;
}

TEST(NewPlugin, EveryServiceOfThePlatformHasItsParts) {
  for (const auto* service : platform_services()) {
    for (const bool provides : {true, false}) {
      NewPlugin plugin{.publisher = "acme", .name = "some-thing"};
      (provides ? plugin.provided : plugin.needed).push_back(service);
      const auto files = new_plugin_files(plugin);
      const std::string port = port_name_of(service->name()) + "_{*this, \"" + port_name_of(service->name()) + "\"";
      EXPECT_THAT(files.at("src/some_thing.hpp"), HasSubstr(port)) << service->name();
      for (const auto& [path, text] : files)
        EXPECT_THAT(text, Not(HasSubstr("@"))) << path << " for " << service->name();
    }
  }
}

TEST(NewPlugin, AServiceThatIsProvidedAndRequiredGivesTwoPorts) {
  const auto* service = platform_services().front();
  const std::string header =
      new_plugin_files({.publisher = "acme", .name = "filter", .provided = {service}, .needed = {service}})
          .at("src/filter.hpp");
  const std::string port = port_name_of(service->name());
  EXPECT_THAT(header, HasSubstr("\"" + port + "\""));
  EXPECT_THAT(header, HasSubstr("\"" + port + "_2\""));
}

TEST(NewPlugin, ItsManifestIsReadByThePackager) {
  const auto files = new_plugin_files({.publisher = "acme-corp", .name = "step-counter"});
  const auto manifest = marketplace::parse_manifest(files.at("manifest.textproto"), "manifest");
  EXPECT_EQ(marketplace::full_name(manifest), "acme-corp/step-counter");
  EXPECT_TRUE(files.contains("proto/acme_corp/step_counter/params.proto"));
}

TEST(ElfLibrary, ReadsWhatALibraryNeedsAndDefines) {
  const ElfLibrary library = read_elf(FIONA_TEST_LIBRARY);
  EXPECT_EQ(library.machine, marketplace::this_architecture());
  EXPECT_TRUE(library.defined.contains("fiona_plugin_entry"));
  EXPECT_THAT(library.libraries, Contains(testing::StartsWith("libfiona.so.")));
  EXPECT_TRUE(missing_symbols(library, library.defined).empty());
}

TEST(ElfLibrary, ASymbolThatNobodyDefinesIsMissing) {
  ElfLibrary library;
  library.needed = {{"printf", ""}, {"nobody_defines_this", ""}, {"printf", "GLIBC_9.99"}};
  const auto missing = missing_symbols(library, {});
  ASSERT_EQ(missing.size(), 2U);
  EXPECT_EQ(missing[0].name, "nobody_defines_this");
  EXPECT_EQ(missing[1].version, "GLIBC_9.99");
}

TEST(ElfLibrary, ATruncatedOneIsRefused) {
  const ScratchDirectory directory;
  const std::string whole = file_text(FIONA_TEST_LIBRARY);
  const auto file = directory.path() / "libcut.so";
  for (const std::size_t size :
       {std::size_t{0}, std::size_t{3}, std::size_t{64}, std::size_t{1000}, whole.size() / 2}) {
    std::ofstream(file, std::ios::binary | std::ios::trunc) << whole.substr(0, size);
    EXPECT_THROW(read_elf(file), Error) << size;
  }
}

TEST(PluginCheck, AnEntryThatIsMissingIsFoundWithoutRunningAnything) {
  const ScratchDirectory directory;
  const auto library = directory.path() / "libnone.so";
  std::filesystem::copy(std::filesystem::canonical("/proc/self/exe"), library);
  std::ofstream(directory.path() / "none.interface.textproto") << "abi: \"other\"";
  Reactor reactor;
  const PluginCheck check = check_plugin(reactor, files_of_library(library), Catalogue("none"), Confinement::Sandbox);
  std::set<std::string> found;
  for (const ErrorText& finding : check.findings) found.insert(finding.what);
  EXPECT_TRUE(found.contains("the plugin was built for another SDK or compiler"));
  EXPECT_TRUE(found.contains("the plugin has no component"));
  EXPECT_TRUE(found.contains("the library has no entry"));
}

TEST(ChildProgram, GivesItsLinesAndItsCode) {
  Reactor reactor;
  std::vector<std::string> out;
  std::vector<std::string> err;
  const ChildEnd end = run_child(reactor, {.program = "sh",
                                           .arguments = {"-c", "echo a; echo b >&2; printf c; exit 3"},
                                           .deadline = soon(60s),
                                           .on_out = [&](const std::string& line) { out.push_back(line); },
                                           .on_err = [&](const std::string& line) { err.push_back(line); }});
  EXPECT_EQ(end.code, 3);
  EXPECT_EQ(out, (std::vector<std::string>{"a", "c"}));
  EXPECT_EQ(err, (std::vector<std::string>{"b"}));
}

TEST(ChildProgram, AfterItsTimeItAndWhatItStartedAreGone) {
  Reactor reactor;
  std::string inner;
  const ChildEnd end = run_child(reactor, {.program = "sh",
                                           .arguments = {"-c", "sleep 1000 & echo $!; wait"},
                                           .deadline = soon(300ms),
                                           .on_out = [&](const std::string& line) { inner = line; }});
  EXPECT_FALSE(end.in_time);
  EXPECT_EQ(end.text(), "did not end in time");
  ASSERT_FALSE(inner.empty());
  // Killed at once; whoever inherited it may take a moment to reap it.
  const std::string status = "/proc/" + inner + "/stat";
  std::string text;
  for (int i = 0; i < 500 && std::filesystem::exists(status) && text.find(") Z ") == std::string::npos; ++i)
    std::getline(std::ifstream(status), text), reactor.run_until([] { return false; }, soon(10ms));
  EXPECT_TRUE(!std::filesystem::exists(status) || text.find(") Z ") != std::string::npos);
}

TEST(ChildProgram, AProgramThatIsNotThereIsNamed) {
  Reactor reactor;
  try {
    run_child(reactor, {.program = "no-such-program", .deadline = soon(1s)});
    FAIL();
  } catch (const Error& error) {
    EXPECT_EQ(error.text().what, "'no-such-program' cannot be started: No such file or directory");
  }
}

}  // namespace
}  // namespace fiona::console
