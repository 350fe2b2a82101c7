// R29: every verb at every level does what the table says, and who decides is the host's own policy.
#include <gtest/gtest.h>

#include <cstdlib>
#include <fstream>
#include <map>
#include <mutex>

#include "scripted_host.hpp"
#include "src/access.hpp"
#include "verb_table.hpp"
#include "watch_list.hpp"

namespace fiona::console {
namespace {

using namespace std::chrono_literals;

/// Lines, and the level that the host asks for; Nothing: the host is asked for nothing, or its refusal is done without.
struct Sample {
  std::string lines;
  Access needed;
};

/// Of each verb first what takes the most that the verb's row says; then what takes less, or names a file on the host's
/// machine and takes more. FILE is a system file that loads something.
const std::map<std::string, std::vector<Sample>>& samples() {
  static const std::map<std::string, std::vector<Sample>> kSamples{
      {"load", {{"load trace-player as walk", Access::Compose}, {"load /home/me/libx.so/x", Access::Administer}}},
      {"unload", {{"unload walk", Access::Compose}}},
      {"wire", {{"wire nav.imu to walk.imu", Access::Compose}}},
      {"unwire", {{"unwire nav.imu", Access::Compose}}},
      {"swap", {{"swap walk for nav", Access::Compose}, {"swap walk for nav watch 1s", Access::Compose}}},
      {"upgrade",
       {{"upgrade walk", Access::Compose},
        {"upgrade walk to 1.0.0 watch 0s", Access::Compose},
        {"upgrade host watch 0s", Access::Administer}}},
      {"begin", {{"begin", Access::Nothing}}},
      {"commit",
       {{"begin\nload a\nset a rate=5\ncommit", Access::Compose}, {"begin\nset walk rate=5\ncommit", Access::Operate}}},
      {"abort", {{"begin\nload a\nabort", Access::Nothing}}},
      {"plan",
       {{"plan load a", Access::Observe},
        {"plan undo", Access::Observe},
        {"plan swap walk for nav", Access::Observe},
        {"plan apply FILE", Access::Observe},
        {"plan load /home/me/libx.so/x", Access::Administer}}},
      {"apply", {{"apply FILE", Access::Compose}}},
      {"undo", {{"undo", Access::Compose}}},
      {"journal", {{"journal", Access::Observe}}},
      {"set",
       {{"set walk rate=5", Access::Operate},
        {"set host clock=virtual", Access::Operate},
        {"set host deliveries=/home/me/log", Access::Administer}}},
      {"get", {{"get walk", Access::Observe}}},
      {"state", {{"state walk neutral", Access::Operate}, {"state walk", Access::Observe}}},
      {"call", {{"call walk.go", Access::Operate}}},
      {"send", {{"send walk.imu", Access::Operate}}},
      {"ls",
       {{"ls", Access::Observe},
        {"ls wires", Access::Observe},
        {"ls services", Access::Observe},
        {"ls hosts", Access::Observe}}},
      {"show", {{"show walk", Access::Observe}, {"show walk.imu", Access::Observe}}},
      {"spots", {{"spots", Access::Observe}}},
      {"why", {{"why nav", Access::Observe}}},
      {"watch", {{"watch walk.imu for 10ms", Access::Observe}}},
      {"record", {{"record RECORDED walk.imu for 10ms", Access::Observe}}},
      {"graph", {{"graph", Access::Observe}}},
      {"top", {{"top", Access::Observe}}},
      {"check", {{"check FILE", Access::Nothing}}},
      {"run", {}},  // starts a host, and asks none
      {"save", {{"save SAVED", Access::Observe}}},
      {"source", {{"source FILE", Access::Compose}}},
      {"wait", {{"wait walk neutral", Access::Observe}}},
      {"expect", {{"expect walk.imu.rate == 1", Access::Observe}}},
      {"sleep", {{"sleep 1ms", Access::Observe}}},
      {"quit", {{"quit", Access::Administer}}},
      {"market", {{"market search", Access::Nothing}}},
      {"plugin", {{"plugin sign nothing.fpk", Access::Nothing}, {"plugin check nothing.fpk", Access::Nothing}}},
      {"keys", {{"keys", Access::Nothing}}},
      {"doctor", {{"doctor", Access::Nothing}}},
      {"paths", {{"paths", Access::Nothing}}},
      {"complete", {{"complete unload ", Access::Nothing}}},
      {"help", {{"help", Access::Nothing}}},
      {"version", {{"version", Access::Observe}}},
  };
  return kSamples;
}

control::System system_of_two() {
  control::System system;
  system.set_host("main");
  for (const char* name : {"walk", "nav"}) {
    auto* one = system.add_instances();
    one->set_name(name);
    one->set_plugin("fiona/tools");
    one->set_mode("active");
    auto* port = one->add_ports();
    port->set_name("imu");
    port->set_service("fiona.sensors.GetIMUService");
    port->set_direction(std::string(name) == "walk" ? fiona::PROVIDES : fiona::REQUIRES);
  }
  return system;
}

/// What a host answers that does all it is asked for, but to end.
std::vector<control::Reply> fulfilled(const control::Request& request) {
  control::Reply reply;
  if (request.has_snapshot()) *reply.mutable_system() = system_of_two();
  if (request.has_transact() || request.has_undo()) {
    const bool dry = request.transact().dry_run() || request.undo().dry_run();
    dry ? static_cast<void>(reply.mutable_planned()) : static_cast<void>(reply.mutable_done());
  }
  if (request.has_call()) reply.mutable_called()->set_outcome("ok");
  if (request.has_wait_mode() || request.has_expect() || request.has_sleep()) reply.mutable_met();
  if (request.has_journal()) reply.mutable_journal();
  if (request.has_read()) reply.mutable_sample();
  if (request.has_describe()) reply.mutable_description();
  if (request.has_watch()) return {};
  if (request.has_upgrade_host()) reply.mutable_failure()->set_what("nobody would start the next one");
  if (reply.what_case() == control::Reply::WHAT_NOT_SET) reply.mutable_done();
  return {reply};
}

/// How a line comes to a console.
enum class From { Shell, Script, SourcedFile };

/// A console with this level, and what the host's policy makes of its lines.
class AccessTable : public ::testing::TestWithParam<From> {
 protected:
  void SetUp() override {
    ::setenv("FIONA_MARKET", "/nonexistent", 1);
    ::setenv("FIONA_KEYS", (directory.path / "keys").c_str(), 1);
    ::setenv("XDG_RUNTIME_DIR", directory.path.c_str(), 1);
    std::ofstream(directory.path / "system.fiona") << "load trace-player as walk\n";
  }

  std::vector<control::Reply> answer(const control::Request& request) {
    const std::lock_guard lock(mutex_);
    try {
      host::require({level_, level_, "tester", "0123"}, request);
      return fulfilled(request);
    } catch (const Error& error) {
      refused_ = true;
      control::Reply reply;
      reply.mutable_failure()->set_code(static_cast<std::uint32_t>(error.code()));
      reply.mutable_failure()->set_what(error.text().what);
      return {reply};
    }
  }

  /// Whether the host has refused it for want of a level.
  bool refused(std::string lines, Access level) {
    {
      const std::lock_guard lock(mutex_);
      level_ = level;
      refused_ = false;
    }
    for (const char* name : {"FILE", "SAVED", "RECORDED"}) {
      const std::size_t at = lines.find(name);
      if (at != std::string::npos)
        lines.replace(at, std::string(name).size(),
                      (directory.path / (name[0] == 'F' ? "system.fiona" : "saved.fiona")).string());
    }
    Options options;
    options.at = "unix:" + host.socket().string();
    options.timeout = 10s;
    options.store = directory.path / "store";
    Session session(reactor, output, options);
    bool told = false;
    try {
      run(session, lines);
      // Elsewhere than in a shell a watch goes on behind its line.
      reactor.run_until([&session] { return session.watches().empty(); }, std::chrono::steady_clock::now() + 10s);
    } catch (const Error& error) {
      told = error.code() == ErrorCode::NotAllowed;
    }
    const std::lock_guard lock(mutex_);
    EXPECT_TRUE(refused_ || !told) << lines << ": refused, and not by the host";
    return refused_;
  }

  void run(Session& session, const std::string& lines) {
    if (GetParam() == From::SourcedFile) {
      const std::string file = (directory.path / "lines.fiona").string();
      std::ofstream(file) << lines << "\n";
      return session.run(split_line("source " + file));
    }
    const bool one = lines.find('\n') == std::string::npos;
    session.setting = one && GetParam() == From::Shell ? Setting::Shell : Setting::Script;
    for (const WordLine& line : split_script(lines, "test")) session.run(line);
  }

  TemporaryDirectory directory;
  ScriptedHost host{[this](const control::Request& request) { return answer(request); }};
  Reactor reactor;
  Output output{[](Stream, std::string_view) {}};

 private:
  std::mutex mutex_;
  Access level_ = Access::Nothing;
  bool refused_ = false;
};

TEST_P(AccessTable, EveryVerbIsAllowedAtTheLevelsThatItsRowSaysAndAtNoOther) {
  for (const Verb& verb : verb_rows()) {
    ASSERT_TRUE(samples().contains(verb.name)) << "a new verb needs a line here: " << verb.name;
    for (const Sample& sample : samples().at(verb.name)) {
      for (int level = 0; level <= 9; ++level) {
        EXPECT_EQ(refused(sample.lines, static_cast<Access>(level)), level < static_cast<int>(sample.needed))
            << sample.lines << " at level " << level;
      }
    }
  }
}

INSTANTIATE_TEST_SUITE_P(, AccessTable, ::testing::Values(From::Shell, From::Script, From::SourcedFile),
                         [](const auto& from) {
                           return from.param == From::Shell    ? "Shell"
                                  : from.param == From::Script ? "Script"
                                                               : "SourcedFile";
                         });

TEST(Access, TheRowOfAVerbThatAsksTheHostSaysWhatTheHostAsksFor) {
  for (const Verb& verb : verb_rows()) {
    const auto& of_verb = samples().at(verb.name);
    if (of_verb.empty() || of_verb.front().needed == Access::Nothing) continue;
    EXPECT_EQ(verb.access, of_verb.front().needed) << verb.name;
  }
  EXPECT_EQ(samples().size(), verb_rows().size()) << "a verb that is no more";
}

}  // namespace
}  // namespace fiona::console
