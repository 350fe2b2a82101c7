// PDDL texts, the domain before a byte 0xFF and the problem behind it: any bytes give operators, or one of the
// planner's own ends, within small bounds; a plan that is found is one.
#include <algorithm>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <string_view>

#include "planner.hpp"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string_view bytes(reinterpret_cast<const char*>(data), size);
  const std::size_t end = std::min(bytes.find('\xff'), bytes.size());
  fiona::planning::PlanRequest request;
  request.domain = bytes.substr(0, end);
  request.problem = bytes.substr(std::min(end + 1, bytes.size()));
  request.time_bound = std::chrono::milliseconds(50);
  request.memory_bound = std::size_t{4} << 20;
  for (const bool optimal : {false, true}) {
    request.optimal = optimal;
    const auto answer = fiona::planning::plan(request);
    using Outcome = fiona::planning::PlanAnswer::Outcome;
    if ((answer.outcome == Outcome::Solved) == !answer.message.empty()) std::abort();
    if ((answer.outcome == Outcome::BadInput) != answer.fault.has_value()) std::abort();
    if (answer.memory > request.memory_bound) std::abort();
  }
  return 0;
}
