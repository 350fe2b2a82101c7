#include "fiona/plugin.hpp"

#include "step_heading.hpp"

FIONA_PLUGIN(plugin) {
  plugin.add<fiona::step_heading::StepHeading>("step-heading",
                                               "counts steps and says how long and which way they went");
}
