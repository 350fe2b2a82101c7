// The author's side: a new plugin, what one declares, what keeps it from being published, the package and who signs.
#include "plugin.hpp"

#include <algorithm>
#include <cstdlib>
#include <fstream>
#include <map>

#include <unistd.h>

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <fiona/marketplace/compiled_protos.hpp>
#include <fiona/marketplace/keeper.hpp>
#include <fiona/marketplace/manifest.hpp>
#include <fiona/marketplace/package.hpp>

#include "../author/plugin_check.hpp"
#include "../author/plugin_template.hpp"
#include "../catalogue.hpp"
#include "../system_view.hpp"
#include "interface_view.hpp"
#include "verbs.hpp"

namespace fiona::console::verbs {
namespace {

namespace fs = std::filesystem;
using google::protobuf::ServiceDescriptor;

/// Of the installed packages of messages: whose service it is, with the types that it is among.
struct MessagesService {
  marketplace::InstalledPackage package;
  std::shared_ptr<const TypeSet> types;
  const ServiceDescriptor* service;
};

std::optional<MessagesService> messages_service(const Session& session, const std::string& typed) {
  for (const auto& package : store_of(session).installed()) {
    if (package.manifest.kind() != fiona::MESSAGES) continue;
    const fiona::Interface interface = package.interface();
    const auto types = std::make_shared<const TypeSet>(interface.descriptors());
    for (const auto& file : interface.descriptors().file()) {
      for (const auto& service : file.service()) {
        const std::string name = file.package() + "." + service.name();
        if (name == typed || service.name() == typed) return MessagesService{package, types, types->service(name)};
      }
    }
  }
  return std::nullopt;
}

const ServiceDescriptor* typed_service(Session& session, const Line& line, const Word& typed, NewPlugin& plugin) {
  std::vector<std::string> known;
  for (const ServiceDescriptor* service : platform_services()) {
    if (service->full_name() == typed.text || service->name() == typed.text) return service;
    known.push_back(service->name());
  }
  if (auto found = messages_service(session, typed.text)) {
    plugin.messages[found->package.name()] = found->package.manifest.version();
    plugin.types.push_back(found->types);
    return found->service;
  }
  const Catalogue catalogue(session.options.store);
  for (const KnownPlugin& other : catalogue.plugins()) {
    for (const auto& component : other.interface.components()) {
      for (const auto& port : component.ports()) {
        if (port.service() != typed.text && short_name(port.service()) != typed.text) continue;
        throw line.error(typed, {.what = fmt::format("the service '{}' is not one of the platform's", typed.text),
                                 .found = fmt::format("{} has it, and brings its proto itself", other.name()),
                                 .next = "make the plugin without it, and add its proto to PROTOS in CMakeLists.txt"});
      }
    }
  }
  throw line.error(typed,
                   {.what = fmt::format("there is no service '{}'", typed.text),
                    .next = "a service of your own is declared in the plugin's proto: docs/patterns.md",
                    .near = nearest_names(typed.text, known)},
                   ErrorCode::NotFound);
}

std::vector<const ServiceDescriptor*> typed_services(Session& session, const Line& line, const std::string& option,
                                                     NewPlugin& plugin) {
  std::vector<const ServiceDescriptor*> services;
  const auto [begin, end] = line.options.equal_range(option);
  for (auto given = begin; given != end; ++given)
    services.push_back(typed_service(session, line, given->second.value, plugin));
  return services;
}

void check_plugin_name(const Line& line, const Word& word, const std::string& text, std::string_view what) {
  const std::string fault = plugin_name_fault(text);
  if (fault.empty()) return;
  throw line.error(word, {.what = fmt::format("a {} cannot be called '{}': it {}", what, text, fault),
                          .expected = "a name like step-counter",
                          .next = "choose another name"});
}

std::string publisher_of(const Line& line) {
  if (const Word* typed = line.option("--publisher")) {
    check_plugin_name(line, *typed, typed->text, "publisher");
    if (marketplace::is_publisher(typed->text)) return typed->text;
    throw line.error(*typed,
                     {.what = fmt::format("'{}' has a meaning of its own, and nobody can publish by it", typed->text),
                      .next = "choose another name"});
  }
  const char* user = std::getenv("USER");
  if (user != nullptr && plugin_name_fault(user).empty() && marketplace::is_publisher(user)) return user;
  throw line.error(line.verb, {.what = "nobody knows who publishes the plugin",
                               .next = fmt::format("plugin new {} --publisher NAME", line.positional[1].text)});
}

/// All files or none: they come into the folder's place at once.
void write_folder(const Line& line, const Word& word, const fs::path& folder,
                  const std::map<fs::path, std::string>& files) {
  std::error_code problem;
  if (fs::exists(fs::symlink_status(folder, problem)))
    throw line.error(word,
                     {.what = fmt::format("there is a '{}' already", folder.string()),
                      .next = "name another folder, or take that one away"},
                     ErrorCode::Failed);
  const fs::path staging = folder.parent_path() / fmt::format(".{}.{}", folder.filename().string(), ::getpid());
  bool written = true;
  for (const auto& [path, text] : files) {
    fs::create_directories((staging / path).parent_path(), problem);
    std::ofstream out(staging / path, std::ios::binary | std::ios::trunc);
    out << text;
    out.close();
    written = written && out.good();
  }
  if (written) fs::rename(staging, folder, problem);
  if (written && !problem) return;
  std::error_code ignored;
  fs::remove_all(staging, ignored);
  throw Error(ErrorCode::Failed, {.what = fmt::format("the plugin cannot be written: {}",
                                                      problem ? problem.message() : "a file is not complete"),
                                  .where = folder.string(),
                                  .next = "look at the folder above it: doctor"});
}

void plugin_new(Session& session, const Line& line) {
  const Word& name = line.positional[1];
  check_plugin_name(line, name, name.text, "plugin");
  NewPlugin plugin{.publisher = publisher_of(line), .name = name.text};
  plugin.provided = typed_services(session, line, "--provides", plugin);
  plugin.needed = typed_services(session, line, "--requires", plugin);
  if (const Word* kind = line.argument("kind")) {
    plugin.kind = kind->text;
    if (plugin.kind != "plugin" && plugin.kind != "messages" && plugin.kind != "system")
      throw line.error(*kind, {.what = fmt::format("there is no kind of package that is called '{}'", kind->text),
                               .expected = "plugin, messages or system"});
    if (plugin.kind != "plugin" && !(plugin.provided.empty() && plugin.needed.empty()))
      throw line.error(*kind, {.what = fmt::format("a package of kind {} has no ports", plugin.kind),
                               .next = "leave --provides and --requires out, or the kind"});
  }
  const bool named = line.positional.size() > 2;
  fs::path folder = fs::absolute(named ? line.positional[2].text : name.text).lexically_normal();
  if (!folder.has_filename()) folder = folder.parent_path();
  write_folder(line, named ? line.positional[2] : name, folder, new_plugin_files(plugin));
  const std::string shown = named ? line.positional[2].text : name.text;
  session.out.done(fmt::format("made {}/{} in {}", plugin.publisher, plugin.name, shown),
                   {{"plugin", plugin.publisher + "/" + plugin.name}, {"folder", folder.string()}});
  session.out.remark(fmt::format("  next: plugin {} {}", plugin.kind == "system" ? "check" : "test", shown));
}

void show_inner_side(Session& session, const fiona::ComponentInterface& component) {
  Table modes({"mode", "activities"});
  for (const auto& mode : component.modes())
    modes.add({mode.name(), fmt::format("{}", fmt::join(mode.activities(), ", "))});
  if (!modes.empty()) session.out.text(fmt::format("\nmodes of {}", component.name()));
  session.out.table(modes, "");
  Table tasks({"task", "starts", "activity"});
  for (const auto& task : component.tasks()) {
    const std::string starts = task.start() == fiona::PERIODIC     ? fmt::format("every {} ms", task.period_ms())
                               : task.start() == fiona::ON_PORT    ? fmt::format("on {}", task.of())
                               : task.start() == fiona::AFTER_TASK ? fmt::format("after {}", task.of())
                                                                   : "runs all the time";
    tasks.add({task.name(), starts, task.activity()});
  }
  if (!tasks.empty()) session.out.text(fmt::format("\ntasks of {}", component.name()));
  session.out.table(tasks, "");
  Table more({"name", "kind", "type", "unit", "doc"});
  for (const auto& probe : component.probes())
    more.add({probe.name(), "probe", probe.type(), probe.unit(), probe.doc()});
  for (const auto& trigger : component.triggers())
    more.add({trigger.name(), "trigger", trigger.argument(), "", trigger.doc()});
  if (!more.empty()) session.out.text(fmt::format("\nprobes and triggers of {}", component.name()));
  session.out.table(more, "");
}

void plugin_describe(Session& session, const Line& line) {
  const fs::path library = line.positional[1].text;
  PluginFiles files = files_of_library(library);
  find_messages(files, store_of(session));
  const Described described = describe_library(session.reactor, files, confinement_of(line));
  if (const Word* out = line.option("-o")) {
    std::ofstream file(out->text, std::ios::binary | std::ios::trunc);
    file << described.text;
    file.close();
    if (!file)
      throw line.error(*out,
                       {.what = "the interface cannot be written",
                        .where = out->text,
                        .expected = "a folder that exists, may be written, and has room"},
                       ErrorCode::Failed);
    return session.out.done(fmt::format("described {} in {}", library.string(), out->text), {{"file", out->text}});
  }
  Table facts({"fact", "value"});
  facts.add({"library", library.string()});
  facts.add({"abi", described.interface.abi()});
  for (const auto& file : described.interface.descriptors().file()) facts.add({"proto", file.name()});
  session.out.table(facts, "", false);
  const TypeSet types(described.interface.descriptors());
  for (const auto& component : described.interface.components()) {
    show_component(session, component, types);
    show_inner_side(session, component);
  }
}

/// Tells all findings; the last one is thrown, and told by whoever ran this line.
void demand_sound(Session& session, const PluginCheck& check) {
  if (session.out.manner.verbose) {
    for (const std::string& passed : check.passed) session.out.text(fmt::format("ok  {}", passed));
  }
  for (std::size_t i = 0; i + 1 < check.findings.size(); ++i)
    session.out.error(Error(ErrorCode::Failed, check.findings[i]));
  if (!check.findings.empty()) throw Error(ErrorCode::Failed, check.findings.back());
}

void plugin_check(Session& session, const Line& line) {
  const fs::path what = typed_folder(line, 1);
  const ScratchDirectory unpacked;
  PluginFiles files = fs::is_directory(what)       ? files_of_folder(what)
                      : what.extension() == ".fpk" ? files_of_package(what, unpacked.path())
                                                   : files_of_library(what);
  find_messages(files, store_of(session));
  PluginCheck check = console::check_plugin(session.reactor, files, session.catalogue(), confinement_of(line));
  // Within a package a place is that of the package.
  for (ErrorText& finding : check.findings) {
    const std::string inside = unpacked.path().string() + "/";
    if (finding.where.starts_with(inside)) finding.where = what.string() + ":" + finding.where.substr(inside.size());
  }
  demand_sound(session, check);
  session.out.done(fmt::format("{}: {} checks, nothing to mend", check.name.empty() ? what.string() : check.name,
                               check.passed.size()),
                   {{"plugin", check.name}, {"checks", check.passed}});
}

/// The folder of a package's data: of a system, its file beside what else there is.
fs::path share_of(const PluginFiles& files, const fs::path& scratch) {
  if (files.system.empty() || !files.library.empty()) return files.share;
  fs::create_directory(scratch / "share");
  if (!files.share.empty()) fs::copy(files.share, scratch / "share", fs::copy_options::recursive);
  fs::copy_file(files.system, scratch / "share" / files.system.filename());
  return scratch / "share";
}

void plugin_pack(Session& session, const Line& line) {
  const fs::path folder = typed_folder(line, 1);
  if (has_library(kind_of(files_of_folder(folder)))) build_plugin(session, folder, build_deadline(line));
  PluginFiles files = files_of_folder(folder);
  find_messages(files, store_of(session));
  demand_sound(session, console::check_plugin(session.reactor, files, session.catalogue(), confinement_of(line)));
  const ScratchDirectory scratch;
  marketplace::PackageSource source;
  source.manifest = file_text(files.manifest);
  if (!files.interface.empty()) source.interface = file_text(files.interface);
  source.readme = file_text(files.readme);
  if (!files.library.empty()) source.libraries = {files.library};
  source.share = share_of(files, scratch.path());
  const Manifest manifest = marketplace::parse_manifest(source.manifest, files.manifest.string());
  const Word* typed = line.option("-o");
  const std::string file = typed != nullptr
                               ? typed->text
                               : fmt::format("{}-{}-{}.fpk", manifest.name(), manifest.version(),
                                             files.library.empty() ? "any" : marketplace::this_architecture());
  marketplace::pack_to(file, source);
  const auto size = fs::file_size(file);
  session.out.done(
      fmt::format("packed {} {} in {}, {} KiB", marketplace::full_name(manifest), manifest.version(), file,
                  size / 1024),
      {{"package", marketplace::full_name(manifest)}, {"version", manifest.version()}, {"file", file}, {"size", size}});
}

/// What the platform does not have and somebody's plugin can be compiled with: packages of messages.
void plugin_messages(Session& session, const Line& line) {
  const marketplace::Store store = store_of(session);
  const auto installed = store.installed();
  std::vector<marketplace::InstalledPackage> shown;
  if (line.positional.size() > 1) {
    const auto package = store.find(line.positional[1].text);
    if (package.manifest.kind() != fiona::MESSAGES)
      throw line.error(line.positional[1], {.what = fmt::format("{} is no package of messages", package.name()),
                                            .next = "plugin messages lists those that are installed"});
    shown = marketplace::messages_of(package.manifest, package.name(), installed);
    shown.push_back(package);
  } else {
    const auto is_messages = [](const auto& package) { return package.manifest.kind() == fiona::MESSAGES; };
    std::copy_if(installed.begin(), installed.end(), std::back_inserter(shown), is_messages);
  }
  Table table({"package", "version", "offers", "library", "protos", "list"});
  for (const auto& package : shown) {
    std::vector<std::string> offers;
    for (const auto& proto : package.manifest.offered()) offers.push_back(proto.name());
    table.add({package.name(),
               package.manifest.version(),
               fmt::format("{}", fmt::join(offers, ", ")),
               {package.library.filename().string(), package.library.string()},
               {(package.share / "proto").string(), (package.share / "proto").string()},
               {"", (store.directory() / "installed.textproto").string()}});
  }
  session.out.table(table, "no package of messages is installed: market search");
}

void plugin_sign(Session& session, const Line& line) {
  const Word* after = line.argument("after");
  for (std::size_t i = 1; i < line.positional.size(); ++i) {
    const fs::path role =
        marketplace::sign_package(line.positional[i].text, {}, after == nullptr ? fs::path() : fs::path(after->text));
    session.out.done(fmt::format("{} signs for {}", role.string(), line.positional[i].text),
                     {{"file", line.positional[i].text}, {"signed", role.string()}});
  }
}

void plugin_unsign(Session& session, const Line& line) {
  for (std::size_t i = 1; i < line.positional.size(); ++i) {
    const std::string& package = line.positional[i].text;
    marketplace::unsign_package(package);
    session.out.done(fmt::format("{} is not signed for any more", package), {{"package", package}});
  }
  session.out.remark(
      "  next: plugin sign FILE, of a package that is; where it was published, publishing that withdraws it");
}

}  // namespace

fs::path typed_folder(const Line& line, std::size_t at) {
  return line.positional.size() > at ? fs::path(line.positional[at].text) : fs::path(".");
}

fiona::PackageKind kind_of(const PluginFiles& files) {
  return marketplace::parse_manifest(file_text(files.manifest), files.manifest.string()).kind();
}

bool has_library(fiona::PackageKind kind) { return kind == fiona::PLUGIN || kind == fiona::MESSAGES; }

marketplace::Store store_of(const Session& session) {
  using marketplace::Store;
  // Other programs are told of it, which run elsewhere.
  return Store(fs::absolute(session.options.store.empty() ? Store::default_directory() : session.options.store));
}

Confinement confinement_of(const Line& line) {
  return line.clause("with") == nullptr ? Confinement::Sandbox : Confinement::None;
}

void plugin(Session& session, const Line& line) {
  static const std::map<std::string, void (*)(Session&, const Line&)> kActions{
      {"new", plugin_new},   {"describe", plugin_describe}, {"test", plugin_test},     {"check", plugin_check},
      {"pack", plugin_pack}, {"sign", plugin_sign},         {"unsign", plugin_unsign}, {"messages", plugin_messages}};
  kActions.at(line.positional[0].text)(session, line);
}

}  // namespace fiona::console::verbs
