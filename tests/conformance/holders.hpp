#pragma once

#include <gtest/gtest.h>

#include <set>
#include <string>
#include <vector>

#include "system_fixture.hpp"

namespace fiona::conformance {

/// A component that holds its activity in every way that there is, and somebody who gives it something to do.
class Holders {
 public:
  struct Kind {
    std::string name;
    std::string blocks;      ///< as who waits for it is told
    std::string queue = "";  ///< the port in front of whose handler a message waits
  };
  static const std::vector<Kind>& kinds() {
    static const std::vector<Kind> all{{"task", "task 'work'"},
                                       {"thread", "task 'thread'"},
                                       {"trigger", "trigger 'turn'"},
                                       {"push", "the handler of 'notices'", "notices"},
                                       {"send", "the handler of 'orders'", "orders"},
                                       {"query", "the handler of 'echo'", "echo"},
                                       {"event", "the handler of 'bell'", "bell"}};
    return all;
  }

  explicit Holders(RunningSystem& system) : system_(system) {
    system_.load_client("holder", "holder");
    system_.load_provider("prompter", "prompter");
    system_.wire("holder.notices", "prompter.notices");
    system_.wire("holder.bell", "prompter.bell");
    system_.wire("prompter.orders", "holder.orders");
    system_.wire("prompter.echo", "holder.echo");
    call("holder.listen");
  }

  /// Gives it something to do of this kind.
  void begin(const Kind& kind) {
    if (kind.name == "trigger") {
      turns_.push_back(system_.begin_call("holder.turn", "degrees=1", 60'000));
    } else {
      call((kind.queue.empty() ? "holder.begin" : "prompter.prompt"), "manner=" + kind.name);
    }
  }
  void open(const Kind& kind) { call("holder.open", "manner=" + kind.name); }
  /// Exactly these, in any order.
  void wait_until_held(const std::set<std::string>& names) {
    std::string text;
    for (const auto& one : names) text += (text.empty() ? "" : " ") + one;
    system_.eventually("held by " + text, [&] { return held() == text; });
  }
  std::string held() { return system_.read("holder.held").payload(); }
  std::uint64_t begun() { return static_cast<std::uint64_t>(system_.read("holder.begun").value()); }
  /// Its other activity goes on, which shows that time has passed.
  void let_it_look() {
    const double before = system_.read("holder.looks").value();
    system_.eventually("it looks", [&] { return system_.read("holder.looks").value() > before + 3; });
  }
  std::shared_ptr<LaterAnswer> begin_to_rest() { return system_.begin_state("holder", "rest", 60'000); }
  void wait_until_blocked(const LaterAnswer& change, const Kind& by) {
    system_.eventually("blocked by " + by.blocks,
                       [&] { return change.ended || system_.instance("holder").pending().blocked_by() == by.blocks; });
    let_it_look();
    EXPECT_EQ(system_.instance("holder").pending().blocked_by(), by.blocks);
    EXPECT_EQ(system_.instance("holder").mode(), "work");
    EXPECT_FALSE(change.ended) << change.reply.ShortDebugString();
  }
  void wait_until_it_rests(const LaterAnswer& change) {
    system_.eventually("the change", [&] { return change.ended.load(); });
    EXPECT_EQ(change.reply.done().note(), "holder is rest");
    EXPECT_EQ(system_.instance("holder").mode(), "rest");
  }
  /// The newest call of its trigger.
  const LaterAnswer& turn() const { return *turns_.back(); }

 private:
  void call(const std::string& target, const std::string& arguments = "") {
    const auto called = system_.call(target, arguments, 30'000);
    EXPECT_EQ(called.outcome(), "ok") << target << " " << arguments << ": " << called.reason();
  }

  RunningSystem& system_;
  std::vector<std::shared_ptr<LaterAnswer>> turns_;
};

}  // namespace fiona::conformance
