#pragma once

#include <string>

#include "fiona/localisation.pb.h"
#include "fiona/sensors.pb.h"
#include "fiona/simulator/imu_model.hpp"
#include "fiona/simulator/radio_model.hpp"
#include "fiona/simulator/walker.hpp"
#include "fiona/time.hpp"

namespace fiona::simulator {

/// The phone's reading in the platform's device axes.
sensors::GetIMU imu_message(const ImuSample& sample);

/// One row of a Wi-Fi scan; `begun` is the instance's time at the simulation's zero.
sensors::RFSignalRSSI wifi_message(const WifiReading& reading, const std::string& receiver, TimePoint begun);

/// What was heard of each beacon since the list before, as one entry: mean strength, latest time, strongest
/// first.
sensors::CommiBeaconList beacon_list(const BeaconBatch& batch, TimePoint begun);

/// Where the phone is and how it is turned: known exactly, so the covariances are zero.
localisation::CommLocation truth_message(const Truth& truth, const ImuOptions& phone);

}  // namespace fiona::simulator
