#include "fiona/plugin.hpp"

#include "fiona/simulator/building_simulator.hpp"

FIONA_PLUGIN(plugin) {
  plugin.add<fiona::simulator::BuildingSimulator>("building-simulator",
                                                  "a person with a phone walks through a building");
}
