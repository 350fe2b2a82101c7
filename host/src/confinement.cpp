#include "confinement.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cstdlib>

#include "fiona/error.hpp"
#include "fiona/marketplace/manifest.hpp"
#include "os/sandbox.hpp"

namespace fiona::host {
namespace {

/// The shipped configuration lets in what this project publishes in the marketplace that it ships. Another marketplace
/// may have a publisher of that name.
constexpr std::string_view kLetIn = "fiona/";

bool has(const std::vector<std::string>& rights, std::string_view right) {
  return std::find(rights.begin(), rights.end(), right) != rights.end();
}

/// The rights that open a sandbox, of those that it was granted.
std::vector<std::string> openings(const Model::Instance& one) {
  std::vector<std::string> found;
  std::copy_if(one.rights.begin(), one.rights.end(), std::back_inserter(found), &marketplace::opens_sandbox);
  return found;
}

/// What whoever may read a folder could connect to in it, as the user: this host's consoles come in without a proof.
void hide_sockets(wire::Confinement& confinement, const std::filesystem::path& of_host) {
  confinement.add_hidden(of_host);
  if (const char* const of_user = std::getenv("XDG_RUNTIME_DIR"); of_user && *of_user) confinement.add_hidden(of_user);
}

bool is_unsigned(const Package& package) { return package.origin == Package::Origin::Unsigned; }

}  // namespace

/// A library that was typed by its path is whoever's who typed it.
bool is_let_in(const Package& package) {
  return package.origin == Package::Origin::Path ||
         (package.origin == Package::Origin::FirstParty && package.name.starts_with(kLetIn));
}

bool is_confined(const Model::Instance& first) {
  if (first.group == kMainGroup) return false;
  if (is_unsigned(*first.package)) return true;
  if (has(first.rights, kUnconfined)) return false;
  return !is_let_in(*first.package) || has(first.rights, kConfined);
}

std::vector<std::string> rights_of_process(const Model::Instance& one) {
  std::vector<std::string> found = openings(one);
  for (const std::string_view right : {kConfined, kUnconfined}) {
    if (has(one.rights, right)) found.emplace_back(right);
  }
  return found;
}

wire::Confinement confinement_of(const Model::Instance& first, const std::filesystem::path& links,
                                 const std::filesystem::path& own) {
  wire::Confinement confinement;
  if (!is_confined(first)) return confinement;
  confinement.set_sandboxed(true);
  const Package& package = *first.package;
  for (const auto& file : package.files) {
    const bool is_typed = file.blake2b().empty();  // by its path
    confinement.add_readable(is_typed ? file.path() : std::filesystem::path(file.path()).parent_path().string());
    if (is_typed) continue;
    auto& library = *confinement.add_libraries();
    library = file;
    library.clear_descriptors();  // what it declares needs more room than a group's papers have
  }
  if (!package.share.empty()) confinement.add_readable(package.share);
  confinement.add_readable(links);
  confinement.add_socket_folders(own);
  hide_sockets(confinement, links.parent_path());
  for (const std::string& right : openings(first)) {
    const std::string what = right.substr(right.find(':') + 1);
    if (right == "network") confinement.set_network(true);
    if (right.starts_with("device:")) confinement.add_devices("/dev/" + what);
    if (right.starts_with("read:")) confinement.add_readable(what);
    if (right.starts_with("write:")) confinement.add_writable(what);
    if (right.starts_with("system-bus:")) confinement.add_system_bus(what);
    if (right.starts_with("session-bus:")) confinement.add_session_bus(what);
  }
  // Not among the links, which every group reaches.
  if (confinement.system_bus_size() + confinement.session_bus_size() > 0)
    confinement.set_buses((links.parent_path() / kBusesFolder / own.filename()).string());
  return confinement;
}

void require_sandbox(const std::string& group, const wire::Ready& ready) {
  for (const auto& layer : ready.sandbox()) {
    if (!os::is_needed_layer(layer.name()) || layer.missing().empty()) continue;
    throw Error(
        ErrorCode::NotAllowed,
        {.what = fmt::format("group '{}' cannot be a sandbox: this system has no {} for it", group, layer.name()),
         .found = layer.missing(),
         .next = "doctor; or, if you trust it as you trust yourself: load … with unconfined"});
  }
}

void require_group(const Model::Instance* first, const Model::Instance& next, const std::string& plugin) {
  const bool may_be_in_main =
      is_let_in(*next.package) || (has(next.rights, kUnconfined) && !is_unsigned(*next.package));
  if (next.group == kMainGroup && !may_be_in_main) {
    throw Error(
        ErrorCode::NotAllowed,
        {.what = fmt::format("{} is not let into main, whose process and rights it would share", next.package->name),
         .expected = "a package of this project, or one that you let in yourself",
         .next = is_unsigned(*next.package)
                     ? fmt::format("load {} in GROUP", plugin)
                     : fmt::format("load {} in GROUP; or, if you trust it as you trust yourself: load {} with {}",
                                   plugin, plugin, kUnconfined)});
  }
  if (!first || next.group == kMainGroup) return;
  const auto rights = openings(*first);
  const auto wanted = openings(next);
  const bool more = std::any_of(wanted.begin(), wanted.end(), [&](const auto& right) { return !has(rights, right); });
  const bool same = is_confined(*first) == is_confined(next) &&
                    (!is_confined(next) || (first->package->library == next.package->library && !more));
  if (same) return;
  throw Error(ErrorCode::NotAllowed,
              {.what = is_confined(*first) ? fmt::format("group '{}' is a sandbox, of {} and what that was granted",
                                                         next.group, first->package->name)
                                           : fmt::format("group '{}' is no sandbox, and {} belongs into one",
                                                         next.group, next.package->name),
               .next = fmt::format("load {} in another GROUP", plugin)});
}

}  // namespace fiona::host
