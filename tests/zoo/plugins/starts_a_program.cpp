#include <stdexcept>
#include <string>

#include "animal.hpp"
#include "program.hpp"

void zoo::act() { throw std::runtime_error("it has started " + std::to_string(zoo::start_program())); }
