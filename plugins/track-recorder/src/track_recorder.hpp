#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <string_view>

#include "files.hpp"
#include "fiona/building/building.hpp"
#include "fiona/component.hpp"
#include "fiona/localisation.fiona.hpp"
#include "fiona/track_recorder/params.pb.h"
#include "thinned_track.hpp"
#include "truth_comparison.hpp"

namespace fiona::recorder {

/// Writes the positions of any localisation as CSV and draws them over the floor plan; with a truth beside
/// it, says how far off they were.
class TrackRecorder final : public Component {
 public:
  using Component::Component;

 private:
  using Parameters = track_recorder::Parameters;
  using Location = localisation::CommLocation;

  void on_start() override;
  void on_mode(std::string_view mode) override;
  void on_stop() override;
  void check(const Parameters& draft) const;
  void changed();

  void on_location(const Received<Location>& location);
  void on_truth(const Received<Location>& truth);
  void report();
  void schedule_report();

  Fix fix(const Received<Location>& location) const;
  building::TrackPoint track_point(const Fix& fix) const;
  std::string drawing() const;
  std::string summary() const;

  Params<Parameters> params_{*this, &TrackRecorder::check, &TrackRecorder::changed};
  Requires<localisation::LocationProvider> location_{
      *this, "location", &TrackRecorder::on_location, {.doc = "the positions to be recorded"}};
  Requires<localisation::LocationProvider> truth_{
      *this,
      "truth",
      &TrackRecorder::on_truth,
      {.optional = true, .doc = "where the device really was: a second track in the drawing, and the errors"}};
  Timer report_{*this, &TrackRecorder::report};

  bool started_ = false;
  std::optional<building::Plan> plan_{};
  std::optional<LineFile> csv_{};
  ThinnedTrack track_{};
  ThinnedTrack truth_track_{};
  TruthComparison comparison_{};
  std::optional<Fix> latest_{};
  bool lost_ = false;  ///< the latest message said that it is not valid
  std::uint64_t points_ = 0;
};

}  // namespace fiona::recorder
