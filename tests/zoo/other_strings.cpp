// Built for the std::string of before C++11: its calls of the SDK take another type than the SDK has.
#define _GLIBCXX_USE_CXX11_ABI 0
#include <fiona/plugin.hpp>

namespace {

class Stepper final : public fiona::Component {
 public:
  using Component::Component;
  void on_start() override { log(fiona::LogLevel::Info, name()); }
};

}  // namespace

FIONA_PLUGIN(plugin) { plugin.add<Stepper>("other-strings"); }
