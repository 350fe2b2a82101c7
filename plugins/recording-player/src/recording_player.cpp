#include "recording_player.hpp"

#include <algorithm>
#include <utility>

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <google/protobuf/util/message_differencer.h>
#include <google/protobuf/util/time_util.h>

#include "fiona/hmi.fiona.hpp"
#include "fiona/localisation.fiona.hpp"
#include "fiona/navigation.fiona.hpp"
#include "fiona/perception.fiona.hpp"
#include "fiona/sensors.fiona.hpp"
#include "schema.hpp"

namespace fiona::recording_player {
namespace {

/// Messages that are further apart are none of one recording.
constexpr std::chrono::nanoseconds kLongest = std::chrono::hours(24 * 3650);

constexpr std::uint64_t kMostToldDamages = 10;

/// The names between commas, without blanks around them.
std::vector<std::string> names_in(std::string_view list) {
  std::vector<std::string> names;
  while (!list.empty()) {
    const auto comma = std::min(list.find(','), list.size());
    std::string_view name = list.substr(0, comma);
    list.remove_prefix(std::min(comma + 1, list.size()));
    while (name.starts_with(' ')) name.remove_prefix(1);
    while (name.ends_with(' ')) name.remove_suffix(1);
    if (!name.empty()) names.emplace_back(name);
  }
  return names;
}

Duration between(std::uint64_t begin_ns, std::uint64_t end_ns) {
  const std::uint64_t ns = std::max(begin_ns, end_ns) - std::min(begin_ns, end_ns);
  const Duration size(static_cast<std::int64_t>(std::min<std::uint64_t>(ns, kLongest.count())));
  return begin_ns <= end_ns ? size : -size;
}

}  // namespace

/// The push services of the catalogue, each of them.
RecordingPlayer::RecordingPlayer(Hull& hull) : Component(hull) {
  offer<sensors::GetIMUService>("imu", "inertial readings");
  offer<sensors::GyroscopeInput>("gyroscope", "turn rates");
  offer<sensors::MagnetometerInput>("magnetometer", "magnetic field");
  offer<sensors::RFSignalRSSIService>("wifi", "radio signal strengths: Wi-Fi or any other");
  offer<sensors::RFTOAService>("toa", "times of arrival");
  offer<sensors::RFAOAService>("aoa", "angles of arrival");
  offer<sensors::SatelliteInView>("satellites", "satellites in view");
  offer<sensors::IbeaconlistProvider>("beacons", "iBeacons");
  offer<perception::PointObjectDetected>("points", "point objects");
  offer<perception::VolumeObjectDetected>("volumes", "objects with extent");
  offer<perception::ObstacleProvider>("obstacle", "whether there is an obstacle");
  offer<localisation::OrientationProvider>("orientation", "how the device was turned");
  offer<localisation::LocationProvider>("location", "where the device was, or was taken to be");
  offer<localisation::StepProvider>("steps", "steps of a pedestrian");
  offer<navigation::PathProvider>("path", "the way to the destination");
  offer<hmi::LocalPath>("turn", "the next turn");
  offer<hmi::InstructionProvider>("instruction", "what the walker was told");
}

void RecordingPlayer::check(const Parameters& draft) const {
  if (!recording_) return;
  Parameters other = draft;
  other.set_at_end(params_->at_end());
  if (google::protobuf::util::MessageDifferencer::Equals(other, *params_)) return;
  throw Error(ErrorCode::NotAllowed, {.what = "the recording is open: only at_end can still be changed",
                                      .where = name(),
                                      .next = "unload " + name() + ", then load it with the new parameters"});
}

void RecordingPlayer::on_start() {
  if (params_->file().empty()) {
    throw Error(ErrorCode::Usage, {.what = "no recording is named",
                                   .where = name(),
                                   .next = "load recording-player as " + name() + " file=FILE.mcap"});
  }
  auto recording = std::make_unique<McapReader>(params_->file());
  const std::uint64_t first_ns = recording->first_ns(), last_ns = recording->last_ns();
  if (last_ns - first_ns > static_cast<std::uint64_t>(kLongest.count())) {
    throw Error(
        ErrorCode::Failed,
        {.what = fmt::format("between its first and last message there are {:.0f} days: one of the times is wrong",
                             static_cast<double>(last_ns - first_ns) / 86'400e9),
         .where = params_->file(),
         .expected = "at most 3650",
         .next = "what else reads and cuts it: mcap info, mcap filter"});
  }
  const double length_s = to_seconds(between(first_ns, last_ns));
  if (params_->from_s() > length_s) {
    throw Error(ErrorCode::Usage, {.what = fmt::format("the recording is over after {:.1f} s", length_s),
                                   .where = params_->file(),
                                   .found = fmt::format("from_s={:g}", params_->from_s()),
                                   .next = "load recording-player as " + name() + " file=FILE.mcap from_s=0"});
  }
  begin_ns_ = first_ns + static_cast<std::uint64_t>(1e9 * params_->from_s());
  if (params_->times() == AS_RECORDED) check_clock();
  connect(*recording);
  if (recording->is_cut()) log(LogLevel::Warning, "the recording is cut off: what is whole of it is played");
  recording_ = std::move(recording);
  played_ = {};
  next_.reset();
  is_over_ = false;
  messages_ = damages_ = 0;
  damaged_.set(0);
  if (const auto records = recording_->damaged(); records > 0)
    tell_damage(fmt::format("{} of its records are garbled and left out", records));
}

/// At its own times it is played on a clock that is not beyond them, and that does not have to count for days until
/// they come.
void RecordingPlayer::check_clock() const {
  constexpr std::uint64_t kLatest_ns = std::uint64_t{2'208'988'800} * 1'000'000'000;  // 2040, as the host's clock
  const bool is_time = begin_ns_ < kLatest_ns;
  const TimePoint begin = is_time ? recorded_begin() : TimePoint{};
  if (is_time && now() <= begin && begin - now() < std::chrono::hours(24)) return;
  const auto text_of = [](TimePoint time) {
    using google::protobuf::util::TimeUtil;
    return TimeUtil::ToString(TimeUtil::NanosecondsToTimestamp(time.time_since_epoch().count()));
  };
  if (!is_time) {
    throw Error(ErrorCode::Failed, {.what = "the recording's own times are none",
                                    .where = params_->file(),
                                    .expected = "its first message before 2040",
                                    .next = "load recording-player as " + name() + " file=FILE.mcap times=FROM_NOW"});
  }
  throw Error(ErrorCode::NotAllowed,
              {.what = "the recording is of another time than the clock shows",
               .where = params_->file(),
               .expected = "a virtual clock that starts at " + text_of(begin) + ", or up to a day before",
               .found = text_of(now()),
               .next = "before the first load: set host clock=virtual start=" + text_of(begin)});
}

/// Those that are asked for, each of which must be there; empty: any.
std::vector<std::string> RecordingPlayer::asked_of(const McapReader& recording) const {
  std::vector<std::string> asked = names_in(params_->channels());
  std::vector<std::string> topics;
  for (const auto& [id, channel] : recording.channels()) topics.push_back(channel.topic);
  for (const std::string& topic : asked) {
    if (std::find(topics.begin(), topics.end(), topic) != topics.end()) continue;
    throw Error(ErrorCode::NotFound, {.what = "the recording has no channel '" + topic + "'",
                                      .where = params_->file(),
                                      .found = fmt::format("{}", fmt::join(topics, ", ")),
                                      .near = nearest_names(topic, topics)});
  }
  return asked;
}

/// The outlets of the channel's type; none, and why: there is no such port, or it means another thing.
std::vector<Outlet*> RecordingPlayer::outlets_for(const McapReader::Channel& channel, std::string& why) const {
  std::vector<Outlet*> found;
  why = channel.type.empty() ? "it has no type" : "no port has its type " + channel.type;
  for (const auto& outlet : outlets_) {
    if (outlet->type().full_name() != channel.type) continue;
    if (const auto differs = difference(channel, outlet->type())) {
      why = *differs;
    } else {
      found.push_back(outlet.get());
    }
  }
  return found;
}

/// The channels to the outlets of their types. What is asked for by name must be played; of the others, some.
void RecordingPlayer::connect(McapReader& recording) {
  const std::vector<std::string> asked = asked_of(recording);
  outlets_of_.clear();
  std::set<McapReader::ChannelId> played;
  std::map<const Outlet*, std::string> taken;
  std::vector<std::string> left_out;
  for (const auto& [id, channel] : recording.channels()) {
    if (!asked.empty() && std::find(asked.begin(), asked.end(), channel.topic) == asked.end()) continue;
    std::string why;
    const std::vector<Outlet*> outlets = outlets_for(channel, why);
    if (outlets.empty()) {
      left_out.push_back(fmt::format("{} ({})", channel.topic, why));
      continue;
    }
    for (const Outlet* outlet : outlets) {
      const std::string& other = taken.try_emplace(outlet, channel.topic).first->second;
      if (other != channel.topic) refuse_two(other, channel.topic, channel.type);
    }
    outlets_of_[id] = outlets;
    played.insert(id);
  }
  const std::string channels = "channels whose types are those of ports";
  const std::string ports = "market info recording-player shows its ports";
  if (!asked.empty() && !left_out.empty()) {
    throw Error(ErrorCode::NotFound,
                {.what = fmt::format("what is asked for cannot be played: {}", fmt::join(left_out, "; ")),
                 .where = params_->file(),
                 .expected = channels,
                 .next = "load recording-player as " + name() +
                         " file=FILE.mcap, with fewer channels or none of them named; " + ports});
  }
  if (played.empty()) {
    throw Error(
        ErrorCode::NotFound,
        {.what = fmt::format("there is nothing to be played{}", recording.is_cut() ? ", and it is cut off" : ""),
         .where = params_->file(),
         .expected = channels,
         .found = left_out.empty() ? "no channel" : fmt::format("{}", fmt::join(left_out, "; ")),
         .next = ports});
  }
  if (!left_out.empty()) log(LogLevel::Warning, fmt::format("left out: {}", fmt::join(left_out, "; ")));
  recording.select(std::move(played), begin_ns_);
}

void RecordingPlayer::refuse_two(const std::string& one, const std::string& other, const std::string& type) const {
  throw Error(
      ErrorCode::Usage,
      {.what = fmt::format("'{}' and '{}' have one type, {}, and there is one port for it", one, other, type),
       .where = params_->file(),
       .next = fmt::format("load recording-player as {} file=FILE.mcap channels={}, and another one for the other",
                           name(), one)});
}

/// Elsewhere than in active it pauses: what remains keeps its distance in time, or, at its own times, is passed over
/// while it does.
void RecordingPlayer::on_mode(std::string_view mode) {
  if (mode == kModeActive) {
    begun_ = params_->times() == AS_RECORDED ? recorded_begin() : now() - played_;
    resumed_ = now();
    next_message_.at(now());
  } else if (begun_) {
    next_message_.cancel();
    played_ = now() - *std::exchange(begun_, std::nullopt);
  }
}

void RecordingPlayer::play_next() {
  if (!begun_ || is_over_) return;
  while (next_ || read_next()) {
    const TimePoint due = *begun_ + between(begin_ns_, next_->logged_ns);
    if (due > now()) return next_message_.at(due);
    if (params_->times() == FROM_NOW || due >= resumed_) play(*next_);
    next_.reset();
  }
  is_over_ ? end() : next_message_.at(now());  // others have their turn before what takes time goes on
}

/// Whether there is one; if not, it is over, or there is more to be read.
bool RecordingPlayer::read_next() {
  try {
    McapReader::Message message;
    const auto next = recording_->next(message);
    is_over_ = next == McapReader::Next::End;
    if (next == McapReader::Next::Message) next_ = message;
  } catch (const Error& error) {
    tell_damage(error.what());
  }
  return next_.has_value();
}

void RecordingPlayer::end() {
  const bool none = messages_ == 0;
  const std::string what =
      fmt::format("end of recording {}{}", params_->file(), none ? ": nothing of it was played" : "");
  log(none ? LogLevel::Warning : LogLevel::Info, what);
  if (params_->at_end() == END_RUN) end_run(none ? static_cast<int>(ErrorCode::Failed) : 0, what);
}

void RecordingPlayer::play(const McapReader::Message& message) {
  // A sensor's clock may have been ahead of the recording's.
  const TimePoint origin = std::max(*begun_ + between(begin_ns_, message.published_ns), TimePoint{});
  const std::int64_t shift_ms = to_milliseconds(*begun_) - static_cast<std::int64_t>(begin_ns_ / 1'000'000);
  for (Outlet* outlet : outlets_of_.at(message.channel)) {
    if (outlet->put(message.data, origin, shift_ms)) {
      ++messages_;
    } else {
      tell_damage(fmt::format("a message of '{}' is garbled", recording_->channels().at(message.channel).topic));
    }
  }
  position_.set(to_seconds(between(begin_ns_, message.logged_ns)) + params_->from_s());
}

/// The first ones in words, all in the count.
void RecordingPlayer::tell_damage(const std::string& what) {
  damaged_.set(++damages_);
  if (damages_ <= kMostToldDamages) log(LogLevel::Warning, what);
}

}  // namespace fiona::recording_player
