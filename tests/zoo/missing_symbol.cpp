// Calls a function that no library has; linked with unresolved symbols allowed, so only the loader finds out.
extern "C" void fiona_zoo_absent_function();
extern "C" void fiona_zoo_call_it() { fiona_zoo_absent_function(); }
