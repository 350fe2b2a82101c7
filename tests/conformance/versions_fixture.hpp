#pragma once

#include <gtest/gtest.h>

#include <stdexcept>
#include <string>
#include <vector>

#include "engine.hpp"
#include "failure.hpp"
#include "fiona/error.hpp"
#include "mailbox.hpp"
#include "system_fixture.hpp"
#include "versioned_plugin.hpp"

namespace fiona::conformance {

/// A system changed by its engine, and a plugin of which another version can be built at any time.
class Versions : public testing::Test {
 protected:
  void build(const std::string& behaviour, const std::string& other_port = "") { plugin.build(behaviour, other_port); }
  std::shared_ptr<LaterAnswer> begin(control::Change change, bool plans = false) {
    control::Transact request;
    request.set_dry_run(plans);
    *request.add_changes() = std::move(change);
    auto answer = std::make_shared<LaterAnswer>();
    engine.transact("test", request, [answer](control::Reply reply) {
      answer->reply = std::move(reply);
      answer->ended = true;
    });
    return answer;
  }
  void serve() {
    for (const auto& job : work.take()) job();
  }
  control::Reply end_of(const std::shared_ptr<LaterAnswer>& answer) {
    system.eventually("the answer", [&] {
      serve();
      return answer->ended.load();
    });
    return answer->reply;
  }
  control::Done make(control::Change change) {
    const control::Reply reply = end_of(begin(std::move(change)));
    if (reply.has_failure()) host::throw_failure(reply.failure());
    return reply.done();
  }
  Error refusal_of(control::Change change) {
    try {
      make(std::move(change));
    } catch (const Error& error) {
      return error;
    }
    throw std::runtime_error("it was taken");
  }
  control::Change load_of(const std::string& group) const { return plugin.load_in(group); }
  static control::Change upgrade_of(double watch_ms = 0) { return VersionedPlugin::upgrade_of(watch_ms); }
  void wire(const std::string& client, const std::string& provider) {
    control::Change change;
    *change.mutable_wire()->mutable_client() = port_name(client);
    *change.mutable_wire()->mutable_provider() = port_name(provider);
    make(std::move(change));
  }
  void let_be(std::chrono::milliseconds time) {
    const auto end = std::chrono::steady_clock::now() + time;
    system.eventually("the time passes", [&] {
      serve();
      return std::chrono::steady_clock::now() >= end;
    });
  }
  /// What serves says its version.
  double version_heard() {
    const auto watch = system.watch("x.samples");
    const double version = system.wait_for(watch, [](const auto&) { return true; }).value();
    system.system().untap(watch);
    return version;
  }
  std::vector<std::string> groups() {
    std::vector<std::string> names;
    const auto snapshot = system.system().snapshot();
    for (const auto& one : snapshot.groups()) {
      if (one.alive()) names.push_back(one.name());
    }
    return names;
  }

  VersionedPlugin plugin;
  host::Mailbox<std::function<void()>> work;
  RunningSystem system{RunningSystem::RestartsGroups{}};
  host::Engine engine{system.system(), plugin.directory() / "journal",
                      [this](std::function<void()> job) { work.push(std::move(job)); }};
};

}  // namespace fiona::conformance
