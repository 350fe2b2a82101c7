#include "living_names.hpp"

#include <filesystem>

#include "catalogue.hpp"
#include "system_view.hpp"
#include "types.hpp"

namespace fiona::console {
namespace {

constexpr std::chrono::milliseconds kCompletionLimit{150};
constexpr std::chrono::seconds kSnapshotLife{1};

}  // namespace

const control::System* LivingNames::system() {
  const auto now = std::chrono::steady_clock::now();
  if (asked_ && now - *asked_ < kSnapshotLife) return known_ ? &system_ : nullptr;
  asked_ = now;
  known_ = false;
  if (!session_.connected()) return nullptr;
  control::Request request;
  request.mutable_snapshot();
  system_ = session_.host().call(std::move(request), kCompletionLimit).system();
  known_ = true;
  return &system_;
}

std::vector<std::string> LivingNames::plugins() {
  std::vector<std::string> names;
  const Catalogue catalogue = session_.catalogue();
  for (const KnownPlugin& plugin : catalogue.plugins()) {
    if (plugin.installed) names.insert(names.end(), {plugin.manifest.name(), plugin.name()});
  }
  return names;
}

std::vector<std::string> LivingNames::packages() {
  std::vector<std::string> names;
  const Catalogue catalogue = session_.catalogue();
  for (const KnownPlugin& plugin : catalogue.plugins()) names.push_back(plugin.name());
  return names;
}

std::vector<std::string> LivingNames::services() {
  std::vector<std::string> names;
  const Catalogue catalogue(session_.options.store);
  for (const KnownPlugin& plugin : catalogue.plugins()) {
    for (const auto& component : plugin.interface.components()) {
      for (const auto& port : component.ports()) names.push_back(short_name(port.service()));
    }
  }
  return names;
}

namespace {

/// A part that may repeat is named as a whole.
void add_fields(const google::protobuf::Descriptor& type, const std::string& before, std::vector<std::string>& names) {
  constexpr std::size_t kLongest = 100, kMost = 1000;  // of a path, of paths: a type may hold itself, and twice
  for (int i = 0; i < type.field_count() && names.size() < kMost; ++i) {
    const auto& field = *type.field(i);
    const std::string path = before + field.name();
    const auto* inner = field.is_repeated() ? nullptr : field.message_type();
    if (inner != nullptr && path.size() < kLongest)
      add_fields(*inner, path + ".", names);
    else
      names.push_back(path);
  }
}

}  // namespace

std::vector<std::string> LivingNames::parameters(const std::string& plugin) {
  std::vector<std::string> names;
  const Catalogue catalogue = session_.catalogue();
  const auto found = catalogue.find(plugin);
  if (found.empty() || !found.front().plugin->installed) return names;
  const auto* type = catalogue.types_of(*found.front().plugin).object(found.front().component->parameters());
  for (int i = 0; type != nullptr && i < type->field_count(); ++i) names.push_back(type->field(i)->name());
  return names;
}

std::vector<std::string> LivingNames::fields(const std::string& type) {
  std::vector<std::string> names;
  if (!session_.connected() || type.empty()) return names;
  control::Request request;
  request.mutable_describe()->set_name(type);
  const control::Reply reply = session_.host().call(std::move(request), kCompletionLimit);
  const TypeSet types(reply.description().files());
  const auto* object = types.object(reply.description().name());
  const auto* service = reply.description().is_service() ? types.service(reply.description().name()) : nullptr;
  if (service != nullptr && service->method_count() > 0) object = service->method(0)->output_type();
  if (object != nullptr) add_fields(*object, "", names);
  return names;
}

std::vector<std::string> LivingNames::files(std::string_view begin) {
  namespace fs = std::filesystem;
  const std::size_t slash = begin.rfind('/');
  const std::string directory = slash == std::string_view::npos ? "" : std::string(begin.substr(0, slash + 1));
  std::vector<std::string> names;
  std::error_code problem;
  constexpr std::size_t kMost = 10'000;
  for (const auto& entry : fs::directory_iterator(directory.empty() ? "." : directory, problem)) {
    if (names.size() < kMost)
      names.push_back(directory + entry.path().filename().string() + (entry.is_directory(problem) ? "/" : ""));
  }
  return names;
}

}  // namespace fiona::console
