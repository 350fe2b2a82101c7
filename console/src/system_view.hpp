#pragma once

#include <string>
#include <string_view>
#include <vector>

#include "shape.hpp"

namespace fiona::console {

/// Reading the host's snapshot: names looked up with near names in the refusal, and what a person calls things.

std::vector<std::string> instance_names(const control::System& system);
const control::InstanceStatus* find_instance(const control::System& system, std::string_view name);
const control::PortStatus* find_port(const control::InstanceStatus& instance, std::string_view name);

/// Throw LineError (NotFound) with near names at the word.
const control::InstanceStatus& instance_at(const control::System& system, const Word& word, const Line& line);
/// A probe as anybody can know it: those that an instance declares and those that its hull has.
struct ProbeInfo {
  std::string name;  ///< without the instance: "spread", "mode", "location.rate"
  std::string type;
  std::string unit;
  std::string doc;
};
std::vector<ProbeInfo> probes_of(const control::InstanceStatus& instance);
std::vector<ProbeInfo> probes_of(const fiona::ComponentInterface& component);

const control::PortStatus& port_at(const control::System& system, const Word& word, const Line& line);

std::string text_of(const control::PortName& name);
/// Who uses a provided port: "nav.location, viewer (attached)".
std::string clients_text(const control::PortStatus& port);
/// "LocationProvider" of "fiona.localisation.LocationProvider".
std::string short_name(std::string_view full_name);
/// "ok", "failed: …", "lost nav.imu", "waiting nav.imu": the worst first.
std::string health_text(const control::InstanceStatus& instance);
/// "connected", "waiting: provider is not active".
std::string connection_text(const control::PortStatus& port);
/// One of the providers of a port with alternatives: "wifi.location serves", "gps.location has been silent for 500 ms".
std::string alternative_text(const control::ProviderStatus& provider);
/// All of them, in their order; empty: it has no alternatives.
std::string alternatives_text(const control::PortStatus& port);
/// "50 Hz", "0.2 Hz", "-".
std::string rate_text(double rate_hz);
/// The lines of a text that is not empty.
std::vector<std::string> split_lines(std::string_view text);
/// "12 ms", "3.4 s", "never".
std::string age_text(double age_ms);
/// "85 us", "1.2 ms", "34 ms".
std::string latency_text(double latency_ms);

}  // namespace fiona::console
