#include "animal.hpp"

void zoo::act() { end_run(); }
