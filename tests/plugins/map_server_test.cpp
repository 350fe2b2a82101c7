#include "map_server.hpp"

#include <png.h>

#include <GeographicLib/LocalCartesian.hpp>
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <regex>
#include <sstream>
#include <string>
#include <utility>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "../temporary_directory.hpp"
#include "fiona/testing/bench.hpp"
#include "level_map.hpp"
#include "map_name.hpp"
#include "osm_text.hpp"

namespace fiona::map_server {
namespace {

using building::Building;
using building::Osm;
using building::Point;
using navigation::CommCoordConvRequest;
using navigation::CommRasterMap;
using navigation::CommRasterMapInfo;
using navigation::MapEdge;
using ::testing::AllOf;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using namespace std::chrono_literals;

/// A corridor 20 x 3 m, two rooms north of it with a door each, the right one for staff; stairs and a lift to level 1.
Osm house() {
  Osm osm;
  osm.node(5, 5, 3, "door=hinged level=0").node(6, 15, 3, "door=hinged level=0 width=2");
  osm.node(7, 0, 1.5, "entrance=main level=0");
  osm.node(40, 8, 1).node(41, 12, 1).node(42, 18, 1.5, "highway=elevator level=0;1").node(43, -10, 1.5);
  osm.node(10, 0, 0).node(11, 20, 0).node(12, 20, 3).node(13, 0, 3);
  osm.way(10, {10, 11, 12, 6, 5, 13, 7, 10}, "indoor=room level=0 name=Hall");
  osm.rectangle(20, 0, 3, 10, 8, "indoor=room level=0 name=Left ref=A1", {5});
  osm.rectangle(30, 10, 3, 20, 8, "indoor=room level=0 name=Right access=private", {6});
  osm.rectangle(50, 0, 0, 20, 3, "indoor=corridor level=1 name=Gallery");
  osm.way(60, {40, 41}, "highway=steps level=0;1 incline=up");
  osm.way(61, {7, 43}, "highway=footway");
  return osm;
}

std::filesystem::path written(const tests::TemporaryDirectory& folder, const std::string& text) {
  const std::filesystem::path file = folder.path / "house.osm";
  std::ofstream(file) << text;
  return file;
}

/// The same building at another latitude (east and west are nearer to each other there), and turned.
std::string moved(const std::string& text, double latitude_deg, double heading_deg) {
  static const std::regex kLatitude("lat=.([0-9.]+)");
  std::ostringstream elsewhere;
  elsewhere.precision(12);
  auto from = text.begin();
  for (std::sregex_iterator at(text.begin(), text.end(), kLatitude), end; at != end; ++at) {
    elsewhere << std::string(from, (*at)[1].first) << std::stod((*at)[1]) - 48.0 + latitude_deg;
    from = (*at)[1].second;
  }
  elsewhere << std::string(from, text.end());
  const std::string reference = "<tag k='fiona:reference' v='yes'/>";
  std::string xml = elsewhere.str();
  return xml.insert(xml.find(reference), "<tag k='fiona:heading' v='" + std::to_string(heading_deg) + "'/>");
}

/// A room whose reference is two kilometres away.
Osm far_house() {
  Osm osm;
  return osm.rectangle(20, 1600, 1200, 1620, 1210, "indoor=room level=0 name=Far");
}

constexpr const char* kAdasSession = "0123456789abcdef";

struct Served {
  explicit Served(const Osm& osm = house()) : Served(osm.text()) {}
  explicit Served(const std::string& text) : file(written(folder, text)) {
    bench.set("building", file.string());
    bench.start();
  }
  template <class S>
  auto ask(const char* port, typename S::RequestType request) {
    return bench.ask<S>(port, std::move(request));
  }
  CommRasterMap map(const std::string& name, const std::string& user = "", const std::string& session = "") {
    navigation::CommRasterMapRequest request;
    request.set_map_name(name);
    request.set_user_name(user);
    request.set_session(session);
    const auto answer = ask<navigation::RasterMapProvider>("raster", request);
    if (!answer) throw std::runtime_error(answer.reason());
    return **answer;
  }
  CommRasterMapInfo info(const std::string& name) {
    navigation::CommRasterMapInfoRequest request;
    request.set_map_name(name);
    return **ask<navigation::RasterMapInfoProvider>("info", request);
  }
  auto convert(const std::string& name, CommCoordConvRequest::CoordType type, double x, double y) {
    CommCoordConvRequest request;
    request.set_map_name(name);
    request.set_coord_type(type);
    request.set_coord_x(x);
    request.set_coord_y(y);
    return ask<navigation::CoordinateConversion>("coordinates", request);
  }
  /// The corners of a map in pixels.
  std::vector<Point> corners(const std::string& name) {
    const CommRasterMapInfo extent = info(name);
    const auto columns = static_cast<double>(extent.grid_x_size()), rows = static_cast<double>(extent.grid_y_size());
    return {{0, 0}, {columns, 0}, {0, rows}, {columns, rows}};
  }
  /// Of level 5.
  void know_ada() {
    bench.answer_with<security::SessionProvider>("sessions", [](const security::CommSessionRequest& request) {
      security::CommSession whose;
      if (request.session() != kAdasSession) return whose;
      whose.set_is_valid(true);
      whose.set_user_name("ada");
      whose.set_authentication_level(5);
      return whose;
    });
  }
  navigation::CommLevelMap levels(std::initializer_list<double> wanted = {}) {
    navigation::CommLevelMapRequest request;
    for (double level : wanted) request.add_level(level);
    return **ask<navigation::LevelMap>("levels", request);
  }

  tests::TemporaryDirectory folder;
  std::filesystem::path file;
  testing::Bench<MapServer> bench;
};

/// The cell of a grid at a place in local metres, as the contract says where it is.
int cell(const CommRasterMap& map, double x_m, double y_m) {
  const auto& grid = map.map_grid_data();
  const auto column = static_cast<std::size_t>((x_m - grid.origin().x()) / grid.cell_size());
  const auto row = static_cast<std::size_t>((y_m - grid.origin().y()) / grid.cell_size());
  return static_cast<unsigned char>(grid.cells().at(row * grid.columns() + column));
}

TEST(MapName, TheLevelIsWhatFollowsTheLastAt) {
  const auto name = MapName::parse("hall12@-0.5");
  ASSERT_TRUE(name);
  EXPECT_EQ(name->name, "hall12");
  EXPECT_EQ(name->level, -0.5);
  EXPECT_EQ(name->text(), "hall12@-0.5");
}

TEST(MapName, WithoutOneLevelItIsNone) {
  for (const char* text : {"", "hall", "hall12.png", "@1", "hall@", "hall@0;1", "hall@first", "hall@0-2"}) {
    EXPECT_FALSE(MapName::parse(text)) << text;
  }
}

TEST(MapName, AKeyIsNoPath) {
  for (const char* text : {"", "a/b", "..", "a@b", "a\nb"}) EXPECT_FALSE(is_map_name(text)) << text;
  EXPECT_TRUE(is_map_name("Albert-Einstein-Allee 55"));
}

TEST(MapServer, WallsAreOccupiedRoomsFreeAndDoorsOpen) {
  Served served;
  const CommRasterMap map = served.map("house@0");
  EXPECT_EQ(cell(map, 5, 5), 0);       // a room
  EXPECT_EQ(cell(map, 2, 3), 100);     // its wall
  EXPECT_EQ(cell(map, 5, 3), 0);       // its door
  EXPECT_EQ(cell(map, 10, 5), 100);    // between the two rooms
  EXPECT_EQ(cell(map, 10, 8.6), 255);  // out of the building
  EXPECT_EQ(map.map_grid_data().cells().size(), map.map_grid_data().columns() * map.map_grid_data().rows());
}

TEST(MapServer, RowsOfTheGridRunFromSouthToNorthAndThoseOfTheImageDown) {
  Osm osm = house();
  osm.rectangle(70, 0, 20, 5, 25, "indoor=room level=0 name=North");
  Served served(osm);
  const CommRasterMap map = served.map("house@0");
  EXPECT_EQ(cell(map, 2, 22), 0);
  EXPECT_EQ(cell(map, 18, 22), 255);
  png_image image{};
  image.version = PNG_IMAGE_VERSION;
  const std::string& bytes = map.map_raster_image();
  ASSERT_NE(png_image_begin_read_from_memory(&image, bytes.data(), bytes.size()), 0);
  image.format = PNG_FORMAT_GRAY;
  std::vector<unsigned char> grey(PNG_IMAGE_SIZE(image));
  ASSERT_NE(png_image_finish_read(&image, nullptr, grey.data(), 0, nullptr), 0);
  EXPECT_EQ(image.width, map.map_grid_data().columns());
  EXPECT_EQ(image.height, map.map_grid_data().rows());
  const auto pixel = served.info("house@0");
  const auto at = [&](double x_m, double y_m) {
    const auto x = static_cast<std::size_t>((x_m - pixel.origin().x()) / pixel.pixel_size());
    const auto y = static_cast<std::size_t>((pixel.origin().y() - y_m) / pixel.pixel_size());
    return grey[y * image.width + x];
  };
  EXPECT_EQ(at(2, 22), 255);  // the room in the north
  EXPECT_LT(at(18, 22), 255);
  EXPECT_EQ(at(0, 22), 0);  // its west wall
}

TEST(MapServer, ARoomForStaffIsOccupiedForGuestsAndFreeForStaff) {
  Served served;
  EXPECT_EQ(cell(served.map("house@0"), 15, 5), 100);
  served.know_ada();
  EXPECT_EQ(cell(served.map("house@0", "ada", kAdasSession), 15, 5), 0);
}

TEST(MapServer, AnotherUsersSessionIsRejectedAndSoIsOneThatHasEnded) {
  Served served;
  served.know_ada();
  navigation::CommLevelMapRequest request;
  request.set_user_name("bert");
  request.set_session(kAdasSession);
  EXPECT_THAT(served.ask<navigation::LevelMap>("levels", request).reason(), HasSubstr("the session is another user's"));
  request.set_user_name("ada");
  EXPECT_TRUE(served.ask<navigation::LevelMap>("levels", request));
  request.set_session(std::string(16, 'x'));
  EXPECT_THAT(served.ask<navigation::LevelMap>("levels", request).reason(),
              HasSubstr("there is no such session, or it has ended"));
}

TEST(MapServer, ANameWithoutASessionIsRejected) {
  Served served;
  navigation::CommRasterMapRequest request;
  request.set_map_name("house@0");
  request.set_user_name("ada");
  const auto answer = served.ask<navigation::RasterMapProvider>("raster", request);
  EXPECT_EQ(answer.outcome(), Outcome::Rejected);
  EXPECT_THAT(answer.reason(), HasSubstr("the request names a user and carries no session"));
  navigation::CommLevelMapRequest levels;
  levels.set_user_name("ada");
  EXPECT_EQ(served.ask<navigation::LevelMap>("levels", levels).outcome(), Outcome::Rejected);
}

TEST(MapServer, ASessionThatNobodyConfirmsIsRejected) {
  Served served;
  navigation::CommRasterMapRequest request;
  request.set_map_name("house@0");
  request.set_session("0123456789abcdef");
  const auto answer = served.ask<navigation::RasterMapProvider>("raster", request);
  EXPECT_EQ(answer.outcome(), Outcome::Rejected);
  EXPECT_THAT(answer.reason(), HasSubstr("the session could not be checked: timeout"));
}

TEST(MapServer, AnUnknownMapIsRefusedWithThoseThatThereAre) {
  Served served;
  for (const char* name : {"house@7", "home@0", "house0.png", ""}) {
    const auto answer = served.convert(name, CommCoordConvRequest::E_GEOGRAPHIC, 0, 0);
    EXPECT_THAT(answer.reason(), HasSubstr("there is no map '" + std::string(name) + "'")) << name;
    EXPECT_THAT(answer.reason(), HasSubstr("house@0, house@1")) << name;
  }
}

/// The part between two pixels, by their places in degrees.
CommRasterMap crop(Served& served, Point upper_left, Point lower_right) {
  const auto place = [&](Point p) {
    return **served.convert("house@0", CommCoordConvRequest::E_GEOGRAPHIC, p.x_m, p.y_m);
  };
  const auto from = place(upper_left), to = place(lower_right);
  navigation::CommRasterMapRequest request;
  request.set_map_name("house@0");
  request.set_map_crop_ul_lon(from.coord_conv_x());
  request.set_map_crop_ul_lat(from.coord_conv_y());
  request.set_map_crop_lr_lon(to.coord_conv_x());
  request.set_map_crop_lr_lat(to.coord_conv_y());
  const auto part = served.ask<navigation::RasterMapProvider>("raster", request);
  if (!part) throw std::runtime_error(part.reason());
  return **part;
}

TEST(MapServer, ACropIsThePartOfTheWholeBetweenItsCorners) {
  for (const std::string& text : {house().text(), far_house().text(), moved(house().text(), 48.0, 200.0)}) {
    Served served(text);
    const CommRasterMap whole = served.map("house@0"), part = crop(served, {20, 10}, {120, 70});
    const auto& grid = part.map_grid_data();
    ASSERT_EQ(grid.columns(), 100u);
    ASSERT_EQ(grid.rows(), 60u);
    for (double x_m = grid.origin().x() + 0.05; x_m < grid.origin().x() + 10; x_m += 0.1) {
      for (double y_m = grid.origin().y() + 0.05; y_m < grid.origin().y() + 6; y_m += 0.1) {
        ASSERT_EQ(cell(part, x_m, y_m), cell(whole, x_m, y_m)) << x_m << ", " << y_m;
      }
    }
  }
}

TEST(MapServer, TheGridTellsTheLevelAndTheReferenceOfItsOrigin) {
  Served served(moved(house().text(), 48.0, 30.0));
  for (const double level : {0.0, 1.0}) {
    const auto origin = served.map("house@" + building::level_text(level)).map_grid_data().origin();
    EXPECT_EQ(origin.z(), level);
    EXPECT_NEAR(origin.reference_lat(), 48.0, 1e-9);
    EXPECT_NEAR(origin.reference_heading(), 30.0, 1e-9);
  }
}

TEST(MapServer, FourZerosAreTheWholeMapAndOneCornerIsRefused) {
  Served served;
  navigation::CommRasterMapRequest request;
  request.set_map_name("house@0");
  request.set_map_crop_ul_lon(0);
  request.set_map_crop_ul_lat(0);
  request.set_map_crop_lr_lon(0);
  request.set_map_crop_lr_lat(0);
  const auto whole = served.ask<navigation::RasterMapProvider>("raster", request);
  ASSERT_TRUE(whole) << whole.reason();
  EXPECT_EQ((*whole)->map_grid_data().columns(), served.map("house@0").map_grid_data().columns());
  request.clear_map_crop_lr_lon();
  request.set_map_crop_ul_lon(10);
  EXPECT_THAT(served.ask<navigation::RasterMapProvider>("raster", request).reason(),
              HasSubstr("a part of a map needs both corners"));
}

TEST(MapServer, ACropWithoutAPixelIsRefusedWithTheExtentOfTheMap) {
  Served served;
  navigation::CommRasterMapRequest request;
  request.set_map_name("house@0");
  request.set_map_crop_ul_lon(11);
  request.set_map_crop_ul_lat(50);
  request.set_map_crop_lr_lon(12);
  request.set_map_crop_lr_lat(49);
  EXPECT_THAT(served.ask<navigation::RasterMapProvider>("raster", request).reason(),
              HasSubstr("within latitude 47.99"));
}

/// Each direction against GeographicLib, at the corners of the map.
void expect_corners_within_a_centimetre(Served& served, double latitude_deg, double longitude_deg, double heading_deg) {
  const CommRasterMapInfo info = served.info("house@0");
  const GeographicLib::LocalCartesian plane(latitude_deg, longitude_deg, 0.0);
  const double heading = heading_deg * M_PI / 180.0;
  for (const Point pixel : served.corners("house@0")) {
    const double x_m = info.origin().x() + pixel.x_m * info.pixel_size();
    const double y_m = info.origin().y() - pixel.y_m * info.pixel_size();
    const double east_m = x_m * std::cos(heading) + y_m * std::sin(heading);
    const double north_m = y_m * std::cos(heading) - x_m * std::sin(heading);
    const auto place = served.convert("house@0", CommCoordConvRequest::E_GEOGRAPHIC, pixel.x_m, pixel.y_m);
    ASSERT_TRUE(place) << place.reason();
    double east, north, up, latitude, longitude, height;
    plane.Forward((*place)->coord_conv_y(), (*place)->coord_conv_x(), 0.0, east, north, up);
    EXPECT_LT(std::hypot(east - east_m, north - north_m), 0.01);
    plane.Reverse(east_m, north_m, 0.0, latitude, longitude, height);
    const auto back = served.convert("house@0", CommCoordConvRequest::E_SYNTHETIC, longitude, latitude);
    ASSERT_TRUE(back) << back.reason();
    EXPECT_LT(std::hypot((*back)->coord_conv_x() - pixel.x_m, (*back)->coord_conv_y() - pixel.y_m) * info.pixel_size(),
              0.01);
  }
}

TEST(MapServer, PixelsAndDegreesAgreeWithGeographicLibAtTheCornersTurnedOrNotAndFarFromTheEquator) {
  for (const auto& [latitude_deg, heading_deg] :
       std::vector<std::pair<double, double>>{{48, 0}, {48, 37}, {48, -160}, {78.2, 0}, {78.2, 300}, {-54.8, 90}}) {
    SCOPED_TRACE(std::to_string(latitude_deg) + ", " + std::to_string(heading_deg));
    Served served(moved(house().text(), latitude_deg, heading_deg));
    ASSERT_NEAR(served.info("house@0").origin().reference_heading(), std::fmod(heading_deg + 360, 360), 1e-9);
    expect_corners_within_a_centimetre(served, latitude_deg, 10.0, heading_deg);
  }
}

TEST(MapServer, ACornerThatWasToldIsOnTheMap) {
  for (const std::string& text : {house().text(), far_house().text(), moved(house().text(), 78.2, 37.0)}) {
    Served served(text);
    const auto back = [&](double longitude, double latitude) {
      return served.convert("house@0", CommCoordConvRequest::E_SYNTHETIC, longitude, latitude);
    };
    for (const Point pixel : served.corners("house@0")) {
      const auto place = served.convert("house@0", CommCoordConvRequest::E_GEOGRAPHIC, pixel.x_m, pixel.y_m);
      const auto found = back((*place)->coord_conv_x(), (*place)->coord_conv_y());
      ASSERT_TRUE(found) << found.reason();
      EXPECT_NEAR((*found)->coord_conv_x(), pixel.x_m, 1e-5);
      EXPECT_NEAR((*found)->coord_conv_y(), pixel.y_m, 1e-5);
      EXPECT_TRUE(served.convert("house@0", CommCoordConvRequest::E_GEOGRAPHIC, (*found)->coord_conv_x(),
                                 (*found)->coord_conv_y()));
    }
    const CommRasterMapInfo info = served.info("house@0");
    EXPECT_TRUE(back(info.map_crop_ul_lon(), info.map_crop_ul_lat()));
    EXPECT_TRUE(back(info.map_crop_lr_lon(), info.map_crop_lr_lat()));
  }
}

TEST(MapServer, ACornerRoundedToTheSevenDecimalsOfARefusalIsOnTheMapAndTwoCentimetresBeyondIsNot) {
  Served served;
  const auto corner = served.info("house@0");
  const auto at = [&](double longitude, double latitude) {
    return served.convert("house@0", CommCoordConvRequest::E_SYNTHETIC, longitude, latitude);
  };
  const double west = corner.map_crop_ul_lon(), north = corner.map_crop_ul_lat();
  const auto rounded = at(west - 0.5e-7, north + 0.5e-7);
  ASSERT_TRUE(rounded) << rounded.reason();
  EXPECT_EQ((*rounded)->coord_conv_x(), 0.0);
  EXPECT_EQ((*rounded)->coord_conv_y(), 0.0);
  EXPECT_FALSE(at(west, north + 2e-7));
}

TEST(MapServer, TheyAgreeTwoKilometresFromTheReferenceToo) {
  Osm osm = house();
  osm.rectangle(70, 1900, 1900, 1990, 1990, "indoor=room level=0 name=Far");
  osm.rectangle(80, -1990, -1990, -1900, -1900, "indoor=room level=0 name=Away");
  Served served;
  served.bench.set("pixel_size", 1.0);
  std::ofstream(served.file) << osm.text();
  served.bench.advance(4s);
  ASSERT_GT(served.info("house@0").grid_x_size(), 3900);
  expect_corners_within_a_centimetre(served, 48.0, 10.0, 0.0);
}

TEST(MapServer, APlaceOffTheMapIsRefusedWithItsExtentInEitherDirection) {
  Served served;
  EXPECT_THAT(served.convert("house@0", CommCoordConvRequest::E_GEOGRAPHIC, -1, 0).reason(),
              HasSubstr("pixels x 0 to "));
  EXPECT_THAT(served.convert("house@0", CommCoordConvRequest::E_SYNTHETIC, 11, 48).reason(),
              HasSubstr("latitude 47.99"));
  EXPECT_THAT(served.convert("house@0", CommCoordConvRequest::E_SYNTHETIC, 1e300, 48).reason(),
              HasSubstr("is not on the map"));
  EXPECT_THAT(served.convert("house@0", CommCoordConvRequest::COORD_TYPE_UNSPECIFIED, 1, 1).reason(),
              HasSubstr("the direction of the conversion is not told"));
}

TEST(MapServer, TheExtentOfATurnedMapIsToldFromSouthToNorthAndFromWestToEast) {
  Served served(moved(house().text(), 48.0, 180.0));
  EXPECT_THAT(served.convert("house@0", CommCoordConvRequest::E_SYNTHETIC, 11, 48).reason(),
              AllOf(HasSubstr("latitude 47.99"), HasSubstr("longitude 9.999")));
}

TEST(MapServer, TheLevelMapHoldsEachKindOfEdge) {
  Served served;
  std::set<MapEdge::Kind> kinds;
  const auto map = served.levels();
  for (const MapEdge& edge : map.edges()) {
    kinds.insert(edge.kind());
    ASSERT_LT(edge.from(), static_cast<unsigned>(map.nodes_size()));
    ASSERT_LT(edge.to(), static_cast<unsigned>(map.nodes_size()));
  }
  EXPECT_THAT(kinds, ElementsAre(MapEdge::CORRIDOR, MapEdge::DOOR, MapEdge::STAIRS, MapEdge::LIFT, MapEdge::OUTDOORS));
}

TEST(MapServer, TheLevelMapNamesLevelsRoomsDoorsAndAccess) {
  Served served;
  const auto map = served.levels({0});
  EXPECT_EQ(map.name(), "house");
  ASSERT_EQ(map.levels_size(), 2);
  EXPECT_EQ(map.levels(1).map_name(), "house@1");
  ASSERT_EQ(map.rooms_size(), 3);
  EXPECT_EQ(map.rooms(1).name(), "Left");
  EXPECT_EQ(map.rooms(1).ref(), "A1");
  EXPECT_EQ(map.rooms(2).access(), 5);
  EXPECT_EQ(map.doors_size(), 3);
  EXPECT_NEAR(map.reference().reference_lat(), 48.0, 1e-9);
  for (const auto& wall : map.walls()) EXPECT_EQ(wall.level(), 0.0);
}

TEST(MapServer, AnUnknownLevelIsRefused) {
  Served served;
  navigation::CommLevelMapRequest request;
  request.add_level(9);
  EXPECT_THAT(served.ask<navigation::LevelMap>("levels", request).reason(), HasSubstr("there is no map 'house@9'"));
}

TEST(MapServer, TheSameBuildingHasTheSameVersionAndAnotherOneAnother) {
  Served one;
  Osm other = house();
  other.rectangle(70, 0, 20, 5, 25, "indoor=room level=0 name=North");
  Served two(other);
  EXPECT_NE(one.levels().version(), 0u);
  for (const auto version : {one.levels().version(), two.levels().version()}) {
    EXPECT_EQ(version >> 63, 0u) << "whole numbers are shown as signed ones";
  }
  EXPECT_EQ(one.levels().version(), one.map("house@0").map_version());
  EXPECT_NE(one.levels().version(), two.levels().version());
}

TEST(MapServer, AChangedFileIsReadAgain) {
  Served served;
  const auto before = served.levels();
  served.bench.advance(2s);
  Osm other = house();
  other.rectangle(70, 0, 20, 5, 25, "indoor=room level=0 name=North");
  std::ofstream(served.file) << other.text();
  served.bench.advance(3s);
  EXPECT_EQ(served.levels({0}).rooms_size(), 4);
  EXPECT_NE(served.levels().version(), before.version());
}

TEST(MapServer, AFileThatBecameUnreadableLeavesTheMapOfBefore) {
  Served served;
  const auto before = served.levels();
  served.bench.advance(2s);
  std::ofstream(served.file) << "<osm version='0.6'><node";
  served.bench.advance(10s);
  EXPECT_EQ(served.levels().version(), before.version());
  EXPECT_EQ(served.bench.probe<std::uint64_t>("failed_reads"), 1u);
  EXPECT_THAT(served.bench.log().back(), HasSubstr("the map of before is served on: "));
  EXPECT_EQ(served.bench.mode(), "active");
}

TEST(MapServer, AFileThatIsGoneIsToldAndCountedOnceAndReadWhenItIsBack) {
  Served served;
  const auto before = served.levels();
  served.bench.advance(2s);
  const std::filesystem::path aside = served.folder.path / "aside";
  std::filesystem::rename(served.file, aside);
  served.bench.advance(10s);
  EXPECT_EQ(served.bench.probe<std::uint64_t>("failed_reads"), 1u);
  EXPECT_THAT(served.bench.log().back(), HasSubstr("the map of before is served on: "));
  EXPECT_THAT(served.bench.log().back(), HasSubstr("there is no such file"));
  EXPECT_EQ(served.levels().version(), before.version());
  const std::size_t told = served.bench.log().size();
  std::filesystem::rename(aside, served.file);
  served.bench.advance(10s);
  EXPECT_EQ(served.bench.log().size(), told) << "the same map, in service";
  std::filesystem::remove(served.file);
  served.bench.advance(10s);
  EXPECT_EQ(served.bench.probe<std::uint64_t>("failed_reads"), 2u);
}

TEST(MapServer, TheNameOfAMapIsThatOfItsFileWithoutWhatSaysThatItIsOne) {
  for (const char* file : {"museum.osm.pbf", "museum.osm", "museum.pbf"}) {
    const tests::TemporaryDirectory folder;
    std::ofstream(folder.path / file) << house().text();
    testing::Bench<MapServer> bench;
    bench.set("building", (folder.path / file).string());
    bench.start();
    EXPECT_EQ((**bench.ask<navigation::LevelMap>("levels", {})).name(), "museum") << file;
  }
}

TEST(MapServer, ABareNameIsThatOfAFileOfThePackage) {
  const tests::TemporaryDirectory package;
  std::ofstream(package.path / "annexe.osm") << house().text();
  testing::Bench<MapServer> bench("map", package.path);
  bench.set("building", "annexe.osm");
  bench.start();
  EXPECT_EQ((**bench.ask<navigation::LevelMap>("levels", {})).name(), "annexe");
  testing::Bench<MapServer> other("map", package.path);
  other.set("building", "nowhere.osm");
  EXPECT_THROW(other.start(), Error);
}

TEST(MapServer, ACompressedFileIsRefusedWithWhatUnpacksIt) {
  const tests::TemporaryDirectory folder;
  const std::filesystem::path file = folder.path / "house.osm.gz";
  std::ofstream(file) << "\x1f\x8b\x08 and more";
  testing::Bench<MapServer> bench;
  bench.set("building", file.string());
  try {
    bench.start();
    FAIL() << "no error";
  } catch (const Error& error) {
    EXPECT_THAT(error.what(), HasSubstr("it is compressed with gzip"));
    EXPECT_THAT(error.what(), HasSubstr("unpack it first: gzip -dc < " + file.string() + " > unpacked.osm"));
  }
}

TEST(MapServer, TooManyPixelsAreRefusedWithTheSizeThatWouldDo) {
  Osm osm = house();
  osm.rectangle(70, 4000, 0, 4010, 10, "indoor=room level=0 name=Far");
  osm.rectangle(80, 0, 4000, 10, 4010, "indoor=room level=0 name=North");
  const tests::TemporaryDirectory folder;
  testing::Bench<MapServer> bench;
  bench.set("building", written(folder, osm.text()).string());
  try {
    bench.start();
    FAIL() << "no error";
  } catch (const Error& error) {
    EXPECT_THAT(error.what(), HasSubstr("would have too many pixels"));
    EXPECT_THAT(error.what(), HasSubstr("load map-server, or set it, with pixel_size=0.98 or more"));
  }
}

TEST(MapServer, ABuildingThatIsNotThereRefusesToStart) {
  testing::Bench<MapServer> bench;
  bench.set("building", "no/such/house.osm");
  try {
    bench.start();
    FAIL() << "no error";
  } catch (const Error& error) {
    EXPECT_THAT(error.what(), HasSubstr("there is no such file"));
  }
}

TEST(MapServer, OnlyThePixelSizeChangesWhileItServes) {
  Served served;
  served.bench.set("pixel_size", 0.5);
  EXPECT_EQ(served.info("house@0").pixel_size(), 0.5);
  EXPECT_THROW(served.bench.set("map_name", "home"), Error);
  EXPECT_THROW(served.bench.set("map_name", "a@b"), Error);
}

}  // namespace
}  // namespace fiona::map_server
