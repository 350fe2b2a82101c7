#include "ground_task.hpp"

namespace fiona::planning {

Lists Lists::inverted(std::size_t count) const {
  Lists result(values_.get_allocator().resource());
  result.begins_.assign(count + 1, 0);
  for (const Index value : values_) ++result.begins_[value + 1];
  for (std::size_t i = 0; i < count; ++i) result.begins_[i + 1] += result.begins_[i];
  result.values_.resize(values_.size());
  List<std::size_t> next(result.begins_.begin(), result.begins_.end() - 1, values_.get_allocator());
  for (std::size_t i = 0; i < size(); ++i)
    for (const Index value : (*this)[i]) result.values_[next[value]++] = static_cast<Index>(i);
  return result;
}

}  // namespace fiona::planning
