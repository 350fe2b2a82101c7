// The service catalogue of the source document (3.1, and figure 2) against the protos, row by row.
//
// FIONA_CATALOGUE_TABLE and FIONA_CATALOGUE_DESCRIPTORS are the paths of catalogue.csv and of a descriptor
// set made with --include_source_info.

#include "catalogue.hpp"

#include <gmock/gmock.h>
#include <google/protobuf/descriptor.pb.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <fstream>
#include <memory>
#include <set>

#include "fiona/hmi.pb.h"
#include "fiona/localisation.pb.h"
#include "fiona/navigation.pb.h"
#include "fiona/options.pb.h"
#include "fiona/perception.pb.h"
#include "fiona/security.pb.h"
#include "fiona/sensors.pb.h"

namespace fiona::catalogue {
namespace {

using google::protobuf::DescriptorPool;
using google::protobuf::FileDescriptor;
using google::protobuf::FileDescriptorProto;
using google::protobuf::FileDescriptorSet;
using ::testing::ElementsAre;
using ::testing::IsEmpty;
using ::testing::StartsWith;

using Edit = void (*)(FileDescriptorProto&);

// The protos with their comments; `edit` may break one file on the way, to see that it is noticed.
std::unique_ptr<DescriptorPool> load_pool(const std::string& edited_file = "", Edit edit = nullptr) {
  std::ifstream file(FIONA_CATALOGUE_DESCRIPTORS, std::ios::binary);
  FileDescriptorSet set;
  EXPECT_TRUE(set.ParseFromIstream(&file)) << FIONA_CATALOGUE_DESCRIPTORS;
  auto pool = std::make_unique<DescriptorPool>();
  for (FileDescriptorProto& proto : *set.mutable_file()) {
    if (proto.name() == edited_file) edit(proto);
    EXPECT_NE(pool->BuildFile(proto), nullptr) << proto.name();
  }
  return pool;
}

const DescriptorPool& protos() {
  static const std::unique_ptr<DescriptorPool> pool = load_pool();
  return *pool;
}

std::vector<Row> table() { return read_table(FIONA_CATALOGUE_TABLE); }

// Numbers that count or name, and measure nothing.
std::vector<std::string> dimensionless() {
  return {"fiona.sensors.CommiBeacon.major",
          "fiona.sensors.CommiBeacon.minor",
          "fiona.perception.PointObjectLocation.obj_id",
          "fiona.perception.VolumeObjectLocation.obj_id",
          "fiona.localisation.CommBasePose.update_count",
          "fiona.navigation.CommPlan.line",
          "fiona.navigation.CommPlan.column",
          "fiona.hmi.CommUserProfileReply.authentication_level",
          "fiona.hmi.Instruction.number",
          "fiona.security.CommSession.authentication_level",
          "fiona.hmi.PointsOfAttentionReply.refused",
          "fiona.navigation.CommRasterMap.map_version",
          "fiona.navigation.CommRasterMapInfo.map_version",
          "fiona.navigation.MapRoom.access",
          "fiona.navigation.MapDoor.access",
          "fiona.navigation.MapEdge.from",
          "fiona.navigation.MapEdge.to",
          "fiona.navigation.MapEdge.access",
          "fiona.navigation.CommLevelMap.version",
          "fiona.navigation.LevelMapVersion.version"};
}

std::vector<std::string> compare_with_broken_row(const std::string& object, const std::string& attribute,
                                                 void (*break_row)(Row&)) {
  std::vector<Row> rows = table();
  const auto row = std::find_if(rows.begin(), rows.end(), [&](const Row& candidate) {
    return candidate.object == object && candidate.attribute == attribute;
  });
  if (row == rows.end()) return {"the table has no row " + object + "." + attribute};
  break_row(*row);
  row->line = 1;
  return compare(rows, protos());
}

// Comments left out: the compiled descriptors have none.
std::string text_of(const FileDescriptor& file) {
  FileDescriptorProto proto;
  file.CopyTo(&proto);
  file.CopyJsonNameTo(&proto);  // protoc writes them into the set; without this call they are left out here
  return proto.DebugString();
}

TEST(Catalogue, TheTableHoldsThe23ServicesOfTheDocument) {
  std::map<std::string, int> services_by_pattern;
  std::set<std::string> seen;
  for (const Row& row : table()) {
    if (!row.service.empty() && seen.insert(row.service).second) ++services_by_pattern[row.pattern];
  }
  EXPECT_EQ(seen.size(), 23U);
  EXPECT_EQ(services_by_pattern["Push Timed"], 9);
  EXPECT_EQ(services_by_pattern["Push Newest"] + services_by_pattern["Push newest"], 6);
  EXPECT_EQ(services_by_pattern["Query"], 6);
  EXPECT_EQ(services_by_pattern["Send"], 1);
  EXPECT_EQ(services_by_pattern["Event"], 1);
}

TEST(Catalogue, TheProtosHold23ServicesAndTheAddedOnes) {
  std::vector<std::string> added;
  int from_the_document = 0;
  for (const std::string& area : areas()) {
    const FileDescriptor* file = protos().FindFileByName("fiona/" + area + ".proto");
    ASSERT_NE(file, nullptr) << area;
    for (int i = 0; i < file->service_count(); ++i) {
      const bool is_added = file->service(i)->options().GetExtension(fiona::document_service) == "added";
      if (is_added) added.push_back(file->service(i)->full_name());
      from_the_document += is_added ? 0 : 1;
    }
  }
  EXPECT_EQ(from_the_document, 23);
  EXPECT_THAT(added, ElementsAre("fiona.localisation.StepProvider", "fiona.navigation.LevelMap",
                                 "fiona.navigation.LevelMapChange", "fiona.navigation.PlanProvider",
                                 "fiona.security.SessionProvider", "fiona.security.LogoutProvider",
                                 "fiona.hmi.InstructionProvider", "fiona.hmi.ProfileUpdate"));
}

TEST(Catalogue, EveryServiceObjectAndAttributeOfTheDocumentIsInTheProtosAndNothingElseUnmarked) {
  EXPECT_THAT(compare(table(), protos()), IsEmpty());
}

TEST(Catalogue, EveryFieldHasDocUnitAndBoundsAndEveryServiceAContract) {
  EXPECT_THAT(check_rules(protos(), dimensionless()), IsEmpty());
}

TEST(Catalogue, TheCompiledDescriptorsAreThoseOfTheProtoFiles) {
  const FileDescriptor* compiled[] = {fiona::sensors::GetIMU::descriptor()->file(),
                                      fiona::perception::CommObstacle::descriptor()->file(),
                                      fiona::localisation::CommStep::descriptor()->file(),
                                      fiona::navigation::CommPath::descriptor()->file(),
                                      fiona::security::CommAuthenticationRequest::descriptor()->file(),
                                      fiona::hmi::NextTurn::descriptor()->file()};
  for (const FileDescriptor* file : compiled) {
    const FileDescriptor* source = protos().FindFileByName(file->name());
    ASSERT_NE(source, nullptr) << file->name();
    EXPECT_TRUE(text_of(*file) == text_of(*source)) << file->name();
  }
}

TEST(Catalogue, AWrongUnitIsNamedWithLineAndField) {
  EXPECT_THAT(compare_with_broken_row("GetIMU", "Yaw_g", [](Row& row) { row.unit = "rad"; }),
              ElementsAre("line 1: fiona.sensors.GetIMU.yaw_g has unit \"deg/s\", expected \"rad\""));
}

TEST(Catalogue, AWrongTypeIsNamedWithBothTypes) {
  EXPECT_THAT(compare_with_broken_row("SVi", "range", [](Row& row) { row.type = "Float"; }),
              ElementsAre("line 1: fiona.sensors.SVi.range is int32, expected float for \"Float\""));
}

TEST(Catalogue, ATypeWithoutARuleNeedsADecision) {
  EXPECT_THAT(
      compare_with_broken_row("RequestPointsOfAttention", "Points of Attention",
                              [](Row& row) { row.decision.clear(); }),
      ElementsAre("line 1: type \"List of Integers (2 x n)\" has no proto type and no decision",
                  "line 1: fiona.hmi.RequestPointsOfAttention.points_of_attention has unit \"\", expected \"m\""));
}

TEST(Catalogue, ANarrowIntegerWithoutItsRangeIsNamed) {
  EXPECT_THAT(
      compare_with_broken_row("PointObjectLocation", "ObjID", [](Row& row) { row.type = "UInt8"; }),
      ElementsAre("line 1: fiona.perception.PointObjectLocation.obj_id keeps the document's type as \"UInt16\", "
                  "expected \"UInt8\"",
                  "line 1: fiona.perception.PointObjectLocation.obj_id does not carry the range of UInt8"));
}

TEST(Catalogue, AnArrayOfAnotherLengthIsNamed) {
  EXPECT_THAT(compare_with_broken_row("CommOrientation", "confidence", [](Row& row) { row.type = "Double[6]"; }),
              ElementsAre("line 1: fiona.localisation.CommOrientation.confidence keeps the document's type as "
                          "\"Double[9]\", expected \"Double[6]\"",
                          "line 1: fiona.localisation.CommOrientation.confidence has size 9, expected 6"));
}

TEST(Catalogue, AMissingAttributeAndAFieldWithoutARowAreBothNamed) {
  EXPECT_THAT(compare_with_broken_row("CommObstacle", "Obstacle", [](Row& row) { row.attribute = "Distance"; }),
              ElementsAre("line 1: fiona.perception.CommObstacle has no field for attribute \"Distance\"",
                          "fiona.perception.CommObstacle.obstacle has no row in the table and is not marked as "
                          "added"));
}

TEST(Catalogue, AWrongPatternIsNamedWithItsMethods) {
  EXPECT_THAT(compare_with_broken_row("CommObstacle", "Obstacle", [](Row& row) { row.pattern = "Send"; }),
              ElementsAre("line 1: fiona.perception.ObstacleProvider has pattern PUSH_NEWEST, expected SEND",
                          "line 1: fiona.perception.ObstacleProvider.Object takes fiona.None, expected "
                          "fiona.perception.CommObstacle",
                          "line 1: fiona.perception.ObstacleProvider.Object returns "
                          "fiona.perception.CommObstacle, expected fiona.None"));
}

TEST(Catalogue, AnUnknownServiceIsNamed) {
  EXPECT_THAT(compare_with_broken_row("NextTurn", "DistanceToTurn", [](Row& row) { row.service = "GlobalPath"; }),
              ElementsAre("line 1: service \"GlobalPath\" is not in fiona/hmi.proto"));
}

TEST(Catalogue, ADecisionWithoutACommentInTheProtoIsNamed) {
  EXPECT_THAT(compare_with_broken_row("GetIMU", "Out_x_m", [](Row& row) { row.decision["meaning"] = ""; }),
              ElementsAre("line 1: fiona.sensors.GetIMU.out_x_m has a decision in the table and no comment in the "
                          "proto"));
}

TEST(Catalogue, AnUnmarkedFieldInTheProtoIsNamed) {
  const auto pool = load_pool("fiona/hmi.proto", [](FileDescriptorProto& file) {
    auto& field = *file.mutable_message_type(0)->add_field();
    field.set_name("street");
    field.set_number(99);
    field.set_type(google::protobuf::FieldDescriptorProto::TYPE_STRING);
    field.set_label(google::protobuf::FieldDescriptorProto::LABEL_OPTIONAL);
  });
  EXPECT_THAT(compare(table(), *pool),
              ElementsAre("fiona.hmi.NextTurn.street has no row in the table and is not marked as added"));
  EXPECT_THAT(check_rules(*pool, dimensionless()),
              ElementsAre("fiona.hmi.NextTurn.street has no doc",
                          "fiona.hmi.NextTurn.street may grow without bound: no size, no max_size"));
}

TEST(Catalogue, ANumberWithoutAUnitAndASensorSilentOnUncertaintyAreNamed) {
  const auto pool = load_pool("fiona/perception.proto", [](FileDescriptorProto& file) {
    file.clear_source_code_info();
    file.mutable_message_type(0)->mutable_field(1)->mutable_options()->ClearExtension(fiona::unit);
  });
  EXPECT_THAT(check_rules(*pool, dimensionless()),
              ElementsAre("fiona.perception.PointObjectLocation.position_x is a number without a unit",
                          "fiona.perception.PointObjectLocation does not say where its uncertainty is carried",
                          "fiona.perception.VolumeObjectLocation does not say where its uncertainty is carried",
                          "fiona.perception.CommObstacle does not say where its uncertainty is carried"));
}

TEST(Catalogue, ARangeThatRefusesAnUnsetFieldIsNamed) {
  const auto pool = load_pool("fiona/security.proto", [](FileDescriptorProto& file) {
    auto& field = *file.mutable_message_type(1)->mutable_field(0);
    field.set_type(google::protobuf::FieldDescriptorProto::TYPE_INT32);
    field.mutable_options()->SetExtension(fiona::min, 1);
    field.mutable_options()->SetExtension(fiona::unit, "m");
  });
  EXPECT_THAT(check_rules(*pool, dimensionless()),
              ElementsAre("fiona.security.CommAuthenticationResponse.access_granted is refused when nobody sets "
                          "it: 0 is out of its range"));
}

TEST(Catalogue, ThePasswordIsMarkedAsSecret) {
  const auto* password = protos().FindFieldByName("fiona.security.CommAuthenticationRequest.password");
  ASSERT_NE(password, nullptr);
  EXPECT_TRUE(password->options().GetExtension(fiona::secret));
}

TEST(Catalogue, ASessionHas128BitsAndIsMarkedAsSecretWhereverItTravels) {
  for (const char* message : {"security.CommAuthenticationResponse", "hmi.CommUserProfileRequest",
                              "navigation.CommRasterMapRequest", "navigation.CommLevelMapRequest"}) {
    const auto* session = protos().FindFieldByName("fiona." + std::string(message) + ".session");
    ASSERT_NE(session, nullptr) << message;
    EXPECT_EQ(session->type(), google::protobuf::FieldDescriptor::TYPE_BYTES) << message;
    EXPECT_EQ(session->options().GetExtension(fiona::size), 16U) << message;
    EXPECT_TRUE(session->options().GetExtension(fiona::secret)) << message;
  }
}

TEST(CatalogueTable, ADecisionOfNoKnownKindIsRefusedWithItsLine) {
  const std::string path = ::testing::TempDir() + "catalogue-with-a-wrong-decision.csv";
  std::ofstream(path) << "area,service,pattern,role,object,attribute,type,unit,description,decision\n"
                      << "hmi,LocalPath,Push newest,object,NextTurn,DistanceToTurn,Uint16,mm,,colour=red\n";
  try {
    read_table(path);
    FAIL() << "no exception";
  } catch (const std::runtime_error& error) {
    EXPECT_EQ(error.what(), path + ": line 2: decision \"colour\" is none of type, unit, fields, meaning");
  }
}

TEST(CatalogueTable, AMissingFileIsRefusedWithItsName) {
  try {
    read_table("no-such-table.csv");
    FAIL() << "no exception";
  } catch (const std::runtime_error& error) {
    EXPECT_THAT(error.what(), StartsWith("no-such-table.csv: line 1: expected the header"));
  }
}

}  // namespace
}  // namespace fiona::catalogue
