#include "author/elf_library.hpp"

#include <algorithm>
#include <array>
#include <cstdint>
#include <limits>
#include <map>
#include <memory>

#include <dlfcn.h>
#include <fcntl.h>
#include <gelf.h>
#include <link.h>
#include <unistd.h>

#include <fmt/format.h>
#include <fiona/error.hpp>

namespace fiona::console {
namespace {

constexpr std::int64_t kLastOffset = std::numeric_limits<int>::max();

struct OpenElf {
  explicit OpenElf(const std::filesystem::path& file) : descriptor(::open(file.c_str(), O_RDONLY | O_CLOEXEC)) {
    ::elf_version(EV_CURRENT);
    if (descriptor >= 0) elf = ::elf_begin(descriptor, ELF_C_READ, nullptr);
  }
  OpenElf(const OpenElf&) = delete;
  OpenElf& operator=(const OpenElf&) = delete;
  ~OpenElf() {
    ::elf_end(elf);
    if (descriptor >= 0) ::close(descriptor);
  }
  int descriptor;
  Elf* elf = nullptr;
};

/// The tables of a file that speak of symbols.
class SymbolTables {
 public:
  SymbolTables(Elf* elf, const std::filesystem::path& file) : elf_(elf), file_(file) {
    for (Elf_Scn* section = nullptr; (section = ::elf_nextscn(elf_, section)) != nullptr;) {
      GElf_Shdr header{};
      if (::gelf_getshdr(section, &header) == nullptr) damaged();
      if (header.sh_type == SHT_DYNAMIC) dynamic_ = read(section, header);
      if (header.sh_type == SHT_DYNSYM) symbols_ = read(section, header);
      if (header.sh_type == SHT_GNU_versym) versions_ = read(section, header);
      if (header.sh_type == SHT_GNU_verneed) read_version_names(read(section, header));
    }
    if (dynamic_.data == nullptr || symbols_.data == nullptr) damaged();
  }

  void add_to(ElfLibrary& library) const {
    GElf_Dyn entry{};
    for (int i = 0; ::gelf_getdyn(dynamic_.data, i, &entry) != nullptr && entry.d_tag != DT_NULL; ++i) {
      if (entry.d_tag == DT_NEEDED) library.libraries.push_back(text(dynamic_, entry.d_un.d_val));
    }
    GElf_Sym symbol{};
    for (int i = 1; ::gelf_getsym(symbols_.data, i, &symbol) != nullptr; ++i) {
      const std::string name = text(symbols_, symbol.st_name);
      if (symbol.st_shndx != SHN_UNDEF)
        library.defined.insert(name);
      else if (GELF_ST_BIND(symbol.st_info) != STB_WEAK)
        library.needed.push_back({name, version_of(i)});
    }
  }

 private:
  struct Section {
    Elf_Data* data = nullptr;
    std::size_t texts = 0;  ///< the section of its strings
  };

  [[noreturn]] void damaged() const {
    throw Error(ErrorCode::Failed, {.what = "the library's tables of symbols cannot be read",
                                    .where = file_.string(),
                                    .next = "build the plugin with fiona_add_plugin"});
  }
  Section read(Elf_Scn* section, const GElf_Shdr& header) const {
    Elf_Data* data = ::elf_getdata(section, nullptr);
    if (data == nullptr) damaged();
    return {data, header.sh_link};
  }
  std::string text(const Section& section, std::size_t at) const {
    const char* found = ::elf_strptr(elf_, section.texts, at);
    if (found == nullptr) damaged();
    return found;
  }
  /// Offsets only go forward, so that a damaged table comes to its end.
  void read_version_names(const Section& section) {
    GElf_Verneed need{};
    for (std::int64_t at = 0; at <= kLastOffset; at += need.vn_next) {
      if (::gelf_getverneed(section.data, static_cast<int>(at), &need) == nullptr) return;
      GElf_Vernaux name{};
      std::int64_t inner = at + need.vn_aux;
      for (unsigned i = 0; i < need.vn_cnt && inner <= kLastOffset; ++i) {
        if (::gelf_getvernaux(section.data, static_cast<int>(inner), &name) == nullptr) break;
        version_names_[name.vna_other] = text(section, name.vna_name);
        if (name.vna_next == 0) break;
        inner += name.vna_next;
      }
      if (need.vn_next == 0) return;
    }
  }
  std::string version_of(int symbol) const {
    GElf_Versym version = 0;
    if (versions_.data == nullptr || ::gelf_getversym(versions_.data, symbol, &version) == nullptr) return "";
    const auto found = version_names_.find(version);
    return found == version_names_.end() ? "" : found->second;
  }

  Elf* elf_;
  const std::filesystem::path& file_;
  Section dynamic_;
  Section symbols_;
  Section versions_;
  std::map<unsigned, std::string> version_names_;
};

std::string machine_text(unsigned machine) {
  if (machine == EM_X86_64) return "x86_64";
  if (machine == EM_AARCH64) return "aarch64";
  return fmt::format("machine {}", machine);
}

/// The library of this process that has the symbol; null: none has. Empty: the program itself, where a copy of a
/// library's variable may be, and what a sanitizer has put there.
const char* origin_of(const NeededSymbol& symbol) {
  void* address = symbol.version.empty() ? ::dlsym(RTLD_DEFAULT, symbol.name.c_str())
                                         : ::dlvsym(RTLD_DEFAULT, symbol.name.c_str(), symbol.version.c_str());
  Dl_info info{};
  link_map* map = nullptr;
  const bool found =
      address != nullptr && ::dladdr1(address, &info, reinterpret_cast<void**>(&map), RTLD_DL_LINKMAP) != 0;
  return found && map != nullptr ? map->l_name : nullptr;
}

}  // namespace

ElfLibrary read_elf(const std::filesystem::path& file) {
  const OpenElf open(file);
  GElf_Ehdr header{};
  const bool is_library = open.elf != nullptr && ::elf_kind(open.elf) == ELF_K_ELF &&
                          ::gelf_getclass(open.elf) == ELFCLASS64 && ::gelf_getehdr(open.elf, &header) != nullptr &&
                          header.e_type == ET_DYN;
  if (!is_library)
    throw Error(ErrorCode::Failed, {.what = "this is no shared library",
                                    .where = file.string(),
                                    .expected = "an ELF shared object of 64 bits",
                                    .next = "build the plugin with fiona_add_plugin"});
  ElfLibrary library;
  library.machine = machine_text(header.e_machine);
  SymbolTables(open.elf, file).add_to(library);
  return library;
}

bool is_platform_library(const std::string& name) {
  constexpr std::array kKnown{"libfiona.so.", "libfiona-msgs.so.", "libprotobuf.so.", "libstdc++.so.",
                              "libgcc_s.so.", "libm.so.",          "libc.so.",        "libpthread.so.",
                              "libdl.so.",    "librt.so.",         "ld-linux"};
  return std::any_of(kKnown.begin(), kKnown.end(), [&](const char* known) { return name.starts_with(known); });
}

std::vector<NeededSymbol> missing_symbols(const ElfLibrary& library, const std::set<std::string>& brought) {
  std::vector<NeededSymbol> missing;
  for (const NeededSymbol& symbol : library.needed) {
    if (brought.contains(symbol.name)) continue;
    const char* origin = origin_of(symbol);
    const bool there = origin != nullptr &&
                       (*origin == '\0' || is_platform_library(std::filesystem::path(origin).filename().string()));
    if (!there) missing.push_back(symbol);
  }
  return missing;
}

}  // namespace fiona::console
