// Its entry is none.
extern "C" const void* fiona_plugin_entry() { return nullptr; }
