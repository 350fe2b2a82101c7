#pragma once

#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "completion.hpp"
#include "session.hpp"

namespace fiona::console {

/// Names from the running host, asked at most once a second and never for longer than 150 ms; from store and
/// marketplace; and from the working directory.
class LivingNames final : public Names {
 public:
  explicit LivingNames(Session& session) : session_(session) {}

  const control::System* system() override;
  std::vector<std::string> plugins() override;
  std::vector<std::string> packages() override;
  std::vector<std::string> services() override;
  std::vector<std::string> parameters(const std::string& plugin) override;
  std::vector<std::string> fields(const std::string& type) override;
  std::vector<std::string> files(std::string_view begin) override;

 private:
  Session& session_;
  control::System system_;
  bool known_ = false;
  std::optional<SteadyTime> asked_;
};

}  // namespace fiona::console
