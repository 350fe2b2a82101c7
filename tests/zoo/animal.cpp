#include "animal.hpp"

#include <fiona/plugin.hpp>

#include <chrono>

#include "fiona/localisation.fiona.hpp"

namespace zoo {

__attribute__((weak)) void construct() {}
__attribute__((weak)) void start() {}
__attribute__((weak)) void act() {}
__attribute__((weak)) void stop() {}
__attribute__((weak)) void destroy() {}

class Animal final : public fiona::Component {
 public:
  explicit Animal(fiona::Hull& hull) : Component(hull) { construct(); }
  ~Animal() override { destroy(); }
  void on_start() override { start(); }
  void on_stop() override { stop(); }
  void on_mode(std::string_view mode) override {
    if (mode == fiona::kModeActive) soon_.at(now() + std::chrono::milliseconds(20));
  }

  static inline thread_local Animal* acting = nullptr;
  using Component::end_run;
  using Component::log;

 private:
  void on_time() {
    acting = this;
    act();
  }

  fiona::Provides<fiona::localisation::StepProvider> steps_{*this, "steps"};
  fiona::Timer soon_{*this, &Animal::on_time};
};

void log(const char* line) { Animal::acting->log(fiona::LogLevel::Info, line); }
void end_run() { Animal::acting->end_run(0, "the zoo closes"); }

}  // namespace zoo

FIONA_PLUGIN(plugin) { plugin.add<zoo::Animal>(zoo_name()); }
