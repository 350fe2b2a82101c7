#include "components.hpp"
#include "pattern_components.hpp"

FIONA_PLUGIN(plugin) {
  fiona::test::add_pacing(plugin);
  fiona::test::add_push(plugin);
  fiona::test::add_query(plugin);
  fiona::test::add_calls(plugin);
  fiona::test::add_state(plugin);
  fiona::test::add_tasks(plugin);
  fiona::test::add_rewiring(plugin);
  fiona::test::add_alternatives(plugin);
  fiona::test::add_master(plugin);
  fiona::test::add_silence(plugin);
  fiona::test::add_standing(plugin);
  fiona::test::add_pattern_components(plugin);
  fiona::test::add_monitoring(plugin);
  fiona::test::add_virtual_time(plugin);
  fiona::test::add_holding(plugin);
  fiona::test::add_whole(plugin);
}
