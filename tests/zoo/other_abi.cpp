// A plugin's edge as an SDK of another age would write it. It must never be asked for its components.
#include <cstdint>
#include <cstdlib>

namespace {

struct Entry {
  std::uint32_t size;
  std::uint32_t edge_version;
  const char* abi;
  void (*declare)(void*);
};

[[noreturn]] void declare(void*) { std::abort(); }

}  // namespace

extern "C" const Entry* fiona_plugin_entry() {
  static const Entry entry{sizeof(Entry), 1, "fiona9.9-cxxabi9999", &declare};
  return &entry;
}
