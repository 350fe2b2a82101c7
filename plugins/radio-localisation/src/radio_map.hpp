#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <unordered_map>
#include <vector>

namespace fiona::radio {

enum class Radio : std::uint8_t { WiFi = 0, Bluetooth = 1 };

/// WGS84 position of (0, 0) of the map's local east-north frame.
struct Reference {
  double latitude_deg;
  double longitude_deg;
};

/// Squares that the rasters of all levels may have together, with and without cells: 64 MiB of memory.
inline constexpr std::int64_t kMostSquares = 1 << 24;

/// A square of the map in which radio was learnt.
struct Cell {
  float x_m, y_m;         ///< centre
  float path_distance_m;  ///< to the nearest place where a survey walk went
};

/// One level: a raster of which only the squares near survey walks are cells.
struct Level {
  int level = 0;  ///< as OSM counts: ground 0
  double west_m = 0.0;
  double south_m = 0.0;
  int columns = 0;
  int rows = 0;
  std::uint32_t first_cell = 0;
  std::uint32_t cell_count = 0;
  std::vector<std::int32_t> cell_at;  ///< columns x rows, from the south-west: global cell or -1
};

/// What is expected of one transmitter in one cell, quantised as it is stored.
struct Expectation {
  std::uint16_t cell;    ///< counted from the level's first cell
  std::uint8_t rssi_q;   ///< mean RSSI when heard: dBm = -rssi_q / 2
  std::uint8_t heard_q;  ///< probability that one sweep hears it: (heard_q + 0.5) / 256
};

/// One transmitter's expectations, level by level.
struct Transmitter {
  std::string id;  ///< normalised, see normalised_id()
  Radio radio = Radio::WiFi;
  struct Span {
    std::uint32_t level_index;
    std::uint32_t begin, end;  ///< into RadioMap::expectations
    float strongest_dbm = 0;   ///< expected anywhere on the level; not stored, see RadioMap::index()
  };
  std::vector<Span> spans;
};

/// How far fixes of a filter on this map err, beside what its particles know: see calibrate().
struct Accuracy {
  double covariance_factor = 4.0;   ///< of the particles' covariance
  double covariance_floor_m = 1.5;  ///< standard deviation that no fix is better than
};

/// How a transmitter is called in the map: lower case, without the separators of a MAC address or UUID.
std::string normalised_id(std::string_view id);

/// Where which transmitter is heard how strongly, learnt from survey walks (see RadioMapLearner). A value, immutable
/// once built; a filter and its tools share one.
class RadioMap {
 public:
  std::string name;                    ///< of the building
  std::optional<Reference> reference;  ///< of the local frame, where the survey knew it
  double cell_m = 2.0;
  Accuracy accuracy;
  std::vector<Level> levels;  ///< ascending
  std::vector<Cell> cells;
  std::vector<Transmitter> transmitters;
  std::vector<Expectation> expectations;

  /// Builds the look-up tables; to be called once after the members above were filled.
  void index();

  /// Number of the transmitter, or empty: it was not heard during the survey.
  std::optional<std::uint32_t> find(std::string_view id) const;

  /// Cell that holds the point, or -1: no survey walk came near.
  std::int32_t cell_at(std::size_t level_index, double x_m, double y_m) const;

  /// Index of the level of that number.
  std::optional<std::size_t> level_index(int level) const;

  /// Sum over all Wi-Fi transmitters of log(1 - probability to be heard), per cell: what hearing nothing would say.
  std::span<const float> silence() const { return silence_; }

 private:
  std::unordered_map<std::string, std::uint32_t> by_id_;
  std::vector<float> silence_;
};

inline double expected_rssi_dbm(const Expectation& e) { return -0.5 * e.rssi_q; }
inline double heard_probability(const Expectation& e) { return (e.heard_q + 0.5) / 256.0; }

}  // namespace fiona::radio
