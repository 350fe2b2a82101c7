// The control protocol, from both ends of its socket: any bytes give messages or end the stream, in whatever pieces
// they come. What a request asks of an object's fields is answered or refused in a sentence.
#include <google/protobuf/stubs/logging.h>
#include <sys/socket.h>

#include <algorithm>
#include <array>
#include <cstdint>
#include <cstdlib>
#include <initializer_list>
#include <string>
#include <string_view>
#include <vector>

#include "control_client.hpp"
#include "field_compare.hpp"
#include "fiona/error.hpp"
#include "fiona/localisation.pb.h"
#include "fiona/probe.pb.h"
#include "inert.hpp"
#include "os/message_stream.hpp"

namespace {

using fiona::control::Reply;
using fiona::control::Request;

std::vector<std::string> requests_in(std::string_view bytes, std::size_t piece) {
  std::array<int, 2> ends{};
  if (::socketpair(AF_UNIX, SOCK_STREAM, 0, ends.data()) != 0) std::abort();
  fiona::os::Descriptor far(ends[0]);
  fiona::os::MessageStream stream{fiona::os::Descriptor(ends[1])};
  std::vector<std::string> requests;
  Request request;
  while (!bytes.empty() && !stream.closed()) {
    const auto sent = ::send(far.get(), bytes.data(), std::min(bytes.size(), piece), MSG_NOSIGNAL);
    if (sent <= 0) std::abort();
    bytes.remove_prefix(static_cast<std::size_t>(sent));
    stream.receive();
    while (stream.next(request)) requests.push_back(request.SerializeAsString());
  }
  return requests;
}

fiona::localisation::CommLocation location() {
  fiona::localisation::CommLocation object;
  object.mutable_position()->set_x(1.5);
  object.mutable_position()->add_confidence(0.25);
  object.set_is_valid(true);
  return object;
}

void check_request(const std::string& bytes) {
  Request request;
  request.ParseFromString(bytes);
  if (!request.has_expect()) return;
  static const auto kLocation = location();
  static const fiona::probe::Number kNumber;
  const auto& expect = request.expect();
  // A request itself has fields of all kinds.
  for (const google::protobuf::Message* object :
       std::initializer_list<const google::protobuf::Message*>{&kLocation, &kNumber, &request}) {
    try {
      fiona::host::compare_field(*object, expect.field(), expect.comparison(), expect.value(), "m");
    } catch (const fiona::Error& error) {
      if (error.text().what.empty()) std::abort();
    }
  }
}

void check_replies(std::string_view bytes) {
  fiona::console::FrameReader reader;
  reader.append(bytes);
  try {
    for (Reply reply; reader.next(reply);) {
      if (reply.has_failure()) fiona::console::throw_failure(reply.failure());
    }
  } catch (const fiona::Error& error) {
    const std::string text = error.what();
    if (fiona::console::inert_lines(text) != text) std::abort();
  }
}

}  // namespace

// The first byte: how long the pieces are in which the rest comes.
extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  static const auto kLogBefore = google::protobuf::SetLogHandler(nullptr);  // it tells of each garbled message
  static_cast<void>(kLogBefore);
  if (size == 0) return 0;
  const std::string_view bytes(reinterpret_cast<const char*>(data) + 1, size - 1);
  const auto requests = requests_in(bytes, 1 + data[0]);
  if (requests != requests_in(bytes, 1 << 12)) std::abort();
  for (const auto& request : requests) check_request(request);
  check_replies(bytes);
  return 0;
}
