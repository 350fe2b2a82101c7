#include <fiona/abi.hpp>

#include <cstdint>

// An entry of the right ABI whose function is none.
extern "C" const void* fiona_plugin_entry() {
  static const struct {
    std::uint32_t size, edge_version;
    const char* abi;
    void (*declare)(void*);
  } entry{sizeof entry, 1, FIONA_ABI_TAG, nullptr};
  return &entry;
}
