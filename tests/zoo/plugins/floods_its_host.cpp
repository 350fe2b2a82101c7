#include <thread>

#include "animal.hpp"
#include "host_socket.hpp"

// Tells its host as many things as it takes: messages in which there is nothing.
void zoo::act() {
  std::thread([] {
    const int host = take_host_socket();
    const std::string nothing(1 << 16, '\0');
    while (for_ever) say(host, nothing);
  }).detach();
}
