#include <pthread.h>

#include "animal.hpp"

/// A forced unwind, which nobody may end.
void zoo::act() { ::pthread_exit(nullptr); }
