#include <filesystem>
#include <fstream>
#include <string>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <zlib.h>

#include <fiona/building/floor_folders.hpp>
#include <fiona/building/svg.hpp>
#include <fiona/error.hpp>

#include "../temporary_directory.hpp"

namespace fiona::building {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;

constexpr const char* kInfo = R"({"map_info": {"height": 50, "width": 200}})";

std::string polygon(const std::string& properties, const std::string& rings) {
  return R"({"type": "Feature", "properties": {)" + properties +
         R"(}, "geometry": {"type": "Polygon", "coordinates": )" + rings + "}}";
}

std::string outline(int floor_num) {
  return polygon(R"("name": "F", "floor_num": )" + std::to_string(floor_num),
                 "[[[10, 40], [10.004, 40], [10.004, 40.001], [10, 40.001], [10, 40]]]");
}

std::string geojson(const std::string& features) {
  return R"({"type": "FeatureCollection", "features": [)" + features + "]}";
}

std::string shop() {
  return polygon(R"("name": "Tea & Co")",
                 "[[[10.001, 40], [10.002, 40], [10.002, 40.0005], [10.001, 40.0005], [10.001, 40]]]");
}

std::string refusal(const std::string& info, const std::string& map) {
  Plan plan;
  try {
    add_floor(plan, info, map, "F1/geojson_map.json");
  } catch (const Error& error) {
    EXPECT_EQ(error.code(), ErrorCode::Failed);
    EXPECT_THAT(error.what(), HasSubstr("cannot read the floor plan F1/geojson_map.json: "));
    EXPECT_THAT(error.what(), HasSubstr("next: get the file again from its source"));
    return error.what();
  }
  ADD_FAILURE() << "nothing was refused";
  return {};
}

/// A directory of its own for each test.
class FloorFolders : public ::testing::Test {
 protected:
  FloorFolders() {
    fs::create_directories(site_ / "F1");
    std::ofstream(site_ / "F1" / "floor_info.json") << kInfo;
  }

  fs::path map() const { return site_ / "F1" / "geojson_map.json.gz"; }

  void pack(const std::string& text) const {
    gzFile file = gzopen(map().c_str(), "wb");
    gzwrite(file, text.data(), static_cast<unsigned>(text.size()));
    gzclose(file);
  }

  std::string refusal() const {
    try {
      read_floor_folders(site_);
    } catch (const Error& error) {
      return error.what();
    }
    ADD_FAILURE() << "nothing was refused";
    return {};
  }

  tests::TemporaryDirectory folder_;
  fs::path site_ = folder_.path / "site";
};

TEST(FloorPlan, TheOutlinesBoxIsAsLargeAsTheFloorAndBeginsAtItsLowerLeft) {
  Plan plan;
  add_floor(plan, kInfo, geojson(outline(1) + "," + shop()), "F1");
  ASSERT_EQ(plan.rooms.size(), 2u);
  const Box box = bounds(plan.rooms[1].polygon.outer);
  EXPECT_NEAR(box.low.x_m, 50.0, 1e-6);
  EXPECT_NEAR(box.low.y_m, 0.0, 1e-6);
  EXPECT_NEAR(box.high.x_m, 100.0, 1e-6);
  EXPECT_NEAR(box.high.y_m, 25.0, 1e-6);
  EXPECT_EQ(plan.rooms[1].name, "Tea & Co");
}

TEST(FloorPlan, FloorsCountFromOneAndMinusOneAndLevelsAscend) {
  Plan plan;
  for (const int floor : {3, -1, 1}) add_floor(plan, kInfo, geojson(outline(floor)), "F");
  ASSERT_EQ(plan.levels.size(), 3u);
  EXPECT_EQ(plan.levels[0].level, -1.0);
  EXPECT_EQ(plan.levels[1].level, 0.0);
  EXPECT_EQ(plan.levels[2].level, 2.0);
}

TEST(FloorPlan, ItIsDrawnWithTheEdgesOfItsShapesAndEscapedNames) {
  Plan plan;
  add_floor(plan, kInfo, geojson(outline(1) + "," + shop()), "F1");
  const std::string svg = floor_plan_svg(plan, {});
  EXPECT_THAT(svg, HasSubstr("stroke=\"#9aa5b1\""));
  EXPECT_THAT(svg, HasSubstr("<title>Tea &amp; Co</title>"));
}

TEST(FloorPlan, OnlyVisitedLevelsAreDrawnWhereThatIsWanted) {
  Plan plan;
  add_floor(plan, kInfo, geojson(outline(1)), "F1");
  add_floor(plan, kInfo, geojson(outline(2)), "F2");
  const Track track{"me", {{0, 1, 1, 1}, {10, 2, 2, 1}}, "", ""};
  EXPECT_THAT(floor_plan_svg(plan, {&track, 1}, {.visited_only = true}), HasSubstr(", 1 level. "));
  EXPECT_THAT(floor_plan_svg(plan, {&track, 1}), HasSubstr(", 2 levels. "));
  EXPECT_THAT(floor_plan_svg(plan, {}, {.visited_only = true}), HasSubstr(", 2 levels. "));
}

TEST(FloorPlan, ShapesThatAreNoPolygonsAreLeftOut) {
  const std::string lift = R"({"properties": {}, "geometry": {"type": "Point", "coordinates": [10.001, 40]}})";
  Plan plan;
  add_floor(plan, kInfo, geojson(outline(1) + "," + lift), "F1");
  EXPECT_EQ(plan.rooms.size(), 1u);
}

TEST(FloorPlan, TextThatIsNotJsonIsRefusedWithItsPlace) {
  EXPECT_THAT(refusal(kInfo, "{\"features\": ["), HasSubstr("parse error at line 1, column 15"));
}

TEST(FloorPlan, AFieldThatIsMissingIsNamed) {
  EXPECT_THAT(refusal(kInfo, "{}"), HasSubstr("key 'features' not found"));
  EXPECT_THAT(refusal("{}", geojson(outline(1))), HasSubstr("key 'map_info' not found"));
  EXPECT_THAT(refusal(kInfo, geojson("")), HasSubstr("array index 0 is out of range"));
}

TEST(FloorPlan, EveryCutOfTheTextIsRefused) {
  const std::string text = geojson(outline(1) + "," + shop());
  for (std::size_t size = 0; size < text.size(); ++size) {
    Plan plan;
    EXPECT_THROW(add_floor(plan, kInfo, text.substr(0, size), "F1"), Error) << size;
  }
}

TEST(FloorPlan, SizesAndFloorsThatCannotBeAreRefused) {
  EXPECT_THAT(refusal(R"({"map_info": {"height": 50, "width": -1}})", geojson(outline(1))),
              HasSubstr("floor_info.json gives it a width of -1.000000 m"));
  EXPECT_THAT(refusal(kInfo, geojson(outline(0))), HasSubstr("floor_num is 0; floors count ..., -1, 1, 2, ..."));
}

TEST(FloorPlan, AnOutlineWithoutWidthIsRefused) {
  const std::string line = polygon(R"("floor_num": 1)", "[[[10, 40], [10, 41], [10, 40]]]");
  EXPECT_THAT(refusal(kInfo, geojson(line)), HasSubstr("its first feature is no outline"));
}

TEST(FloorPlan, AShapeFarOutsideOfTheOutlineIsRefused) {
  const std::string far = polygon("", "[[[50, 40], [51, 40], [51, 41]]]");
  EXPECT_THAT(refusal(kInfo, geojson(outline(1) + "," + far)), HasSubstr("a shape lies far outside of the outline"));
}

TEST_F(FloorFolders, PackedAndPlainFilesGiveTheSame) {
  pack(geojson(outline(2) + "," + shop()));
  const Plan packed = read_floor_folders(site_);
  fs::remove(map());
  std::ofstream(site_ / "F1" / "geojson_map.json") << geojson(outline(2) + "," + shop());
  const Plan plain = read_floor_folders(site_);
  ASSERT_EQ(packed.rooms.size(), 2u);
  EXPECT_EQ(packed.rooms[1].polygon.outer, plain.rooms[1].polygon.outer);
  EXPECT_EQ(packed.name, site_.filename().string());
}

TEST_F(FloorFolders, APackedFileThatWasCutIsRefused) {
  pack(geojson(outline(2) + "," + shop()));
  fs::resize_file(map(), fs::file_size(map()) / 2);
  EXPECT_THAT(refusal(), HasSubstr("cannot read the floor plan " + map().string() + ": it is truncated or garbled"));
}

TEST_F(FloorFolders, APackedFileWithADamagedByteIsRefused) {
  pack(geojson(outline(2) + "," + shop()));
  std::fstream file(map(), std::ios::in | std::ios::out | std::ios::binary);
  file.seekp(static_cast<std::streamoff>(fs::file_size(map())) - 6);
  file.put('\x55');
  file.close();
  EXPECT_THAT(refusal(), HasSubstr("it is truncated or garbled"));
}

TEST_F(FloorFolders, AFileThatUnpacksToTooMuchIsRefused) {
  pack(std::string(17u << 20, ' '));
  EXPECT_THAT(refusal(), HasSubstr("it is larger than 16 MiB"));
}

TEST_F(FloorFolders, AFloorWithoutItsSizeNamesTheMissingFile) {
  pack(geojson(outline(1)));
  fs::remove(site_ / "F1" / "floor_info.json");
  EXPECT_THAT(refusal(), HasSubstr("floor_info.json: No such file or directory"));
}

TEST_F(FloorFolders, TwoFoldersOfOneFloorAreRefused) {
  pack(geojson(outline(1)));
  fs::copy(site_ / "F1", site_ / "F1_copy");
  EXPECT_THAT(refusal(), HasSubstr("another folder holds the same floor, F"));
}

TEST_F(FloorFolders, AFolderWithoutFloorsSaysWhatIsExpected) {
  EXPECT_THAT(refusal(), HasSubstr("this folder holds no floor plan"));
  EXPECT_THAT(refusal(), HasSubstr("a folder for each floor, with floor_info.json and geojson_map.json"));
}

}  // namespace
}  // namespace fiona::building
