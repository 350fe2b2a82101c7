#pragma once

#include <cstdio>
#include <filesystem>
#include <memory>
#include <mutex>
#include <string>
#include <vector>

#include "fiona/clock.hpp"

namespace fiona::host {

/// Writes each delivery of a system on a virtual clock as a line: its time in seconds, the wire, the number on the
/// wire, and the hash of the object without its secrets, or the word of a delivery without one. In the order (time,
/// wire, number): the same for the same system, whatever threads and processes it ran in.
class DeliveryLog final : public DeliveryRecorder {
 public:
  /// What may wait to be sorted. An instant with more is written in several runs, each sorted; they end where rounds
  /// of the instant do, so that this too is the same each time.
  static constexpr std::size_t kMaxLines = 65'536;

  /// Begins the file anew. Throws Error.
  explicit DeliveryLog(std::filesystem::path file);
  /// Where nobody has asked for a failure says it on standard error.
  ~DeliveryLog() override;

  /// What was recorded goes: another run begins.
  void begin_anew();
  void delivered(TimePoint at, std::string_view wire, std::uint64_t sequence, std::string_view what) override;
  void round(TimePoint at) override;
  const std::filesystem::path& file() const { return file_; }
  /// Why it could not be written; empty: it could.
  std::string failure() const;

 private:
  struct Line {
    std::string wire;
    std::uint64_t sequence;
    std::string what;
  };
  struct Closer {
    void operator()(std::FILE* file) const { std::fclose(file); }
  };
  void write();
  void note_failure();

  const std::filesystem::path file_;
  mutable std::mutex mutex_;
  std::unique_ptr<std::FILE, Closer> out_;
  std::string failure_;
  mutable bool told_ = false;  ///< that
  TimePoint at_{};
  std::vector<Line> lines_;
};

}  // namespace fiona::host
