#include <algorithm>
#include <set>

#include <gtest/gtest.h>

#include "command_line.hpp"
#include "completion.hpp"
#include "verb_table.hpp"
#include "watch_list.hpp"

namespace fiona::console {
namespace {

using namespace std::chrono_literals;

std::string refusal_of_line(const std::string& text) {
  try {
    read_line(split_line(text));
  } catch (const LineError& error) {
    return error.what();
  }
  return "no error";
}

Line line_of(const std::string& text) { return read_line(split_line(text)); }

/// Two instances: nav requires `imu` and `location`, walk provides `imu`.
class FixedNames final : public Names {
 public:
  FixedNames() {
    auto* walk = system_.add_instances();
    walk->set_name("walk");
    walk->add_modes("active");
    auto* trace = walk->add_parameters();
    trace->set_name("trace");
    auto* direction = walk->add_parameters();
    direction->set_name("direction");
    direction->set_range("up|down");
    add_port(*walk, "imu", fiona::PROVIDES);
    auto* nav = system_.add_instances();
    nav->set_name("nav");
    add_port(*nav, "imu", fiona::REQUIRES);
  }
  const control::System* system() override { return silent ? nullptr : &system_; }
  std::vector<std::string> plugins() override { return {"trace-player", "fiona/trace-player"}; }
  std::vector<std::string> packages() override { return {"fiona/step-heading"}; }
  std::vector<std::string> services() override { return {"GetIMUService", "LidarScan"}; }
  std::vector<std::string> parameters(const std::string&) override { return {"trace", "rate"}; }
  std::vector<std::string> fields(const std::string& type) override {
    return type == "fiona.sensors.GetIMUService" ? std::vector<std::string>{"out_x_acc", "position.x"}
                                                 : std::vector<std::string>{};
  }
  std::vector<std::string> files(std::string_view) override { return {"demo.fiona", "systems/", "with blank"}; }

  bool silent = false;

 private:
  static void add_port(control::InstanceStatus& instance, const char* name, fiona::Direction direction) {
    auto* port = instance.add_ports();
    port->set_name(name);
    port->set_direction(direction);
    port->set_service("fiona.sensors.GetIMUService");
  }
  control::System system_;
};

std::vector<std::string> candidates(std::string_view typed) {
  FixedNames names;
  return complete(typed, names).candidates;
}

using Texts = std::vector<std::string>;

TEST(VerbTable, HasEveryVerbOnce) {
  std::multiset<std::string> names;
  for (const Verb& verb : verb_rows()) names.insert(verb.name);
  for (const char* name :
       {"load", "unload", "wire",   "unwire", "set",    "get",   "state", "ls",   "show",    "spots",  "watch", "check",
        "run",  "save",   "source", "wait",   "expect", "sleep", "quit",  "help", "version", "market", "record"})
    EXPECT_EQ(names.count(name), 1U) << name;
}

TEST(VerbTable, EveryRowHasHelpAccessAndAHandler) {
  for (const Verb& verb : verb_rows()) {
    EXPECT_FALSE(verb.does.empty()) << verb.name;
    EXPECT_NE(verb.handler, nullptr) << verb.name;
    EXPECT_GE(static_cast<int>(verb.access), 1) << verb.name;
    EXPECT_LE(static_cast<int>(verb.access), 9) << verb.name;
    ASSERT_FALSE(verb.forms.empty()) << verb.name;
    for (const Shape& shape : verb.forms)
      EXPECT_TRUE((shape.text() + " ").starts_with(verb.name + " ")) << shape.text();
  }
}

TEST(VerbTable, EveryPlaceOfEveryFormIsCompletedOrFreeText) {
  // Words that only the person knows: numbers, times, new names.
  const std::set<std::string> free{"ADDRESS:PORT",
                                   "NAME=ADDRESS:PORT=KEY",
                                   "URL",
                                   "KEY",
                                   "",
                                   "N",
                                   "T",
                                   "VALUE",
                                   "CODE",
                                   "WORD",
                                   "NAME",
                                   "FIELD",
                                   "ENDPOINT",
                                   "INSTANCE.PARAM=VALUE",
                                   "FIELD=VALUE",
                                   "OBJECT",
                                   "MIB",
                                   "CORES",
                                   "VERSION",
                                   "PACKAGE@VERSION",
                                   "TEXT"};
  const std::vector<std::string> known = completed_placeholders();
  const auto check = [&](const Slot& slot, const std::string& form) {
    const std::string placeholder = slot.placeholder();
    EXPECT_TRUE(free.contains(placeholder) || std::count(known.begin(), known.end(), placeholder) > 0)
        << placeholder << " in " << form;
  };
  for (const Verb& verb : verb_rows()) {
    for (const Shape& shape : verb.forms) {
      for (const Slot& slot : shape.positional()) check(slot, shape.text());
      for (const Clause& clause : shape.clauses()) check(clause.slot, shape.text());
      for (const OptionSlot& option : shape.options()) check(option.slot, shape.text());
      for (const ArgumentSlot& argument : shape.arguments()) check(argument.slot, shape.text());
    }
  }
}

TEST(Shapes, ComeFromTheTextThatHelpShows) {
  const Shape shape("load PLUGIN [as INSTANCE] [PARAM=VALUE …]");
  ASSERT_EQ(shape.positional().size(), 1U);
  EXPECT_TRUE(shape.positional()[0].required);
  ASSERT_NE(shape.find_clause("as"), nullptr);
  EXPECT_FALSE(shape.find_clause("as")->slot.required);
  EXPECT_TRUE(shape.takes_arguments());
  EXPECT_FALSE(shape.needs_arguments());
}

TEST(Lines, AreReadByTheirForm) {
  const Line line = line_of("load trace-player as walk in fast at neutral trace=\"a b\" rate=5");
  EXPECT_EQ(line.positional[0].text, "trace-player");
  EXPECT_EQ(line.clause("as")->text, "walk");
  EXPECT_EQ(line.clause("in")->text, "fast");
  EXPECT_EQ(line.clause("at")->text, "neutral");
  ASSERT_EQ(line.control_arguments().size(), 2U);
  EXPECT_EQ(line.control_arguments()[0].value().text(), "a b");
}

TEST(Lines, OptionsStandAnywhereAndTakeTheirValues) {
  const Line line = line_of("run a.fiona --headless b.fiona --for 10s --set walk.trace=X --set walk.rate=2 --json");
  EXPECT_EQ(line.positional.size(), 2U);
  EXPECT_TRUE(line.has("--headless"));
  EXPECT_EQ(line.option("--for")->text, "10s");
  EXPECT_EQ(line.options.count("--set"), 2U);
  EXPECT_EQ(line.options.find("--set")->second.name.text, "walk.trace");
  EXPECT_TRUE(line.has("--json"));
}

TEST(Lines, WatchTakesACountOrATimeAfterEvery) {
  EXPECT_EQ(watch_request(line_of("watch nav.location every 5")).every_nth, 5U);
  EXPECT_DOUBLE_EQ(watch_request(line_of("watch nav.location every 200ms")).every_ms, 200);
  EXPECT_THROW(watch_request(line_of("watch nav.location every 0")), Error);
  EXPECT_THROW(watch_request(line_of("watch nav.location every 5m")), Error);
}

TEST(Lines, WatchNamesAPortAProbeOrAProbeOfAPort) {
  EXPECT_EQ(watch_request(line_of("watch nav.spread")).port.port(), "spread");
  EXPECT_EQ(watch_request(line_of("watch nav.location.rate")).port.port(), "location.rate");
  for (const char* wrong : {"watch nav", "watch nav.", "watch .spread", "watch nav..rate", "watch a.b.c.d"})
    EXPECT_THROW(watch_request(line_of(wrong)), Error) << wrong;
}

TEST(Lines, WhenTakesAConditionOfSeveralWords) {
  const auto when = [](const char* line) { return *watch_request(line_of(line)).when; };
  const auto above = when("watch nav.spread when above 3m every 1s");
  EXPECT_EQ(above.compared().comparison(), control::GREATER);
  EXPECT_EQ(above.compared().value().integer(), 3);
  EXPECT_EQ(above.compared().value().unit(), "m");
  EXPECT_EQ(when("watch nav.spread when below -2 for 5s").compared().comparison(), control::LESS);
  EXPECT_EQ(when("watch nav.mode when is failed").compared().value().text(), "failed");
  EXPECT_TRUE(when("watch nav.mode when changes").changes());
  EXPECT_DOUBLE_EQ(when("watch nav.location when older than 1s").older_than_ms(), 1000);
  const auto field = when("watch nav.location x when position.x above 2");
  EXPECT_EQ(field.field(), "position.x");
  EXPECT_EQ(field.compared().comparison(), control::GREATER);
}

TEST(Lines, WhatIsNoConditionIsRefusedWithThoseThatAre) {
  for (const char* wrong : {"watch a.b when higher 3", "watch a.b when above", "watch a.b when older 1s",
                            "watch a.b when changes 3", "watch a.b when x above 3 4", "watch a.b when older than 3"})
    EXPECT_THROW(watch_request(line_of(wrong)), Error) << wrong;
  try {
    watch_request(line_of("watch a.b when higher 3"));
  } catch (const Error& error) {
    EXPECT_EQ(error.text().what, "'higher' is no condition");
    EXPECT_EQ(error.text().expected,
              "[FIELD] above VALUE, [FIELD] below VALUE, [FIELD] is VALUE, changes, older than T");
  }
}

TEST(Lines, ANegativeNumberIsNoOption) { EXPECT_EQ(line_of("expect nav.location.x > -5").positional[2].text, "-5"); }

TEST(Lines, AnUnknownVerbGetsTheNearestNames) {
  EXPECT_EQ(refusal_of_line("lod x"), "column 1: there is no verb 'lod'\n  did you mean: load\n  next: help");
}

TEST(Lines, AMissingWordIsNamed) {
  EXPECT_EQ(refusal_of_line("load"),
            "column 1: load needs PLUGIN\n  expected: load PLUGIN [as NAME] [in GROUP|HOST/GROUP] [at MODE] [with "
            "RIGHT …] [PARAM=VALUE …]");
}

TEST(Lines, AMissingClauseIsNamed) {
  EXPECT_NE(refusal_of_line("wire a.b").find("wire needs 'to INSTANCE.PORT'"), std::string::npos);
}

TEST(Lines, AWordAfterAKeywordIsNeeded) {
  EXPECT_NE(refusal_of_line("load x as").find("column 8: a word is missing after 'as'"), std::string::npos);
}

TEST(Lines, AKeywordThatDoesNotBelongIsRefusedWithTheWayToQuoteIt) {
  EXPECT_NE(refusal_of_line("swap a for c else e").find("column 14: 'else' does not belong to swap here"),
            std::string::npos);
}

TEST(Lines, AClauseThatMayBeRepeatedTakesAWordEachTimeOrSeveralAtOnce) {
  const auto others = [](const char* text) {
    Texts found;
    for (const Word& word : read_line(split_line(text)).clause_words("else")) found.push_back(word.text);
    return found;
  };
  EXPECT_EQ(others("wire a.b to c.d else e.f else g.h every 5"), (Texts{"e.f", "g.h"}));
  EXPECT_EQ(others("wire a.b to c.d else e.f g.h"), (Texts{"e.f", "g.h"}));
  EXPECT_EQ(others("wire a.b to c.d"), Texts{});
}

TEST(Lines, AnArgumentThatTheVerbDoesNotKnowIsRefused) {
  EXPECT_NE(refusal_of_line("wire a.b to c.d else e.f hodl=3s").find("column 26: wire takes no hodl=…"),
            std::string::npos);
}

TEST(Lines, OneWordTooManyIsRefused) {
  EXPECT_NE(refusal_of_line("unload a b").find("column 10: 'b' is one word too many"), std::string::npos);
}

TEST(Lines, AWordThatIsNoneOfTheChoicesGetsTheNearest) {
  EXPECT_EQ(refusal_of_line("ls wirse"),
            "column 4: 'wirse' cannot stand here\n  expected: instances, plugins, wires, services, hosts\n  did you "
            "mean: wires");
}

TEST(Lines, AnArgumentGivenTwiceIsRefused) {
  EXPECT_NE(refusal_of_line("set a x=1 x=2").find("column 11: x is given twice"), std::string::npos);
}

TEST(Lines, AnArgumentWhereNoneIsTakenIsRefused) {
  EXPECT_NE(refusal_of_line("ls x=1").find("column 4: ls takes no x=…"), std::string::npos);
}

TEST(Lines, AnUnknownOptionGetsTheNearest) {
  EXPECT_NE(refusal_of_line("run a --headles").find("did you mean: --headless"), std::string::npos);
}

TEST(Lines, SetNeedsSomethingToSet) {
  EXPECT_NE(refusal_of_line("set a").find("set needs at least one name=value"), std::string::npos);
}

TEST(Lines, OfEveryVerbAndFormAreRead) {
  std::set<std::string> verbs;
  for (const char* line :
       {"load acme/lidar as l in HOST/GROUP rate=5",
        "unload l",
        "wire a.x to b.y else c.y else d.y every 5",
        "unwire a.x",
        "swap a for b watch 10s",
        "upgrade a",
        "upgrade a to 1.2.0 watch 10s",
        "upgrade host",
        "upgrade host watch 30s",
        "state a",
        "state a neutral",
        "set a rate=5 name=\"x y\"",
        "get a",
        "get a rate",
        "ls",
        "ls instances",
        "ls plugins",
        "ls wires",
        "ls services",
        "ls hosts",
        "show LocationProvider",
        "spots",
        "why a",
        "why a.x",
        "watch a.x position.x position.y every 500ms for 10s",
        "watch a.spread when above 3m",
        "watch a.spread when below 3m every 5",
        "watch a.spread when changes",
        "watch stop",
        "record walk.mcap a.x b.spread for 10s",
        "record stop walk.mcap",
        "call a.x {number: 7} for 5s",
        "call a.go speed=2",
        "send a.x {number: 7}",
        "graph",
        "graph dot",
        "graph mermaid",
        "top",
        "plan swap a for b",
        "undo",
        "journal",
        "begin",
        "commit",
        "abort",
        "check f.fiona",
        "apply f.fiona",
        "save f.fiona",
        "source f.fiona",
        "run f.fiona g.fiona --headless --strict --for 10s",
        "wait a active for 5s",
        "expect a.x.field >= 3 for 5s",
        "sleep 1s",
        "quit",
        "quit 3",
        "market search lidar --provides LidarScan",
        "market search for spots",
        "market info lidar --from https://example.org",
        "market install lidar --from DIR -y",
        "market install --locked fiona.lock",
        "market remove lidar -y",
        "market update",
        "market rollback",
        "market rollback 3",
        "market init DIR",
        "market publish a.fpk b.fpk --to DIR",
        "market accept DIR acme",
        "market accept DIR acme 0000000000000000000000000000000000000000000000000000000000000000",
        "plugin new lidar --provides LocationProvider --requires GetIMUService --requires StepProvider",
        "plugin describe liblidar.so -o lidar.interface.textproto",
        "plugin test",
        "plugin test lidar for 30min with unconfined",
        "plugin check lidar.fpk",
        "plugin pack lidar -o lidar.fpk",
        "plugin sign lidar.fpk",
        "plugin unsign acme/lidar@1.1.0",
        "keys",
        "keys list",
        "keys new acme",
        "keys trust root.json --from DIR",
        "help",
        "help wire",
        "help patterns",
        "help exit",
        "doctor",
        "paths",
        "complete unload ",
        "version"}) {
    EXPECT_NO_THROW(verbs.insert(line_of(line).verb.text)) << line;
  }
  for (const Verb& verb : verb_rows()) EXPECT_TRUE(verbs.contains(verb.name)) << verb.name;
}

TEST(Lines, ASecondFormIsChosenByItsWord) {
  EXPECT_EQ(line_of("watch stop nav.location").positional.size(), 2U);
  EXPECT_EQ(line_of("market install a b -y").positional.size(), 3U);
  EXPECT_EQ(refusal_of_line("market instal a"),
            "column 8: market cannot 'instal'\n  expected: search, info, install, update, remove, rollback, history, "
            "list, verify, lock, init, publish, accept, revoke, keys, rotate, sign\n  did you mean: install\n  next: "
            "help market");
}

TEST(CommandLine, OptionsBeforeTheLineAreTheProcesss) {
  const CommandLine command = read_command_line({"--host", "lab", "--timeout=3s", "-q", "ls", "wires"});
  EXPECT_EQ(command.options.host, "lab");
  EXPECT_EQ(command.options.timeout, 3s);
  EXPECT_TRUE(command.manner.quiet);
  EXPECT_EQ(command.line->items.size(), 2U);
}

TEST(CommandLine, AskedForJsonAnywhereMistakesOfTheLineAreJsonToo) {
  EXPECT_TRUE(read_command_line({"lod", "x", "--json"}).manner.json);
  EXPECT_TRUE(read_command_line({"lod x --json"}).manner.json);
  EXPECT_TRUE(read_command_line({"lod x", "--json"}).manner.json);
  EXPECT_FALSE(read_command_line({"set", "a", "b=--json"}).manner.json);
}

TEST(CommandLine, AnUnknownOptionIsNotUnderstoodAndGetsTheNearest) {
  try {
    read_command_line({"--jsn", "ls"});
    FAIL() << "it was taken";
  } catch (const Error& error) {
    EXPECT_EQ(error.code(), ErrorCode::Usage);
    EXPECT_STREQ(error.what(), "there is no option --jsn\n  did you mean: --json\n  next: fiona help");
  }
}

TEST(CommandLine, HelpAndVersionNeedNoLine) {
  EXPECT_TRUE(read_command_line({"--help"}).help);
  EXPECT_TRUE(read_command_line({"-h"}).help);
  EXPECT_TRUE(read_command_line({"--version"}).version);
}

TEST(Completion, BeginsWithVerbs) { EXPECT_EQ(candidates("un"), (Texts{"undo", "unload", "unwire"})); }

TEST(Completion, GoesOnInTheLineThatIsPlanned) {
  EXPECT_EQ(candidates("plan un"), (Texts{"undo", "unload", "unwire"}));
  EXPECT_EQ(candidates("plan unload w"), Texts{"walk"});
}

TEST(Completion, KnowsLivingInstances) { EXPECT_EQ(candidates("unload w"), Texts{"walk"}); }

TEST(Completion, OffersTheEndOfAWireThatFits) {
  EXPECT_EQ(candidates("wire "), Texts{"nav.imu"});
  EXPECT_EQ(candidates("wire nav.imu to "), Texts{"walk.imu"});
}

TEST(Completion, OffersKeywordsWhenTheWordsBeforeAreThere) {
  EXPECT_EQ(candidates("wire nav.imu "), (Texts{"else", "every", "hold=", "to"}));
}

TEST(Completion, OffersProvidersAfterElseAndElseAgain) {
  EXPECT_EQ(candidates("wire nav.imu to walk.imu else "), Texts{"walk.imu"});
  EXPECT_EQ(candidates("wire nav.imu to walk.imu else walk.imu "), (Texts{"else", "every", "hold="}));
}

TEST(Completion, KnowsParametersAndTheirValues) {
  EXPECT_EQ(candidates("set walk t"), Texts{"trace="});
  EXPECT_EQ(candidates("set walk direction="), (Texts{"direction=down", "direction=up"}));
}

TEST(Completion, KnowsWhatAPluginTakes) { EXPECT_EQ(candidates("load trace-player as x t"), Texts{"trace="}); }

TEST(Completion, KnowsTheFieldsOfWhatAPortSays) {
  EXPECT_EQ(candidates("watch walk.imu out"), Texts{"out_x_acc"});
  EXPECT_EQ(candidates("expect walk.imu.p"), Texts{"walk.imu.position.x"});
}

TEST(Completion, PassesOverTheOptionsBeforeTheVerb) {
  EXPECT_EQ(candidates("--host main --json unload w"), Texts{"walk"});
  EXPECT_EQ(candidates("--hos"), Texts{"--host"});
  EXPECT_TRUE(candidates("--host ").empty());
}

TEST(Completion, KnowsModes) {
  EXPECT_EQ(candidates("state walk "), (Texts{"active", "deactivated", "for", "neutral"}));
}

TEST(Completion, KnowsPluginsFilesAndOptions) {
  EXPECT_EQ(candidates("load tr"), Texts{"trace-player"});
  EXPECT_EQ(candidates("source d"), Texts{"demo.fiona"});
  EXPECT_EQ(candidates("run x --h"), (Texts{"--headless", "--host"}));
}

TEST(Completion, KnowsServicesOfThePlatformForANewPlugin) {
  EXPECT_EQ(candidates("plugin new x --provides Lo"), (Texts{"LocalPath", "LocationProvider", "LogoutProvider"}));
  EXPECT_EQ(candidates("plugin new x --provides StepProvider --requires GetI"), Texts{"GetIMUService"});
  EXPECT_EQ(candidates("plugin new x --requires=GetI"), Texts{"--requires=GetIMUService"});
}

TEST(Completion, KnowsServicesOfPackagesToSearchFor) {
  EXPECT_EQ(candidates("market search --provides Li"), Texts{"LidarScan"});
  EXPECT_EQ(candidates("market search lidar --requires="), (Texts{"--requires=GetIMUService", "--requires=LidarScan"}));
}

TEST(Completion, WithoutAHostOffersWhatTheTableKnows) {
  FixedNames names;
  names.silent = true;
  EXPECT_TRUE(complete("unload ", names).candidates.empty());
  EXPECT_EQ(complete("ls w", names).candidates, Texts{"wires"});
}

TEST(Completion, InsideAQuoteOffersNothing) { EXPECT_TRUE(candidates("show \"wa lk").empty()); }

}  // namespace
}  // namespace fiona::console
