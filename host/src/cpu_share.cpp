#include "cpu_share.hpp"

#include <utility>

namespace fiona::host {

bool CpuShare::exceeds(Time now, std::chrono::nanoseconds taken) {
  if (since_ == Time{}) {
    since_ = now;
    taken_ = taken;
  }
  if (now - since_ < kWithin) return false;
  cores_ = std::chrono::duration<double>(taken - std::exchange(taken_, taken)).count() /
           std::chrono::duration<double>(now - std::exchange(since_, now)).count();
  return most_ > 0 && cores_ > most_ && !std::exchange(held_, true);
}

}  // namespace fiona::host
