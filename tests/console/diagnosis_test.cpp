// Why something is silent: the chain to where the trouble begins, of systems made by hand.
#include "diagnosis.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "system_view.hpp"

namespace fiona::console {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::SizeIs;

/// phone.imu -> steps.imu; phone.wifi and steps.steps -> nav; all of it works.
class Diagnosis : public ::testing::Test {
 protected:
  Diagnosis() {
    instance("phone");
    provides("phone", "imu");
    provides("phone", "wifi");
    instance("steps");
    requires_from("steps", "imu", "phone.imu");
    provides("steps", "steps");
    instance("nav");
    requires_from("nav", "steps", "steps.steps");
    requires_from("nav", "wifi", "phone.wifi");
    provides("nav", "location");
  }

  control::InstanceStatus& instance(const std::string& name) {
    for (auto& one : *system_.mutable_instances()) {
      if (one.name() == name) return one;
    }
    auto& made = *system_.add_instances();
    made.set_name(name);
    made.set_component(name);
    made.set_mode("active");
    made.add_modes("active");
    made.set_mode_since_s(60);
    return made;
  }
  control::PortStatus& port(const std::string& owner, const std::string& name) {
    for (auto& one : *instance(owner).mutable_ports()) {
      if (one.name() == name) return one;
    }
    auto& made = *instance(owner).add_ports();
    made.set_name(name);
    made.set_pattern(fiona::PUSH_TIMED);
    made.set_lease_ms(300);
    made.set_age_ms(20);
    made.set_rate_hz(50);
    made.set_latency_p99_ms(1);
    return made;
  }
  control::PortStatus& provides(const std::string& owner, const std::string& name) {
    port(owner, name).set_direction(fiona::PROVIDES);
    return port(owner, name);
  }
  void requires_from(const std::string& owner, const std::string& name, const std::string& provider) {
    auto& client = port(owner, name);
    client.set_direction(fiona::REQUIRES);
    client.set_connection(control::CONNECTED);
    const std::size_t dot = provider.find('.');
    client.mutable_peer()->set_instance(provider.substr(0, dot));
    client.mutable_peer()->set_port(provider.substr(dot + 1));
    auto& back = *port(provider.substr(0, dot), provider.substr(dot + 1)).add_clients();
    back.set_instance(owner);
    back.set_port(name);
  }
  void silence(const std::string& owner, const std::string& name, double seconds) {
    port(owner, name).set_age_ms(1000 * seconds);
    port(owner, name).set_rate_hz(0);
    port(owner, name).set_silent(port(owner, name).direction() == fiona::PROVIDES);
  }
  void refuse(const std::string& owner, const std::string& name, double ago_s) {
    port(owner, name).set_refused(7);
    port(owner, name).set_refusal("yaw is nan, not a finite number");
    port(owner, name).set_refusal_age_ms(1000 * ago_s);
  }
  void leave_unwired(const std::string& owner, const std::string& name) {
    port(owner, name).set_direction(fiona::REQUIRES);
    port(owner, name).set_connection(control::UNWIRED);
  }

  std::vector<std::string> why(const std::string& what) {
    const std::size_t dot = what.find('.');
    const auto& owner = instance(what.substr(0, dot));
    const auto found = dot == std::string::npos ? findings_of(system_, owner)
                                                : findings_of(system_, owner, port(owner.name(), what.substr(dot + 1)));
    std::vector<std::string> texts;
    for (const Finding& one : found) texts.push_back(one.thing + " " + one.state);
    return texts;
  }

  control::System system_;
};

TEST_F(Diagnosis, OfWhatWorksThereIsNothingToSay) {
  EXPECT_THAT(why("nav"), IsEmpty());
  EXPECT_THAT(why("nav.location"), IsEmpty());
  EXPECT_THAT(why("steps.imu"), IsEmpty());
}

TEST_F(Diagnosis, FollowsTheWiresToTheInstanceThatFailed) {
  instance("phone").set_mode("failed");
  instance("phone").set_reason("the file ends in line 12");
  for (const char* name : {"imu", "wifi"}) silence("phone", name, 5);
  for (const char* client : {"imu"}) silence("steps", client, 5);
  silence("steps", "steps", 5);
  silence("nav", "steps", 5);
  silence("nav", "location", 5);
  EXPECT_THAT(why("nav.location"),
              ElementsAre("phone failed: the file ends in line 12", "phone.imu is silent", "steps.imu gets nothing",
                          "steps.steps is silent", "nav.steps gets nothing", "phone.wifi is silent",
                          "nav.wifi gets nothing", "nav.location is silent"));
}

TEST_F(Diagnosis, AModeThatServesNothingIsTheRootAndTheLineThatChangesItIsToldFirst) {
  instance("steps").set_mode("neutral");
  silence("steps", "steps", 2);
  const auto found = findings_of(system_, instance("steps"), port("steps", "steps"));
  ASSERT_THAT(found, SizeIs(2));
  EXPECT_EQ(found[0].state, "is neutral");
  EXPECT_EQ(found[0].since_s, 60);
  EXPECT_EQ(found[0].next, "state steps active");
}

TEST_F(Diagnosis, APortOfAnActivityThatTheModeLacksSaysInWhichItWorks) {
  auto& component = *system_.add_interfaces()->add_components();
  component.set_name("nav");
  auto& guiding = *component.add_modes();
  guiding.set_name("guiding");
  guiding.add_activities("guide");
  component.add_modes()->set_name("active");
  port("nav", "location").set_activity("guide");
  silence("nav", "location", 2);
  EXPECT_THAT(why("nav.location"), ElementsAre("nav.location works in guiding, and nav is active"));
}

TEST_F(Diagnosis, AProviderThatIsSilentThoughItGetsEverythingIsItselfTheRoot) {
  silence("steps", "steps", 4);
  silence("nav", "steps", 4);
  auto& task = *instance("steps").add_tasks();
  task.mutable_task()->set_name("detect");
  task.set_overruns(12);
  EXPECT_THAT(
      why("nav.steps"),
      ElementsAre("steps.steps is silent, though steps gets all that it requires; task 'detect' has overrun 12 times",
                  "nav.steps gets nothing"));
}

TEST_F(Diagnosis, AProviderThatIsNotLoadedIsNamedWithTheNameThatWasMeant) {
  port("nav", "wifi").set_connection(control::WAITING);
  port("nav", "wifi").mutable_peer()->set_instance("phome");
  const auto found = findings_of(system_, instance("nav"), port("nav", "wifi"));
  ASSERT_THAT(found, SizeIs(2));
  EXPECT_EQ(found[0].thing, "phome");
  EXPECT_THAT(found[0].next, HasSubstr("phone"));
  EXPECT_EQ(found[1].thing, "nav.wifi");
}

TEST_F(Diagnosis, WhatArrivesButIsRefusedSaysSo) {
  silence("nav", "wifi", 3);
  port("nav", "wifi").set_refused(40);
  EXPECT_THAT(
      why("nav.wifi"),
      ElementsAre("nav.wifi takes nothing of what its provider says: 40 broke a rule of size, range or finiteness"));
  port("nav", "wifi").set_refusal("rssi is 7, above 0 dBm");
  EXPECT_THAT(why("nav.wifi"),
              ElementsAre("nav.wifi takes nothing of what its provider says: 40 broke a rule, the last: "
                          "rssi is 7, above 0 dBm"));
}

TEST_F(Diagnosis, AProviderWhosePutsAreRefusedIsTheRootBeforeWhatItIsNotWiredTo) {
  leave_unwired("steps", "map");
  silence("steps", "steps", 4);
  silence("nav", "steps", 4);
  refuse("steps", "steps", 0.1);
  const std::string refused = "steps.steps is refused: 7 broke a rule, the last: yaw is nan, not a finite number";
  EXPECT_THAT(why("nav.steps"), ElementsAre(refused, "steps.map is not wired", "nav.steps gets nothing"));
  EXPECT_EQ(why("steps").front(), refused);
  EXPECT_EQ(why("steps.steps").front(), refused);
}

TEST_F(Diagnosis, ARefusalIsToldWhileItIsNewOrNothingHasComeSince) {
  refuse("steps", "steps", 3);
  EXPECT_THAT(why("nav"), ElementsAre(HasSubstr("steps.steps is refused")));
  refuse("steps", "steps", 3000);
  EXPECT_THAT(why("nav"), IsEmpty());
  silence("steps", "steps", 3000.5);
  EXPECT_THAT(why("steps.steps"), ElementsAre(HasSubstr("steps.steps is refused")));
}

TEST_F(Diagnosis, AProviderThatWasRestartedLatelyIsTheRootBeforeWhatItIsNotWiredTo) {
  leave_unwired("steps", "map");
  silence("steps", "steps", 4);
  silence("nav", "steps", 4);
  instance("steps").set_restarts(2);
  instance("steps").set_restart_reason("group 'cage' was ended: 'steps' was stuck in imu for 1.0 s");
  instance("steps").set_restarted_s(4);
  EXPECT_THAT(why("nav.steps"),
              ElementsAre("steps was restarted 2x: group 'cage' was ended: 'steps' was stuck in imu for 1.0 s",
                          "steps.map is not wired", "steps.steps is silent", "nav.steps gets nothing"));
  instance("steps").set_restarted_s(4000);
  EXPECT_EQ(why("nav.steps").front(), "steps.map is not wired");
}

TEST_F(Diagnosis, AProviderWhoseLastObjectStillHoldsIsNotSilent) {
  for (auto* one : {&port("steps", "steps"), &port("nav", "steps")}) one->set_age_ms(300'000);
  EXPECT_THAT(why("nav"), IsEmpty());
  EXPECT_THAT(why("steps"), IsEmpty());
}

TEST_F(Diagnosis, AClientOfEachFifthMessageMissesNothing) {
  port("nav", "steps").set_prescale(5);
  port("nav", "steps").set_age_ms(900);
  EXPECT_THAT(why("nav"), IsEmpty());
}

TEST_F(Diagnosis, WhatComesLaterThanItsLeaseIsLate) {
  port("nav", "wifi").set_latency_p99_ms(900);
  EXPECT_THAT(why("nav"),
              ElementsAre("nav.wifi is late: one in a hundred is under way for 900 ms, and 300 ms is loss"));
}

TEST_F(Diagnosis, APortThatNobodyWiredIsToldUnlessItIsOptional) {
  auto& map = port("nav", "map");
  map.set_direction(fiona::REQUIRES);
  map.set_connection(control::UNWIRED);
  EXPECT_THAT(why("nav"), ElementsAre("nav.map is not wired"));
  map.set_optional(true);
  EXPECT_THAT(why("nav"), IsEmpty());
}

TEST_F(Diagnosis, ACircleOfWiresEnds) {
  requires_from("phone", "back", "nav.location");
  for (const char* one : {"imu", "wifi", "back"}) silence("phone", one, 5);
  silence("steps", "imu", 5);
  silence("steps", "steps", 5);
  for (const char* one : {"steps", "wifi", "location"}) silence("nav", one, 5);
  EXPECT_THAT(why("nav.location"), ::testing::Contains(HasSubstr("nav.location is silent")));
}

TEST_F(Diagnosis, OfSeveralProvidersThoseThatCannotServeAreNamed) {
  auto& wifi = port("nav", "wifi");
  auto& first = *wifi.add_providers();
  first.mutable_provider()->set_instance("phone");
  first.mutable_provider()->set_port("wifi");
  first.set_reason("has been silent for 500 ms");
  silence("phone", "wifi", 0.5);
  EXPECT_THAT(why("nav.wifi"),
              ::testing::Contains("phone.wifi is an alternative that cannot serve: has been silent for 500 ms"));
}

}  // namespace
}  // namespace fiona::console
