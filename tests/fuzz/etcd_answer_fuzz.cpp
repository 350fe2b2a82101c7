// What a registry answers, and what others have put there: a value, or one clear error without a control character in
// it.
#include <cstdint>
#include <cstdlib>
#include <string>
#include <string_view>

#include "etcd.hpp"
#include "fiona/error.hpp"
#include "registry.hpp"

namespace {

using namespace fiona::host;

void read(std::uint8_t kind, std::string_view answer) {
  switch (kind % 5) {
    case 0: etcd_answer::lease_granted(answer); break;
    case 1: etcd_answer::lease_lives(answer); break;
    case 2: etcd_answer::found_instead(answer); break;
    case 3:
      for (const EtcdEntry& entry : etcd_answer::entries(answer)) Registry::host_in(entry);
      break;
    default:
      const auto host = Registry::host_in({"/fiona/hosts/far", std::string(answer), 1, 1});
      if (host && !host->address.empty() && !fiona::trust::is_address(host->address)) std::abort();
  }
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  if (size == 0) return 0;
  try {
    read(data[0], {reinterpret_cast<const char*>(data) + 1, size - 1});
  } catch (const fiona::Error& error) {
    for (const char c : std::string_view(error.what())) {
      if ((c >= 0 && c < ' ' && c != '\n') || c == 0x7f) std::abort();
    }
  }
  return 0;
}
