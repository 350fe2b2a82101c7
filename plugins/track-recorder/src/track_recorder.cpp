#include "track_recorder.hpp"

#include <fmt/format.h>
#include <google/protobuf/util/message_differencer.h>

#include <chrono>
#include <filesystem>
#include <system_error>

#include "fiona/building/floor_folders.hpp"
#include "fiona/hull.hpp"

namespace fiona::recorder {
namespace {

using track_recorder::Parameters;

[[noreturn]] void refuse_value(const std::string& name, const std::string& found, const std::string& expected) {
  throw Error(ErrorCode::Usage,
              {.what = "parameter '" + name + "' does not take this value", .expected = expected, .found = found});
}

constexpr const char* kHeader = "trace,t_ms,x,y,floor,cov_xx,cov_xy,cov_yy";

bool fits_a_csv_field(const std::string& text) { return text.find_first_of(",\"\r\n") == std::string::npos; }

std::string level_text(const Fix& fix) { return fix.level ? std::to_string(whole_level(*fix.level)) : ""; }

/// xx, xy and yy of the row-wise 3 x 3 matrix; empty fields where the localisation does not tell.
std::string covariance_text(const localisation::CommPosition& position) {
  if (position.confidence_size() != 9) return ",,";
  return fmt::format("{:.4f},{:.4f},{:.4f}", position.confidence(0), position.confidence(1), position.confidence(4));
}

building::Plan plan_of(const std::filesystem::path& path) {
  std::error_code error;
  if (std::filesystem::is_directory(path, error)) return building::read_floor_folders(path);
  return building::Building::read(path).plan();
}

}  // namespace

void TrackRecorder::check(const Parameters& draft) const {
  if (!fits_a_csv_field(draft.trace()) || draft.trace().empty()) {
    refuse_value("trace", draft.trace(), "a name without comma, quotation mark and line break");
  }
  if (!draft.svg().empty() && draft.svg() == draft.csv()) {
    refuse_value("svg", draft.svg(), "another file than that of csv");
  }
  if (!started_) return;
  Parameters other = draft;
  other.set_report_period_s(params_->report_period_s());
  if (google::protobuf::util::MessageDifferencer::Equals(other, *params_)) return;
  throw Error(ErrorCode::NotAllowed, {.what = "the recording has begun: only report_period_s can still be changed",
                                      .where = name(),
                                      .next = "unload " + name() + ", then load it with the new parameters"});
}

void TrackRecorder::changed() {
  report_.cancel();
  if (hull().is_active()) schedule_report();
}

void TrackRecorder::on_start() {
  // First what may be refused: then no file has been touched.
  if (!params_->building().empty()) plan_ = plan_of(params_->building());
  if (!params_->svg().empty()) check_replaceable(params_->svg());
  const std::string empty_plan = params_->svg().empty() ? "" : drawing();
  for (const auto& [file, nothing] :
       {std::pair(params_->csv(), kHeader + std::string("\n")), std::pair(params_->svg(), empty_plan + "\n")}) {
    if (file.empty()) continue;
    const auto kept = keep_aside(file, nothing);
    if (kept) log(LogLevel::Info, "what was in " + file + " is in " + kept->string());
  }
  if (!params_->csv().empty()) {
    csv_.emplace(params_->csv());
    csv_->add(kHeader);
  }
  // It tells of a file that cannot be written before the walk, not after it.
  if (!params_->svg().empty()) write_atomically(params_->svg(), empty_plan);
  started_ = true;
}

void TrackRecorder::on_mode(std::string_view mode) {
  if (mode != kModeNeutral) schedule_report();
}

void TrackRecorder::on_stop() {
  log(points_ > 0 ? LogLevel::Info : LogLevel::Warning, summary());
  if (!params_->svg().empty()) write_atomically(params_->svg(), drawing());
}

void TrackRecorder::on_location(const Received<Location>& location) {
  lost_ = !location->is_valid();
  if (lost_) return;
  const Fix now = fix(location);
  latest_ = now;
  ++points_;
  track_.add(track_point(now));
  comparison_.add_estimate(now);
  if (!csv_) return;
  csv_->add(fmt::format("{},{},{:.3f},{:.3f},{},{}", params_->trace(), track_point(now).t_ms, now.x_m, now.y_m,
                        level_text(now), covariance_text(location->position())));
}

void TrackRecorder::on_truth(const Received<Location>& truth) {
  if (!truth->is_valid()) return;
  const Fix now = fix(truth);
  truth_track_.add(track_point(now));
  comparison_.add_truth(now);
}

Fix TrackRecorder::fix(const Received<Location>& location) const {
  const auto& position = location->position();
  return {location.origin, position.x(), position.y(), position.has_z() ? std::optional(position.z()) : std::nullopt};
}

building::TrackPoint TrackRecorder::track_point(const Fix& fix) const {
  const auto since_start = std::chrono::floor<std::chrono::milliseconds>(fix.time - clock_start());
  return {since_start.count(), fix.x_m, fix.y_m, fix.level.value_or(0.0)};
}

void TrackRecorder::schedule_report() {
  const double period_s = params_->report_period_s();
  if (period_s > 0.0) report_.at(now() + std::chrono::round<Duration>(std::chrono::duration<double>(period_s)));
}

void TrackRecorder::report() {
  schedule_report();
  std::string line = fmt::format("{:.1f} s: ", to_seconds(now() - clock_start()));
  if (!latest_) {
    line += lost_ ? "no valid location" : "no location yet";
  } else {
    line += fmt::format("x {:.2f} m, y {:.2f} m, {}", latest_->x_m, latest_->y_m,
                        latest_->level ? "level " + level_text(*latest_) : "outdoors");
    if (comparison_.latest_m()) line += fmt::format(", error {:.2f} m", *comparison_.latest_m());
    const double age_s = to_seconds(now() - latest_->time);
    if (lost_) line += fmt::format(", not valid since {:.1f} s", age_s);
  }
  log(LogLevel::Info, line);
}

std::string TrackRecorder::drawing() const {
  std::vector<building::Track> tracks;
  if (!truth_track_.empty()) tracks.push_back({"truth", truth_track_.points(), "#444444", "2 3"});
  if (!track_.empty()) tracks.push_back({"location", track_.points(), "#0072b2", "none"});
  const building::SvgOptions options{.title = params_->trace(), .visited_only = true};
  return plan_ ? building::floor_plan_svg(*plan_, tracks, options) : building::track_svg(tracks, options);
}

std::string TrackRecorder::summary() const {
  if (points_ == 0) return params_->trace() + ": no valid location arrived";
  std::string text = fmt::format("{}: {} points", params_->trace(), points_);
  const ErrorStatistics& errors = comparison_.errors();
  if (errors.count() == 0) return text;
  const double right = static_cast<double>(comparison_.right_levels()) / static_cast<double>(errors.count());
  return text + fmt::format("; error of {}: mean {:.2f} m, median {:.2f} m, p90 {:.2f} m; level right {:.1f} %",
                            errors.count(), errors.mean_m(), errors.quantile_m(0.5), errors.quantile_m(0.9),
                            100.0 * right);
}

}  // namespace fiona::recorder
