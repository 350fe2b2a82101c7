// Runs a fuzz target without a fuzzer: over each file of its corpus, then over mutations of them, the same ones each
// time. A child does it, so that whatever ends it, the input that did is known, kept in a file and told. Where the code
// is optimised and without sanitizers, so is one that takes more time or memory than is promised.
//
//     TARGET MUTATIONS CORPUS_DIR …
#include <sys/mman.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <new>
#include <random>
#include <span>
#include <string>
#include <vector>

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size);

namespace {

/// One input must not take longer than this, with a sanitizer on a loaded machine.
constexpr unsigned kLongestInput_s = 30;
/// What one may take where nothing is added to the code: of processor time, and of memory with all before it.
constexpr double kMostProcessor_s = 1;
constexpr double kMostMemory_MiB = 256;
constexpr std::size_t kLargestInput = 1 << 16;

struct Seed {
  std::string name;
  std::string bytes;
};

std::vector<Seed> read_corpus(std::span<char*> directories) {
  std::vector<Seed> seeds;
  for (const char* directory : directories) {
    for (const auto& entry : std::filesystem::directory_iterator(directory)) {
      std::ifstream file(entry.path(), std::ios::binary);
      seeds.push_back({entry.path().filename().string(), {std::istreambuf_iterator<char>(file), {}}});
    }
  }
  std::sort(seeds.begin(), seeds.end(), [](const Seed& a, const Seed& b) { return a.name < b.name; });
  return seeds;
}

class Mutator {
 public:
  Mutator(const std::vector<Seed>& seeds, std::uint64_t number) : seeds_(seeds), random_(number) {}

  std::string input() {
    std::string bytes = seed().bytes;
    for (std::size_t changes = 1 + below(4); changes > 0; --changes) change(bytes);
    bytes.resize(std::min(bytes.size(), kLargestInput));
    return bytes;
  }

 private:
  // Not std::uniform_int_distribution: its numbers differ between standard libraries.
  std::size_t below(std::size_t end) { return static_cast<std::size_t>(random_() % std::max<std::size_t>(end, 1)); }
  const Seed& seed() { return seeds_[below(seeds_.size())]; }

  void change(std::string& bytes) {
    static constexpr std::array<char, 8> kTelling{'\0', '\xff', '\x7f', '\x80', '\n', '"', '0', '-'};
    const std::size_t at = below(bytes.size() + 1);
    const std::size_t length = 1 + below(below(2) == 0 ? 4 : 32);
    switch (below(6)) {
      case 0: bytes.insert(at, 1, kTelling[below(kTelling.size())]); break;
      case 1: bytes.erase(at, length); break;
      case 2: bytes.insert(at, std::string(bytes, below(bytes.size() + 1), length)); break;
      case 3: {
        const std::string& other = seed().bytes;
        bytes.replace(at, length, other, below(other.size() + 1), length);
        break;
      }
      case 4:
        if (at < bytes.size()) bytes[at] = kTelling[below(kTelling.size())];
        break;
      default:
        if (at < bytes.size()) bytes[at] = static_cast<char>(bytes[at] ^ (1 << below(8)));
    }
  }

  const std::vector<Seed>& seeds_;
  std::mt19937_64 random_;
};

std::string input_number(const std::vector<Seed>& seeds, std::size_t number) {
  return number < seeds.size() ? seeds[number].bytes : Mutator(seeds, number).input();
}

struct Taken {
  double processor_s = 0;
  double memory_mib = 0;  ///< at most so far
};

Taken taken() {
  rusage usage{};
  ::getrusage(RUSAGE_SELF, &usage);
  const auto seconds = [](const timeval& time) {
    return static_cast<double>(time.tv_sec) + 1e-6 * static_cast<double>(time.tv_usec);
  };
  return {seconds(usage.ru_utime) + seconds(usage.ru_stime), static_cast<double>(usage.ru_maxrss) / 1024};
}

void require_modest(const Taken& before) {
  const Taken now = taken();
  const double processor_s = now.processor_s - before.processor_s;
  if (processor_s <= kMostProcessor_s && now.memory_mib <= kMostMemory_MiB) return;
  std::fprintf(stderr,
               "it took %.2f s of processor time (%.0f at most), and there are %.0f MiB of memory (%.0f at most)\n",
               processor_s, kMostProcessor_s, now.memory_mib, kMostMemory_MiB);
  std::exit(1);
}

void run_all(const std::vector<Seed>& seeds, std::size_t mutations, std::atomic<std::size_t>& number) {
  for (; number < seeds.size() + mutations; ++number) {
    const std::string bytes = input_number(seeds, number);
    ::alarm(kLongestInput_s);
    // A copy of its exact size on the heap, so that AddressSanitizer sees a read beyond it.
    const std::vector<std::uint8_t> input(bytes.begin(), bytes.end());
    const Taken before = taken();
    LLVMFuzzerTestOneInput(input.data(), input.size());
    if (FIONA_MEASURED) require_modest(before);
  }
}

int report(const std::string& target, const std::vector<Seed>& seeds, std::size_t number, int status) {
  const std::string file = target + ".failing-input";
  std::ofstream(file, std::ios::binary) << input_number(seeds, number);
  const std::string which =
      number < seeds.size() ? "the seed " + seeds[number].name : "mutation " + std::to_string(number - seeds.size());
  std::fprintf(stderr, "error: %s ended the target: %s\n  next: it is in %s\n", which.c_str(),
               WIFSIGNALED(status) ? ::strsignal(WTERMSIG(status)) : "it exited", file.c_str());
  return 1;
}

}  // namespace

int main(int argc, char** argv) {
  if (argc < 3) {
    std::fprintf(stderr, "usage: %s MUTATIONS CORPUS_DIR …\n", argv[0]);
    return 2;
  }
  const std::size_t mutations = std::stoul(argv[1]);
  const auto seeds = read_corpus({argv + 2, argv + argc});
  if (seeds.empty()) {
    std::fprintf(stderr, "error: %s holds no seed\n", argv[2]);
    return 1;
  }
  void* shared =
      ::mmap(nullptr, sizeof(std::atomic<std::size_t>), PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS, -1, 0);
  if (shared == MAP_FAILED) return std::perror("mmap"), 1;
  auto& number = *new (shared) std::atomic<std::size_t>(0);
  const pid_t child = ::fork();
  if (child < 0) return std::perror("fork"), 1;
  if (child == 0) {
    run_all(seeds, mutations, number);
    std::exit(0);
  }
  int status = 0;
  ::waitpid(child, &status, 0);
  if (status != 0) return report(std::filesystem::path(argv[0]).filename().string(), seeds, number, status);
  std::printf("%zu seeds and %zu mutations passed\n", seeds.size(), mutations);
  return 0;
}
