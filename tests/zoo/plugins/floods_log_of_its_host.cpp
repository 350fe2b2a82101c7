#include <thread>

#include "animal.hpp"
#include "fiona/wire.pb.h"
#include "host_socket.hpp"

// Has its host write long lines in its own name, without the bound that its process has for them.
void zoo::act() {
  std::thread([] {
    const int host = take_host_socket();
    fiona::wire::GroupMessage line;
    line.mutable_logged()->set_instance("captor");
    line.mutable_logged()->set_text(std::string(10'000, 'x'));
    while (for_ever) tell(host, line);
  }).detach();
}
