// What graph, top and the man pages make of a system and of the table of verbs.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>

#include "help_texts.hpp"
#include "manual.hpp"
#include "top_view.hpp"
#include "verb_table.hpp"
#include "wiring_graph.hpp"

namespace fiona::console {
namespace {

using namespace std::chrono_literals;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::Not;

/// phone.imu -> steps.imu at 50 Hz; steps.map is a white spot. The client is loaded first.
control::System walk(const std::string& phone = "phone") {
  control::System system;
  system.set_host("museum");
  system.set_clock("system");
  auto& steps = *system.add_instances();
  steps.set_name("steps");
  steps.set_plugin("fiona/step-heading");
  steps.set_mode("active");
  auto& imu = *steps.add_ports();
  imu.set_name("imu");
  imu.set_direction(fiona::REQUIRES);
  imu.set_service("fiona.sensors.GetIMUService");
  imu.set_connection(control::CONNECTED);
  imu.set_rate_hz(50);
  imu.set_latency_p50_ms(0.05);
  imu.set_latency_p99_ms(4.5);
  imu.set_dropped(3);
  imu.mutable_peer()->set_instance(phone);
  imu.mutable_peer()->set_port("imu");
  auto& map = *steps.add_ports();
  map.set_name("map");
  map.set_direction(fiona::REQUIRES);
  map.set_service("fiona.navigation.MapService");
  map.set_latency_p50_ms(-1);
  map.set_latency_p99_ms(-1);
  auto& provider = *system.add_instances();
  provider.set_name(phone);
  provider.set_plugin("fiona/building-simulator");
  provider.set_mode("active");
  auto& out = *provider.add_ports();
  out.set_name("imu");
  out.set_direction(fiona::PROVIDES);
  out.set_service("fiona.sensors.GetIMUService");
  out.set_latency_p50_ms(-1);
  out.set_latency_p99_ms(-1);
  return system;
}

TEST(Graph, AsTextGoesFromProvidersToClients) {
  EXPECT_EQ(text_graph(walk()),
            "phone  building-simulator, active\n"
            "  imu -> steps.imu  50 Hz\n"
            "\n"
            "steps  step-heading, active\n"
            "  imu <- phone.imu\n"
            "  map ?- MapService\n");
}

TEST(Graph, AWireThatDoesNotWorkSaysWhy) {
  auto system = walk();
  system.mutable_instances(0)->mutable_ports(0)->set_connection(control::LOST);
  system.mutable_instances(0)->mutable_ports(0)->set_reason("phone is gone");
  EXPECT_THAT(text_graph(system), HasSubstr("imu <- phone.imu  lost: phone is gone"));
  EXPECT_THAT(dot_graph(system), HasSubstr("style=dashed"));
  EXPECT_THAT(mermaid_graph(system), HasSubstr("-.->"));
}

TEST(Graph, NamesCannotEndTheQuotesOfALanguage) {
  const auto system = walk("a\"];b -> c\\");
  EXPECT_THAT(dot_graph(system), HasSubstr("label=\"a\\\"];b -> c\\\\ (active)\""));
  EXPECT_THAT(mermaid_graph(system), HasSubstr("[\"a#quot;];b -#62; c\\ (active)\"]"));
}

TEST(Graph, DrawsEachInstanceOnceAndEachWhiteSpot) {
  const std::string dot = dot_graph(walk());
  EXPECT_EQ(std::count(dot.begin(), dot.end(), '\n'), 3 + 3 + 2 + 1) << dot;
  EXPECT_THAT(dot, HasSubstr("[label=\"MapService?\", style=dotted]"));
}

TEST(Graph, ACircleEnds) {
  auto system = walk();
  auto& back = *system.mutable_instances(1)->add_ports();
  back.set_name("back");
  back.set_direction(fiona::REQUIRES);
  back.mutable_peer()->set_instance("steps");
  back.mutable_peer()->set_port("out");
  EXPECT_THAT(text_graph(system), HasSubstr("out -> phone.back"));
}

TEST(Top, BusyAndCpuAreSharesOfTheTimeSinceTheSnapshotBefore) {
  TopView view;
  const std::chrono::steady_clock::time_point begin{};
  auto system = walk();
  view.update(system, begin);
  EXPECT_EQ(view.instances(TopView::Order::Name).objects().at(0)["busy"], nullptr);
  system.mutable_instances(1)->set_handler_ms(250);
  system.mutable_instances(1)->set_cpu_ms(40);
  view.update(system, begin + 1s);
  EXPECT_EQ(view.instances(TopView::Order::Name).objects().at(0)["busy"], 25.0);
  EXPECT_EQ(view.instances(TopView::Order::Name).objects().at(0)["cpu"], 4.0);
  EXPECT_THAT(view.names(TopView::Order::Cpu), ElementsAre("phone", "steps"));
  EXPECT_THAT(view.names(TopView::Order::Busy), ElementsAre("phone", "steps"));
  system.mutable_instances(1)->set_handler_ms(10);  // another one of that name
  view.update(system, begin + 2s);
  EXPECT_EQ(view.instances(TopView::Order::Name).objects().at(0)["busy"], nullptr);
}

TEST(Top, EachColumnCanOrderTheRows) {
  TopView view;
  view.update(walk(), {});
  EXPECT_THAT(view.names(TopView::Order::Latency), ElementsAre("steps", "phone"));
  EXPECT_THAT(view.names(TopView::Order::Drops), ElementsAre("steps", "phone"));
  EXPECT_THAT(view.names(TopView::Order::Name), ElementsAre("phone", "steps"));
  const auto row = view.instances(TopView::Order::Latency).objects().at(0);
  EXPECT_EQ(row["p50"], 0.05);
  EXPECT_EQ(row["p99"], 4.5);
  EXPECT_EQ(row["drops"], 3);
}

TEST(Top, PortsOfAnInstanceThatIsGoneAreNone) {
  TopView view;
  view.update(walk(), {});
  EXPECT_FALSE(view.ports("steps").empty());
  EXPECT_TRUE(view.ports("nobody").empty());
}

TEST(Top, InEightyColumnsOnlyTheEndOfTheHealthMayBeCut) {
  TopView view;
  auto system = walk();
  view.update(system, {});
  system.mutable_instances(1)->set_handler_ms(250);
  system.mutable_instances(1)->set_cpu_ms(125);
  view.update(system, std::chrono::steady_clock::time_point() + 1s);
  const auto lines = view.instances(TopView::Order::Busy).lines();
  EXPECT_LE(lines.at(0).find("health"), 74U) << lines.at(0);
}

TEST(Top, RestartsAreAColumnOnceThereWereSome) {
  TopView view;
  auto system = walk();
  view.update(system, {});
  EXPECT_THAT(view.instances(TopView::Order::Name).lines().at(0), Not(HasSubstr("restarts")));
  EXPECT_EQ(view.instances(TopView::Order::Name).objects().at(0)["restarts"], 0);
  system.mutable_instances(1)->set_restarts(2);
  view.update(system, {});
  const auto lines = view.instances(TopView::Order::Name).lines();
  EXPECT_THAT(lines.at(0), HasSubstr("drops  restarts  health"));
  EXPECT_EQ(view.instances(TopView::Order::Name).objects().at(0)["restarts"], 2);
}

/// The page as a reader sees it.
std::string unescaped(std::string page) {
  for (const auto& [escape, text] : {std::pair{"\\-", "-"},
                                     {"\\(aq", "'"},
                                     {"\\(ga", "`"},
                                     {"\\(ha", "^"},
                                     {"\\(ti", "~"},
                                     {"\\e", "\\"},
                                     {"\\&", ""},
                                     {"\\[u2026]", "…"}}) {
    for (std::size_t at = 0; (at = page.find(escape, at)) != std::string::npos; at += std::string_view(text).size())
      page.replace(at, std::string_view(escape).size(), text);
  }
  return page;
}

TEST(Manual, HasEveryFormOfEveryVerbAndEveryOption) {
  const std::string command = unescaped(command_manual("1.2.3"));
  const std::string system = unescaped(system_file_manual("1.2.3"));
  for (const Verb& verb : verb_rows()) {
    for (const Shape& shape : verb.forms) {
      EXPECT_THAT(command, HasSubstr(".B " + shape.text() + "\n"));
      EXPECT_EQ(verb.name != "run", system.find(".B " + shape.text() + "\n") != std::string::npos) << shape.text();
    }
    EXPECT_THAT(command, HasSubstr(verb.does));
  }
  for (const GlobalOption& option : global_options()) EXPECT_THAT(command, HasSubstr(".B " + option.slot.name));
  EXPECT_THAT(system, Not(HasSubstr(".B run [FILE")));
}

TEST(Manual, HasEveryExitCode) {
  const std::string page = unescaped(command_manual("1.2.3"));
  for (const char* code : {"0", "1", "2", "3", "4", "5", "6", "7", "8", "9", "130"})
    EXPECT_THAT(page, HasSubstr(std::string(".B ") + code + "\n"));
}

}  // namespace
}  // namespace fiona::console
