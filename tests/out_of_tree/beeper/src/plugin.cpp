#include <fiona/plugin.hpp>

#include "beeper.hpp"

FIONA_PLUGIN(plugin) { plugin.add<acme::beeper::Beeper>("beeper", "beeps, then ends the run"); }
