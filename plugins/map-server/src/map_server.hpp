#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <string_view>

#include "fiona/building/building.hpp"
#include "fiona/component.hpp"
#include "fiona/map_server/params.pb.h"
#include "fiona/navigation.fiona.hpp"
#include "fiona/security.fiona.hpp"
#include "raster.hpp"

namespace fiona::map_server {

/// Serves one building out of its OSM file: rasters, their extent, coordinates, rooms and the walking graph.
class MapServer final : public Component {
 public:
  using Component::Component;

 private:
  using Parameters = map_server::Parameters;

  /// One reading of the file. Shared with the requests whose session is being checked meanwhile; never changed.
  struct Map {
    Map(building::Building building_, std::string name_, double pixel_m);

    building::Building building;
    std::string name;
    PixelFrame frame;
    std::uint64_t version;
  };
  struct Stamp {
    std::filesystem::file_time_type time{};
    std::uintmax_t size = 0;
    bool operator==(const Stamp&) const = default;
  };

  void on_start() override;
  void check(const Parameters& draft) const;
  void changed();

  std::filesystem::path file() const;
  std::shared_ptr<const Map> read() const;
  void use(std::shared_ptr<const Map> map);
  void look();
  Stamp stamp() const;

  double level_of(const Map& map, const std::string& map_name) const;
  Async<int> access_of(std::string user_name, std::string session);

  Async<navigation::CommRasterMap> on_map(const navigation::CommRasterMapRequest& request);
  navigation::CommRasterMapInfo on_info(const navigation::CommRasterMapInfoRequest& request);
  navigation::CommCoordConv on_coordinates(const navigation::CommCoordConvRequest& request);
  Async<navigation::CommLevelMap> on_levels(const navigation::CommLevelMapRequest& request);
  std::optional<navigation::LevelMapVersion> differs(navigation::LevelMapVersion& known,
                                                     const navigation::LevelMapVersion& now);

  Params<Parameters> params_{*this, &MapServer::check, &MapServer::changed};
  Requires<security::SessionProvider> sessions_{
      *this, "sessions", {.optional = true, .doc = "whose a session is; without it there are guests only"}};
  Provides<navigation::RasterMapProvider> raster_{*this, "raster", &MapServer::on_map};
  Provides<navigation::RasterMapInfoProvider> info_{*this, "info", &MapServer::on_info};
  Provides<navigation::CoordinateConversion> coordinates_{*this, "coordinates", &MapServer::on_coordinates};
  Provides<navigation::LevelMap> levels_{*this, "levels", &MapServer::on_levels};
  Provides<navigation::LevelMapChange> change_{*this, "map_change", &MapServer::differs};
  Probe<std::uint64_t> version_{*this, "version", {.doc = "of the map that is served now"}};
  Probe<std::uint64_t> failed_reads_{*this, "failed_reads", {.doc = "changes of the file that could not be read"}};
  Task look_{*this, "look", std::chrono::milliseconds(1000), &MapServer::look};

  std::shared_ptr<const Map> map_{};
  Stamp seen_{};  ///< of the file when it was last looked at
  Stamp read_{};  ///< of the file when it was last read, whether that worked or not
  std::uint64_t failures_ = 0;
};

}  // namespace fiona::map_server
