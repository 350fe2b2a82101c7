// Recordings: any bytes give messages or fiona::Error; what their channels say of
// their types can be compared with the types that are known.
#include <cstdint>
#include <cstdlib>

#include <sys/mman.h>
#include <unistd.h>

#include <fmt/format.h>
#include <fiona/error.hpp>

#include "fiona/localisation.pb.h"
#include "mcap_reader.hpp"
#include "outlet.hpp"
#include "schema.hpp"

namespace {

using fiona::recording_player::McapReader;

constexpr int kMostMessages = 10'000;

void play(McapReader& recording) {
  for (int i = 0; i < kMostMessages; ++i) {
    try {
      McapReader::Message message;
      const auto next = recording.next(message);
      if (next == McapReader::Next::End) return;
      if (next == McapReader::Next::Later) continue;
      fiona::localisation::CommStep step;
      if (step.ParseFromArray(message.data.data(), static_cast<int>(message.data.size())))
        fiona::recording_player::shift_times(step, 1'000'000'007);
    } catch (const fiona::Error&) {
    }
  }
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const int file = ::memfd_create("recording", MFD_CLOEXEC);
  if (file < 0 || ::write(file, data, size) != static_cast<ssize_t>(size)) std::abort();
  try {
    McapReader recording(fmt::format("/proc/self/fd/{}", file));
    std::set<McapReader::ChannelId> all;
    for (const auto& [id, channel] : recording.channels()) {
      all.insert(id);
      fiona::recording_player::difference(channel, *fiona::localisation::CommStep::descriptor());
    }
    if (recording.first_ns() > recording.last_ns()) std::abort();
    recording.select(all, recording.first_ns());
    play(recording);
  } catch (const fiona::Error&) {
  }
  ::close(file);
  return 0;
}
