#include <gtest/gtest.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include <fiona/marketplace/hash.hpp>
#include <fiona/marketplace/index.hpp>
#include <fiona/marketplace/install.hpp>
#include <fiona/plugin.hpp>
#include <fstream>

#include "hostile_corpus.hpp"
#include "support.hpp"

namespace fiona::marketplace {
namespace {

using namespace testing;
namespace filesystem = std::filesystem;

// A marketplace that offers an archive made by an enemy under an index entry that fits it, and a store that
// has something to lose. Each test takes the pieces of an honest package, changes them, and says what must be
// answered.
class HostileArchive : public ::testing::Test {
 protected:
  HostileArchive() {
    publish_plugin(scratch_.path(), market_, "steps", "1.0.0");
    publish_plugin(scratch_.path(), market_, "base", "1.0.0");
    install("base", Marketplace{market_}, store_);
    write_file(scratch_ / "home/precious", "precious");
    const auto entry = Marketplace{market_}.info("steps")[0];
    honest_ = file_content(market_ / entry.file());
    pieces_ = pieces_of(honest_);
    manifest_ = pieces_[0].substr(512, pieces_[0].find('\0', 512) - 512);
  }

  // Offers the bytes as the package steps 1.0.0.
  void offer(const std::string& bytes) {
    Index index = Marketplace{market_}.index();
    for (auto& entry : *index.mutable_entries()) {
      if (entry.manifest().name() != "steps") continue;
      entry.set_blake2b(blake2b(bytes));
      entry.set_size(bytes.size());
      entry.set_file("acme.steps-1.0.0-" + std::string(this_architecture()) + "-" + entry.blake2b().substr(0, 16) +
                     ".fpk");
      write_file(market_ / entry.file(), bytes);
    }
    write_file(market_ / "index.binpb", index.SerializeAsString());
  }

  Error refusal(const std::string& bytes, const PackageLimits& limits = {}) {
    offer(bytes);
    const auto before = snapshot(scratch_.path());
    InstallOptions options;
    options.limits = limits;
    const Error error = error_of([&] { install("steps", Marketplace{market_}, store_, options); });
    EXPECT_EQ(snapshot(scratch_.path()), before);
    EXPECT_FALSE(error.text().where.empty());
    EXPECT_FALSE(error.text().next.empty());
    return error;
  }

  void expect_refused(const std::vector<std::string>& pieces, const std::string& what, const std::string& found = "") {
    const Error error = refusal(compress(joined(pieces)));
    EXPECT_EQ(error.text().what, what);
    EXPECT_EQ(error.text().found, found);
    EXPECT_EQ(error.text().next, "do not use this package; tell its publisher");
  }

  std::vector<std::string> with(std::size_t index, const std::string& piece) const {
    auto pieces = pieces_;
    pieces[index] = piece;
    return pieces;
  }

  std::vector<std::string> inserted(std::size_t index, const std::string& piece) const {
    auto pieces = pieces_;
    pieces.insert(pieces.begin() + static_cast<std::ptrdiff_t>(index), piece);
    return pieces;
  }

  std::vector<std::string> with_manifest(const std::string& text) const {
    return with(0, raw_file({.path = "manifest.textproto", .size = text.size()}, text));
  }

  std::string edited(const std::string& from, const std::string& to) const {
    std::string text = manifest_;
    return text.replace(text.find(from), from.size(), to);
  }

  Scratch scratch_;
  filesystem::path market_ = scratch_ / "market";
  filesystem::path store_ = scratch_ / "home/store";
  std::string honest_;
  std::vector<std::string> pieces_;  // manifest, interface, README, lib/libsteps.so, share/data/map.osm, share/help.txt
  std::string manifest_;
};

TEST_F(HostileArchive, TheHonestPiecesPutTogetherAgainAreInstalled) {
  offer(compress(joined(pieces_)));
  EXPECT_EQ(install("steps", Marketplace{market_}, store_).outcome, InstallOutcome::Installed);
}

TEST_F(HostileArchive, APathWithDotDotIsRefused) {
  expect_refused(with(5, raw_file({.path = "share/../../../precious", .size = 4}, "evil")),
                 "a file's path has a \"..\" element", "share/../../../precious");
}

TEST_F(HostileArchive, APathWithDotDotInTheManifestIsRefused) {
  expect_refused(with_manifest(edited("share/help.txt", "share/../../x")), "a listed file's path has a \"..\" element",
                 "\"share/../../x\"");
}

TEST_F(HostileArchive, AnAbsolutePathIsRefused) {
  expect_refused(inserted(3, raw_file({.path = "/etc/passwd", .size = 4}, "evil")), "a file's path is absolute",
                 "/etc/passwd");
}

TEST_F(HostileArchive, ASymbolicLinkIsRefused) {
  expect_refused(with(5, raw({.path = "share/help.txt", .type = '2', .link = "/etc/passwd"})),
                 "share/help.txt is a symbolic link");
}

TEST_F(HostileArchive, ASymbolicLinkForADirectoryAndAFileThroughItAreRefused) {
  expect_refused(inserted(4, raw({.path = "share", .type = '2', .link = "../../.."})), "share is a symbolic link");
}

TEST_F(HostileArchive, AHardLinkIsRefused) {
  expect_refused(with(5, raw({.path = "share/help.txt", .type = '1', .link = "../../../precious"})),
                 "share/help.txt is a hard link");
}

TEST_F(HostileArchive, DevicesAndPipesAreRefused) {
  for (const char type : {'3', '4', '6'}) {
    expect_refused(with(5, raw({.path = "share/help.txt", .type = type})), "share/help.txt is a device or pipe");
  }
}

TEST_F(HostileArchive, ADirectoryEntryIsRefused) {
  expect_refused(inserted(4, raw({.path = "share/", .type = '5', .mode = 0777})), "share/ is a directory");
}

TEST_F(HostileArchive, AFileThatComesTwiceIsRefused) {
  expect_refused(inserted(4, pieces_[3]), "lib/libsteps.so is in the package twice or out of order", "lib/libsteps.so");
}

TEST_F(HostileArchive, FilesInAnotherOrderAreRefused) {
  auto pieces = pieces_;
  std::swap(pieces[1], pieces[2]);
  expect_refused(pieces, "README.md is in the package twice or out of order", "README.md");
}

TEST_F(HostileArchive, AFileThatTheManifestDoesNotListIsRefused) {
  expect_refused(inserted(4, raw_file({.path = "lib/libevil.so", .size = 4}, "evil")),
                 "lib/libevil.so is not listed in the manifest", "lib/libevil.so");
}

TEST_F(HostileArchive, AFileAfterTheLastListedIsRefused) {
  expect_refused(inserted(6, raw_file({.path = "share/more.txt", .size = 4}, "evil")),
                 "share/more.txt is not listed in the manifest", "share/more.txt");
}

TEST_F(HostileArchive, AMissingFileIsTold) {
  auto pieces = pieces_;
  pieces.pop_back();
  expect_refused(pieces, "the package lacks share/help.txt");
}

TEST_F(HostileArchive, AHeaderThatAnnouncesMoreThanTheManifestIsRefused) {
  expect_refused(with(5, raw_file({.path = "share/help.txt", .size = 5}, "helpx")),
                 "share/help.txt has another size than the manifest says", "5 bytes");
}

TEST_F(HostileArchive, AManifestThatAnnouncesLessThanTheHeaderIsRefused) {
  expect_refused(with_manifest(edited("size: 4", "size: 1")), "share/help.txt has another size than the manifest says",
                 "4 bytes");
}

TEST_F(HostileArchive, OtherContentOfTheSameSizeIsASignatureError) {
  const Error error = refusal(compress(joined(with(5, raw_file({.path = "share/help.txt", .size = 4}, "evil")))));
  EXPECT_EQ(error.code(), ErrorCode::BadSignature);
  EXPECT_EQ(error.text().what, "share/help.txt is not what the manifest says");
  EXPECT_EQ(error.text().found, blake2b("evil"));
}

TEST_F(HostileArchive, ATruncatedStreamIsToldAtEveryLength) {
  for (std::size_t length = 4; length < honest_.size(); length += 7) {
    const std::string what = refusal(honest_.substr(0, length)).text().what;
    EXPECT_EQ(what, "the package ends too early") << length;
  }
}

TEST_F(HostileArchive, ATruncatedArchiveInAWholeStreamIsTold) {
  std::string tar = joined(pieces_);
  EXPECT_EQ(refusal(compress(tar.substr(0, tar.size() - 512))).text().what, "the package's archive ends too early");
  EXPECT_EQ(refusal(compress(tar.substr(0, tar.size() - 1024))).text().what, "the package's archive ends too early");
  EXPECT_EQ(refusal(compress(tar.substr(0, 700))).text().what,
            "the package's archive is damaged: Truncated tar archive");
}

TEST_F(HostileArchive, BytesThatAreNotZstdAreRefused) {
  EXPECT_EQ(refusal(joined(pieces_)).text().what, "this is not a package: it does not begin as zstd does");
  EXPECT_EQ(refusal("").text().what, "this is not a package: it does not begin as zstd does");
}

TEST_F(HostileArchive, ASkippableFrameBeforeTheContentIsRefused) {
  const std::string hidden("\x50\x2a\x4d\x18\x04\x00\x00\x00evil", 12);
  EXPECT_EQ(refusal(hidden + honest_).text().what, "this is not a package: it does not begin as zstd does");
}

TEST_F(HostileArchive, AWindowAboveEightMebibytesIsRefused) {
  const Error error = refusal(compress(joined(pieces_), 27));
  EXPECT_EQ(error.text().what, "the package cannot be decompressed: Frame requires too much memory for decoding");
  EXPECT_EQ(error.text().expected, "zstd with a window of at most 8 MiB");
}

TEST_F(HostileArchive, ADamagedByteIsNoticed) {
  std::string damaged = honest_;
  damaged[damaged.size() / 2] ^= 1;
  EXPECT_NE(refusal(damaged).text().what, "");
}

TEST_F(HostileArchive, GarbageAfterTheStreamIsRefused) {
  EXPECT_EQ(refusal(honest_ + "x").text().what, "the package has bytes after its end");
}

TEST_F(HostileArchive, ASecondFrameIsRefused) {
  EXPECT_EQ(refusal(honest_ + compress(joined(pieces_))).text().what, "the package has bytes after its end");
  const std::string tar = joined(pieces_);
  EXPECT_EQ(refusal(compress(tar.substr(0, 1000)) + compress(tar.substr(1000))).text().what,
            "the package has bytes after its end");
}

TEST_F(HostileArchive, ASecondArchiveAfterTheFirstIsRefused) {
  EXPECT_EQ(refusal(compress(joined(pieces_) + joined(pieces_))).text().what,
            "the package has bytes after its last file");
  EXPECT_EQ(refusal(compress(joined(pieces_) + std::string(1, '\0'))).text().what,
            "the package has bytes after its last file");
  EXPECT_EQ(refusal(compress(joined(pieces_) + std::string(200'000, '\0'))).text().what,
            "the package has bytes after its last file");
}

TEST_F(HostileArchive, AMissingManifestIsTold) {
  auto pieces = pieces_;
  pieces.erase(pieces.begin());
  expect_refused(pieces, "the manifest is not the package's first file", "interface.textproto");
}

TEST_F(HostileArchive, AnEmptyArchiveIsTold) { expect_refused({}, "the package is empty"); }

TEST_F(HostileArchive, ASecondManifestIsRefused) {
  expect_refused(inserted(3, pieces_[0]), "the package has a second manifest");
}

TEST_F(HostileArchive, ALateManifestIsRefused) {
  auto pieces = pieces_;
  std::swap(pieces[0], pieces[5]);
  expect_refused(pieces, "the manifest is not the package's first file", "share/help.txt");
}

TEST_F(HostileArchive, AManifestAboveOneMebibyteIsRefusedBeforeItIsRead) {
  expect_refused(with(0, raw({.path = "manifest.textproto", .size = (1u << 20) + 1})), "the manifest is too large",
                 "1048577 bytes");
}

TEST_F(HostileArchive, AManifestThatIsALinkIsRefused) {
  expect_refused(with(0, raw({.path = "manifest.textproto", .type = '2', .link = "x"})),
                 "manifest.textproto is a symbolic link");
}

TEST_F(HostileArchive, NamesThatAreNotTextAreRefusedAndNotShown) {
  for (const auto* name : {"share/\xff\xfe", "share/\xc0\xaf", "share/\x1b[2J"}) {
    expect_refused(with(5, raw_file({.path = name, .size = 4}, "evil")),
                   "a file's path has a character other than ASCII letters, digits and ._+@=,-",
                   "a file whose name is not plain text");
  }
}

TEST_F(HostileArchive, AnOverlongNameIsRefused) {
  const std::string name = "share/" + std::string(150, 'a');
  const std::string extension = "160 path=" + name + "\n";
  std::string record = std::to_string(extension.size()) + " path=" + name + "\n";
  record = std::to_string(record.size()) + record.substr(record.find(' '));
  auto pieces = with(5, raw_file({.path = "share/a", .size = 4}, "evil"));
  pieces.insert(pieces.begin() + 5, raw_file({.path = "x", .size = record.size(), .type = 'x'}, record));
  const Error error = refusal(compress(joined(pieces)));
  EXPECT_EQ(error.text().what, "a file's path is longer than 100 characters");
}

TEST_F(HostileArchive, AnExtendedHeaderThatSaysTheSameAgainIsRefused) {
  const std::string record = "23 path=share/help.txt\n";
  ASSERT_EQ(record.size(), 23u);
  expect_refused(inserted(5, raw_file({.path = "x", .size = record.size(), .type = 'x'}, record)),
                 "the package's archive is not in the one form that packages have",
                 "another header or filling at share/help.txt");
}

TEST_F(HostileArchive, AGnuLongNameIsRefused) {
  expect_refused(
      inserted(5, raw_file({.path = "././@LongLink", .size = 15, .type = 'L'}, std::string("share/help.txt\0", 15))),
      "the package's archive is not in the one form that packages have", "another header or filling at share/help.txt");
}

TEST_F(HostileArchive, ASparseFileIsRefused) {
  const std::string record =
      "22 GNU.sparse.major=1\n22 GNU.sparse.minor=0\n33 GNU.sparse.name=share/help.txt\n"
      "26 GNU.sparse.realsize=999\n";
  auto pieces = with(5, raw_file({.path = "share/x", .size = 512}, "1\n0\n999\n"));
  pieces.insert(pieces.begin() + 5, raw_file({.path = "x", .size = record.size(), .type = 'x'}, record));
  EXPECT_NE(refusal(compress(joined(pieces))).text().what, "nothing was thrown");
}

TEST_F(HostileArchive, ExtendedAttributesAreRefused) {
  const std::string record = "35 SCHILY.xattr.user.evil=yes12345\n";
  ASSERT_EQ(record.size(), 35u);
  expect_refused(inserted(5, raw_file({.path = "x", .size = record.size(), .type = 'x'}, record)),
                 "share/help.txt has extended attributes");
}

TEST_F(HostileArchive, AHugeExtendedHeaderIsRefusedBeforeItFillsMemory) {
  const std::string comment(900'000, 'c');
  std::string record = " comment=" + comment + "\n";
  record = std::to_string(record.size() + 6) + record;
  std::vector<std::string> pieces = pieces_;
  for (int i = 0; i < 20; ++i) {
    pieces.insert(pieces.begin() + 5, raw_file({.path = "x", .size = record.size(), .type = 'x'}, record));
  }
  EXPECT_EQ(refusal(compress(joined(pieces))).text().what, "the package has an archive header that no package has");
}

TEST_F(HostileArchive, NamesThatDifferOnlyInCaseAreRefused) {
  expect_refused(with_manifest(edited("share/data/map.osm", "share/HELP.txt")),
                 "share/help.txt differs from another name only in upper and lower case");
}

TEST_F(HostileArchive, AFileWhereADirectoryIsNeededIsRefused) {
  expect_refused(with_manifest(edited("share/help.txt", "share/data/map.osm/x")),
                 "share/data/map.osm is listed as a file, and share/data/map.osm/x needs a directory there");
}

TEST_F(HostileArchive, AFileListedTwiceIsRefused) {
  expect_refused(with_manifest(edited("share/data/map.osm", "share/help.txt")), "share/help.txt is listed twice");
}

TEST_F(HostileArchive, ASetUserIdBitIsRefused) {
  const std::string help = pieces_[5].substr(512, 4);
  expect_refused(with(5, raw_file({.path = "share/help.txt", .size = 4, .mode = 04755}, help)),
                 "the package's archive is not in the one form that packages have",
                 "another header or filling at share/help.txt");
}

TEST_F(HostileArchive, BytesHiddenInTheFillingAreRefused) {
  std::string piece = pieces_[5];
  piece.back() = 'x';
  expect_refused(with(5, piece), "the package's archive is not in the one form that packages have",
                 "another header or filling at share/help.txt");
}

TEST_F(HostileArchive, AHeaderWithAWrongChecksumIsRefused) {
  std::string piece = pieces_[5];
  piece[148] = '7';
  const Error error = refusal(compress(joined(with(5, piece))));
  EXPECT_EQ(error.text().what, "the package's archive is damaged: Damaged tar archive");
}

TEST_F(HostileArchive, AManifestThatAsksForMoreThanTheTotalIsRefusedBeforeUnpacking) {
  PackageLimits limits;
  limits.total_bytes = 205 + std::string_view(kAbiTag).size();
  const Error error = refusal(honest_, limits);
  EXPECT_EQ(error.text().what, "share/help.txt makes the package larger than it may be");
}

TEST_F(HostileArchive, SizesWhoseSumOverflowsAreRefused) {
  expect_refused(with_manifest(edited("size: 4", "size: 18446744073709551615")),
                 "share/help.txt makes the package larger than it may be", "18446744073709551615 bytes");
}

TEST_F(HostileArchive, TooManyFilesAreRefused) {
  PackageLimits limits;
  limits.files = 3;
  const Error error = refusal(honest_, limits);
  EXPECT_EQ(error.text().what, "the package has too many files");
}

// 400 MiB of zeros in a few KiB, honestly declared but above what a package may have: nothing is unpacked.
TEST_F(HostileArchive, ABombIsRefusedFromItsManifest) {
  expect_refused(with_manifest(edited("size: 4", "size: 629145600")),
                 "share/help.txt makes the package larger than it may be", "629145600 bytes");
}

TEST_F(HostileArchive, ABombBehindAModestManifestStopsAtItsDeclaredSize) {
  const std::string zeros(std::size_t{64} << 20, '\0');
  expect_refused(with(5, raw_file({.path = "share/help.txt", .size = zeros.size()}, zeros)),
                 "share/help.txt has another size than the manifest says", "67108864 bytes");
}

TEST_F(HostileArchive, AnEndlessStreamOfEmptyBlocksIsRefused) {
  // Raw blocks of no bytes: 3 bytes each that decompress to nothing.
  std::string stream("\x28\xb5\x2f\xfd\x00\x58", 6);
  PackageLimits limits;
  limits.total_bytes = 5000;
  for (int i = 0; i < 4'000'000; ++i) stream.append("\0\0\0", 3);
  const Error error = refusal(stream, limits);
  EXPECT_EQ(error.text().what, "the package is larger than a package may be");
}

TEST_F(HostileArchive, AnInterfaceOfAnotherAbiIsRefused) {
  expect_refused(with_manifest(edited(kAbiTag, "abi-2")), "the manifest and the interface speak of different ABIs",
                 kAbiTag);
}

TEST_F(HostileArchive, AManifestThatIsNotTextIsTold) {
  const Error error = refusal(compress(joined(with_manifest("\xff\xfe\n"))));
  EXPECT_NE(error.text().where.find(".fpk/manifest.textproto:1:1"), std::string::npos) << error.text().where;
  EXPECT_EQ(error.text().what.find("this is not a Manifest: "), 0u);
}

TEST_F(HostileArchive, AnHonestPackageUnderAnotherPackagesEntryIsASignatureError) {
  offer(compress(joined(with_manifest(edited("Counts steps", "Counts stepz")))));
  const auto before = snapshot(scratch_.path());
  const Error error = error_of([&] { install("steps", Marketplace{market_}, store_); });
  EXPECT_EQ(error.code(), ErrorCode::BadSignature);
  EXPECT_EQ(error.text().what, "the package is not the one that the index describes");
  EXPECT_EQ(snapshot(scratch_.path()), before);
}

TEST_F(HostileArchive, APipeInPlaceOfThePackageIsNotWaitedFor) {
  offer(honest_);
  const auto entry = Marketplace{market_}.info("steps")[0];
  filesystem::remove(market_ / entry.file());
  ASSERT_EQ(::mkfifo((market_ / entry.file()).c_str(), 0600), 0);
  EXPECT_EQ(error_of([&] { install("steps", Marketplace{market_}, store_); }).text().what,
            "this is not a regular file");
}

// What installing one archive did, seen from outside the process that did it.
struct Attempt {
  bool refused = false;          // with a next step, as failed or as a wrong hash
  std::uint64_t written = 0;     // bytes into the store, all files together
  std::uint64_t outside = 0;     // files or directories that were made elsewhere than in staging
  std::uint64_t memory_kib = 0;  // how much larger the process became
};

std::uint64_t status_kib(const char* field) {
  std::ifstream file("/proc/self/status");
  for (std::string line; std::getline(file, line);) {
    if (line.starts_with(field)) return std::stoull(line.substr(line.find(':') + 1));
  }
  return 0;
}

// In a process of its own, so that its memory is its own and a crash is one line.
Attempt attempt(const filesystem::path& market, const filesystem::path& store) {
  auto* shared = static_cast<Attempt*>(
      ::mmap(nullptr, sizeof(Attempt), PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS, -1, 0));
  new (shared) Attempt;
  const pid_t child = ::fork();
  if (child == 0) {
    InstallOptions options;
    const OsCalls real = system_calls();
    const auto in_staging = [](int directory, const char* name) {
      const auto where = filesystem::read_symlink("/proc/self/fd/" + std::to_string(directory)) / name;
      return where.string().find("/staging-") != std::string::npos || where.filename() == "packages" ||
             where.filename() == "generations";
    };
    options.os.create = [&](int directory, const char* name, mode_t mode) {
      if (!in_staging(directory, name)) ++shared->outside;
      return real.create(directory, name, mode);
    };
    options.os.mkdir = [&](int directory, const char* name, mode_t mode) {
      if (!in_staging(directory, name)) ++shared->outside;
      return real.mkdir(directory, name, mode);
    };
    options.os.write = [&](int file, const void* bytes, std::size_t size) {
      shared->written += size;
      return real.write(file, bytes, size);
    };
    std::ofstream("/proc/self/clear_refs") << 5;  // the peak begins anew
    const std::uint64_t before_kib = status_kib("VmRSS");
    try {
      install("steps", Marketplace{market}, store, options);
    } catch (const Error& error) {
      shared->refused = (error.code() == ErrorCode::Failed || error.code() == ErrorCode::BadSignature) &&
                        !error.text().what.empty() && !error.text().next.empty();
    }
    shared->memory_kib = status_kib("VmHWM") - before_kib;
    ::_exit(0);
  }
  int status = 0;
  ::waitpid(child, &status, 0);
  Attempt seen = *shared;
  ::munmap(shared, sizeof(Attempt));
  if (!WIFEXITED(status)) seen.refused = false;
  return seen;
}

TEST_F(HostileArchive, EveryKindOfTheCorpusIsRefusedWithinItsBounds) {
  const auto corpus = hostile_corpus(honest_);
  EXPECT_GE(corpus.size(), 60u);
  std::uint64_t declared = pieces_[0].size();  // the manifest, and what it says
  const auto entry = Marketplace{market_}.info("steps")[0];
  for (const auto& file : entry.manifest().files()) declared += file.size();
  for (const auto& kind : corpus) {
    offer(kind.bytes);
    const auto before = snapshot(scratch_.path());
    const Attempt seen = attempt(market_, store_);
    EXPECT_TRUE(seen.refused) << kind.name;
    EXPECT_EQ(seen.outside, 0u) << kind.name;
    EXPECT_LE(seen.written, declared) << kind.name;
    if (!FIONA_SANITIZED) {
      EXPECT_LE(seen.memory_kib, 64u * 1024) << kind.name;
    }
    EXPECT_TRUE(snapshot(scratch_.path()) == before) << kind.name << " left something";
  }
}

}  // namespace
}  // namespace fiona::marketplace
