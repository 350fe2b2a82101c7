#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "fiona/abi.hpp"
#include "fiona/component.hpp"
#include "fiona/hull.hpp"

namespace fiona {

/// The component classes of a plugin, in the order in which they were added.
class Plugin {
 public:
  struct Entry {
    std::string name;
    std::string doc;
    Hull::Factory make;
  };

  /// Offers class C under `name`; `doc` is one sentence for `show`.
  template <class C>
  void add(std::string_view name, std::string_view doc = {}) {
    entries_.push_back({std::string(name), std::string(doc),
                        [](Hull& hull) -> std::unique_ptr<Component> { return std::make_unique<C>(hull); }});
  }
  const std::vector<Entry>& entries() const { return entries_; }

 private:
  std::vector<Entry> entries_;
};

/// What `fiona_plugin_entry` returns: a struct of C, version first, so that a host of another age can still read it.
struct PluginEntry {
  std::uint32_t size;               ///< of this struct
  std::uint32_t edge_version;       ///< 1
  const char* abi;                  ///< `kAbiTag` of the SDK that the plugin was built with
  void (*declare)(Plugin& plugin);  ///< called only when the tags are equal
};

inline constexpr std::uint32_t kPluginEdgeVersion = 1;
inline constexpr const char* kPluginEntrySymbol = "fiona_plugin_entry";

/// The ABI tag of the SDK that this translation unit was compiled with: everything that must be equal on both sides
/// before C++ may cross the plugin's edge (SDK version, compiler ABI, standard library, protobuf, catalogue). Read from
/// the package's interface before the library is opened, and again from the library itself.
inline constexpr const char* kAbiTag = FIONA_ABI_TAG;

}  // namespace fiona

/// Defines the plugin's one exported symbol: `FIONA_PLUGIN(plugin) { plugin.add<StepCounter>("step-counter"); }`
#define FIONA_PLUGIN(plugin)                                                                           \
  static void fiona_declare_plugin(::fiona::Plugin& plugin);                                           \
  extern "C" __attribute__((visibility("default"))) const ::fiona::PluginEntry* fiona_plugin_entry() { \
    static const ::fiona::PluginEntry entry{sizeof(::fiona::PluginEntry), ::fiona::kPluginEdgeVersion, \
                                            ::fiona::kAbiTag, &fiona_declare_plugin};                  \
    return &entry;                                                                                     \
  }                                                                                                    \
  static void fiona_declare_plugin(::fiona::Plugin& plugin)
