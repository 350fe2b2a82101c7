#include "verb_table.hpp"

#include <algorithm>

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <fiona/hull_probes.hpp>

#include "verbs/verbs.hpp"

namespace fiona::console {
namespace {

std::vector<Shape> forms(std::initializer_list<std::string_view> texts) { return {texts.begin(), texts.end()}; }

std::vector<Verb> composing_verbs() {
  return {
      {"load",
       forms({"load PLUGIN [as NAME] [in GROUP|HOST/GROUP] [at MODE] [with RIGHT …] "
              "[PARAM=VALUE …]"}),
       "creates an instance of a plugin",
       "PLUGIN is publisher/name, name, name/component where a plugin has several, or the path of a library.\n"
       "Without `as` the instance has the component's name; without `in` it lives in main; in HOST or HOST/GROUP on "
       "another host; `at` is its first mode.\n"
       "`with master` lets a component that asks for it change the system, as whoever types does. A package of another "
       "publisher gets a group of its own, a sandbox, of its instance's name; `with network`, `with device:NAME`, "
       "`with "
       "read:/PATH`, `with write:/PATH` and `with system-bus:NAME` or `session-bus:NAME`, a service on D-Bus, open it "
       "as far as its manifest asks; before Linux 6.12 `with network` opens the abstract sockets of the user's "
       "programs "
       "too; `with confined` makes a sandbox for a "
       "package that needs none, and `with unconfined` none for one that does. A path names a file on the host's "
       "machine: that takes administer, as do parameters that are paths there, devices, files, services on D-Bus and "
       "`unconfined`.",
       Access::Compose, verbs::load},
      {"unload", forms({"unload INSTANCE"}), "retires an instance and says who depended on it", "", Access::Compose,
       verbs::unload},
      {"wire", forms({"wire INSTANCE.PORT to INSTANCE.PORT [else INSTANCE.PORT …] [every N] [hold=T]"}),
       "connects a required port to a provided one",
       "Checked before it is done; a port that has a wire already gets the new one without a gap. Where no instance "
       "has "
       "the provider's name yet, the wire waits for it; but whom somebody serves is not cut off so.\n"
       "`every N` passes each N-th message of a push. Left out, it is as the port had it before.\n"
       "`else` names who serves while those before are not there, silent for longer than their lease, or say that what "
       "they say is not valid; all are connected all the time. A better one serves again once it has been fit for the "
       "hold "
       "time, 3s unless `hold` says otherwise: wire nav.location to fusion.location else wifi.location hold=5s.",
       Access::Compose, verbs::wire},
      {"unwire", forms({"unwire INSTANCE.PORT"}), "takes the wire of a required port away", "", Access::Compose,
       verbs::unwire},
      {"swap", forms({"swap INSTANCE for INSTANCE [watch T]"}), "moves all who use one instance to another",
       "Each wire goes to the port of the same name, or the only one of the same service; all of them or none.\n"
       "With `watch` what both push is compared first, for T on the system's clock, and how far they differ is told. "
       "If the "
       "new one says nothing, or nothing valid, while the old one does, nothing is swapped.",
       Access::Compose, verbs::swap},
      {"upgrade", forms({"upgrade INSTANCE [to VERSION] [watch T]", "upgrade host [watch T]"}),
       "puts the installed version of an instance's package in the place of the one that runs",
       "The new version starts beside the old one in a process of its own, with its mode, parameters and wires; if it "
       "fits, reaches the mode and says what the old one says, it takes over, and what was asked before is still "
       "answered. "
       "The old one stands by for T, 10s unless `watch` says otherwise, and takes its place again if the new one ends, "
       "hangs, fails or falls silent. What is answered is told when that is over; `watch 0s` waits for nothing.\n"
       "As in: market update wifi, upgrade wifi. `to` names another version that the store still has; `undo` goes "
       "back.\n"
       "`upgrade host`, of one that was started with `run --supervised`, starts the fiona-host that is installed now "
       "in "
       "its place: groups go on with the wires between them, what is in main is made again, and groups that are "
       "started "
       "later are of the new build. If that does not come up, or ends within T, the one before runs again. It takes "
       "the "
       "level administer.",
       Access::Compose, verbs::upgrade, false},
  };
}

std::vector<Verb> transaction_verbs() {
  return {
      {"begin", forms({"begin"}), "collects the changes of the lines that follow, until commit",
       "At a prompt and in a system file. Nothing is changed before commit.", Access::Compose, verbs::begin},
      {"commit", forms({"commit"}), "makes the collected changes, all or none",
       "Each is checked before the first is made; when one fails, those before it are taken back. It takes the level "
       "that "
       "the highest of them takes.",
       Access::Compose, verbs::commit},
      {"abort", forms({"abort"}), "drops the collected changes", "", Access::Compose, verbs::abort},
      {"plan", forms({"plan LINE"}), "shows what a line would do, step by step, and what would take it back",
       "As in: plan swap wifi for fusion, plan apply museum.fiona, plan undo.", Access::Observe, verbs::plan, false,
       true},
      {"apply", forms({"apply FILE"}), "makes the running system equal to a file, with the fewest changes",
       "Lines that only look are passed over; the others are load, wire, set, state. All or nothing.", Access::Compose,
       verbs::apply, false},
      {"undo", forms({"undo"}), "takes back the last change that has not been taken back",
       "An instance that was unloaded is loaded again and begins anew.", Access::Compose, verbs::undo, false},
      {"journal", forms({"journal [N]"}), "lists the last changes: who made them, and what became of them", "",
       Access::Observe, verbs::journal},
  };
}

std::vector<Verb> operating_verbs() {
  return {
      {"set", forms({"set INSTANCE PARAM=VALUE …"}), "changes parameters, all or none",
       "A number may carry a unit, which is converted: 200ms, 1.5m, 30deg.\n"
       "The instance `host` is the host itself: set host clock=virtual start=TIME speed=0 deliveries=FILE; "
       "TIME, as in 2024-05-31T09:30:00Z, is when a recording began that is to be played at its own times, else 0; "
       "deliveries names a file there, which takes administer, as does any parameter that is a path there.",
       Access::Operate, verbs::set},
      {"get", forms({"get INSTANCE [PARAM]"}), "shows parameters with unit, range and default", "", Access::Observe,
       verbs::get},
      {"state", forms({"state INSTANCE [MODE] [for T]"}), "shows the mode, or changes it and waits until it is reached",
       "A mode is left when the work that it leaves has ended; `for`, or 10 s, is how long that may take. deactivated "
       "is "
       "neutral, and cancels what waits. To see the mode takes observe.",
       Access::Operate, verbs::state},
      {"call", forms({"call INSTANCE.NAME [OBJECT] [FIELD=VALUE …] [for T]"}),
       "uses a query port or a trigger by hand, and shows the answer",
       "Of a required port: the provider at its wire's end. OBJECT is protobuf text: {number: 7}. `for`, or 2 s, is "
       "how "
       "long it may take.\n"
       "A value of a secret field, a password, is shown in no answer or error and kept in no history. Type it at the "
       "prompt: the command lines of a shell are kept by the shell.",
       Access::Operate, verbs::call, false},
      {"send", forms({"send INSTANCE.NAME [OBJECT] [FIELD=VALUE …] [for T]"}), "hands an object to a send port by hand",
       "OBJECT is protobuf text: {number: 7}. Waits until the provider's hull has it; of a query port or a trigger it "
       "is `call`.",
       Access::Operate, verbs::call, false},
  };
}

/// "Each instance has the probes mode, …; each port …".
std::string hull_probe_text() {
  const auto names = [](HullProbe::Of of) {
    std::string text;
    for (const HullProbe& one : hull_probes()) {
      if (one.of == of) text += (text.empty() ? "" : ", ") + std::string(one.name);
    }
    return text;
  };
  return fmt::format("Each instance has the probes {}; each port {}; each task {}: radio.mode, radio.wifi.rate.\n",
                     names(HullProbe::Of::Instance), names(HullProbe::Of::Port), names(HullProbe::Of::Task));
}

std::vector<Verb> seeing_verbs() {
  return {
      {"ls", forms({"ls [instances|plugins|wires|services|hosts]"}), "lists what runs, is installed or connected",
       "health says ok, unwired, waiting, lost, failed, or silent: its process does not answer; wires is "
       "connected/required.",
       Access::Observe, verbs::ls},
      {"show", forms({"show THING"}), "everything about an instance, port, plugin, service or object",
       "THING: walk, walk.imu, walk.imu.rate, trace-player, LocationProvider, CommLocation. Without a host, what is "
       "installed and "
       "what the platform knows.",
       Access::Observe, verbs::show},
      {"spots", forms({"spots"}), "white spots: required ports that nobody serves, provided ones that nobody uses",
       "Who could serve: running instances, installed plugins, packages of the marketplace, each with the line to "
       "type.",
       Access::Observe, verbs::spots},
      {"why", forms({"why INSTANCE|INSTANCE.PORT"}),
       "why it is silent, late, not active, lost or failed: what led to it, the root first",
       "Follows what an instance requires to where the trouble begins, over wires and alternatives.", Access::Observe,
       verbs::why},
      {"watch",
       forms({"watch INSTANCE.PORT|INSTANCE.PROBE [FIELD …] [every N|T] [when CONDITION …] [for T]",
              "watch stop [INSTANCE.PORT|INSTANCE.PROBE]"}),
       "prints what goes through a port, or what a probe says",
       "Any type. `every 5` prints each fifth; `every 1s` is the shortest time between two values, on the "
       "system's clock, and where that is faster than yours about half of it between two lines; `for` ends it, on "
       "yours.\n"
       "With `when` only what makes the condition true: [FIELD] above V, below V, is V, changes, older than T. It has "
       "to "
       "become false before it is told again.\n" +
           hull_probe_text() +
           "At a prompt and in a system file it goes on while other lines run; `watch stop` ends it. From a shell, "
           "Ctrl-C does. When the group or host that it looks at is lost, it says so and goes on once that is back.",
       Access::Observe, verbs::watch},
      {"record", forms({"record FILE INSTANCE.PORT|INSTANCE.PROBE … [for T]", "record stop [FILE]"}),
       "keeps what goes through ports in a file, each message with its time and type",
       "Any types. FILE, on this machine, is an MCAP file, which Foxglove, PlotJuggler and libraries in many languages "
       "read; times are since 1970-01-01 UTC, of a virtual clock that starts at 0 since then. Passwords and other "
       "secrets are "
       "left out.\n"
       "At a prompt and in a system file it goes on while other lines run; `record stop` ends it. From a shell, Ctrl-C "
       "does. If it is killed, all but the last second can be read.",
       Access::Observe, verbs::record},
      {"graph", forms({"graph [dot|mermaid]"}), "the wiring as text, for Graphviz or for Mermaid",
       "As text `<-` comes from there, `?-` nobody serves, `->` goes there. As in: fiona graph dot | dot -Tsvg > "
       "system.svg",
       Access::Observe, verbs::graph},
      {"top", forms({"top [every T] [for T] [sort=COLUMN]"}),
       "full screen: who takes how much time, how late, how many were lost",
       "busy is the share of the time that an instance's handlers take; age that of the oldest newest message that it "
       "has; "
       "p50 and p99 are of the latency, from a message's origin to the handler, over the last 10 to 20 s.\n"
       "Keys: arrows (or j, k) select, enter shows the ports, escape goes back, s sorts by the next column, + and - "
       "change the period, q leaves. COLUMN is busy, cpu, queue, rate, age, p99, drops or instance. Without a terminal "
       "it prints the table, once, or as long as `for` says.",
       Access::Observe, verbs::top, false},
  };
}

std::vector<Verb> file_verbs() {
  return {
      {"check", forms({"check FILE"}), "reads a system file against the installed interfaces and starts nothing",
       "Grammar, plugins, instances, ports, contracts, parameters: each mistake with line and column; then the white "
       "spots.",
       Access::Observe, verbs::check},
      {"run",
       forms({"run [FILE …] [--restore] [--supervised] [--headless] [--strict] [--for T] [--set INSTANCE.PARAM=VALUE "
              "…] [--host NAME] [--store DIR] [--unsigned DIR] "
              "[--listen ADDRESS:PORT] [--serve ADDRESS:PORT] [--peer NAME=ADDRESS:PORT=KEY …] [--registry URL] "
              "[--group-memory MIB] [--group-threads N] [--group-descriptors N] [--group-cpu CORES]"}),
       "starts a host and runs system files in it (from a shell)",
       "FILE is a system file, or the name of an installed package that is a system. Without it the system begins "
       "empty. In a terminal the prompt follows; --headless lets the system run until "
       "it "
       "ends, --for T for that long on its clock.\n"
       "--restore begins with the system that this host had when it was last changed, also if it was killed then.\n"
       "--supervised starts the host again when it ends without being told to, or hangs, with that system; groups go "
       "on "
       "meanwhile, and keep the wires between them.\n"
       "--set replaces or adds a parameter of an instance that the files load, or files that they source. --strict "
       "refuses white spots (exit code "
       "4).\n"
       "--group-memory, --group-threads and --group-descriptors say what each group may take, other than main: 1024 "
       "MiB, "
       "128 and 1024; one that takes more is ended. One that takes more than --group-cpu cores (0.5 or so; 0: no "
       "limit) "
       "for two seconds gets no more from then on; without control groups, what others leave.\n"
       "--unsigned lets packages in DIR be loaded that nobody has signed, as unsigned/NAME, each in a sandbox.\n"
       "--listen lets another host lead this one over tcp; --peer names a host that this one leads: load … in NAME; "
       "--serve "
       "lets consoles on other machines connect. Each needs keys: keys make. With --registry http://HOST:PORT, an "
       "etcd, "
       "a host holds its name there, and --peer NAME=KEY finds it wherever it is.",
       Access::Administer, verbs::run, false},
      {"save", forms({"save FILE"}), "writes the running system as a file that gives it back",
       "Replaces the file in one step, the one that a link leads to, and keeps its mode; - is standard output. A saved "
       "system that is run and saved again is the same text.",
       Access::Observe, verbs::save},
      {"source", forms({"source FILE"}), "runs the lines of a file, up to the first that fails",
       "Each line takes its own level.", Access::Compose, verbs::source},
  };
}

std::vector<Verb> waiting_verbs() {
  return {
      {"wait", forms({"wait INSTANCE MODE [for T]"}), "waits until an instance is in a mode",
       "Time is the system's clock; without `for`, 2 s (or --timeout).", Access::Observe, verbs::wait, false},
      {"expect", forms({"expect INSTANCE.PORT.FIELD|INSTANCE.PROBE OP VALUE [for T]"}),
       "waits until a field of a message, or a probe, fulfils a condition, and fails otherwise",
       "OP: == != < <= > >=. Time is the system's clock; without `for`, 2 s. In a shell, quote < and >.",
       Access::Observe, verbs::expect, false},
      {"sleep", forms({"sleep T"}), "lets the system's clock pass", "T has a unit: 500ms, 2s, 1min.", Access::Observe,
       verbs::sleep, false},
      {"quit", forms({"quit [CODE] [-y]"}), "ends the host; its exit code is CODE",
       "It returns once another host can have its name. At the prompt of a host that something else has started it "
       "asks "
       "first; -y answers. To leave the prompt and let the host run: Ctrl-D.",
       Access::Administer, verbs::quit, false},
  };
}

std::vector<Verb> remaining_verbs() {
  return {
      {"market",
       forms({"market search [WORD …] [for spots|FILE] [--provides SERVICE …] [--requires SERVICE …] [--from DIR]",
              "market info PACKAGE [--from DIR]", "market install [PACKAGE …] [--locked FILE] [--from DIR] [-y]",
              "market update [PACKAGE …] [--from DIR] [-y]", "market remove PACKAGE … [-y]", "market rollback [N] [-y]",
              "market history", "market list", "market verify", "market lock [FILE]", "market init DIR",
              "market publish FILE … [--to DIR]", "market accept DIR [NAME [KEY] …]",
              "market revoke DIR NAME [because=TEXT]", "market keys DIR",
              "market rotate DIR root|targets|online [KEY …] [threshold=N]", "market sign DIR [-y]"}),
       "finds packages, installs them with what they require, goes back; keeps a marketplace",
       "PACKAGE is [publisher/]name[@version]. --from names a marketplace: a directory or an http(s) address, trusted "
       "by "
       "`keys trust`.\n"
       "`search` finds words in names, texts and services; `for spots` those that fill the white spots of the running "
       "system, `for FILE` those of a system file.\n"
       "`update` without --from also asks each other marketplace for what came from there. "
       "`install`, `update`, `remove` and `rollback` do all or nothing. What goes beyond the line typed, as packages "
       "that are required, rights, a publisher of whom nothing is installed, is shown and asked first; -y answers yes, "
       "and plan market … shows it and does nothing.\n"
       "`rollback` goes back to the packages before the last change, or to generation N of `history`. `lock` writes "
       "fiona.lock, what is installed or what FILE loads, to the byte; `install --locked` installs that.\n"
       "`init` makes a marketplace and its keys. `publish` hands in packages that `plugin sign` has signed; `accept`, "
       "by "
       "who has the keys, takes them in, those of a new publisher where NAME names him and KEY, or an answer, says "
       "that "
       "this key is his. `revoke` takes back "
       "publisher/name@version, all of publisher/name, or a publisher with his key: users who have it are told, and "
       "cannot "
       "start it.\n"
       "`keys` lists who signs what; `rotate` gives a role other keys, a new one or those named (a name, or 64 digits "
       "of "
       "somebody else's); `threshold` of the root's have to sign, each by `sign`.",
       Access::Administer, verbs::market, false},
      {"plugin",
       forms({"plugin new NAME [kind=plugin|messages|system] [--provides SERVICE …] [--requires SERVICE …] "
              "[--publisher NAME] [DIR]",
              "plugin describe LIBRARY [-o FILE] [with unconfined]", "plugin test [DIR] [for T] [with unconfined]",
              "plugin check [DIR|LIBRARY|FILE] [with unconfined]",
              "plugin pack [DIR] [-o FILE] [for T] [with unconfined]", "plugin sign FILE … [after=FILE]",
              "plugin unsign PACKAGE@VERSION …", "plugin messages [PACKAGE]"}),
       "the author's side: makes a plugin, tests it, checks it, packs it and signs the package",
       "`new` writes a folder that builds and passes its tests at once: a component with these ports, its parameters, "
       "a "
       "test, manifest and README. SERVICE is one of the platform's or of an installed package of messages; the "
       "publisher is the user's name unless "
       "--publisher says another.\n"
       "`test` builds in DIR/build with cmake, runs the author's tests, then puts each component on a bench where "
       "its ports are held to their contracts (period, lease, ranges, covariances, answers), and loads it into a host. "
       "`for`, or 10min, is how long building and tests may take.\n"
       "`check` says what would keep it from being published, with the place and what to do; of DIR, a library or a "
       "package. -v lists what is well.\n"
       "`pack` builds, checks and writes NAME-VERSION-MACHINE.fpk: the same files give the same bytes. `sign` writes "
       "PUBLISHER.json beside it: all that the publisher's key (keys new PUBLISHER) signs for. Who has lost that, or "
       "the "
       "key, or has signed what was never published, signs `after` what the marketplace has: "
       "metadata/NUMBER.PUBLISHER.json. `unsign` takes a version off the list.\n"
       "`describe` shows what a library declares, or writes it to FILE, as its interface. `messages` lists the "
       "installed "
       "packages whose objects a plugin can be compiled with: fiona_add_plugin(… MESSAGES PACKAGE).\n"
       "To be asked what it declares, code runs in a sandbox; `with unconfined`, with all that you may: for systems "
       "that have "
       "no sandbox, and code that you trust as you trust yourself.",
       Access::Administer, verbs::plugin, false},
      {"keys",
       forms({"keys", "keys list", "keys make", "keys show",
              "keys allow NAME KEY [as observe|operate|compose|administer]", "keys know NAME ADDRESS:PORT KEY",
              "keys forget NAME", "keys new NAME", "keys renew NAME", "keys trust FILE [--from DIR]"}),
       "keys of this user: who may connect, what signs packages, which marketplace is trusted",
       "Without a word, and with `list`: who may connect, who is known, which keys sign and what is trusted. `make` "
       "makes the pair, once; `show` prints the key that "
       "others are "
       "given. `allow` lets a host connect to those that --listen; with `as` it lets a console connect to those that "
       "--serve, and says what it may. `know` gives a host on another machine a name: fiona --at NAME. `new` makes a "
       "key "
       "that signs packages, named as their publisher; `renew` puts another in its place and signs all again; `trust` "
       "lets a marketplace be trusted by its root.json.",
       Access::Administer, verbs::keys, false},
      {"doctor", forms({"doctor"}), "looks for what keeps fiona from working on this machine, and says what mends it",
       "Exit code 1 where something is wrong.", Access::Observe, verbs::doctor},
      {"paths", forms({"paths"}), "where sockets, store, marketplace, keys and history are, and what sets that", "",
       Access::Observe, verbs::paths},
      {"complete", forms({"complete LINE"}), "what could stand next in a line, one candidate a line",
       "For shells: each but the last word is typed already. The scripts for bash, zsh and fish are installed with "
       "fiona.",
       Access::Observe, verbs::complete, false, true},
      {"help", forms({"help [VERB|exit|grammar|patterns]"}), "this, or one verb in full", "", Access::Observe,
       verbs::help},
      {"version", forms({"version"}), "the versions of console and host", "", Access::Observe, verbs::version},
  };
}

std::vector<OptionSlot> global_slots() {
  std::vector<OptionSlot> slots;
  for (const GlobalOption& option : global_options()) slots.push_back(option.slot);
  return slots;
}

std::size_t matched_literals(const WordLine& words, const Shape& shape) {
  if (words.items.size() < 2 || shape.positional().empty() || words.items[1].name) return 0;
  const Slot& first = shape.positional().front();
  return first.placeholder().empty() && first.accepts(words.items[1].word) ? 1 : 0;
}

}  // namespace

const std::vector<Verb>& verb_rows() {
  static const std::vector<Verb> kVerbs = [] {
    std::vector<Verb> all;
    for (auto part : {composing_verbs(), transaction_verbs(), operating_verbs(), seeing_verbs(), file_verbs(),
                      waiting_verbs(), remaining_verbs()}) {
      all.insert(all.end(), part.begin(), part.end());
    }
    return all;
  }();
  return kVerbs;
}

const Verb* find_verb(std::string_view name) {
  const auto found =
      std::find_if(verb_rows().begin(), verb_rows().end(), [name](const Verb& verb) { return verb.name == name; });
  return found == verb_rows().end() ? nullptr : &*found;
}

const std::vector<GlobalOption>& global_options() {
  static const std::vector<GlobalOption> kOptions{
      {{"--at", {{"ENDPOINT"}, false, false}},
       "the host to speak to: unix:PATH, ADDRESS:PORT=KEY, or a name of `keys know`"},
      {{"--control", {}}, "over tcp: all that the key of this console may there; without it, observe"},
      {{"--host", {{"NAME"}, false, false}}, "the host to speak to, by its name"},
      {{"--store", {{"DIR"}, false, false}}, "where packages are installed"},
      {{"--timeout", {{"T"}, false, false}}, "how long the host may take to answer, 2s"},
      {{"--json", {}}, "one JSON object a line"},
      {{"-q", {}}, "no confirmations"},
      {{"-v", {}}, "more detail"},
  };
  return kOptions;
}

Line read_line(const WordLine& words) {
  static const std::vector<OptionSlot> kGlobal = global_slots();
  const Word& name = words.items.front().word;
  if (words.items.front().name)
    throw LineError(words, words.items.front().name->place, {.what = "a line begins with a verb", .next = "help"});
  const Verb* verb = name.kind == WordKind::Plain ? find_verb(name.text) : nullptr;
  if (verb == nullptr) {
    std::vector<std::string> known;
    for (const Verb& row : verb_rows()) known.push_back(row.name);
    throw LineError(words, name.place,
                    {.what = fmt::format("there is no verb '{}'", name.text),
                     .next = name.text == "exit" ? "Ctrl-D leaves the prompt; quit ends the host" : "help",
                     .near = nearest_names(name.text, known)});
  }
  if (verb->takes_line) {
    Line line;
    line.words = words;
    line.verb = name;
    return line;
  }
  // The form whose literal word stands in the line is meant; otherwise the first that takes a word of any meaning.
  const auto literal = std::find_if(verb->forms.begin(), verb->forms.end(),
                                    [&words](const Shape& shape) { return matched_literals(words, shape) > 0; });
  if (literal != verb->forms.end()) return bind(words, *literal, kGlobal);
  const auto open = std::find_if(verb->forms.begin(), verb->forms.end(), [](const Shape& shape) {
    return shape.positional().empty() || !shape.positional().front().placeholder().empty();
  });
  if (open != verb->forms.end() || verb->forms.size() == 1)
    return bind(words, open == verb->forms.end() ? verb->forms.front() : *open, kGlobal);
  std::vector<std::string> known;
  for (const Shape& shape : verb->forms) known.push_back(shape.positional().front().choices.front());
  const bool any = words.items.size() > 1;
  const Word& second = any ? words.items[1].word : name;
  throw LineError(words, second.place,
                  {.what = any ? fmt::format("{} cannot '{}'", name.text, second.text)
                               : fmt::format("{} needs one more word", name.text),
                   .expected = fmt::format("{}", fmt::join(known, ", ")),
                   .next = fmt::format("help {}", name.text),
                   .near = nearest_names(second.text, known)});
}

}  // namespace fiona::console
