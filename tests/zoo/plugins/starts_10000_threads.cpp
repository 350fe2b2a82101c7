#include <pthread.h>
#include <unistd.h>

#include <stdexcept>

#include "animal.hpp"

void zoo::act() {
  pthread_attr_t small;
  ::pthread_attr_init(&small);
  ::pthread_attr_setstacksize(&small, 16384);
  const auto wait = [](void*) -> void* {
    while (for_ever) ::pause();
    return nullptr;
  };
  for (int i = 0; i < 10'000; ++i) {
    pthread_t thread;
    if (::pthread_create(&thread, &small, wait, nullptr) != 0) ::usleep(1000);
  }
  throw std::runtime_error("it was given all that it wanted");
}
