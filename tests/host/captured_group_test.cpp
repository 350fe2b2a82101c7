// A group whose process a component has taken over: it speaks to the host as it likes.
#include <fcntl.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <signal.h>
#include <sys/mman.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <string>
#include <thread>

#include "os/descriptor.hpp"
#include "served_host.hpp"

namespace fiona::host {
namespace {

using conformance::ServedHost;
using conformance::TestConsole;
using testing::HasSubstr;

/// What this process says to its standard error, to be looked at while it goes on.
class StandardError {
 public:
  StandardError() { ::dup2(file_.get(), STDERR_FILENO); }
  ~StandardError() { ::dup2(before_.get(), STDERR_FILENO); }
  StandardError(const StandardError&) = delete;
  StandardError& operator=(const StandardError&) = delete;
  std::string said() const {
    std::string text(static_cast<std::size_t>(::lseek(file_.get(), 0, SEEK_END)), '\0');
    const ssize_t read = ::pread(file_.get(), text.data(), text.size(), 0);
    return text.substr(0, static_cast<std::size_t>(std::max<ssize_t>(read, 0)));
  }

 private:
  const os::Descriptor before_{::fcntl(STDERR_FILENO, F_DUPFD_CLOEXEC, 0)};
  const os::Descriptor file_{::memfd_create("stderr", MFD_CLOEXEC)};
};

class CapturedGroup : public testing::Test {
 protected:
  CapturedGroup() { console.load("source", "far", "source", "period_ms=5"); }
  void load(const std::string& captor) {
    control::Change change;
    control::Load& request = *change.mutable_load();
    request.set_plugin(std::string(ZOO_DIRECTORY) + "/lib" + captor + ".so");
    request.set_instance("captor");
    request.set_group("cage");
    request.add_rights("confined");
    console.change(std::move(change));
  }
  double seconds_of(const std::function<void()>& what) {
    const auto begun = std::chrono::steady_clock::now();
    what();
    return std::chrono::duration<double>(std::chrono::steady_clock::now() - begun).count();
  }

  ServedHost host;
  TestConsole console{host};
};

TEST_F(CapturedGroup, ThatDribblesIsSilentAndHoldsUpNobody) {
  load("dribbles");
  console.eventually("it is silent", [&] {
    EXPECT_LT(seconds_of([&] { console.snapshot(); }), 2.5) << "300 ms, on an idle machine";
    return console.instance("captor").silent_s() > 0;
  });
  EXPECT_LT(seconds_of([&] { console.snapshot(); }), 2.5);
  EXPECT_EQ(console.instance("source").silent_s(), 0);
  EXPECT_THROW(console.set("captor", "x=1"), Error);
}

TEST_F(CapturedGroup, ThatSaysWhatIsNoMessageIsEnded) {
  load("garbles");
  const pid_t process = console.process_of("cage");
  console.eventually("it is ended", [&] { return console.instance("captor").mode() == "failed"; });
  EXPECT_THAT(console.instance("captor").reason(),
              HasSubstr("group 'cage' was ended: it said 4 bytes that are no fiona.wire.GroupMessage"));
  console.eventually("its process is gone", [&] { return ::kill(process, 0) != 0; });
}

TEST_F(CapturedGroup, ThatFloodsTheLogIsWrittenNoMoreThanAnyOther) {
  testing::internal::CaptureStderr();
  const double seconds = seconds_of([&] {
    load("floods-log-of-its-host");
    for (int i = 0; i < 20; ++i) {
      console.snapshot();
      std::this_thread::sleep_for(std::chrono::milliseconds(50));
    }
  });
  const std::string said = testing::internal::GetCapturedStderr();
  EXPECT_THAT(said, HasSubstr("captor: xxx"));
  EXPECT_LT(static_cast<double>(said.size()), (2000 + 400 * (seconds + 1)) * 4200.0);
}

TEST_F(CapturedGroup, InASandboxEndsNoRun) {
  TestConsole runner(host);
  auto run = runner.request();
  run.mutable_run();
  runner.send(run);
  const StandardError error;
  load("ends-the-run");
  console.eventually("it was refused", [&] {
    console.snapshot();
    return error.said().find("asked for the end of the run") != std::string::npos;
  });
  EXPECT_THAT(error.said(),
              HasSubstr("'captor' asked for the end of the run, which is not for a component in a sandbox"));
  EXPECT_FALSE(runner.has_answer());
  EXPECT_EQ(console.instance("captor").mode(), "active");
}

TEST_F(CapturedGroup, ThatFloodsItsHostIsEndedOnceItIsAskedAndHoldsUpNobody) {
  load("floods-its-host");
  console.eventually("it is ended", [&] {
    EXPECT_LT(seconds_of([&] { console.snapshot(); }), 2.5) << "300 ms, on an idle machine";
    return console.instance("captor").mode() == "failed";
  });
  EXPECT_THAT(console.instance("captor").reason(),
              HasSubstr("group 'cage' was ended: it said more than 64 MiB and did not answer"));
  EXPECT_EQ(console.instance("source").mode(), "active");
}

TEST_F(CapturedGroup, IsNotBelievedWhatItSaysOfOthers) {
  console.load("sink", "main", "sink");
  console.change(TestConsole::wire_of("sink.each", "source.newest"));
  console.load("mover", "far", "mover", "work_ms=5000");  // holds the activity that a change of mode waits for
  console.load("source", "far", "silent", "period_ms=10000");
  console.change(TestConsole::wire_of("mover.orders", "silent.newest"));
  TestConsole watcher(host), runner(host), mover(host);
  auto watch = watcher.request();
  *watch.mutable_watch()->mutable_port() = conformance::port_name("source.newest");
  watcher.send(watch);
  ASSERT_TRUE(watcher.receive().has_sample());
  auto run = runner.request();
  run.mutable_run();
  runner.send(run);
  control::Change rest;
  rest.mutable_state()->set_instance("mover");
  rest.mutable_state()->set_mode("rest");
  mover.begin(rest);
  testing::internal::CaptureStderr();
  load("forges");
  console.eventually("it has ended", [&] { return console.instance("captor").mode() == "failed"; });
  EXPECT_THAT(console.instance("captor").reason(), HasSubstr("exited with code 0"));
  EXPECT_EQ(console.instance("source").mode(), "active");
  const std::string said = testing::internal::GetCapturedStderr();
  EXPECT_THAT(said, HasSubstr("group 'cage' has spoken of what it does not have, and was not asked for (tapped)"));
  EXPECT_THAT(said, testing::Not(HasSubstr("forged")));
  const control::InstanceStatus sink = console.instance("sink");
  for (const auto& port : sink.ports()) {
    if (port.name() != "each") continue;
    EXPECT_EQ(port.connection(), control::CONNECTED) << port.reason();
  }
  EXPECT_FALSE(runner.has_answer());
  EXPECT_FALSE(mover.has_answer());
  while (watcher.has_answer()) EXPECT_NE(watcher.receive().sample().sequence(), 123'456'789U);
  ASSERT_TRUE(watcher.receive().has_sample()) << "it goes on";
}

}  // namespace
}  // namespace fiona::host
