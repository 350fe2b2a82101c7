#include <filesystem>
#include <fstream>
#include <iostream>
#include <sstream>
#include <string>
#include <vector>

#include <boost/program_options.hpp>

#include <fiona/error.hpp>
#include <fiona/tool.hpp>
#include <fiona/walk/dataset.hpp>

#include "beacon_map.hpp"
#include "drawn_beacons.hpp"
#include "level_map.hpp"
#include "radio_map_file.hpp"
#include "survey_csv.hpp"
#include "survey_learner.hpp"
#include "survey_plan.hpp"
#include "survey_walks.hpp"

namespace {

namespace options = boost::program_options;
namespace beacons = fiona::beacons;
using fiona::Error;
using fiona::ErrorCode;

constexpr const char* kUsage =
    "usage: fiona-beaconmap learn DIR -o FILE [--plan BUILDING.osm] [--name NAME]\n"
    "       fiona-beaconmap learn SURVEY.csv -o FILE [--name NAME]\n"
    "       fiona-beaconmap drawn BUILDING.osm -o FILE\n"
    "       fiona-beaconmap plan DIR -o BUILDING.osm --reference LAT,LON [--width METRES] [--name NAME]\n"
    "       fiona-beaconmap help\n"
    "DIR holds recorded survey walks; SURVEY.csv has the columns walk,second,x,y,level,beacon,rssi_dbm, with an\n"
    "empty beacon in a second that heard none. `drawn` takes the beacons that a building's file has\n"
    "(fiona:beacon=UUID/MAJOR/MINOR on a node), without a survey.\n";

[[noreturn]] void usage_error(const std::string& what, const std::string& found) {
  throw Error(ErrorCode::Usage, {.what = what, .found = found, .next = "fiona-beaconmap help"});
}

std::vector<fiona::radio::Journey> survey_walks(const fiona::walk::Dataset& dataset) {
  std::vector<fiona::radio::Journey> walks;
  dataset.for_each_survey_walk([&](const fiona::walk::Walk& walk) {
    walks.push_back(fiona::radio::journey_of(walk));
    return true;
  });
  return walks;
}

std::optional<fiona::building::Building> building_of(const options::variables_map& given) {
  if (given.count("plan") == 0) return std::nullopt;
  return fiona::building::Building::read(given["plan"].as<std::string>());
}

int learn(const options::variables_map& given, const std::filesystem::path& from) {
  if (given.count("output") == 0) usage_error("learn needs to know where to write", "no -o FILE");
  const bool is_folder = std::filesystem::is_directory(from);
  if (!is_folder && std::filesystem::exists(from) && given.count("plan") != 0) {
    usage_error("--plan goes with a folder of walks: a survey without steps is judged second by second, without walls",
                "--plan " + given["plan"].as<std::string>());
  }
  const auto building = building_of(given);
  const auto plan =
      building ? beacons::FloorPlan(fiona::map_server::level_map_of(*building, "plan", {})) : beacons::FloorPlan();
  const std::string output = given["output"].as<std::string>();
  const std::string name = given.count("name") != 0 ? given["name"].as<std::string>() : from.stem().string();
  beacons::BeaconMap map;
  if (is_folder) {
    const auto dataset = fiona::walk::Dataset::open(from);
    fiona::radio::check_writable(output);
    const auto walks = survey_walks(dataset);
    std::vector<beacons::SurveySecond> seconds;
    for (std::size_t i = 0; i < walks.size(); ++i) {
      const auto more = beacons::seconds_of(walks[i], static_cast<std::uint32_t>(i));
      seconds.insert(seconds.end(), more.begin(), more.end());
    }
    std::cerr << "learning from " << seconds.size() << " seconds of " << walks.size() << " walks\n";
    map = beacons::learn(seconds, name);
    std::cerr << "judging how far off positions are, which takes some minutes\n";
    beacons::learn_compass(walks, map);
    *map.mutable_accuracy() = beacons::accuracy_of(walks, plan, {});
  } else {
    const auto seconds = beacons::read_survey(from);
    fiona::radio::check_writable(output);
    std::cerr << "learning from " << seconds.size() << " seconds, which takes some minutes where they are many\n";
    map = beacons::learn(seconds, name);
    *map.mutable_accuracy() = beacons::accuracy_of(seconds, {});
  }
  if (building) beacons::set_reference(map, building->reference());
  beacons::save(map, output);
  const auto& radio = map.radio();
  std::cerr << "learnt " << map.name() << ": " << map.beacons_size() << " beacons, " << map.survey_size()
            << " places; shadowing " << radio.shadowing() << " dB alike over " << radio.shadowing_reach()
            << " m, a second's reading " << radio.reading() << " dB, receivers " << radio.offset() << " dB; covariance "
            << map.accuracy().factor() << " times the spread and at least " << map.accuracy().floor()
            << " m; written to " << output << '\n';
  return 0;
}

int drawn(const options::variables_map& given, const std::string& file) {
  if (given.count("output") == 0) usage_error("drawn needs to know where to write", "no -o FILE");
  const auto map = beacons::drawn_in(fiona::building::Building::read(file));
  beacons::save(map, given["output"].as<std::string>());
  std::cerr << map.beacons_size() << " beacons of " << map.name() << " written to " << given["output"].as<std::string>()
            << '\n';
  return 0;
}

int plan(const options::variables_map& given, const std::string& folder) {
  if (given.count("output") == 0) usage_error("plan needs to know where to write", "no -o BUILDING.osm");
  fiona::building::Wgs84 reference;
  char comma = 0;
  std::istringstream text(given.count("reference") != 0 ? given["reference"].as<std::string>() : "");
  text >> reference.latitude_deg >> comma >> reference.longitude_deg;
  if (!text || comma != ',' || std::abs(reference.latitude_deg) > 90 || std::abs(reference.longitude_deg) > 180) {
    usage_error("--reference is not a position: LAT,LON in degrees", text.str());
  }
  const double width_m = given["width"].as<double>();
  if (!(width_m >= 1.0 && width_m <= 20.0))
    usage_error("--width is out of range: 1 to 20 metres", std::to_string(width_m));
  const auto dataset = fiona::walk::Dataset::open(folder);
  const std::string name = given.count("name") != 0 ? given["name"].as<std::string>() : dataset.name();
  const std::string output = given["output"].as<std::string>();
  fiona::radio::check_writable(output);
  const auto walks = survey_walks(dataset);
  std::ofstream out(output);
  out << beacons::plan_of(walks, {name, reference, 0.5 * width_m});
  out.close();
  if (!out)
    throw Error(ErrorCode::Failed,
                {.what = "the plan cannot be written", .where = output, .next = "-o FILE names one that can"});
  std::cerr << "plan of " << name << " from " << walks.size() << " walks written to " << output << '\n';
  return 0;
}

int run(int argc, char** argv) {
  options::options_description named;
  named.add_options()("help,h", "")("output,o", options::value<std::string>(), "")(
      "name", options::value<std::string>(), "")("plan", options::value<std::string>(), "")(
      "reference", options::value<std::string>(), "")("width", options::value<double>()->default_value(4.0), "")(
      "words", options::value<std::vector<std::string>>(), "");
  options::positional_options_description words;
  words.add("words", -1);
  options::variables_map given;
  options::store(options::command_line_parser(argc, argv).options(named).positional(words).run(), given);
  const auto line =
      given.count("words") != 0 ? given["words"].as<std::vector<std::string>>() : std::vector<std::string>{};
  if (given.count("help") != 0 || (line.size() == 1 && line[0] == "help")) {
    std::cout << kUsage;
    return 0;
  }
  if (line.size() == 2 && line[0] == "learn") return learn(given, line[1]);
  if (line.size() == 2 && line[0] == "drawn") return drawn(given, line[1]);
  if (line.size() == 2 && line[0] == "plan") return plan(given, line[1]);
  usage_error(line.empty() ? "fiona-beaconmap needs a command" : "fiona-beaconmap did not understand its command",
              line.empty() ? "nothing" : line[0] + " with " + std::to_string(line.size() - 1) + " words");
}

}  // namespace

int main(int argc, char** argv) {
  return fiona::run_tool<options::error>([&] { return run(argc, argv); }, kUsage);
}
