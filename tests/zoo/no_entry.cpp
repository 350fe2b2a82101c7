// A sound library that is no plugin.
extern "C" int fiona_zoo_forty_two() { return 42; }
