#include "os/read_pages.hpp"

#include <link.h>
#include <sys/mman.h>
#include <unistd.h>

#include <cstdint>
#include <fstream>
#include <string>

namespace fiona::os {
namespace {

/// A smaller part is not worth the call, which may have to stop the threads on other processors.
constexpr std::uintptr_t kLeastBytes = 256 * 1024;

/// Parts of a library or program that are mapped without the right to write hold what is in the file.
int let_go_of_read_parts(dl_phdr_info* object, std::size_t, void*) {
  static const auto page = static_cast<std::uintptr_t>(::sysconf(_SC_PAGESIZE));
  for (const ElfW(Phdr)* part = object->dlpi_phdr; part != object->dlpi_phdr + object->dlpi_phnum; ++part) {
    if (part->p_type != PT_LOAD || (part->p_flags & PF_W) != 0 || part->p_memsz < kLeastBytes) continue;
    const std::uintptr_t begin = (object->dlpi_addr + part->p_vaddr) & ~(page - 1);
    const std::uintptr_t end = object->dlpi_addr + part->p_vaddr + part->p_memsz;
    ::madvise(reinterpret_cast<void*>(begin), end - begin, MADV_DONTNEED);
  }
  return 0;
}

/// It writes its breakpoints into pages that count as read.
bool has_debugger() {
  std::ifstream status("/proc/self/status");
  for (std::string line; std::getline(status, line);) {
    if (line.starts_with("TracerPid:")) return line != "TracerPid:\t0";
  }
  return false;
}

}  // namespace

void let_go_of_read_pages() {
  if (!has_debugger()) ::dl_iterate_phdr(&let_go_of_read_parts, nullptr);
}

int ReadPages::look(std::size_t opened, Time now) {
  if (opened != opened_) {
    opened_ = opened;
    due_ = now + kAfter;
  }
  if (!due_) return -1;
  if (now < *due_)
    return 1 + static_cast<int>(std::chrono::duration_cast<std::chrono::milliseconds>(*due_ - now).count());
  due_.reset();
  let_go_of_read_pages();
  return -1;
}

}  // namespace fiona::os
