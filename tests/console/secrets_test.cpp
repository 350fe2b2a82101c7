// R32: a password that is typed comes out nowhere: not in errors, not in answers, not in the history.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "author/plugin_template.hpp"
#include "fiona/options.pb.h"
#include "fiona/security.pb.h"
#include "living_names.hpp"
#include "scripted_host.hpp"
#include "secret_names.hpp"
#include "typed_secrets.hpp"

#include <fiona/secrets.hpp>

namespace fiona::console {
namespace {

using namespace std::chrono_literals;
using testing::HasSubstr;
using testing::Not;

/// The line up to what is not shown of it.
std::string shown(std::string_view line, const SecretNames& names = {}) {
  return std::string(line.substr(0, names.begin_in(line)));
}

TEST(SecretNames, AreThoseOfThePlatformFromTheBeginning) {
  for (const auto* service : platform_services()) {
    for (int i = 0; i < service->method_count(); ++i) {
      for (const auto* type : {service->method(i)->input_type(), service->method(i)->output_type()}) {
        const std::string path = first_secret(*type).value_or("password");
        const std::string name = path.substr(path.rfind('.') + 1);
        EXPECT_EQ(shown(name + "=x"), name + "=") << type->full_name();
      }
    }
  }
}

TEST(SecretNames, WhateverFollowsOneMayBelongToItsValue) {
  EXPECT_EQ(shown("call auth.login username=anna password=correct horse"), "call auth.login username=anna password=");
  EXPECT_EQ(shown("call auth.login password=\"correct horse\" username=anna"), "call auth.login password=");
  EXPECT_EQ(shown("call auth.login {username: \"anna\" password : \"x\"}"),
            "call auth.login {username: \"anna\" password : ");
  EXPECT_EQ(shown("call auth.login password=ab\"c"), "call auth.login password=");
  EXPECT_EQ(shown("cal auth.login user.password[0]=x"), "cal auth.login user.password[0]=");
  EXPECT_EQ(shown("call auth.login password hunter2"), "call auth.login password ");
}

TEST(SecretNames, AWordThatGivesNoValueHidesNothing) {
  for (const char* line : {"show password", "call profiles.session user=anna", "expect auth.session == 3",
                           "set web session_time=60", "load passwords as password", "watch nav.session count"}) {
    EXPECT_EQ(shown(line), line);
  }
}

/// A type as a stranger's plugin brings it: a key has a door and a pin, which is secret.
google::protobuf::FileDescriptorSet strangers_types() {
  google::protobuf::FileDescriptorSet files;
  auto& file = *files.add_file();
  file.set_name("lock.proto");
  file.set_package("acme");
  file.set_syntax("proto3");
  file.add_dependency("fiona/options.proto");
  auto& type = *file.add_message_type();
  type.set_name("Key");
  for (const char* name : {"door", "pin"}) {
    auto& field = *type.add_field();
    field.set_name(name);
    field.set_number(type.field_size());
    field.set_type(google::protobuf::FieldDescriptorProto::TYPE_STRING);
    field.set_label(google::protobuf::FieldDescriptorProto::LABEL_OPTIONAL);
    field.mutable_options()->SetExtension(fiona::secret, std::string(name) == "pin");
  }
  auto& service = *file.add_service();
  service.set_name("Lock");
  auto& query = *service.add_method();
  query.set_name("Query");
  query.set_input_type(".acme.Key");
  query.set_output_type(".acme.Key");
  return files;
}

/// A host with a lock: a port that is asked with a key, and a trigger that gives one.
class SecretLine : public ::testing::Test {
 protected:
  static std::vector<control::Reply> answer(const control::Request& request) {
    control::Reply reply;
    if (request.has_snapshot()) {
      auto& lock = *reply.mutable_system()->add_instances();
      lock.set_name("lock");
      auto& open = *lock.add_ports();
      open.set_name("open");
      open.set_service("acme.Lock");
      auto& cut = *lock.add_triggers();
      cut.set_name("cut");
      cut.set_argument("acme.Key");
    } else if (request.has_describe()) {
      *reply.mutable_description()->mutable_files() = strangers_types();
    } else if (request.has_call()) {
      auto& result = *reply.mutable_called()->mutable_result();
      reply.mutable_called()->set_outcome("ok");
      result.set_type("acme.Key");
      result.set_object(
          "\x0a\x04hall\x12\x06"
          "canary");
      *result.mutable_files() = strangers_types();
    } else {
      reply.mutable_failure()->set_code(static_cast<std::uint32_t>(ErrorCode::NotFound));
      reply.mutable_failure()->set_what("there is no instance 'lok'");
    }
    return {reply};
  }

  std::string kept(const std::string& line) {
    LivingNames names(session);
    return kept_part(line, session, names);
  }

  /// What comes out when the line is run.
  std::string said(const std::string& line) {
    said_.clear();
    try {
      session.run(split_line(line));
    } catch (const Error& error) {
      output.error(error);
    }
    return said_;
  }

  static Options options_of(const ScriptedHost& host) {
    Options options;
    options.at = "unix:" + host.socket().string();
    options.timeout = 10s;
    return options;
  }

  std::string said_;
  ScriptedHost host{answer};
  Reactor reactor;
  Output output{[this](Stream, std::string_view lines) { said_ += lines; }};
  Session session{reactor, output, options_of(host)};
};

TEST_F(SecretLine, IsKeptUpToTheFirstSecretOfTheFieldsThatTheHostNames) {
  session.host();
  EXPECT_EQ(kept("call lock.open door=hall pin=1234"), "call lock.open door=hall pin=");
  EXPECT_EQ(kept("call lock.cut {door: \"hall\" pin: \"1234\"}"), "call lock.cut {door: \"hall\" pin: ");
  EXPECT_EQ(kept("call lock.open door=hall"), "call lock.open door=hall");
}

TEST_F(SecretLine, IsKeptWithoutValuesWhereNobodySaysWhichAreSecret) {
  EXPECT_EQ(kept("call lock.open door=hall pin=1234"), "call lock.open door=") << "no host is connected";
  session.host();
  EXPECT_EQ(kept("call lok.open pin=1234"), "call lok.open pin=");
  EXPECT_EQ(kept("cal lock.open pin=1234"), "cal lock.open pin=");
  EXPECT_EQ(kept("call lock.open pin=\"12"), "call lock.open pin=");
  EXPECT_EQ(kept("call lok.open {pin: \"1234\"}"), "call lok.open {");
  EXPECT_EQ(kept("call auth.login {username: \"anna\" password: \"x\"}"), "call auth.login {");
}

TEST_F(SecretLine, ThatIsNoneIsKeptWhole) {
  for (const char* line : {"ls", "set nav speed=3 note=\"a b\"", "load step-heading as steps rate=5Hz",
                           "wire a.b to c.d", "call lock.open", "shwo lock"}) {
    EXPECT_EQ(kept(line), line);
  }
}

TEST_F(SecretLine, IsShownWithStarsUnderAnError) {
  EXPECT_EQ(said("unload lok.x password=hunter22"),
            "error: column 14: unload takes no password=…\n"
            "  unload lok.x password=********\n"
            "               ^\n"
            "  expected: unload INSTANCE\n");
}

TEST_F(SecretLine, ThatCannotBeReadIsNotRepeatedFromTheSecretOn) {
  const std::string text = said("call auth.login password=correct horse battery");
  EXPECT_THAT(text, HasSubstr("it may be part of a secret and is not repeated"));
  for (const char* word : {"correct", "horse", "battery"}) EXPECT_THAT(text, Not(HasSubstr(word)));
  output.manner.json = true;
  EXPECT_THAT(said("call auth.login password=correct horse battery"), Not(HasSubstr("horse")));
  EXPECT_THAT(said("call auth.login password=12\\\n34 horse"), Not(HasSubstr("horse")));
}

TEST_F(SecretLine, AnAnswersSecretIsNotShown) {
  EXPECT_THAT(said("call lock.open"), HasSubstr("door=\"hall\"\n  pin=(secret)\n"));
  EXPECT_THAT(said("call lock.open --json"), HasSubstr(R"("result":{"door":"hall","pin":null})"));
}

TEST_F(SecretLine, WhatATriggerGivesIsForWhoeverCalledIt) {
  EXPECT_THAT(said("call lock.cut"), HasSubstr("pin=\"canary\""));
  EXPECT_THAT(said("call lock.cut --json"), HasSubstr(R"("pin":"canary")"));
}

}  // namespace
}  // namespace fiona::console
