#pragma once

#include <cstdint>
#include <string>
#include <string_view>
#include <utility>

#include "fiona/control.pb.h"

namespace fiona::host {

inline constexpr std::string_view kMainGroup = "main";  ///< the host's own process
/// Rights that an operator gives, and no manifest asks for: to be in no sandbox; to be in one all the same.
inline constexpr std::string_view kUnconfined = "unconfined";
inline constexpr std::string_view kConfined = "confined";
inline constexpr std::string_view kTypedByPath = "local/";  ///< begins the name of a library that is in no package
inline constexpr std::string_view kHostItself = "host";     ///< where else an instance is named

/// Of all that a host and a group have between them: the messages of wire.proto, the words that a group is started
/// with, its descriptors, the page of its strands. Another number where a build does not understand one before it.
inline constexpr std::uint32_t kGroupProtocol = 6;

using PortKey = std::pair<std::string, std::string>;  ///< instance, port

PortKey key_of(const control::PortName& name);
control::PortName port_of(const PortKey& key);
/// "nav.location".
std::string text_of(const control::PortName& name);
/// The other way round; without a dot it is an instance.
control::PortName port_named(const std::string& text);

}  // namespace fiona::host
