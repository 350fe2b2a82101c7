// Consoles over tcp: who may what, and what those do to a host that die, hang, are too many, or speak nonsense.
#include <arpa/inet.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/resource.h>
#include <sys/socket.h>
#include <unistd.h>

#include <cstdlib>
#include <memory>
#include <random>
#include <vector>

#include "control_client.hpp"
#include "served_host.hpp"

namespace fiona::host {
namespace {

using namespace std::chrono_literals;
using conformance::ServedHost;
using conformance::TemporaryDirectory;
using conformance::TestConsole;
using console::ControlClient;
using testing::HasSubstr;
using trust::Access;

template <class F>
Error error_of(F request) {
  try {
    request();
  } catch (const Error& error) {
    return error;
  }
  return Error(ErrorCode::Failed, "no error");
}

/// A console by hand, which may send what it likes, and read or not.
class RawConsole {
 public:
  RawConsole(const ServedHost& host, const trust::KeyPair& keys, int most_unread = 1000)
      : socket_(context_, zmq::socket_type::dealer) {
    socket_.set(zmq::sockopt::curve_serverkey, host.keys().pair().open.bytes());
    socket_.set(zmq::sockopt::curve_publickey, keys.open.bytes());
    socket_.set(zmq::sockopt::curve_secretkey, keys.secret.bytes());
    socket_.set(zmq::sockopt::reconnect_ivl, -1);
    socket_.set(zmq::sockopt::rcvhwm, most_unread);
    socket_.set(zmq::sockopt::rcvtimeo, 20'000);
    socket_.set(zmq::sockopt::linger, 0);
    socket_.connect(host.serves());
    hello();
  }
  void hello() {
    control::Carried hello;
    hello.mutable_hello()->set_version(1);
    hello.mutable_hello()->set_control(true);
    send(hello.SerializeAsString());
  }
  void send(const std::string& bytes) { socket_.send(zmq::buffer(bytes), zmq::send_flags::none); }
  void ask(const control::Request& request) {
    const std::string body = request.SerializeAsString();
    control::Carried carried;
    for (int shift = 0; shift < 32; shift += 8)
      *carried.mutable_stream() += static_cast<char>(body.size() >> shift & 0xff);
    *carried.mutable_stream() += body;
    send(carried.SerializeAsString());
  }
  /// The next that is no sign of life. Throws when nothing comes.
  control::Carried receive() {
    control::Carried carried;
    while (carried.what_case() == control::Carried::WHAT_NOT_SET) {
      zmq::message_t message;
      if (!socket_.recv(message)) throw std::runtime_error("nothing has come");
      if (!carried.ParseFromArray(message.data(), static_cast<int>(message.size())))
        throw std::runtime_error("this is nonsense");
    }
    return carried;
  }
  std::string last_words() {
    while (true) {
      const control::Carried carried = receive();
      if (carried.has_ended()) return carried.ended().reason();
    }
  }

 private:
  zmq::context_t context_;
  zmq::socket_t socket_;
};

class Remote : public testing::Test {
 protected:
  void SetUp() override { ::setenv("FIONA_KEYS", (directory.path / "keys").c_str(), 1); }

  /// Lets this user's console in under this name.
  trust::KeyPair allowed(Access level, const std::string& name = "office") {
    const trust::KeyDirectory ours;
    const trust::KeyPair pair = ours.has_pair() ? ours.pair() : ours.make();
    host.keys().allow_console(name, pair.open.text(), level);
    return pair;
  }
  console::Endpoint endpoint() const {
    const std::string address = host.serves().substr(std::string("tcp://").size());
    return {{}, console::RemoteAddress{address, address, host.keys().pair().open}};
  }
  std::unique_ptr<ControlClient> connect(bool control) {
    return std::make_unique<ControlClient>(reactor, endpoint(), 20s, control);
  }
  static control::Request load() {
    control::Request request;
    *request.mutable_transact()->add_changes() = TestConsole::set_of("gauge", "level=1");
    return request;
  }
  static control::Request snapshot() {
    control::Request request;
    request.mutable_snapshot();
    return request;
  }
  static control::Request watch(const std::string& probe) {
    control::Request request;
    request.set_id(7);
    request.mutable_watch()->mutable_port()->set_instance("gauge");
    request.mutable_watch()->mutable_port()->set_port(probe);
    return request;
  }
  int connected() { return here.snapshot().consoles_size(); }

  TemporaryDirectory directory;
  ServedHost host{conformance::Transport::Process, true};
  TestConsole here{host};
  console::Reactor reactor;
};

TEST_F(Remote, WithoutControlEvenAnAdministratorOnlyLooks) {
  allowed(Access::Administer);
  here.load("gauge", "main");
  const auto looks = connect(false);
  EXPECT_EQ(looks->call(snapshot()).system().instances_size(), 1);
  const Error error = error_of([&] { looks->call(load()); });
  EXPECT_EQ(error.code(), ErrorCode::NotAllowed);
  EXPECT_EQ(error.text().what, "set needs the level operate (4), and this console has observe (1)");
  EXPECT_EQ(error.text().next, "the same with --control: fiona --at HOST --control LINE");
}

TEST_F(Remote, SeveralConsolesAtOnceHaveEachTheLevelOfItsConnection) {
  allowed(Access::Operate);
  here.load("gauge", "main");
  const auto looks = connect(false);
  const auto operates = connect(true);
  EXPECT_TRUE(operates->call(load()).has_done());
  EXPECT_EQ(error_of([&] { looks->call(load()); }).code(), ErrorCode::NotAllowed);
  control::Request quit;
  quit.mutable_quit();
  const Error error = error_of([&] { operates->call(quit); });
  EXPECT_EQ(error.text().what, "quit needs the level administer (9), and this console has operate (4)");
  EXPECT_THAT(error.text().next, HasSubstr(" as administer"));
  here.eventually("both are told of", [&] { return connected() == 2; });
}

/// A request of each kind, with nothing in it but a change of each kind for a transaction.
std::vector<control::Request> each_request() {
  std::vector<control::Request> all;
  const auto& kinds = *control::Request::descriptor()->FindOneofByName("what");
  const auto& changes = *control::Change::descriptor()->FindOneofByName("what");
  for (int i = 0; i < kinds.field_count(); ++i)
    all.emplace_back().GetReflection()->MutableMessage(&all.back(), kinds.field(i));
  for (int i = 0; i < changes.field_count(); ++i) {
    control::Change& change = *all.emplace_back().mutable_transact()->add_changes();
    change.GetReflection()->MutableMessage(&change, changes.field(i));
  }
  return all;
}

TEST_F(Remote, AParameterThatNamesAFileOfTheHostsMachineTakesAdminister) {
  here.load("sink", "main", "sink");
  const auto set = [](const std::string& parameters) {
    control::Request request;
    *request.mutable_transact()->add_changes() = TestConsole::set_of("sink", parameters);
    return request;
  };
  const std::string named = "notes=" + (directory.path / "notes").string();
  allowed(Access::Compose);
  {
    const auto composes = connect(true);
    const Error error = error_of([&] { composes->call(set("work_ms=1 " + named)); });
    EXPECT_EQ(error.code(), ErrorCode::NotAllowed);
    EXPECT_EQ(error.text().what, "set sink notes needs the level administer (9), and this console has compose (6)");
    control::Request plan = set(named);
    plan.mutable_transact()->set_dry_run(true);
    EXPECT_EQ(error_of([&] { composes->call(plan); }).code(), ErrorCode::NotAllowed);
    EXPECT_TRUE(composes->call(set("work_ms=1")).has_done());
    here.change(TestConsole::set_of("sink", named));
    EXPECT_TRUE(composes->call(set("work_ms=2 " + named)).has_done()) << "it is that already";
    EXPECT_TRUE(composes->call(set("notes=")).has_done()) << "none";
    EXPECT_EQ(error_of([&] { composes->call(set(named)); }).code(), ErrorCode::NotAllowed);
  }
  allowed(Access::Administer);
  EXPECT_TRUE(connect(true)->call(set(named)).has_done());
}

// There are four levels that a key may have; whose key has none is not connected at all.
TEST_F(Remote, EveryKindOfRequestAndOfChangeIsRefusedBelowItsLevelAndAtNoOther) {
  for (const Access level : {Access::Observe, Access::Operate, Access::Compose, Access::Administer}) {
    allowed(level);
    const auto client = connect(true);
    for (const control::Request& request : each_request()) {
      // Allowed, these two end the host, and the third waits for its end.
      const bool ends = request.has_quit() || request.has_upgrade_host() || request.has_run();
      const bool refused = level < need_of(request).level;
      if (ends && !refused) continue;
      EXPECT_EQ(error_of([&] { client->call(request); }).code() == ErrorCode::NotAllowed, refused)
          << request.ShortDebugString() << " at level " << static_cast<int>(level);
    }
  }
}

TEST_F(Remote, TheJournalTellsWhoItWasAndNotWhoItSaysItWas) {
  allowed(Access::Operate, "kitchen");
  here.load("gauge", "main");
  const auto operates = connect(true);
  operates->set_author("console");
  operates->call(load());
  EXPECT_EQ(here.last_entry().author(), "kitchen: console");
}

TEST_F(Remote, AnUnknownKeyIsRefusedInASentenceThatSaysHowToBeLetIn) {
  const std::string key = trust::KeyDirectory().make().open.text();
  const Error error = error_of([&] { connect(true); });
  EXPECT_EQ(error.code(), ErrorCode::NotAllowed);
  EXPECT_EQ(error.text().what, "the host does not let this console in: its key is not in the list there");
  EXPECT_EQ(error.text().next, "on that machine: fiona keys allow NAME " + key + " as observe");
  here.eventually("counted", [&] { return here.snapshot().refused_consoles() == 1; });
}

TEST_F(Remote, AHostThatMayConnectIsNoConsole) {
  host.keys().allow("office", trust::KeyDirectory().make().open.text());
  EXPECT_EQ(error_of([&] { connect(false); }).code(), ErrorCode::NotAllowed);
}

TEST_F(Remote, AHostWithAnotherKeyGetsNothing) {
  allowed(Access::Observe);
  console::Endpoint wrong = endpoint();
  wrong.remote->key = trust::KeyDirectory(directory.path / "impostor").make().open;
  const Error error = error_of([&] { ControlClient(reactor, wrong, 20s); });
  EXPECT_EQ(error.code(), ErrorCode::Unreachable);
  EXPECT_THAT(error.text().what, HasSubstr("the key of that host is another one"));
}

TEST_F(Remote, NobodyThereIsSaidAtOnce) {
  allowed(Access::Observe);
  console::Endpoint nobody = endpoint();
  nobody.remote->address = "127.0.0.1:1";
  const Error error = error_of([&] { ControlClient(reactor, nobody, 20s); });
  EXPECT_EQ(error.text().what, "no host serves consoles there");
  EXPECT_EQ(error.text().where, "tcp://127.0.0.1:1");
}

TEST_F(Remote, AForgottenKeyLosesItsSessionAndIsToldWhy) {
  allowed(Access::Observe);
  const auto client = connect(false);
  host.keys().forget("office");
  reactor.run_until([&] { return client->closed(); }, std::chrono::steady_clock::now() + 20s);
  EXPECT_EQ(client->farewell(), "the host has gone: what its key may do has been changed");
}

TEST_F(Remote, AKeyThatWasReplacedGetsNothingOfTheOneThatHasItsNameNow) {
  RawConsole replaced(host, allowed(Access::Observe));
  EXPECT_TRUE(replaced.receive().has_welcome());
  const std::string next = trust::KeyDirectory(directory.path / "next").make().open.text();
  host.keys().forget("office");
  host.keys().allow_console("office", next, Access::Administer);
  EXPECT_EQ(replaced.last_words(), "what its key may do has been changed");
  replaced.hello();  // over the same connection
  EXPECT_EQ(replaced.last_words(), "its key is no longer in the list of consoles that may connect");
}

TEST_F(Remote, ALongRequestAndALongAnswerArriveWhole) {
  allowed(Access::Observe);
  const auto client = connect(false);
  control::Request request;
  request.mutable_describe()->set_name(std::string(3'000'000, 'x'));
  const Error error = error_of([&] { client->call(request); });
  EXPECT_EQ(error.code(), ErrorCode::NotFound);
  EXPECT_GT(std::string(error.what()).size(), 3'000'000U);
}

TEST_F(Remote, AConsoleThatDiesInTheMiddleOfAWatchLeavesNothingBehind) {
  const auto pair = allowed(Access::Observe);
  here.load("gauge", "main");
  const std::size_t before = os::open_descriptors();
  {
    RawConsole dies(host, pair);
    dies.ask(watch("level"));
    while (!dies.receive().has_stream()) continue;
    EXPECT_EQ(connected(), 1);
  }
  here.eventually("it is gone", [&] { return connected() == 0; });
  here.eventually("so are its descriptors", [&] { return os::open_descriptors() <= before; });
  EXPECT_EQ(here.snapshot().ended_consoles(), 0U) << "to go is no fault";
}

TEST_F(Remote, AConsoleThatHangsHoldsNobodyUpAndIsDropped) {
  const auto pair = allowed(Access::Observe);
  here.load("gauge", "main");
  RawConsole hangs(host, pair, 1);
  hangs.ask(watch("count"));
  for (int i = 0; i < 200; ++i) {
    auto burst = here.request();
    *burst.mutable_transact()->add_changes() = TestConsole::set_of("gauge", "burst=1000 go=" + std::to_string(i + 1));
    EXPECT_TRUE(here.ask(burst).has_done()) << "another console is served all the while";
    hangs.send("");
  }
  here.eventually("it is dropped", [&] { return connected() == 0; });
  EXPECT_EQ(here.snapshot().ended_consoles(), 1U);
}

TEST_F(Remote, WhatNoConsoleSendsEndsItsSession) {
  const auto pair = allowed(Access::Administer);
  control::Carried hello;
  hello.mutable_hello()->set_version(1);
  for (const std::string& nonsense : {std::string("\xff\xff\xff\xff"), hello.SerializeAsString()}) {
    RawConsole speaks(host, pair);
    ASSERT_TRUE(speaks.receive().has_welcome());
    speaks.send(nonsense);
    EXPECT_EQ(speaks.last_words(), "this is not how a console speaks");
  }
  RawConsole announces(host, pair);
  control::Carried huge;
  huge.set_stream("\xff\xff\xff\xff too much");
  announces.send(huge.SerializeAsString());
  EXPECT_EQ(announces.last_words(), "the host has closed the connection");
  EXPECT_EQ(here.snapshot().ended_consoles(), 2U);
}

TEST_F(Remote, AnotherVersionIsRefusedInASentence) {
  const auto pair = allowed(Access::Administer);
  RawConsole console(host, pair);
  ASSERT_TRUE(console.receive().has_welcome());
  RawConsole late(host, pair);
  ASSERT_TRUE(late.receive().has_welcome());
  control::Carried ended;
  ended.mutable_ended();
  late.send(ended.SerializeAsString());
  control::Carried hello;
  hello.mutable_hello()->set_version(2);
  late.send(hello.SerializeAsString());
  EXPECT_THAT(late.last_words(), HasSubstr("another version of the protocol"));
}

TEST_F(Remote, OneTooManyIsTurnedAwayWithTheNumberThatMayBe) {
  const auto pair = allowed(Access::Observe);
  std::vector<std::unique_ptr<RawConsole>> consoles;
  for (std::size_t i = 0; i < RemoteConsoles::kMost; ++i) {
    consoles.push_back(std::make_unique<RawConsole>(host, pair));
    ASSERT_TRUE(consoles.back()->receive().has_welcome());
    for (auto& one : consoles) one->send("");
  }
  const Error error = error_of([&] { connect(false); });
  EXPECT_EQ(error.code(), ErrorCode::NotAllowed);
  EXPECT_EQ(error.text().what, "the host refuses this console: host 'served' has 32 consoles over tcp already");
  EXPECT_EQ(here.snapshot().consoles_size(), static_cast<int>(RemoteConsoles::kMost))
      << "one on the host's machine is served still";
}

TEST_F(Remote, WhereNoDescriptorsAreLeftOneIsTurnedAwayAndTheHostGoesOn) {
  if (!os::kLimitsMemory) GTEST_SKIP() << "a sanitizer asks by a pipe whether memory may be read";
  RawConsole console(host, allowed(Access::Observe));
  EXPECT_TRUE(console.receive().has_welcome());
  const std::size_t connected_with = os::open_descriptors();
  control::Carried leaves;
  leaves.mutable_ended();
  console.send(leaves.SerializeAsString());
  here.eventually("both ends are closed", [&] { return os::open_descriptors() + 2 <= connected_with; });
  rlimit before{};
  ::getrlimit(RLIMIT_NOFILE, &before);
  const rlimit few{connected_with + 64, before.rlim_max};
  ::setrlimit(RLIMIT_NOFILE, &few);
  std::vector<os::Descriptor> taken;
  while (taken.empty() || taken.back()) taken.emplace_back(::dup(STDIN_FILENO));
  taken.resize(taken.size() - 2);  // the one that there was not, and one of the two that it needs
  console.hello();
  const std::string last_words = console.last_words();
  taken.clear();
  ::setrlimit(RLIMIT_NOFILE, &before);
  EXPECT_THAT(last_words, HasSubstr("Too many open files"));
  console.hello();
  EXPECT_TRUE(console.receive().has_welcome());
}

TEST_F(Remote, AConsoleWaitsForSoManyAnswersAndNoMoreUntilItStopsSome) {
  allowed(Access::Observe);
  const auto client = connect(false);
  control::Request sleep;
  sleep.mutable_sleep()->set_duration_ms(3'600'000);
  std::uint64_t last = 0;
  for (int i = 0; i < 1000; ++i) last = client->begin(sleep, [](const control::Reply&) {});
  EXPECT_EQ(error_of([&] { client->call(snapshot()); }).text().what, "this console waits for 1000 answers already");
  control::Request stop;
  stop.mutable_unwatch()->set_watch(last);
  client->call(stop);
  EXPECT_TRUE(client->call(snapshot()).has_system());
}

TEST_F(Remote, GarbageOnThePortChangesNothing) {
  allowed(Access::Observe);
  const auto client = connect(false);
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  address.sin_port = htons(static_cast<std::uint16_t>(std::stoi(host.serves().substr(host.serves().rfind(':') + 1))));
  std::minstd_rand random(1);
  for (int i = 0; i < 50; ++i) {
    const os::Descriptor socket(::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0));
    ASSERT_EQ(::connect(socket.get(), reinterpret_cast<const sockaddr*>(&address), sizeof address), 0);
    std::string garbage = i % 2 == 0 ? "" : std::string("\xff\0\0\0\0\0\0\0\x01\x7f\x03", 11);
    while (garbage.size() < 4000) garbage += static_cast<char>(random());
    static_cast<void>(::send(socket.get(), garbage.data(), garbage.size(), MSG_NOSIGNAL));
  }
  EXPECT_TRUE(client->call(snapshot()).has_system());
  EXPECT_TRUE(connect(false)->call(snapshot()).has_system());
}

TEST_F(Remote, TheAnswerToQuitArrivesBeforeTheEnd) {
  allowed(Access::Administer);
  const auto client = connect(true);
  control::Request quit;
  quit.mutable_quit()->set_exit_code(3);
  EXPECT_TRUE(client->call(quit).has_done());
}

}  // namespace
}  // namespace fiona::host
