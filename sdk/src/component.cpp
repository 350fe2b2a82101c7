#include "fiona/component.hpp"

#include <utility>

#include "fiona/hull.hpp"

namespace fiona {

const std::string& Component::name() const { return hull_.name(); }
TimePoint Component::now() const { return hull_.clock().now(); }
TimePoint Component::clock_start() const { return hull_.clock().start(); }

std::filesystem::path Component::resource(std::string_view relative) const {
  const auto path = hull_.share() / relative;
  std::error_code error;
  if (!hull_.share().empty() && std::filesystem::exists(path, error)) return path;
  throw Error(ErrorCode::NotFound,
              {.what = "the package of '" + name() + "' has no file '" + std::string(relative) + "'",
               .where = hull_.share().string(),
               .next = "install the package again, or list the file in its SHARE"});
}

void Component::end_run(int exit_code, std::string reason) { hull_.events().run_ended(name(), exit_code, reason); }

void Component::cancel_calls(bool on, std::optional<Pattern> pattern) { hull_.cancel_calls(on, pattern); }

void Component::spawn(Async<> work) { hull_.spawn(std::move(work)); }

void Component::log(LogLevel level, std::string_view text) const { hull_.events().logged(name(), level, text); }

}  // namespace fiona
