#include <unistd.h>

#include "animal.hpp"
#include "fiona/wire.pb.h"
#include "host_socket.hpp"

// Tells its host what only others may: of the instance "source", and of all that has a small number.
namespace {

using fiona::wire::GroupMessage;

using zoo::tell;

void forge_about(int host, std::uint64_t number) {
  GroupMessage tapped, tap_ended, mode_set, call_ended, wire_lost;
  tapped.mutable_tapped()->set_tap(number);
  tapped.mutable_tapped()->set_sequence(123'456'789);
  tap_ended.mutable_tap_ended()->set_tap(number);
  tap_ended.mutable_tap_ended()->mutable_failure()->set_what("forged");
  mode_set.mutable_mode_set()->set_change(number);
  call_ended.mutable_call_ended()->set_run(number);
  wire_lost.mutable_wire_lost()->set_wire(number);
  wire_lost.mutable_wire_lost()->set_reason("forged");
  for (const auto& one : {tapped, tap_ended, mode_set, call_ended, wire_lost}) tell(host, one);
}

void forge_about_the_source(int host) {
  GroupMessage failed, ended, logged, asked, gone;
  failed.mutable_mode_changed()->set_instance("source");
  failed.mutable_mode_changed()->set_mode("failed");
  failed.mutable_mode_changed()->set_reason("forged");
  ended.mutable_run_ended()->set_instance("source");
  logged.mutable_logged()->set_instance("source");
  logged.mutable_logged()->set_text("forged");
  asked.mutable_asked()->set_instance("source");
  gone.mutable_group_ended()->set_group("far");
  for (const auto& one : {failed, ended, logged, asked, gone}) tell(host, one);
}

}  // namespace

void zoo::act() {
  const int host = take_host_socket();
  for (std::uint64_t number = 1; number <= 100; ++number) forge_about(host, number);
  forge_about_the_source(host);
  ::_exit(0);
}
