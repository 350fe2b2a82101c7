#include "author/plugin_check.hpp"

#include <algorithm>
#include <array>
#include <functional>
#include <optional>
#include <regex>
#include <set>

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <fiona/abi.hpp>
#include <fiona/describe.hpp>
#include <fiona/marketplace/compiled_protos.hpp>
#include <fiona/marketplace/manifest.hpp>
#include <fiona/marketplace/requirement.hpp>
#include <fiona/messages.hpp>
#include <fiona/plugin.hpp>

#include "author/elf_library.hpp"
#include "grammar.hpp"
#include "script.hpp"
#include "system_check.hpp"
#include "system_view.hpp"
#include "types.hpp"
#include "verb_table.hpp"

#include "fiona/options.pb.h"

namespace fiona::console {
namespace {

namespace fs = std::filesystem;

constexpr std::size_t kMostSymbols = 8;

/// "manifest.textproto:7" of the first line that begins with a field; the file alone where none does.
std::string field_place(const fs::path& file, const std::string& text, const std::string& field) {
  std::size_t line = 1;
  for (std::size_t begin = 0; begin < text.size(); ++line) {
    const std::size_t end = std::min(text.find('\n', begin), text.size());
    const std::string_view here = std::string_view(text).substr(begin, end - begin);
    const std::size_t first = here.find_first_not_of(" \t");
    if (first != std::string_view::npos && here.substr(first).starts_with(field))
      return fmt::format("{}:{}", file.string(), line);
    begin = end + 1;
  }
  return file.string();
}

std::string underscored(std::string name) {
  std::replace(name.begin(), name.end(), '-', '_');
  return name;
}

class PluginChecker {
 public:
  PluginChecker(Reactor& reactor, const PluginFiles& files, const Catalogue& catalogue, Confinement confinement)
      : reactor_(reactor), files_(files), catalogue_(catalogue), confinement_(confinement) {}

  PluginCheck run() {
    if (!files_.manifest.empty()) look("manifest", [this] { check_manifest(); });
    if (!files_.readme.empty()) look("README", [this] { check_readme(); });
    if (!files_.protos.empty()) look("protos are the publisher's", [this] { check_proto_files(); });
    if (manifest_ && manifest_->kind() == fiona::SYSTEM) look("system file", [this] { check_system_file(); });
    if (files_.library.empty()) {
      if (manifest_ && (manifest_->kind() == fiona::PLUGIN || is_messages()))
        find({.what = "the plugin has not been built",
              .where = files_.manifest.parent_path().string(),
              .expected = "its library and interface in the folder build",
              .next = "plugin test"});
      return std::move(check_);
    }
    look("interface", [this] { check_interface(); });
    look("library", [this] { check_library(); });
    // Code that would not load does not say what it declares.
    if (check_.findings.empty()) look("interface is what the code declares", [this] { check_declared(); });
    return std::move(check_);
  }

 private:
  bool is_messages() const { return manifest_ && manifest_->kind() == fiona::MESSAGES; }
  void find(ErrorText text) { check_.findings.push_back(std::move(text)); }

  /// One part; what stops it is a finding too.
  void look(const std::string& what, const std::function<void()>& part) {
    const std::size_t before = check_.findings.size();
    try {
      part();
    } catch (const Error& error) {
      find(error.text());
    }
    if (check_.findings.size() == before) check_.passed.push_back(what);
  }

  void check_manifest() {
    const std::string text = file_text(files_.manifest);
    try {
      manifest_ = marketplace::parse_manifest(text, files_.manifest.string());
    } catch (const Error& error) {
      // Which field is wrong is the first word of the sentence, unless its place is known already.
      ErrorText told = error.text();
      const std::string field = told.what.substr(0, told.what.find(' '));
      if (told.where == files_.manifest.string()) told.where = field_place(files_.manifest, text, field + ":");
      if (told.next.empty()) told.next = "correct it, and plugin check again";
      return find(told);
    }
    check_.name = marketplace::full_name(*manifest_);
    if (files_.packed) marketplace::check_packed_manifest(*manifest_, files_.manifest.string());
    for (const std::string& right : manifest_->rights()) check_right(right, text);
    check_try(text);
  }

  void check_right(const std::string& right, const std::string& text) {
    if (right == "master" || marketplace::opens_sandbox(right)) return;
    static const std::vector<std::string> kKnown{"master",  "network",     "device:",     "read:/",
                                                 "write:/", "system-bus:", "session-bus:"};
    find({.what = fmt::format("'{}' is no right that a host knows", right),
          .where = field_place(files_.manifest, text, "rights:"),
          .expected = "\"network\", \"device:NAME\" of /dev, \"read:/PATH\", \"write:/PATH\", "
                      "\"system-bus:NAME\" and \"session-bus:NAME\" of D-Bus, \"master\"",
          .next = "name one of these, or leave it out",
          .near = nearest_names(right, kKnown)});
  }

  void check_try(const std::string& text) {
    const std::string place = field_place(files_.manifest, text, "try:");
    if (manifest_->kind() == fiona::PLUGIN && manifest_->try_().empty())
      find({.what = "the manifest has no line that shows the plugin at work",
            .where = place,
            .next = fmt::format("try: \"load {} as {}\"", check_.name, manifest_->name())});
    for (const std::string& line : split_lines(manifest_->try_())) {
      try {
        read_line(split_line(line));
      } catch (const LineError& error) {
        ErrorText told = error.text();
        told.what = fmt::format("the console does not understand try: {}", told.what);
        told.where = place;
        told.found = line;
        find(told);
      }
    }
  }

  /// It is what `fiona run NAME` runs, with what it requires and nothing else.
  void check_system_file() {
    const std::string expected = manifest_->name() + ".fiona";
    if (files_.system.filename() != expected)
      return find({.what = "a package of kind SYSTEM needs its system file",
                   .where = files_.manifest.parent_path().string(),
                   .expected = expected,
                   .next = "save " + expected + " in a running system makes one"});
    for (const LineError& error : check_system(files_.system, catalogue_).errors) find(error.text());
    for (const Line& line : read_script(files_.system.string())) {
      if (line.verb.text == "load") check_is_required(line.positional[0]);
    }
  }

  void check_is_required(const Word& plugin) {
    const std::string where = fmt::format("{}:{}", files_.system.string(), plugin.place.line);
    if (!marketplace::library_path(plugin.text).empty())
      return find({.what = fmt::format("it loads a library by its path: {}", plugin.text),
                   .where = where,
                   .expected = "PUBLISHER/NAME of a package",
                   .next = "publish that plugin, and load it by its name"});
    for (const std::string& text : manifest_->requirements()) {
      const std::string package = marketplace::Requirement::parse(text, "").package;
      if (package == plugin.text || plugin.text.starts_with(package + "/")) return;
    }
    find({.what = fmt::format("it loads {}, which the manifest does not require", plugin.text),
          .where = where,
          .next = fmt::format("load PUBLISHER/NAME, and requirements: \"{}\"", plugin.text)});
  }

  void check_readme() {
    const std::string text = file_text(files_.readme);
    if (text.find_first_not_of(" \t\r\n") == std::string::npos)
      find({.what = "README.md says nothing",
            .where = files_.readme.string(),
            .next = "say what the plugin does, for whom, and which ports it has"});
  }

  /// The publisher's own: no other plugin can bring a file of that name.
  bool is_publishers(const std::string& proto) const {
    return proto.starts_with(manifest_->publisher() + "/") ||
           proto.starts_with(underscored(manifest_->publisher()) + "/");
  }

  void check_proto_files() {
    if (!manifest_) return;
    std::set<fs::path> protos;
    for (const auto& entry : fs::recursive_directory_iterator(files_.protos)) {
      if (entry.path().extension() == ".proto") protos.insert(entry.path());
    }
    const std::string expected = underscored(manifest_->publisher());
    for (const fs::path& file : protos) {
      const std::string name = file.lexically_relative(files_.protos).generic_string();
      if (!is_publishers(name))
        find({.what = fmt::format("the proto file '{}' is not under the publisher's name", name),
              .where = file.string(),
              .expected =
                  fmt::format("proto/{}/…: a process may hold each proto file once, whoever brings it", expected),
              .next = fmt::format("move it to proto/{}/{}", expected, file.filename().string())});
      check_proto_package(file, expected);
    }
  }

  void check_proto_package(const fs::path& file, const std::string& expected) {
    const std::string text = file_text(file);
    static const std::regex kPackage(R"((^|\n)[ \t]*package[ \t]+([A-Za-z0-9_.]+)[ \t]*;)");
    std::smatch found;
    const std::string package = std::regex_search(text, found, kPackage) ? found[2].str() : "";
    if (package == expected || package.starts_with(expected + ".")) return;
    find({.what = package.empty() ? "the proto file has no package"
                                  : fmt::format("the proto package '{}' is not the publisher's", package),
          .where = field_place(file, text, "package"),
          .expected = fmt::format("package {}.…;", expected),
          .next = "rename the package"});
  }

  void check_interface() {
    interface_ = marketplace::parse_interface(file_text(files_.interface), files_.interface.string());
    const std::string place = files_.interface.string();
    if (interface_->abi() != kAbiTag)
      find({.what = "the plugin was built for another SDK or compiler",
            .where = place,
            .expected = kAbiTag,
            .found = interface_->abi().empty() ? "no ABI tag" : interface_->abi(),
            .next = "build it again with this SDK"});
    if (is_messages() && interface_->descriptors().file_size() == interface_->shared_size())
      find({.what = "the library brings no proto file",
            .where = place,
            .next = "fiona_add_messages(… PROTOS publisher/name/objects.proto)"});
    check_messages(place);
    if (interface_->components().empty() && !interface_->planned() && !is_messages())
      find({.what = "the plugin has no component",
            .where = place,
            .next = "FIONA_PLUGIN(plugin) { plugin.add<Class>(\"name\"); } adds one"});
    check_documented(place);
    check_asked_rights(place);
    for (const auto& file : interface_->descriptors().file()) {
      if (is_platform_proto(file.name()))
        find({.what = fmt::format("the proto file '{}' is the platform's, and the plugin brings it", file.name()),
              .where = place,
              .next = "leave it out of PROTOS: libfiona has it"});
      else if (manifest_ && !is_publishers(file.name()) && !is_shared(file.name()))
        find({.what = fmt::format("the proto file '{}' is not under the publisher's name", file.name()),
              .where = place,
              .expected = underscored(manifest_->publisher()) + "/…",
              .next = "move the file and its package"});
    }
  }

  bool is_shared(const std::string& proto) const {
    return std::find(interface_->shared().begin(), interface_->shared().end(), proto) != interface_->shared().end();
  }

  /// Where it was compiled with objects of other packages: that these are there, in that form, and that it says so.
  void check_messages(const std::string& place) {
    fiona::Manifest derived;
    marketplace::list_protos(*interface_, derived);
    if (derived.shared().empty()) return;
    const std::string name = check_.name.empty() ? files_.library.filename().string() : check_.name;
    for (const auto& package : marketplace::messages_of(derived, name, files_.messages)) {
      if (manifest_ && !marketplace::requires_package(*manifest_, package.name()))
        find({.what = fmt::format("it is compiled with the objects of {}, and the manifest does not require that",
                                  package.name()),
              .where = place,
              .next = fmt::format("requirements: \"{} >= {}\"", package.name(), package.manifest.version())});
    }
  }

  void check_documented(const std::string& place) {
    const TypeSet types(interface_->descriptors());
    for (const auto& component : interface_->components()) {
      if (component.doc().empty())
        find({.what = fmt::format("nobody is told what component '{}' is for", component.name()),
              .where = place,
              .next = fmt::format("plugin.add<Class>(\"{}\", \"one sentence\")", component.name())});
      const auto* parameters = component.parameters().empty() ? nullptr : types.object(component.parameters());
      for (int i = 0; parameters != nullptr && i < parameters->field_count(); ++i) {
        if (parameters->field(i)->options().GetExtension(fiona::doc).empty())
          find({.what =
                    fmt::format("the parameter '{}' of {} has no doc", parameters->field(i)->name(), component.name()),
                .where = parameters->file()->name(),
                .next = "[(fiona.doc) = \"one sentence\"]"});
      }
    }
    for (const auto& file : interface_->descriptors().file()) {
      for (const auto& service : file.service()) {
        if (is_shared(file.name())) continue;
        if (service.options().GetExtension(fiona::service_doc).empty())
          find({.what = fmt::format("the service '{}' has no doc", service.name()),
                .where = file.name(),
                .next = "option (fiona.service_doc) = \"one sentence\";"});
      }
    }
  }

  /// What the code uses must stand where its users read it.
  void check_asked_rights(const std::string& place) {
    if (!manifest_) return;
    const auto& asked = manifest_->rights();
    for (const auto& component : interface_->components()) {
      for (const auto& right : component.rights()) {
        if (std::find(asked.begin(), asked.end(), right) == asked.end())
          find({.what = fmt::format("component '{}' uses the right '{}', and the manifest does not ask for it",
                                    component.name(), right),
                .where = place,
                .next = fmt::format("rights: \"{}\"", right)});
      }
    }
  }

  void check_library() {
    const std::string place = files_.library.string();
    const ElfLibrary library = read_elf(files_.library);
    if (files_.packed && manifest_ && manifest_->architecture() != library.machine)
      find({.what = "the library is for another machine than the manifest says",
            .where = place,
            .expected = manifest_->architecture(),
            .found = library.machine,
            .next = "pack it again"});
    const std::string entry = is_messages() ? kMessagesEntrySymbol : kPluginEntrySymbol;
    if (!library.defined.contains(entry))
      find({.what = "the library has no entry",
            .where = place,
            .expected = "the symbol " + entry,
            .next = is_messages() ? "fiona_add_messages(…) defines it"
                                  : "FIONA_PLUGIN(plugin) { plugin.add<Class>(\"name\"); } defines it"});
    check_content(place);
    std::set<std::string> brought = library.defined;
    std::set<std::string> names;
    for (const fs::path& file : files_.brought) {
      const ElfLibrary other = read_elf(file);
      brought.insert(other.defined.begin(), other.defined.end());
      names.insert(file.filename().string());
    }
    for (const std::string& name : library.libraries) {
      if (!is_platform_library(name) && !names.contains(name) && !is_sanitizers(name))
        find({.what = fmt::format("it needs the library {}, which neither the platform nor the package has", name),
              .where = place,
              .next = "link it statically, or bring it along below lib/; a package of messages: market install NAME"});
    }
    if (library.machine == marketplace::this_architecture()) check_symbols(library, brought, place);
  }

  static bool is_sanitizers(const std::string& name) {
    return name.starts_with("libasan.") || name.starts_with("libubsan.") || name.starts_with("libtsan.");
  }

  void check_symbols(const ElfLibrary& library, const std::set<std::string>& brought, const std::string& place) {
    const std::vector<NeededSymbol> missing = missing_symbols(library, brought);
    const std::string next = "add the source or library that defines it; fiona_add_plugin links with --no-undefined";
    for (std::size_t i = 0; i < missing.size() && i < kMostSymbols; ++i) {
      const std::string version = missing[i].version.empty() ? "" : "@" + missing[i].version;
      find({.what = fmt::format("nobody defines the symbol {}{}", missing[i].name, version),
            .where = place,
            .next = next});
    }
    if (missing.size() > kMostSymbols)
      find(
          {.what = fmt::format("and {} further symbols", missing.size() - kMostSymbols), .where = place, .next = next});
  }

  /// What stands in the file itself, whatever its interface says.
  void check_content(const std::string& place) {
    const std::string content = file_text(files_.library);
    if (interface_ && !interface_->abi().empty() && content.find(interface_->abi()) == std::string::npos)
      find({.what = "the library was not built with the SDK that its interface names",
            .where = place,
            .expected = interface_->abi(),
            .next = "build it again"});
    // A compiled proto file carries its descriptor: field 1 is its name, field 2 its package.
    for (const char* name : {"options", "sensors", "perception", "localisation", "navigation", "security", "hmi",
                             "probe", "manifest", "control", "wire"}) {
      const std::string file = fmt::format("fiona/{}.proto", name);
      const std::string begin = fmt::format("\n{}{}\x12", static_cast<char>(file.size()), file);
      if (content.find(begin) != std::string::npos)
        find({.what = fmt::format("the platform's proto file '{}' is compiled into the library", file),
              .where = place,
              .expected = "libfiona-msgs has it: protobuf ends a process that gets it twice",
              .next = "leave it out of PROTOS, and link fiona::fiona"});
    }
  }

  void check_declared() {
    const Described described = describe_library(reactor_, files_, confinement_);
    const std::string place = files_.interface.string();
    const std::string next = "build it again: fiona_add_plugin describes it, or plugin describe LIBRARY -o FILE";
    const auto& now = described.interface.components();
    const auto& said = interface_->components();
    for (int i = 0; i < std::max(now.size(), said.size()); ++i) {
      if (i >= now.size() || i >= said.size() || now[i].name() != said[i].name())
        return find({.what = "the code does not declare the components that the interface names",
                     .where = place,
                     .expected = i < now.size() ? now[i].name() : "no further component",
                     .found = i < said.size() ? said[i].name() : "no further component",
                     .next = next});
      const std::string difference = interface_difference(now[i], said[i]);
      if (!difference.empty())
        return find(
            {.what = fmt::format("component '{}' is not what the interface says: {}", now[i].name(), difference),
             .where = place,
             .next = next});
    }
    if (described.interface.SerializeAsString() != interface_->SerializeAsString())
      find({.what = "the interface is that of an older build: modes, tasks, texts or types have changed",
            .where = place,
            .next = next});
  }

  Reactor& reactor_;
  const PluginFiles& files_;
  const Catalogue& catalogue_;
  const Confinement confinement_;
  PluginCheck check_;
  std::optional<fiona::Manifest> manifest_;
  std::optional<fiona::Interface> interface_;
};

}  // namespace

PluginCheck check_plugin(Reactor& reactor, const PluginFiles& files, const Catalogue& catalogue,
                         Confinement confinement) {
  return PluginChecker(reactor, files, catalogue, confinement).run();
}

}  // namespace fiona::console
