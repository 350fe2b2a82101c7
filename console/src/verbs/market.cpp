// The only verb that changes a store. What it finds is in market_search.cpp.
#include <algorithm>
#include <ctime>
#include <map>
#include <set>

#include <fmt/chrono.h>
#include <fmt/format.h>
#include <fmt/ranges.h>
#include <fiona/marketplace/install.hpp>
#include <fiona/marketplace/lock.hpp>
#include <fiona/marketplace/open.hpp>

#include "../catalogue.hpp"
#include "../script.hpp"
#include "../system_view.hpp"
#include "market.hpp"
#include "market_keep.hpp"
#include "verbs.hpp"

namespace fiona::console::verbs {
namespace {

using marketplace::Marketplace;
using marketplace::Marketplaces;
using marketplace::Plan;
using marketplace::PlanStep;
using marketplace::StepKind;
using marketplace::Store;

/// Others may change the store while somebody thinks about a plan.
constexpr int kMostPlans = 5;

Store chosen_store(const Session& session) {
  return Store(session.options.store.empty() ? Store::default_directory() : session.options.store);
}

std::optional<Store> unsigned_store(Session& session) {
  const auto directory = session.unsigned_packages();
  if (directory.empty()) return std::nullopt;
  return Store(directory, Store::Kind::Unsigned);
}

std::vector<std::string> names_in(const Line& line) {
  std::vector<std::string> names;
  for (std::size_t i = 1; i < line.positional.size(); ++i) names.push_back(line.positional[i].text);
  return names;
}

/// "install", "instead of 1.0.0": what a step does, for a plan.
std::string step_text(const PlanStep& step) {
  switch (step.kind) {
    case StepKind::Install: return "install";
    case StepKind::Upgrade: return "instead of " + step.previous_version;
    case StepKind::Downgrade: return "back from " + step.previous_version;
    case StepKind::Replace: return "other content";
    case StepKind::Repair: return "repair";
    case StepKind::Remove: return "remove";
  }
  return "";
}

std::string done_text(const PlanStep& step) {
  const std::string package = fmt::format("{} {}", step.package, step.version);
  switch (step.kind) {
    case StepKind::Install: return "installed " + package;
    case StepKind::Upgrade:
    case StepKind::Downgrade:
    case StepKind::Replace: return fmt::format("installed {} in place of {}", package, step.previous_version);
    case StepKind::Repair: return "repaired " + package;
    case StepKind::Remove: return "removed " + package;
  }
  return package;
}

std::string rights_text(const std::vector<std::string>& rights) {
  std::vector<std::string> texts;
  for (const std::string& right : rights) texts.push_back(right_text(right));
  return fmt::format("{}", fmt::join(texts, "; "));
}

/// Who is behind the name of a publisher, where that is new here.
std::string publisher_text(const std::string& publisher, const PlanStep& step) {
  const std::string keys = fmt::format("{}", fmt::join(step.new_keys, ", "));
  if (step.new_publisher && keys.empty()) return fmt::format("nothing of the publisher {} is installed yet", publisher);
  if (step.new_publisher)
    return fmt::format("nothing of the publisher {} is installed yet; its key: {}", publisher, keys);
  if (step.known_keys.empty())
    return fmt::format("the publisher {} signs with a key that is new here: {}", publisher, keys);
  return fmt::format("the publisher {} signs with another key than what is installed: {}\n  before: {}", publisher,
                     keys, fmt::join(step.known_keys, ", "));
}

/// What is asked for, in words: why a package comes, which rights, whose it is.
void show_plan(Session& session, const Plan& plan) {
  Table table({"package", "version", "does", "because", "rights"});
  table.leave_out_if_empty("because");
  for (const PlanStep& step : plan.steps) {
    table.add({step.package, step.version, step_text(step), step.because, {rights_text(step.rights), step.rights}});
  }
  session.out.table(table, "");
  for (const PlanStep& step : plan.steps) {
    if (!step.previous_version.empty() && !step.new_rights.empty())
      session.out.text(fmt::format("{} {} asks for more than {}: {}", step.package, step.version, step.previous_version,
                                   rights_text(step.new_rights)));
  }
  std::set<std::string> told;
  for (const PlanStep& step : plan.steps) {
    const std::string publisher = step.package.substr(0, step.package.find('/'));
    if ((step.new_publisher || !step.new_keys.empty()) && told.insert(publisher).second)
      session.out.text(publisher_text(publisher, step));
  }
}

/// Lines that install who provides a service: from the marketplace that was asked, else from the user's own.
std::string providing_lines(const marketplace::MissingService& missing, const Marketplace* market) {
  std::vector<std::string> packages = missing.providers;
  std::string option = market == nullptr ? "" : market->option();
  if (packages.empty() && !option.empty()) {
    option.clear();
    try {
      marketplace::OpenOptions without_network;
      without_network.ask_network = false;
      for (const IndexEntry& entry : marketplace::open_marketplace("", without_network).providers_of(missing.service))
        packages.push_back(marketplace::full_name(entry.manifest()));
    } catch (const Error&) {
      // There is none, or it cannot be read: nothing was asked of it.
    }
  }
  if (packages.empty()) return "; no package of the marketplace does either";
  return fmt::format(": market install {}{}", fmt::join(packages, ", or "), option);
}

/// What else there is to say, done or not.
void remark(Session& session, const Plan& plan, const Marketplace* market) {
  for (const std::string& note : plan.notes) session.out.remark(note);
  for (const auto& missing : plan.missing) {
    session.out.remark(fmt::format("{} requires {}, which nothing installed provides{}", missing.port,
                                   short_name(missing.service), providing_lines(missing, market)));
  }
}

/// Throws Error where it may not be done. A plan that is what was typed and no more needs no question.
void require_consent(Session& session, const Line& line, const Plan& plan, bool ask_always) {
  if (line.has("-y") || (!plan.needs_consent() && !ask_always)) return;
  show_plan(session, plan);
  require_yes(session, line, "Do this?", "nothing was changed",
              {.what = fmt::format("{} does more than was typed, and nobody is here to agree", plan.change),
               .next = "the same line with -y, if that is meant"});
}

void tell_done(Session& session, const Plan& plan) {
  for (const PlanStep& step : plan.steps) {
    session.out.done(done_text(step), {{"package", step.package},
                                       {"version", step.version},
                                       {"previous", step.previous_version},
                                       {"because", step.because}});
    if (step.kind != StepKind::Install || !step.entry) continue;
    for (const std::string& shown : split_lines(step.entry->manifest().try_())) session.out.remark("  try: " + shown);
  }
}

/// A running system goes on with what it has loaded. The change is made, whether or not that system can be asked.
void tell_running(Session& session, const Plan& plan) try {
  const bool replaces = std::any_of(plan.steps.begin(), plan.steps.end(), [](const PlanStep& step) {
    return step.kind != StepKind::Install && step.kind != StepKind::Remove && step.kind != StepKind::Repair;
  });
  if (!replaces || session.host_if_running() == nullptr) return;
  const control::System system = session.snapshot();
  for (const auto& instance : system.instances()) {
    const auto is_its = [&](const PlanStep& step) {
      return step.package == instance.plugin() && step.version != instance.version() && step.kind != StepKind::Remove;
    };
    if (std::any_of(plan.steps.begin(), plan.steps.end(), is_its))
      session.out.remark(fmt::format("{} runs {} {}: upgrade {}", instance.name(), instance.plugin(),
                                     instance.version(), instance.name()));
  }
} catch (const Error& error) {
  session.out.remark("what runs could not be asked for its versions: " + error.text().what);
}

void tell_unchanged(Session& session, const Plan& plan, const Store& store) {
  for (const std::string& name : plan.asked) {
    const auto steps = [&name](const PlanStep& step) { return step.package == name; };
    if (std::any_of(plan.steps.begin(), plan.steps.end(), steps)) continue;
    const std::string version = store.find(name).manifest.version();
    session.out.done(fmt::format("{} {} is installed already", name, version),
                     {{"package", name}, {"version", version}});
  }
  if (plan.rollback_to != 0)
    session.out.done(fmt::format("back to generation {}", plan.rollback_to), {{"generation", plan.rollback_to}});
  else if (plan.asked.empty() && plan.steps.empty())
    session.out.done(fmt::format("'{}' changes nothing", plan.change));
}

/// Plans, asks and does; again where the store has changed meanwhile.
template <class Make>
void carry_out(Session& session, const Line& line, const Marketplaces& from, bool ask_always, const Make& make) {
  const Marketplace* market = from.empty() ? nullptr : from.front();
  const Store store = chosen_store(session);
  marketplace::InstallOptions options;
  options.on_wait = [&session](const std::string& who) { session.out.remark(fmt::format("waiting for {}", who)); };
  for (int attempt = 0; attempt < kMostPlans; ++attempt) {
    const Plan plan = make(store);
    if (session.planning) {
      show_plan(session, plan);
      remark(session, plan, market);
      if (plan.steps.empty()) session.out.text(fmt::format("'{}' changes nothing", plan.change));
      return;
    }
    require_consent(session, line, plan, ask_always);
    if (!marketplace::apply(plan, from, store.directory(), options)) continue;
    tell_done(session, plan);
    tell_running(session, plan);
    tell_unchanged(session, plan, store);
    return remark(session, plan, market);
  }
  throw Error(ErrorCode::Unreachable, {.what = "others change this store all the time",
                                       .where = store.directory().string(),
                                       .next = "try again when they have ended"});
}

/// A lock names a marketplace with each package: what the user's own has not, to the byte, is asked for there.
std::vector<Marketplace> locked_markets(Session& session, const Line& line, const fiona::Lock& lock) {
  std::vector<Marketplace> markets{chosen_market(session, line)};
  if (line.option("--from") != nullptr) return markets;
  const fiona::Lock own = marketplace::part_of(lock, markets.front());
  const auto installed = chosen_store(session).installed();
  std::set<std::string> others;
  for (const auto& locked : lock.packages()) {
    const auto is_it = [&locked](const auto& one) { return one.blake2b() == locked.blake2b(); };
    const auto is_there = [&locked](const auto& one) { return one.directory.filename() == locked.blake2b(); };
    if (std::any_of(own.packages().begin(), own.packages().end(), is_it)) continue;
    if (std::any_of(installed.begin(), installed.end(), is_there)) continue;
    // Of the user's own the plan says what is not there.
    if (locked.marketplace() != markets.front().source()) others.insert(locked.marketplace());
  }
  for (const auto& place : others) markets.push_back(opened_market(session, place));
  return markets;
}

void install_locked(Session& session, const Line& line, const std::string& file) {
  const fiona::Lock lock = marketplace::read_lock(file);
  const std::vector<Marketplace> markets = locked_markets(session, line, lock);
  Marketplaces from;
  for (const auto& market : markets) from.push_back(&market);
  carry_out(session, line, from, false,
            [&](const Store& store) { return marketplace::plan_locked(lock, from, store); });
}

void install(Session& session, const Line& line) {
  const std::vector<std::string> names = names_in(line);
  const Word* locked = line.option("--locked");
  if ((locked != nullptr) == !names.empty())
    throw line.error(line.verb, {.what = locked != nullptr ? "a lock names its packages itself" : "no package is named",
                                 .expected = "market install PACKAGE …, or market install --locked FILE"});
  if (locked != nullptr) return install_locked(session, line, locked->text);
  const Marketplace market = chosen_market(session, line);
  carry_out(session, line, {&market}, false,
            [&](const Store& store) { return marketplace::plan_install(names, market, store); });
}

/// What came from where, of what is named or of all.
std::map<std::string, std::vector<std::string>> by_source(const Store& store, const std::vector<std::string>& names) {
  std::map<std::string, std::vector<std::string>> sources;
  for (const std::string& name : names) {
    const auto package = store.find(name);
    sources[package.source].push_back(package.name());
  }
  if (!names.empty()) return sources;
  for (const auto& package : store.installed()) sources[package.source].push_back(package.name());
  return sources;
}

struct UpdatePart {
  Marketplace market;
  std::vector<std::string> packages;  ///< none: all
};

void update_part(Session& session, const Line& line, const UpdatePart& part) {
  carry_out(session, line, {&part.market}, false, [&](const Store& store) {
    Plan plan = marketplace::plan_update(part.packages, part.market, store);
    const bool all = line.positional.size() == 1;
    if (line.option("--from") == nullptr) plan.change = (all ? "update" : plan.change) + part.market.option();
    return plan;
  });
}

/// The user's own is asked for all, each other for what came from there. What came from one that cannot be asked, or
/// from which nothing may be taken, stays as it is, and that is a failure.
void update(Session& session, const Line& line) {
  auto sources = by_source(chosen_store(session), names_in(line));
  sources.erase(Marketplace::default_directory().string());
  if (line.option("--from") != nullptr || sources.empty())
    return update_part(session, line, {chosen_market(session, line), names_in(line)});
  std::vector<UpdatePart> parts;
  std::vector<ErrorCode> failed;
  const auto try_to = [&](const std::function<void()>& what) {
    try {
      what();
    } catch (const Error& error) {
      session.out.error(error);
      failed.push_back(error.code());
    }
  };
  try_to([&] { parts.push_back({opened_market(session, ""), names_in(line)}); });
  for (const auto& [source, packages] : sources) {
    if (!parts.empty() && parts.front().market.source() == source) continue;
    try_to([&, &place = source, &wanted = packages] { parts.push_back({opened_market(session, place), wanted}); });
  }
  const std::size_t all = parts.size() + failed.size();
  for (const UpdatePart& part : parts) try_to([&] { update_part(session, line, part); });
  if (failed.empty()) return;
  throw Error(failed.front(),
              {.what = fmt::format("from {} of {} marketplaces nothing was taken: what came from there stays as it is",
                                   failed.size(), all),
               .next = "market list says what came from where; then market update again"});
}

/// The instances of the running host that a package's plugin has made.
std::vector<std::string> instances_of(Session& session, const std::vector<std::string>& packages) {
  std::vector<std::string> names;
  if (session.host_if_running() == nullptr) return names;
  const control::System system = session.snapshot();
  for (const auto& instance : system.instances()) {
    if (std::find(packages.begin(), packages.end(), instance.plugin()) != packages.end())
      names.push_back(fmt::format("{} ({})", instance.name(), instance.plugin()));
  }
  return names;
}

void remove(Session& session, const Line& line) {
  const Plan first = marketplace::plan_remove(names_in(line), chosen_store(session));
  std::vector<std::string> packages;
  for (const PlanStep& step : first.steps) packages.push_back(step.package);
  const std::vector<std::string> running = instances_of(session, packages);
  if (!running.empty() && !session.planning)
    session.out.warning(
        fmt::format("the running system uses it, and goes on with it until it ends: {}", fmt::join(running, ", ")));
  carry_out(session, line, {}, !running.empty(),
            [&](const Store& store) { return marketplace::plan_remove(names_in(line), store); });
}

void rollback(Session& session, const Line& line) {
  std::optional<std::uint64_t> generation;
  if (line.positional.size() > 1) generation = count_of(line.positional[1], line.words);
  carry_out(session, line, {}, false,
            [&](const Store& store) { return marketplace::plan_rollback(generation, store); });
}

std::string time_text(std::int64_t time_s) {
  const std::time_t seconds = time_s;
  std::tm local{};
  ::localtime_r(&seconds, &local);
  return fmt::format("{:%Y-%m-%d %H:%M:%S}", local);
}

void history(Session& session, const Line&) {
  Table table({"generation", "time", "packages", "change", "state"});
  for (const marketplace::Generation& one : chosen_store(session).history()) {
    table.add({{fmt::format("{}", one.number), one.number},
               {one.time_s == 0 ? "" : time_text(one.time_s), one.time_s},
               {fmt::format("{}", one.packages), one.packages},
               one.change,
               one.present ? "present" : one.fault});
  }
  session.out.table(table, "nothing has been installed yet");
}

void list(Session& session, const Line&) {
  Table table({"package", "version", "came", "from", "state"});
  table.leave_out_if_empty("state");
  const Store store = chosen_store(session);
  for (const auto& package : store.installed()) {
    const auto revoked = store.revocation(package);
    table.add({package.name(), package.manifest.version(), package.as_requirement ? "as requirement" : "asked for",
               package.source, revoked ? "revoked: " + revoked->reason() : ""});
  }
  if (const auto unsigned_packages = unsigned_store(session)) {
    for (const auto& package : unsigned_packages->installed())
      table.add({package.name(), package.manifest.version(), "with --unsigned", package.source, "unsigned"});
  }
  session.out.table(table, "nothing is installed");
}

void verify(Session& session, const Line&) {
  const Store store = chosen_store(session);
  std::size_t damaged = 0;
  const auto packages = store.installed();
  for (const auto& package : packages) {
    try {
      store.verify(package);
    } catch (const Error& error) {
      ++damaged;
      session.out.error(error);
    }
  }
  if (damaged > 0)
    throw Error(ErrorCode::BadSignature,
                {.what = fmt::format("{} of {} packages are damaged", damaged, packages.size()),
                 .where = store.directory().string(),
                 .next = "market install NAME@VERSION repairs one"});
  session.out.done(fmt::format("{} packages, all as they were installed", packages.size()),
                   {{"packages", packages.size()}});
}

/// The installed package of what stands after `load`: publisher/name, name, or either with /component behind it.
std::string package_of(const std::string& plugin, const Store& store) {
  const auto installed = store.installed();
  for (std::string name = plugin; !name.empty();
       name.resize(name.rfind('/') == std::string::npos ? 0 : name.rfind('/'))) {
    for (const auto& package : installed) {
      if (package.name() == name || package.manifest.name() == name) return store.find(name).name();
    }
  }
  return store.find(plugin).name();  // which says that there is none
}

/// The packages that a system file loads.
std::vector<std::string> loaded_by(const std::string& file, const Store& store) {
  std::vector<std::string> packages;
  for (const Line& line : read_script(file)) {
    if (line.verb.text != "load") continue;
    const Word& plugin = line.positional[0];
    if (!marketplace::library_path(plugin.text).empty()) continue;
    try {
      packages.push_back(package_of(plugin.text, store));
    } catch (const Error& error) {
      throw LineError(line.words, plugin.place, error.text(), error.code());
    }
  }
  return packages;
}

void lock(Session& session, const Line& line) {
  const Store store = chosen_store(session);
  std::filesystem::path target = "fiona.lock";
  std::optional<std::vector<std::string>> packages;
  if (line.positional.size() > 1) {
    const std::filesystem::path file = system_path(line.positional[1].text, session.options.store);
    packages = loaded_by(file.string(), store);
    if (file == line.positional[1].text) target = file.parent_path() / target;
  }
  const fiona::Lock made = marketplace::make_lock(store, packages);
  marketplace::write_lock(target, made);
  session.out.done(fmt::format("locked {} packages in {}", made.packages_size(), target.string()),
                   {{"packages", made.packages_size()}, {"file", target.string()}});
}

/// What runs of packages that have been revoked. That is told once: a host that cannot be asked must not keep the rest.
void tell_revoked(Session& session, const std::vector<std::string>& packages) {
  if (packages.empty()) return;
  try {
    if (const auto running = instances_of(session, packages); !running.empty())
      session.out.warning(fmt::format("it still runs: {}\n  next: unload", fmt::join(running, ", ")));
  } catch (const Error& problem) {
    session.out.warning(fmt::format(
        "whether it still runs is not known: {}\n  next: fiona --host NAME ls, of each host", problem.text().what));
  }
}

}  // namespace

marketplace::Marketplace chosen_market(Session& session, const Line& line) {
  const Word* from = line.option("--from");
  return opened_market(session, from == nullptr ? "" : from->text);
}

marketplace::Marketplace opened_market(Session& session, const std::string& place) {
  marketplace::Marketplace market = marketplace::open_marketplace(place);
  if (market.left_out() > 0)
    session.out.remark(fmt::format("the index of {} has {} part{} that this version of FIONA does not understand",
                                   market.source(), market.left_out(), market.left_out() == 1 ? "" : "s"));
  const Store store = chosen_store(session);
  std::vector<std::string> packages;
  for (const auto& revoked : marketplace::note_revocations(market, store.directory())) {
    session.out.warning(
        fmt::format("{} {}, which is installed, has been revoked{}; it is not started any more\n  next: "
                    "market update {}, or market remove {}",
                    revoked.package(), revoked.version(), revoked.reason().empty() ? "" : ": " + revoked.reason(),
                    revoked.package(), revoked.package()));
    packages.push_back(revoked.package());
  }
  tell_revoked(session, packages);
  return market;
}

void require_yes(Session& session, const Line& line, const std::string& question, const std::string& undone,
                 ErrorText nobody) {
  const std::optional<bool> answer = session.ask ? session.ask(question + " (yes/no) ") : std::nullopt;
  if (!answer) throw line.error(line.verb, std::move(nobody), ErrorCode::NotAllowed);
  if (!*answer)
    throw line.error(line.verb, {.what = undone + ": you said no", .next = "the same line, should it be done"},
                     ErrorCode::Failed);
}

std::string right_text(const std::string& right) {
  if (right == "master") return "changes the running system (master)";
  if (right == "network") return "speaks to the network (network)";
  if (right.starts_with("device:")) return fmt::format("uses the device {} ({})", right.substr(7), right);
  if (right.starts_with("system-bus:"))
    return fmt::format("talks to {} on the system's D-Bus ({})", right.substr(11), right);
  if (right.starts_with("session-bus:"))
    return fmt::format("talks to {} on your session's D-Bus ({})", right.substr(12), right);
  const std::string where = right.ends_with('/') ? "what it is granted in " : "";
  if (right.starts_with("read:")) return fmt::format("reads {}{} ({})", where, right.substr(5), right);
  if (right.starts_with("write:")) return fmt::format("reads and writes {}{} ({})", where, right.substr(6), right);
  return right;
}

void market(Session& session, const Line& line) {
  static const std::map<std::string, void (*)(Session&, const Line&)> kActions{
      {"search", market_search}, {"info", market_info},
      {"install", install},      {"update", update},
      {"remove", remove},        {"rollback", rollback},
      {"history", history},      {"list", list},
      {"verify", verify},        {"lock", lock},
      {"init", market_init},     {"publish", market_publish},
      {"accept", market_accept}, {"revoke", market_revoke},
      {"keys", market_keys},     {"rotate", market_rotate},
      {"sign", market_sign}};
  kActions.at(line.positional[0].text)(session, line);
}

}  // namespace fiona::console::verbs
