// Components that throw something, each from one of the places where the platform calls a component.
#include <pthread.h>
#include <unwind.h>
#include <fiona/plugin.hpp>

#include <chrono>
#include <stdexcept>

#include "fiona/localisation.fiona.hpp"

namespace fiona::zoo {
namespace {

enum class Place { Constructor, Start, Mode, Timer, Task, Own, Coroutine, Stop };

void throw_std() { throw std::runtime_error("the antenna fell off"); }
void throw_int() { throw 42; }
/// Of another language: the run-time library of C++ can catch it, and knows nothing about it.
void throw_foreign() {
  static _Unwind_Exception foreign{};
  foreign.exception_class = 0x464f524549474e00;  // "FOREIGN"
  ::_Unwind_RaiseException(&foreign);
}

/// A forced unwind, which nobody may end.
void end_thread() { ::pthread_exit(nullptr); }

template <void (*kThrow)(), Place kPlace>
class Throws final : public Component {
 public:
  explicit Throws(Hull& hull) : Component(hull) { at(Place::Constructor); }
  void on_start() override { at(Place::Start); }
  void on_mode(std::string_view mode) override {
    at(Place::Mode);
    if (mode == kModeActive) soon_.at(now());
  }
  void on_stop() override { at(Place::Stop); }

 private:
  static void at(Place place) {
    if (place == kPlace) kThrow();
  }
  void on_time() {
    at(Place::Timer);
    hull().spawn(coroutine(), [] {});
  }
  void tick() { at(Place::Task); }
  void listen(const OwnThread& own) {
    at(Place::Own);
    own.wait_for(std::chrono::hours(1));
  }
  static Async<> coroutine() {
    at(Place::Coroutine);
    co_return;
  }

  Provides<localisation::StepProvider> steps_{*this, "steps"};
  Timer soon_{*this, &Throws::on_time};
  Task ticker_{*this, "ticker", std::chrono::milliseconds(5), &Throws::tick};
  Task listener_{*this, "listener", free_running, &Throws::listen};
};

template <void (*kThrow)()>
void add(Plugin& plugin, const std::string& what) {
  plugin.add<Throws<kThrow, Place::Constructor>>(what + "-in-constructor");
  plugin.add<Throws<kThrow, Place::Start>>(what + "-in-start");
  plugin.add<Throws<kThrow, Place::Mode>>(what + "-in-mode");
  plugin.add<Throws<kThrow, Place::Timer>>(what + "-in-timer");
  plugin.add<Throws<kThrow, Place::Task>>(what + "-in-task");
  plugin.add<Throws<kThrow, Place::Own>>(what + "-in-own");
  plugin.add<Throws<kThrow, Place::Coroutine>>(what + "-in-coroutine");
  plugin.add<Throws<kThrow, Place::Stop>>(what + "-in-stop");
}

}  // namespace
}  // namespace fiona::zoo

FIONA_PLUGIN(plugin) {
  fiona::zoo::add<fiona::zoo::throw_std>(plugin, "std");
  fiona::zoo::add<fiona::zoo::throw_int>(plugin, "int");
  fiona::zoo::add<fiona::zoo::throw_foreign>(plugin, "foreign");
  fiona::zoo::add<fiona::zoo::end_thread>(plugin, "end");
}
