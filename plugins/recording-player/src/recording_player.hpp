#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "fiona/component.hpp"
#include "fiona/recording_player/params.pb.h"
#include "mcap_reader.hpp"
#include "outlet.hpp"

namespace fiona::recording_player {

/// Puts what a recording holds, each message as long after it became active as it had come after the first one, or when
/// it had come, on a clock that starts where the recording does. On a virtual clock that is as fast as the components
/// behind it can work, and always the same.
class RecordingPlayer final : public Component {
 public:
  explicit RecordingPlayer(Hull& hull);

 private:
  void on_start() override;
  void on_mode(std::string_view mode) override;
  void check(const Parameters& draft) const;

  template <PushService S>
  void offer(std::string_view name, std::string_view doc) {
    outlets_.push_back(std::make_unique<OutletOf<S>>(*this, name, doc));
  }
  std::vector<std::string> asked_of(const McapReader& recording) const;
  std::vector<Outlet*> outlets_for(const McapReader::Channel& channel, std::string& why) const;
  void connect(McapReader& recording);
  [[noreturn]] void refuse_two(const std::string& one, const std::string& other, const std::string& type) const;

  void play_next();
  void play(const McapReader::Message& message);
  bool read_next();
  TimePoint recorded_begin() const { return TimePoint{Duration(static_cast<std::int64_t>(begin_ns_))}; }
  void check_clock() const;
  void tell_damage(const std::string& what);
  void end();

  Params<Parameters> params_{*this, &RecordingPlayer::check};
  std::vector<std::unique_ptr<Outlet>> outlets_{};
  Probe<double> position_{
      *this, "position", {.unit = "s", .doc = "of what was played last, since the recording's begin"}};
  Probe<std::uint64_t> damaged_{*this, "damaged", {.doc = "messages and chunks that could not be read"}};
  Timer next_message_{*this, &RecordingPlayer::play_next};

  std::unique_ptr<McapReader> recording_{};
  std::map<McapReader::ChannelId, std::vector<Outlet*>> outlets_of_{};
  std::optional<McapReader::Message> next_{};
  bool is_over_ = false;
  std::uint64_t messages_ = 0;  ///< put so far
  std::uint64_t damages_ = 0;
  std::uint64_t begin_ns_ = 0;        ///< of what is played, on the recording's clock
  Duration played_{};                 ///< since then, while it pauses
  std::optional<TimePoint> begun_{};  ///< when that was, on the instance's; none: it pauses
  TimePoint resumed_{};               ///< of messages at their own times, those before are passed over
};

}  // namespace fiona::recording_player
