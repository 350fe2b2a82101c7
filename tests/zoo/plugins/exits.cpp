#include <unistd.h>

#include "animal.hpp"

void zoo::act() { ::_exit(0); }
