// Changes of a running system, in any order, several at a time: what comes of them is what a small model says that
// shares nothing with the host's; what fails has changed nothing; `undo` gives back what was there; and the journal of
// it all leads to the same system.
//
// An input is a script. Each line is a transaction; first may stand ? (plan it only), ! (the system is to be this,
// whole) and & (the next one is asked for before this has ended). Then its changes, in which all other characters say
// nothing:
//
//   +a   load 'a'; +a0 neutral, +a9 in a mode that there is not     =a3   set its parameter to 3
//   -a   unload it                                                   :a0   state neutral; 1: active, 9: no such mode
//   >A2a'b   wire A's third port to a.echo, else to b's port that fits   /A2   unwire it
//   +.       no instance may have this name
//   >A2ab_4  with a hold time of 0.4 s; _9: longer than may be
//   ~ab  swap a with b
//
// A line that begins with < takes back the last one, with * lets time pass.
#include <poll.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <map>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "../temporary_directory.hpp"
#include "engine.hpp"
#include "fiona/error.hpp"
#include "fiona/probe.pb.h"
#include "mailbox.hpp"
#include "system.hpp"

namespace {

using namespace fiona::host;
namespace control = fiona::control;

constexpr std::size_t kMostLines = 40;

// ---- what there is ---------------------------------------------------------------------------------------------

constexpr std::string_view kBeacons = "abcd", kTickers = "ef", kNavigators = "ABC", kWitnesses = "DE";
constexpr char kNoName = '.';  ///< what may be no instance's
/// Ports that require, as scripts number them, and the port of a provider that fits each.
constexpr std::array<const char*, 6> kRequired{"fixes", "last", "latest", "echo", "orders", "samples"};
constexpr std::array<const char*, 6> kFitting{"fixes", "last", "fixes", "echo", "orders", "samples"};
constexpr std::size_t kLatest = 2, kEcho = 3, kSamples = 5;
constexpr double kMostHold_ms = 3'600'000;  ///< docs/patterns.md, Wiring

bool is_in(std::string_view all, char name) { return all.find(name) != std::string_view::npos; }
bool is_name(char name) {
  return is_in(kBeacons, name) || is_in(kTickers, name) || is_in(kNavigators, name) || is_in(kWitnesses, name) ||
         name == kNoName;
}
const char* component_of(char name) {
  return is_in(kBeacons, name)     ? "beacon"
         : is_in(kTickers, name)   ? "ticker"
         : is_in(kWitnesses, name) ? "witness"
                                   : "navigator";
}
bool has_required(char name, std::size_t port) {
  return is_in(kNavigators, name) ? port != kSamples : is_in(kWitnesses, name) && (port == kEcho || port == kSamples);
}
bool has_provided(char name, const std::string& port) {
  return is_in(kBeacons, name) ? port != kFitting[kSamples]
                               : is_in(kTickers, name) && (port == kFitting[kEcho] || port == kFitting[kSamples]);
}
const char* parameter_of(char name) { return is_in(kTickers, name) ? "source" : "x"; }
bool has_parameter(char name) { return is_in(kBeacons, name) || is_in(kTickers, name); }

enum class Mode : char { Neutral = '0', Active = '1', Unknown = '9' };
const char* text_of(Mode mode) {
  return mode == Mode::Neutral ? "neutral" : mode == Mode::Active ? "active" : "flying";
}

// ---- the small model -------------------------------------------------------------------------------------------

struct Provider {
  char name;
  std::string port;
  bool operator==(const Provider&) const = default;
};
struct Client {
  char name;
  std::size_t port;
  auto operator<=>(const Client&) const = default;
};
struct Change {
  char verb;
  char name = 0;   ///< of the instance, or of the one that is swapped
  char other = 0;  ///< that takes its place
  std::size_t port = 0;
  Mode mode = Mode::Active;
  int value = 0;
  std::vector<Provider> providers{};
  std::optional<double> hold_ms{};
};
struct Wiring {
  std::vector<Provider> providers;
  double hold_ms = Model::Wire::kHold_ms;  ///< of one with alternatives
  bool operator==(const Wiring&) const = default;
};

struct Expected {
  struct Instance {
    Mode mode = Mode::Active;
    int value = 0;
    bool operator==(const Instance&) const = default;
  };
  std::map<char, Instance> instances{};
  std::map<Client, Wiring> wires{};
  bool operator==(const Expected&) const = default;

  bool fits(std::size_t port, const Provider& provider) const {
    return has_provided(provider.name, provider.port) && provider.port == kFitting[port];
  }
  /// False: it is refused.
  bool make(const Change& change) {
    const auto found = instances.find(change.name);
    const Client client{change.name, change.port};
    const bool has_client = found != instances.end() && has_required(change.name, change.port);
    if (change.name == kNoName) return false;
    switch (change.verb) {
      case '+':
        for (const auto& [from, to] : wires) {
          const auto misfit = [&, port = from.port](const auto& one) {
            return one.name == change.name && !fits(port, one);
          };
          if (std::any_of(to.providers.begin(), to.providers.end(), misfit)) return false;
        }
        return instances.emplace(change.name, Instance{change.mode}).second;
      case '-':
        std::erase_if(wires, [&](const auto& wire) { return wire.first.name == change.name; });
        return instances.erase(change.name) == 1;
      case '>':
        for (auto one = change.providers.begin(); one != change.providers.end(); ++one) {
          if (one->name == kNoName || std::find(change.providers.begin(), one, *one) != one) return false;
          if (instances.contains(one->name) && !fits(change.port, *one)) return false;
        }
        if (change.hold_ms && (change.providers.size() == 1 || *change.hold_ms > kMostHold_ms)) return false;
        if (has_client) {
          const bool several = change.providers.size() > 1;
          Wiring& wiring = wires[client];
          wiring = {change.providers, change.hold_ms.value_or(several ? wiring.hold_ms : Model::Wire::kHold_ms)};
        }
        return has_client;
      case '/': return has_client && wires.erase(client) == 1;
      case ':':
        if (found != instances.end()) found->second.mode = change.mode;
        return found != instances.end();
      case '=':
        if (found == instances.end() || !has_parameter(change.name)) return false;
        found->second.value = change.value;
        return true;
      default: return swap(change.name, change.other);
    }
  }
  bool has_any(const std::vector<Provider>& providers) const {
    return std::any_of(providers.begin(), providers.end(),
                       [this](const auto& one) { return instances.contains(one.name); });
  }
  /// Whom somebody serves is not wired to nobody, unless he is unwired first.
  bool cuts_off(const Expected& before, const std::vector<Change>& changes) const {
    return std::any_of(wires.begin(), wires.end(), [&](const auto& entry) {
      const auto& [client, wiring] = entry;
      const auto old = before.wires.find(client);
      if (old == before.wires.end() || old->second == wiring) return false;
      const auto unwires = [&, of = client](const Change& one) {
        return one.verb == '/' && Client{one.name, one.port} == of;
      };
      if (std::any_of(changes.begin(), changes.end(), unwires)) return false;
      return has_any(old->second.providers) && !has_any(wiring.providers);
    });
  }
  bool swap(char old, char next) {
    if (!instances.contains(old) || !instances.contains(next)) return false;
    bool any = false;
    for (auto& [client, wire] : wires) {
      std::vector<Provider> moved;
      for (Provider one : wire.providers) {
        if (one.name == old) {
          any = true;
          one.name = next;
          if (!has_provided(next, one.port)) return false;
        }
        if (std::find(moved.begin(), moved.end(), one) == moved.end()) moved.push_back(one);
      }
      wire.providers = moved;
      if (moved.size() == 1) wire.hold_ms = Model::Wire::kHold_ms;
    }
    return any;
  }
};

// ---- scripts ---------------------------------------------------------------------------------------------------

struct Line {
  enum class Kind { Changes, Undo, Time };
  Kind kind = Kind::Changes;
  bool plans = false;
  bool is_whole = false;
  bool is_awaited = true;
  std::vector<Change> changes{};
};

class Reader {
 public:
  explicit Reader(std::string_view text) : text_(text) {}

  std::optional<Line> line() {
    if (at_ >= text_.size()) return std::nullopt;
    Line line;
    for (; at_ < text_.size() && text_[at_] != '\n'; ++at_) {
      const bool first = line.changes.empty() && line.kind == Line::Kind::Changes;
      if (first && text_[at_] == '?') line.plans = true;
      if (first && text_[at_] == '!') line.is_whole = true;
      if (first && text_[at_] == '&') line.is_awaited = false;
      if (first && text_[at_] == '<') line.kind = Line::Kind::Undo;
      if (first && text_[at_] == '*') line.kind = Line::Kind::Time;
      if (auto change = this->change()) line.changes.push_back(std::move(*change));
    }
    ++at_;
    return line;
  }

 private:
  char next() const { return at_ + 1 < text_.size() ? text_[at_ + 1] : '\n'; }
  std::optional<Mode> mode() {
    if (next() != '0' && next() != '1' && next() != '9') return std::nullopt;
    return static_cast<Mode>(text_[++at_]);
  }
  std::optional<Change> change() {
    if (!is_in("+-=:>/~", text_[at_]) || !is_name(next())) return std::nullopt;
    Change change{text_[at_]};
    change.name = text_[++at_];
    switch (change.verb) {
      case '+': change.mode = mode().value_or(Mode::Active); return change;
      case '-': return change;
      case ':':
        if (const auto wanted = mode()) return change.mode = *wanted, change;
        return std::nullopt;
      case '~':
        if (!is_name(next())) return std::nullopt;
        change.other = text_[++at_];
        return change;
      default: break;
    }
    if (next() < '0' || next() > '9') return std::nullopt;
    change.value = text_[++at_] - '0';
    if (change.verb == '=') return change;
    change.port = static_cast<std::size_t>(change.value) % kRequired.size();
    while (change.verb == '>' && is_name(next())) {
      Provider provider{text_[++at_], kFitting[change.port]};
      if (next() == '\'') ++at_, provider.port = kFitting[kEcho];
      change.providers.push_back(std::move(provider));
    }
    if (change.verb == '>' && change.providers.empty()) return std::nullopt;
    if (change.verb == '>' && next() == '_') {
      ++at_;
      if (next() < '0' || next() > '9') return std::nullopt;
      change.hold_ms = text_[++at_] == '9' ? 2 * kMostHold_ms : 100.0 * (text_[at_] - '0');
    }
    return change;
  }

  std::string_view text_;
  std::size_t at_ = 0;
};

control::PortName named(char instance, const std::string& port) { return port_of({std::string(1, instance), port}); }

control::Change asked_for(const Change& change) {
  control::Change asked;
  const std::string name(1, change.name);
  switch (change.verb) {
    case '+':
      asked.mutable_load()->set_plugin(std::string(TEST_COMPONENTS_LIBRARY) + "/" + component_of(change.name));
      asked.mutable_load()->set_instance(name);
      if (change.mode != Mode::Active) asked.mutable_load()->set_mode(text_of(change.mode));
      break;
    case '-': asked.mutable_unload()->set_instance(name); break;
    case '>': {
      auto& wire = *asked.mutable_wire();
      *wire.mutable_client() = named(change.name, kRequired[change.port]);
      *wire.mutable_provider() = named(change.providers.front().name, change.providers.front().port);
      for (std::size_t i = 1; i < change.providers.size(); ++i)
        *wire.add_alternatives() = named(change.providers[i].name, change.providers[i].port);
      if (change.hold_ms) wire.set_hold_ms(*change.hold_ms);
      break;
    }
    case '/': *asked.mutable_unwire()->mutable_client() = named(change.name, kRequired[change.port]); break;
    case ':':
      asked.mutable_state()->set_instance(name);
      asked.mutable_state()->set_mode(text_of(change.mode));
      break;
    case '=': {
      asked.mutable_set()->set_instance(name);
      auto& argument = *asked.mutable_set()->add_parameters();
      argument.set_name(parameter_of(change.name));
      argument.mutable_value()->set_integer(change.value);
      break;
    }
    default: asked.mutable_replace()->set_old(name); asked.mutable_replace()->set_next(std::string(1, change.other));
  }
  return asked;
}

control::Change virtual_clock() {
  control::Change change;
  change.mutable_set()->set_instance(std::string(kHostItself));
  auto& argument = *change.mutable_set()->add_parameters();
  argument.set_name("clock");
  argument.mutable_value()->set_text("virtual");
  return change;
}

// ---- what is looked at -----------------------------------------------------------------------------------------

void require(bool holds, const char* what) {
  if (holds) return;
  std::fprintf(stderr, "it does not hold that %s\n", what);
  std::abort();
}

std::string text_of(const Provider& provider) { return std::string(1, provider.name) + "." + provider.port; }

struct Place {
  fiona::tests::TemporaryDirectory directory;
  System system{{.name = "fuzz",
                 .store = directory.path / "store",
                 .directory = directory.path,
                 .threads = 1,
                 .ends_hung_groups = false,
                 .restarts_groups = false,
                 .tries_libraries = false},
                [](const fiona::wire::GroupMessage&) {}};
  /// Its interface takes longer to read than all else here: it is kept.
  const std::shared_ptr<const Package> package =
      system.packages().find(std::string(TEST_COMPONENTS_LIBRARY) + "/beacon").package;
};

class Run {
 public:
  explicit Run(System& system) : system_(system) { transact({Line::Kind::Changes, false, true}, Expected()); }

  void make(const Line& line) {
    if (line.kind == Line::Kind::Time) return let_time_pass();
    const bool undoes = line.kind == Line::Kind::Undo;
    const bool is_mode_alone = line.changes.size() == 1 && line.changes.front().verb == ':';
    // A change of mode alone holds up nobody: what is asked for behind it may overtake it.
    const bool may_be_overtaken = undoes || line.is_whole || is_mode_alone;
    if (may_be_overtaken) await_all();
    if (undoes) {
      undo(line.plans);
    } else if (!line.changes.empty() || line.is_whole) {
      transact(line, expected_);
    }
    if (line.is_awaited || may_be_overtaken) await_all();
  }

  /// The journal leads to the same system, and nothing is left of that.
  void end() {
    await_all();
    std::string records = Journal::record_of(control::JournalEntry());
    const auto told = engine_.journal(0);
    for (const auto& entry : told.entries()) records += Journal::record_of(entry);
    Model again;
    again.make(virtual_clock(), system_.packages());  // which an earlier run may have set
    const auto read = Journal::told_by(records);
    for (const auto& change : read.changes) again.make(change, system_.packages());
    require(Model::difference(system_.model(), again).empty(), "the journal leads to the system that there is");
    require(Model::difference(again, system_.model()).empty(), "the journal leads there and back");
    make({Line::Kind::Changes, false, true});
    require(system_.snapshot().instances().empty() && system_.model().wires().empty(), "nothing is left");
  }

 private:
  enum class Outcome { Done, Planned, Refused };

  void transact(const Line& line, const Expected& before) {
    Expected after = line.is_whole ? Expected() : before;
    bool is_refused = false, fails = false;
    control::Transact request;
    request.set_dry_run(line.plans);
    request.set_whole(line.is_whole);
    if (line.is_whole) *request.add_changes() = virtual_clock();
    std::map<char, Mode> loaded_in;
    for (const auto& change : line.changes) {
      *request.add_changes() = asked_for(change);
      is_refused = is_refused || !after.make(change);
      fails = fails || (!line.is_whole && is_in("+:", change.verb) && change.mode == Mode::Unknown);
      if (change.verb == '+') loaded_in[change.name] = change.mode;
    }
    is_refused = is_refused || (!line.is_whole && after.cuts_off(before, line.changes));
    // Whole, the system goes there by the shortest way: modes in between are not gone through.
    for (const auto& [name, one] : after.instances) {
      const bool is_new = !before.instances.contains(name);
      fails = fails || one.mode == Mode::Unknown || (is_new && loaded_in[name] == Mode::Unknown);
    }
    const Outcome outcome = is_refused   ? Outcome::Refused
                            : line.plans ? Outcome::Planned
                            : fails      ? Outcome::Refused
                                         : Outcome::Done;
    if (outcome == Outcome::Done) note(after);
    engine_.transact("fuzz", request, expecting(outcome));
  }

  void undo(bool plans) {
    control::Undo request;
    request.set_dry_run(plans);
    const Outcome outcome = before_.empty() ? Outcome::Refused : plans ? Outcome::Planned : Outcome::Done;
    if (outcome == Outcome::Done) {
      expected_ = before_.back();
      before_.pop_back();
    }
    engine_.undo("fuzz", request, expecting(outcome));
  }

  void note(const Expected& after) {
    if (after == expected_) return;
    before_.push_back(expected_);
    expected_ = after;
  }

  Waits::Answer expecting(Outcome outcome) {
    ++open_;
    return [this, outcome](const control::Reply& reply) {
      --open_;
      require(reply.has_done() == (outcome == Outcome::Done), "what can be done is done, and nothing else");
      require(reply.has_planned() == (outcome == Outcome::Planned), "what can be done is planned, and nothing else");
      if (!reply.has_failure()) return;
      require(!reply.failure().what().empty(), "a refusal says what was wrong");
      const bool helps =
          !reply.failure().next().empty() || !reply.failure().expected().empty() || !reply.failure().near().empty();
      require(helps, "a refusal says what would have been right");
    };
  }

  void await_all() {
    const auto most = std::chrono::steady_clock::now() + std::chrono::seconds(20);
    while (open_ > 0) {
      require(std::chrono::steady_clock::now() < most, "each transaction ends");
      pollfd wake{work_.descriptor(), POLLIN, 0};
      ::poll(&wake, 1, 100);
      system_.watch_time();
      for (const auto& job : work_.take()) job();
    }
    look();
  }

  void let_time_pass() {
    await_all();
    system_.settle();
    control::Sleep request;
    request.set_duration_ms(60);
    ++open_;
    system_.waits().sleep(1, 1, request, [this](const control::Reply& reply) {
      const bool slept = reply.has_met();
      work_.push([this, slept] {
        --open_;
        require(slept, "time passes");
      });
    });
    await_all();
    look_at_what_came();
  }

  void look() {
    const Model& model = system_.model();
    require(model.names().size() == expected_.instances.size(), "there are as many instances as there should be");
    require(model.wires().size() == expected_.wires.size(), "there are as many wires as there should be");
    for (const auto& [client, wiring] : expected_.wires) {
      const auto& providers = wiring.providers;
      const auto* wire = model.wire_of(named(client.name, kRequired[client.port]));
      require(wire && wire->providers.size() == providers.size(), "a wire has the alternatives that it should have");
      for (std::size_t i = 0; i < providers.size(); ++i)
        require(fiona::host::text_of(wire->providers[i]) == text_of(providers[i]), "alternatives are in their order");
      require(providers.size() == 1 || wire->hold_ms == wiring.hold_ms, "a wire has the hold time that it should have");
    }
    const auto snapshot = system_.snapshot();
    require(static_cast<std::size_t>(snapshot.instances_size()) == expected_.instances.size(),
            "what is meant to be is there");
    for (const auto& one : snapshot.instances()) {
      require(one.name().size() == 1 && expected_.instances.contains(one.name()[0]), "nothing else is there");
      look_at(one, expected_.instances.at(one.name()[0]));
    }
  }

  void look_at(const control::InstanceStatus& status, const Expected::Instance& instance) {
    const char name = status.name()[0];
    require(status.component() == component_of(name), "it is of its component");
    require(status.mode() == text_of(instance.mode), "it is in its mode");
    require(status.set_parameters_size() == (instance.value == 0 ? 0 : 1), "what was set is set, and nothing else");
    for (const auto& argument : status.set_parameters()) {
      const auto& value = argument.value();
      require(argument.name() == parameter_of(name), "its parameter is the one that was set");
      require((value.kind_case() == control::Value::kInteger ? static_cast<double>(value.integer()) : value.number()) ==
                  instance.value,
              "a parameter has the value that it was given");
    }
    for (const auto& port : status.ports()) {
      if (port.direction() == fiona::PROVIDES) look_at_provided(name, port);
      if (port.direction() == fiona::REQUIRES) look_at_required(name, port);
    }
  }

  void look_at_provided(char name, const control::PortStatus& port) {
    std::vector<std::string> clients;
    for (const auto& client : port.clients()) clients.push_back(fiona::host::text_of(client));
    std::vector<std::string> wired;
    for (const auto& [client, wiring] : expected_.wires) {
      const auto& providers = wiring.providers;
      if (std::find(providers.begin(), providers.end(), Provider{name, port.name()}) != providers.end())
        wired.push_back(std::string(1, client.name) + "." + kRequired[client.port]);
    }
    std::sort(clients.begin(), clients.end());
    std::sort(wired.begin(), wired.end());
    require(clients == wired, "who is wired to a port is who should be");
  }

  void look_at_required(char name, const control::PortStatus& port) {
    const auto at = std::find(kRequired.begin(), kRequired.end(), port.name());
    if (at == kRequired.end())
      return require(port.connection() == control::UNWIRED, "what no script names has no wire");
    const auto found = expected_.wires.find({name, static_cast<std::size_t>(at - kRequired.begin())});
    if (found == expected_.wires.end())
      return require(port.connection() == control::UNWIRED, "what has no wire has none");
    const auto is_there = [this](const Provider& one) { return expected_.instances.contains(one.name); };
    const auto& providers = found->second.providers;
    const bool any = std::any_of(providers.begin(), providers.end(), is_there);
    require(any ? port.connection() == control::CONNECTED || port.connection() == control::LOST
                : port.connection() == control::WAITING,
            "a wire waits as long as nobody is there, and no longer");
    if (providers.size() == 1) return;
    require(static_cast<std::size_t>(port.providers_size()) == providers.size(), "each alternative is told");
    int serving = 0;
    for (int i = 0; i < port.providers_size(); ++i) {
      const auto& one = port.providers(i);
      const auto& wanted = providers[static_cast<std::size_t>(i)];
      require(fiona::host::text_of(one.provider()) == text_of(wanted), "alternatives are told in their order");
      require((one.connection() == control::WAITING) == !is_there(wanted), "an alternative waits until it is there");
      require(!one.serves() || is_there(wanted), "who serves is there");
      serving += one.serves() ? 1 : 0;
    }
    require(serving <= 1, "one serves at a time");
  }

  /// Values of now, where one provider gives them.
  void look_at_what_came() {
    for (const auto& [client, wiring] : expected_.wires) {
      const auto& providers = wiring.providers;
      if (client.port != kLatest || providers.size() != 1) continue;
      const auto provider = expected_.instances.find(providers.front().name);
      const bool gives = provider != expected_.instances.end() && provider->second.mode == Mode::Active;
      if (expected_.instances.at(client.name).mode != Mode::Active || !gives) continue;
      const auto tapped = system_.read(named(client.name, "latest_is"));
      fiona::probe::Text text;
      require(text.ParseFromString(tapped.object()), "a probe can be read");
      require(text.value() == std::string("ok ") + providers.front().name,
              "what comes is of the provider that is wired");
    }
  }

  System& system_;
  Expected expected_;
  std::vector<Expected> before_;  ///< each change that can be taken back
  int open_ = 0;
  Mailbox<std::function<void()>> work_;
  Engine engine_{system_, {}, [this](std::function<void()> job) { work_.push(std::move(job)); }};
};

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  static Place place;
  static const bool kClockIsVirtual = (Run(place.system).end(), true);  // which the first one's journal would have
  static_cast<void>(kClockIsVirtual);
  Reader reader({reinterpret_cast<const char*>(data), size});
  Run run(place.system);
  for (std::size_t i = 0; i < kMostLines; ++i) {
    const auto line = reader.line();
    if (!line) break;
    run.make(*line);
  }
  run.end();
  return 0;
}
