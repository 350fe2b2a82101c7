#pragma once

#include <acme/beeper/params.fiona.hpp>
#include <fiona/component.hpp>

namespace acme::beeper {

/// Beeps as often as it is told to, then ends the run with success.
class Beeper final : public fiona::Component {
 public:
  using Component::Component;
  void on_mode(std::string_view mode) override {
    if (mode == fiona::kModeActive) beep();
  }

 private:
  void beep() {
    Beep beep;
    beep.set_number(++number_);
    beeps_.put(std::move(beep));
    if (number_ >= params_->beeps()) return end_run(0, "all beeps have sounded");
    const auto pause = std::chrono::duration<double>(params_->pause());
    next_.at(now() + std::chrono::duration_cast<fiona::Duration>(pause));
  }

  std::uint32_t number_ = 0;
  fiona::Params<Params> params_{*this};
  fiona::Provides<Beeps> beeps_{*this, "beeps"};
  fiona::Timer next_{*this, &Beeper::beep};
};

}  // namespace acme::beeper
