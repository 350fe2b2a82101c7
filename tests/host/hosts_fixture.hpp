// A host that leads another over tcp: both in a directory of their own.
#pragma once

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/types.h>

#include <chrono>
#include <fstream>
#include <string>

#include "evidence.hpp"
#include "fiona/error.hpp"
#include "system_fixture.hpp"

namespace fiona::host {

using namespace std::chrono_literals;
using conformance::OtherHost;
using conformance::RunningSystem;
using conformance::TemporaryDirectory;
using conformance::Transport;
using testing::HasSubstr;
using testing::Not;
using Steady = std::chrono::steady_clock;

template <class F>
Error error_of(F request) {
  try {
    request();
  } catch (const Error& error) {
    return error;
  }
  return Error(ErrorCode::Failed, "no error");
}

inline double ms_since(Steady::time_point begin) {
  return std::chrono::duration<double, std::milli>(Steady::now() - begin).count();
}

/// Of the host's groups, the first; 0: it has none.
inline pid_t group_of(pid_t host) {
  const std::string id = std::to_string(host);
  std::ifstream children("/proc/" + id + "/task/" + id + "/children");
  for (pid_t one = 0; children >> one;) {
    if (conformance::content_of("/proc/" + std::to_string(one) + "/cmdline").find("--endpoint") != std::string::npos)
      return one;
  }
  return 0;
}

class Hosts : public testing::Test {
 protected:
  /// The source on this host puts every 5 ms; the sink on the other receives each.
  static void wire_source_to_sink(RunningSystem& system) {
    system.load_in("", "source", "source", "neutral period_ms=5");
    system.load_in("far", "sink", "sink");
    system.wire("sink.each", "source.newest");
    system.state("source", "active");
    system.eventually("messages come", [&] { return system.port("sink.each").messages() > 10; });
  }
  /// What was put before this moment has come, or has been counted as lost.
  static void expect_nothing_lost_silently(RunningSystem& system) {
    system.state("source", "neutral");
    const auto put = system.port("source.newest").messages();
    system.eventually("each message is accounted for", [&] {
      const auto sink = system.port("sink.each");
      return sink.messages() + sink.dropped() == put;
    });
  }
  TemporaryDirectory directory;
};

}  // namespace fiona::host
