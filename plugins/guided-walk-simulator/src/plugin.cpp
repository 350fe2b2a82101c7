#include "fiona/plugin.hpp"
#include "fiona/simulator/building_simulator.hpp"

FIONA_PLUGIN(plugin) {
  plugin.add<fiona::simulator::GuidedWalkSimulator>("guided-walk-simulator",
                                                    "simulates a person with a phone who does as they are told");
}
