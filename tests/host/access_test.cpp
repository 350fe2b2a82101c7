// The policy itself: each kind of request and change has a level, and what is unknown is for nobody.
#include "access.hpp"

#include <gtest/gtest.h>

#include "fiona/error.hpp"

namespace fiona::host {
namespace {

using trust::Access;

/// A message with this kind of its only oneof, and nothing in it.
template <class Message>
Message of_kind(const google::protobuf::FieldDescriptor& kind) {
  Message message;
  message.GetReflection()->MutableMessage(&message, &kind);
  return message;
}

control::Request transact(std::initializer_list<control::Change> changes) {
  control::Request request;
  request.mutable_transact()->mutable_changes()->Add(changes.begin(), changes.end());
  return request;
}

control::Change set_of(const std::string& instance) {
  control::Change change;
  change.mutable_set()->set_instance(instance);
  return change;
}

control::Change load_of(const std::string& plugin) {
  control::Change change;
  change.mutable_load()->set_plugin(plugin);
  return change;
}

TEST(AccessPolicy, EveryKindOfRequestAndOfChangeHasALevel) {
  const auto& requests = *control::Request::descriptor()->FindOneofByName("what");
  ASSERT_GT(requests.field_count(), 15);
  for (int i = 0; i < requests.field_count(); ++i) {
    const Access level = need_of(of_kind<control::Request>(*requests.field(i))).level;
    EXPECT_GE(level, Access::Observe) << requests.field(i)->name();
    EXPECT_LE(level, Access::Administer) << requests.field(i)->name();
  }
  const auto& changes = *control::Change::descriptor()->FindOneofByName("what");
  ASSERT_GT(changes.field_count(), 6);
  for (int i = 0; i < changes.field_count(); ++i) {
    const Access level = need_of(transact({of_kind<control::Change>(*changes.field(i))})).level;
    EXPECT_GE(level, Access::Operate) << changes.field(i)->name();
    EXPECT_LE(level, Access::Administer) << changes.field(i)->name();
  }
}

TEST(AccessPolicy, WhatIsUnknownIsForNobodyAlsoWhenItIsOnlyTried) {
  EXPECT_EQ(need_of(control::Request()).level, Access::Nobody);
  control::Request unknown = transact({load_of("a"), control::Change()});
  EXPECT_EQ(need_of(unknown).level, Access::Nobody);
  unknown.mutable_transact()->set_dry_run(true);
  EXPECT_EQ(need_of(unknown).level, Access::Nobody);
  EXPECT_THROW(require({}, unknown), Error) << "not even for the host's own user";
}

TEST(AccessPolicy, ATransactionTakesWhatTheHighestOfItsChangesTakes) {
  EXPECT_EQ(need_of(transact({set_of("a"), set_of("b")})).level, Access::Operate);
  EXPECT_EQ(need_of(transact({set_of("a"), load_of("b"), set_of("c")})).level, Access::Compose);
  EXPECT_EQ(need_of(transact({set_of("a"), load_of("b"), set_of("c")})).what, "load");
  control::Request whole = transact({});
  whole.mutable_transact()->set_whole(true);
  EXPECT_EQ(need_of(whole).level, Access::Compose) << "it may unload all there is";
}

TEST(AccessPolicy, ToTryIsToLookButNotAtFiles) {
  control::Request plan = transact({load_of("a"), set_of("a")});
  plan.mutable_transact()->set_dry_run(true);
  EXPECT_EQ(need_of(plan).level, Access::Observe);
  plan = transact({load_of("/home/me/libx.so/x")});
  plan.mutable_transact()->set_dry_run(true);
  EXPECT_EQ(need_of(plan).level, Access::Administer);
}

TEST(AccessPolicy, WhatNamesAFileOnTheHostsMachineTakesAdminister) {
  EXPECT_EQ(need_of(transact({load_of("/home/me/libx.so/x")})).level, Access::Administer);
  control::Change deliveries = set_of("host");
  deliveries.mutable_set()->add_parameters()->set_name("deliveries");
  EXPECT_EQ(need_of(transact({deliveries})).level, Access::Administer);
  EXPECT_EQ(need_of(transact({set_of("host")})).level, Access::Operate);
}

Error refusal(const Rights& rights, const control::Request& request) {
  try {
    require(rights, request);
  } catch (const Error& error) {
    return error;
  }
  return Error(ErrorCode::Failed, "no error");
}

TEST(AccessPolicy, ARefusalSaysWhatIsNeededWhatIsThereAndHowToGetMore) {
  const Error error = refusal({Access::Observe, Access::Operate, "office", "6f2c"}, transact({load_of("a")}));
  EXPECT_EQ(error.code(), ErrorCode::NotAllowed);
  EXPECT_EQ(error.text().what, "load needs the level compose (6), and this console has observe (1)");
  EXPECT_EQ(error.text().expected, "compose (6)");
  EXPECT_EQ(error.text().found, "observe (1), of operate (4) that its key may have");
  EXPECT_EQ(error.text().next, "on the machine of the host: fiona keys allow office 6f2c as compose");
}

TEST(AccessPolicy, WhoHasNotAskedForControlIsToldTo) {
  const Error error = refusal({Access::Observe, Access::Compose, "office", "6f2c"}, transact({set_of("a")}));
  EXPECT_EQ(error.text().what, "set needs the level operate (4), and this console has observe (1)");
  EXPECT_EQ(error.text().next, "the same with --control: fiona --at HOST --control LINE");
}

TEST(AccessPolicy, AComponentIsNamedAndNamesNoFiles) {
  const Error error = refusal({Access::Compose, Access::Compose, "boss"}, transact({load_of("/home/me/libx.so/x")}));
  EXPECT_EQ(error.text().what, "load of a path needs the level administer (9), and 'boss' has compose (6)");
  EXPECT_EQ(error.text().next, "a console on the machine of the host may");
}

}  // namespace
}  // namespace fiona::host
