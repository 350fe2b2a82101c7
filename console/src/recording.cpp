#include "recording.hpp"

#include <algorithm>
#include <cmath>

#include <fiona/error.hpp>
#include <fiona/secrets.hpp>

namespace fiona::console {
namespace {

/// All files that the type needs, each behind those that it imports.
void add_files(const google::protobuf::FileDescriptor& file, google::protobuf::FileDescriptorSet& all) {
  const auto is_it = [&file](const auto& one) { return one.name() == file.name(); };
  if (std::any_of(all.file().begin(), all.file().end(), is_it)) return;
  for (int i = 0; i < file.dependency_count(); ++i) add_files(*file.dependency(i), all);
  file.CopyTo(all.add_file());
}

}  // namespace

/// Its first sample describes its type; so does that of a host that is back.
Recording::Port& Recording::port_of(const std::string& name, const control::Sample& sample) {
  const auto known = ports_.find(name);
  if (known != ports_.end() && known->second.type == sample.type()) return known->second;
  auto types = std::make_unique<TypeSet>(sample.files());
  const auto* type = types->object(sample.type());
  if (type == nullptr) {
    throw Error(ErrorCode::Failed, {.what = "the host did not describe the type " + sample.type(),
                                    .where = name,
                                    .next = "run the console of the same version as the host: fiona --version"});
  }
  google::protobuf::FileDescriptorSet files;
  add_files(*type->file(), files);
  Port port;
  port.type = sample.type();
  port.channel = writer_.add_channel(name, sample.type(), files);
  if (first_secret(*type)) {
    port.whole = types->make(sample.type());
    port.types = std::move(types);
  }
  return ports_.insert_or_assign(name, std::move(port)).first->second;
}

void Recording::take(const std::string& name, const control::Sample& sample) {
  lost_ += sample.skipped();
  if (sample.type().empty()) return;  // a probe that has no value yet
  const Port& port = port_of(name, sample);
  std::string without_secrets;
  if (port.whole) {
    if (!port.whole->ParseFromString(sample.object())) return void(++lost_);
    without_secrets = WithoutSecrets(*port.whole)->SerializeAsString();
  }
  const std::int64_t age_ns = std::llround(1e6 * sample.age_ms());
  const auto ns = [](std::int64_t time_ns) { return static_cast<std::uint64_t>(std::max<std::int64_t>(0, time_ns)); };
  writer_.write({.channel = port.channel,
                 .sequence = static_cast<std::uint32_t>(sample.sequence()),
                 .logged_ns = ns(sample.origin_ns() + age_ns),
                 .published_ns = ns(sample.origin_ns()),
                 .data = port.whole ? std::string_view(without_secrets) : std::string_view(sample.object())});
}

}  // namespace fiona::console
