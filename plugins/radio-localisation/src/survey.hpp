#pragma once

#include <optional>

#include <fiona/walk/walk.hpp>

#include "radio_map_learner.hpp"

namespace fiona::radio {

/// Teaches the learner one survey walk. A Wi-Fi row counts once, where it was really heard: scan results repeat what
/// was heard up to half a minute before, and before the first way-point nobody knows where that was. Walks without
/// way-points teach nothing; of others the learner's number comes back.
std::optional<std::uint32_t> add_survey_walk(RadioMapLearner& learner, const walk::Walk& walk);

}  // namespace fiona::radio
