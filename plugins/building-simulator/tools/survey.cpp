// fiona-survey: walks through a building file with the simulated phone and writes what a surveyor would have
// recorded, for learning and testing radio maps.

#include <cstdint>
#include <exception>
#include <iostream>
#include <string>

#include <boost/program_options.hpp>

#include <fiona/building/building.hpp>
#include <fiona/error.hpp>
#include <fiona/simulator/survey.hpp>
#include <fiona/tool.hpp>

namespace {

namespace options = boost::program_options;

int run(int count, char** words) {
  std::string building_file, directory;
  std::uint64_t seed = 1;
  fiona::simulator::SurveyOptions survey;
  options::options_description shown;
  shown.add_options()("help,h", "this text")                                                      //
      ("seed", options::value(&seed)->default_value(seed), "the same seed gives the same bytes")  //
      ("output,o", options::value(&directory)->required(),
       "directory to write; must not exist or be empty")  //
      ("spacing", options::value(&survey.spacing_m)->default_value(survey.spacing_m),
       "metres between points")  //
      ("test-walks", options::value(&survey.test_walks)->default_value(survey.test_walks), "on each level");
  options::options_description all;
  all.add(shown).add_options()("building", options::value(&building_file));
  options::positional_options_description places;
  places.add("building", 1);
  options::variables_map given;
  options::store(options::command_line_parser(count, words).options(all).positional(places).run(), given);
  if (given.contains("help")) {
    std::cout << "fiona-survey BUILDING.osm --seed N -o DIRECTORY\n" << shown;
    return 0;
  }
  if (!given.contains("building")) {
    throw fiona::Error(fiona::ErrorCode::Usage, {.what = "which building is to be surveyed?",
                                                 .expected = "fiona-survey BUILDING.osm --seed N -o DIRECTORY",
                                                 .next = "fiona-survey --help"});
  }
  options::notify(given);
  if (!(survey.spacing_m >= 0.5 && survey.spacing_m <= 20.0) || survey.test_walks > 1000) {
    throw fiona::Error(fiona::ErrorCode::Usage, {.what = "the survey cannot be planned",
                                                 .expected = "--spacing from 0.5 to 20 m, --test-walks up to 1000",
                                                 .next = "fiona-survey --help"});
  }
  const auto building = fiona::building::Building::read(building_file);
  for (const std::string& warning : building.warnings()) std::cerr << building_file << ": " << warning << '\n';
  const auto report = fiona::simulator::write_survey(building, seed, directory, survey);
  for (const std::string& note : report.notes) std::cerr << note << '\n';
  std::cout << report.levels << " levels, " << report.survey_walks << " survey walks and " << report.test_walks
            << " test walks in " << directory << '\n';
  return 0;
}

}  // namespace

int main(int count, char** words) {
  return fiona::run_tool<options::error>([&] { return run(count, words); }, "  next: fiona-survey --help\n");
}
