#include <cmath>
#include <filesystem>
#include <iomanip>
#include <iostream>
#include <optional>
#include <string>
#include <vector>

#include <boost/program_options.hpp>

#include <fiona/error.hpp>
#include <fiona/tool.hpp>
#include <fiona/walk/dataset.hpp>

#include "accuracy.hpp"
#include "radio_map_file.hpp"
#include "survey.hpp"

namespace {

namespace options = boost::program_options;
using fiona::Error;
using fiona::ErrorCode;

constexpr const char* kUsage =
    "usage: fiona-radiomap learn DIR -o FILE [--name NAME] [--reference LAT,LON] [--cell METRES]\n"
    "       fiona-radiomap info FILE\n"
    "       fiona-radiomap help\n";

[[noreturn]] void usage_error(const std::string& what, const std::string& found) {
  throw Error(
      ErrorCode::Usage,
      {.what = what, .expected = "learn DIR -o FILE, or info FILE", .found = found, .next = "fiona-radiomap help"});
}

fiona::radio::Reference parse_reference(const std::string& text) {
  std::size_t used = 0;
  try {
    const double latitude = std::stod(text, &used);
    if (used < text.size() && text[used] == ',') {
      const std::string rest = text.substr(used + 1);
      const double longitude = std::stod(rest, &used);
      if (used == rest.size() && std::abs(latitude) <= 90.0 && std::abs(longitude) <= 180.0) {
        return {latitude, longitude};
      }
    }
  } catch (const std::logic_error&) {  // not numbers: told below
  }
  throw Error(ErrorCode::Usage, {.what = "--reference is not a position",
                                 .expected = "LAT,LON in degrees, such as 49.4611419,11.1109429",
                                 .found = text,
                                 .next = "fiona-radiomap help"});
}

int learn(const options::variables_map& given, const std::string& folder) {
  if (given.count("output") == 0) usage_error("learn needs to know where to write", "no -o FILE");
  const std::string output = given["output"].as<std::string>();
  std::optional<fiona::radio::Reference> reference;
  if (given.count("reference") != 0) reference = parse_reference(given["reference"].as<std::string>());
  const auto dataset = fiona::walk::Dataset::open(folder);
  fiona::radio::LearnerOptions learner_options;
  learner_options.cell_m = given["cell"].as<double>();
  if (!(learner_options.cell_m >= 0.5 && learner_options.cell_m <= 20.0)) {
    usage_error("--cell is out of range: 0.5 to 20 metres", std::to_string(learner_options.cell_m));
  }
  fiona::radio::check_writable(output);
  fiona::radio::RadioMapLearner learner(learner_options);
  std::vector<fiona::radio::SurveyedJourney> journeys;
  dataset.for_each_survey_walk([&](const fiona::walk::Walk& walk) {
    if (const auto number = fiona::radio::add_survey_walk(learner, walk)) {
      journeys.push_back({*number, fiona::radio::journey_of(walk)});
    }
    return true;
  });
  auto map = learner.learn(given.count("name") != 0 ? given["name"].as<std::string>() : dataset.name());
  map.reference = reference;
  map.accuracy = fiona::radio::fit_accuracy(fiona::radio::left_out_fixes(learner, journeys));
  fiona::radio::save(map, output);
  std::cerr << "learnt " << map.name << " from " << learner.walks() << " walks: " << map.levels.size() << " levels, "
            << map.transmitters.size() << " transmitters, " << std::filesystem::file_size(output) / 1024 << " KiB in "
            << output << '\n';
  return 0;
}

int info(const std::string& file) {
  const auto map = fiona::radio::load(file);
  std::cout << "name          " << map.name << '\n';
  if (map.reference) {
    std::cout << "reference     " << std::setprecision(10) << map.reference->latitude_deg << ','
              << map.reference->longitude_deg << '\n';
  }
  std::size_t beacons = 0;
  for (const auto& transmitter : map.transmitters) beacons += transmitter.radio == fiona::radio::Radio::Bluetooth;
  std::cout << "transmitters  " << map.transmitters.size() - beacons << " Wi-Fi, " << beacons << " Bluetooth\n"
            << "cells         " << map.cells.size() << " of " << map.cell_m << " m\n"
            << "accuracy      " << map.accuracy.covariance_factor << " times the spread's variance, and at least "
            << map.accuracy.covariance_floor_m << " m\n"
            << std::fixed << std::setprecision(1);
  for (const auto& level : map.levels) {
    std::cout << "level " << std::setw(4) << level.level << "    x " << level.west_m << " .. "
              << level.west_m + level.columns * map.cell_m << " m, y " << level.south_m << " .. "
              << level.south_m + level.rows * map.cell_m << " m, " << level.cell_count << " cells\n";
  }
  return 0;
}

int run(int argc, char** argv) {
  options::options_description named;
  named.add_options()("help,h", "")("output,o", options::value<std::string>(), "")(
      "name", options::value<std::string>(), "")("reference", options::value<std::string>(), "")(
      "cell", options::value<double>()->default_value(fiona::radio::LearnerOptions{}.cell_m), "")(
      "words", options::value<std::vector<std::string>>(), "");
  options::positional_options_description words;
  words.add("words", -1);
  options::variables_map given;
  // A reference may begin with a minus, which must not look like an option: long ones need their `=`.
  options::store(options::command_line_parser(argc, argv).options(named).positional(words).run(), given);
  const auto line =
      given.count("words") != 0 ? given["words"].as<std::vector<std::string>>() : std::vector<std::string>{};
  if (given.count("help") != 0 || (line.size() == 1 && line[0] == "help")) {
    std::cout << kUsage;
    return 0;
  }
  if (line.size() == 2 && line[0] == "learn") return learn(given, line[1]);
  if (line.size() == 2 && line[0] == "info") return info(line[1]);
  usage_error(line.empty() ? "fiona-radiomap needs a command" : "fiona-radiomap did not understand its command",
              line.empty() ? "nothing" : line[0] + " with " + std::to_string(line.size() - 1) + " words");
}

}  // namespace

int main(int argc, char** argv) {
  return fiona::run_tool<options::error>([&] { return run(argc, argv); }, kUsage);
}
