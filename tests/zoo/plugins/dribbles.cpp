#include <thread>

#include "animal.hpp"
#include "host_socket.hpp"

// Tells its host something of 16 MiB, a byte at a time, and begins again.
void zoo::act() {
  std::thread([] {
    const int host = take_host_socket();
    while (for_ever) {
      say(host, std::string("\0\0\0\1", 4));
      for (int said = 0; said < 16 << 20; ++said) say(host, "x");
    }
  }).detach();
}
