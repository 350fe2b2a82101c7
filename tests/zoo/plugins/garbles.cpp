#include <thread>

#include "animal.hpp"
#include "host_socket.hpp"

// Tells its host what is no message, and goes on.
void zoo::act() {
  std::thread([] {
    say(take_host_socket(), std::string("\4\0\0\0\xff\xff\xff\xff", 8));
    while (for_ever) std::this_thread::sleep_for(std::chrono::seconds(1));
  }).detach();
}
