#pragma once

#include <optional>
#include <string>

#include <google/protobuf/descriptor.h>

#include "mcap_reader.hpp"

namespace fiona::recording_player {

/// Why messages of this channel cannot be read as objects of `type`, which has its name: their encoding, or the first
/// field that differs, as between two ports (fiona::object_difference). None: they can.
std::optional<std::string> difference(const McapReader::Channel& channel, const google::protobuf::Descriptor& type);

}  // namespace fiona::recording_player
