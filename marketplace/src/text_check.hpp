#pragma once

#include <google/protobuf/message.h>

#include <string>
#include <string_view>

namespace fiona::marketplace {

/// Why `text` must not reach a terminal, as the end of a sentence; empty if it may: it is UTF-8 without
/// control, direction or invisible characters; line ends only where `lines` allows them.
std::string text_fault(std::string_view text, bool lines);

/// The same for every string of a message and the messages in it, descriptors excepted: "FIELD FAULT" of the
/// first that is at fault, or nothing. Fields named doc or try may have several lines.
std::string texts_fault(const google::protobuf::Message& message);

/// Parses protobuf text and checks its strings. Throws fiona::Error (Failed) with line and column.
void parse_text(std::string_view text, const std::string& where, google::protobuf::Message& message);

}  // namespace fiona::marketplace
