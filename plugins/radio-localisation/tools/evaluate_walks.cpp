#include <cstdint>
#include <fstream>
#include <iostream>
#include <memory>
#include <string>

#include <boost/program_options.hpp>

#include <fiona/error.hpp>
#include <fiona/tool.hpp>
#include <fiona/walk/dataset.hpp>

#include "journey.hpp"
#include "radio_map_file.hpp"

namespace {

namespace options = boost::program_options;
namespace radio = fiona::radio;
namespace walk = fiona::walk;

constexpr radio::Time kOutput{200};

void write_estimates(const walk::Walk& walk, std::shared_ptr<const radio::RadioMap> map,
                     const radio::FilterOptions& options, std::ostream& out) {
  radio::RadioFilter filter(std::move(map), options);
  radio::replay(radio::journey_of(walk), filter, kOutput, [&](radio::Time time) {
    const radio::Estimate at = filter.estimate();
    if (!at.is_valid()) return;
    out << walk.name << ',' << time.count() << ',' << at.x_m << ',' << at.y_m << ',' << at.level << ','
        << at.covariance(0, 0) << ',' << at.covariance(0, 1) << ',' << at.covariance(1, 1) << '\n';
  });
}

int run(int argc, char** argv) {
  options::options_description named("usage: evaluate-walks DIR --map FILE -o OUT.csv");
  named.add_options()("help,h", "this text")("folder", options::value<std::string>(), "recorded walks")(
      "map", options::value<std::string>(), "radio map, see fiona-radiomap")(
      "output,o", options::value<std::string>(), "trace,t_ms,x,y,floor and the covariance, m^2")(
      "seed", options::value<std::uint64_t>()->default_value(1), "of the filter")(
      "particles", options::value<std::size_t>()->default_value(radio::FilterOptions{}.particles), "of the filter");
  options::positional_options_description words;
  words.add("folder", 1);
  options::variables_map given;
  options::store(options::command_line_parser(argc, argv).options(named).positional(words).run(), given);
  if (given.count("help") != 0 || given.count("folder") * given.count("map") * given.count("output") == 0) {
    (given.count("help") != 0 ? std::cout : std::cerr) << named;
    return given.count("help") != 0 ? 0 : static_cast<int>(fiona::ErrorCode::Usage);
  }
  const auto dataset = walk::Dataset::open(given["folder"].as<std::string>());
  const auto map = std::make_shared<const radio::RadioMap>(radio::load(given["map"].as<std::string>()));
  std::ofstream out(given["output"].as<std::string>());
  out << "trace,t_ms,x,y,floor,var_x,cov_xy,var_y\n";
  radio::FilterOptions filter;
  filter.seed = given["seed"].as<std::uint64_t>();
  filter.particles = given["particles"].as<std::size_t>();
  dataset.for_each_test_walk([&](const walk::Walk& walk) {
    write_estimates(walk, map, filter, out);
    return true;
  });
  out.close();
  if (!out) {
    throw fiona::Error(fiona::ErrorCode::Failed, {.what = "cannot write " + given["output"].as<std::string>(),
                                                  .next = "-o FILE names one that can"});
  }
  return 0;
}

}  // namespace

int main(int argc, char** argv) {
  return fiona::run_tool<options::error>([&] { return run(argc, argv); });
}
