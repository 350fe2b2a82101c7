#include "hostile_corpus.hpp"

#include <zstd.h>

#include <cstring>

#include "support.hpp"

namespace fiona::marketplace::testing {
namespace {

using Pieces = std::vector<std::string>;

constexpr std::size_t kHelp = 5;  // share/help.txt, the last of the honest pieces

// "LENGTH KEY=VALUE\n", where LENGTH counts itself (POSIX pax).
std::string pax_record(const std::string& key, const std::string& value) {
  const std::string rest = " " + key + "=" + value + "\n";
  std::size_t length = rest.size() + 1;
  while (std::to_string(length).size() + rest.size() != length) ++length;
  return std::to_string(length) + rest;
}

std::string pax(const std::string& records, char type = 'x') {
  return raw_file({.path = "PaxHeaders/x", .size = records.size(), .type = type}, records);
}

// Puts the checksum right after a header was changed by hand.
std::string summed(std::string piece) {
  piece.replace(148, 8, "        ");
  unsigned sum = 0;
  for (std::size_t i = 0; i < 512; ++i) sum += static_cast<unsigned char>(piece[i]);
  char text[16];
  std::snprintf(text, sizeof text, "%06o", sum);
  piece.replace(148, 7, text, 7);
  piece[155] = ' ';
  return piece;
}

std::string with_bytes(std::string piece, std::size_t at, std::string_view bytes) {
  return summed(piece.replace(at, bytes.size(), bytes));
}

class Corpus {
 public:
  explicit Corpus(const std::string& honest) : honest_(honest), pieces_(pieces_of(honest)), tar_(joined(pieces_)) {}

  std::vector<HostileArchiveKind> make() {
    add_names();
    add_types();
    add_headers();
    add_extensions();
    add_order();
    add_sizes();
    add_streams();
    return std::move(kinds_);
  }

 private:
  void add(const std::string& name, const std::string& bytes) { kinds_.push_back({name, bytes}); }
  void add_tar(const std::string& name, const std::string& tar) { add(name, compress(tar)); }
  void add_pieces(const std::string& name, const Pieces& pieces) { add_tar(name, joined(pieces)); }
  // share/help.txt becomes this.
  void replace(const std::string& name, const std::string& piece) {
    Pieces pieces = pieces_;
    pieces[kHelp] = piece;
    add_pieces(name, pieces);
  }
  // This comes before share/help.txt.
  void insert(const std::string& name, const std::string& piece, std::size_t at = kHelp) {
    Pieces pieces = pieces_;
    pieces.insert(pieces.begin() + static_cast<std::ptrdiff_t>(at), piece);
    add_pieces(name, pieces);
  }

  void add_names() {
    const std::pair<const char*, const char*> names[] = {
        {"a path that climbs out", "../../precious"},
        {"a path that climbs out from within", "share/../../../precious"},
        {"a path with a dot element", "share/./help.txt"},
        {"a path with an empty element", "share//help.txt"},
        {"an absolute path", "/tmp/precious"},
        {"two slashes at its beginning", "//precious"},
        {"a path of Windows", "share\\..\\..\\precious"},
        {"a drive of Windows", "C:/precious"},
        {"a device of Windows", "share/NUL:"},
        {"an alternate stream", "share/help.txt:evil"},
        {"a look-alike letter (Cyrillic)", "sh\xd0\xb0re/help.txt"},
        {"a full-width slash", "share\xef\xbc\x8fhelp.txt"},
        {"a division slash", "share\xe2\x88\x95..\xe2\x88\x95precious"},
        {"a name that turns right to left", "share/\xe2\x80\xaetxt.pleh"},
        {"a name with a zero-width space", "share/he\xe2\x80\x8blp.txt"},
        {"a composed letter", "share/h\xc3\xa9lp.txt"},
        {"a decomposed letter", "share/he\xcc\x81lp.txt"},
        {"an overlong encoding of a slash", "share/\xc0\xafprecious"},
        {"bytes that are not UTF-8", "share/\xff\xfe"},
        {"an escape sequence", "share/\x1b]0;evil\x07"},
        {"a line end in a name", "share/help\n.txt"},
        {"a blank at its end", "share/help.txt "},
        {"a dot at its end", "share/help.txt."},
        {"a name that is an option", "-rf"},
        {"a hidden file", "share/.bashrc"},
        {"only dots", "share/..."},
        {"the store's own list", "installed.textproto"},
        {"a package's place in the store", "packages/x"},
        {"an empty name", ""},
        {"a name in other case", "share/HELP.TXT"},
    };
    for (const auto& [what, path] : names) replace(what, raw_file({.path = path, .size = 4}, "help"));
    std::string deep = "share";
    while (deep.size() < 97) deep += "/a";
    replace("a path of fifty elements", raw_file({.path = deep, .size = 4}, "help"));
    replace("a name cut by a null byte", with_bytes(pieces_[kHelp], 0, std::string_view("share/help\0txt", 14)));
    replace("a path in the prefix field", with_bytes(raw_file({.path = "help.txt", .size = 4}, "help"), 345, "share"));
    replace("a prefix that climbs out", with_bytes(raw_file({.path = "precious", .size = 4}, "help"), 345, "../../.."));
  }

  void add_types() {
    for (const char* target : {"/etc/passwd", "../../../precious", "help.txt"}) {
      const std::string where = std::string(" to ") + target;
      replace("a symbolic link" + where, raw({.path = "share/help.txt", .type = '2', .link = target}));
      replace("a hard link" + where, raw({.path = "share/help.txt", .type = '1', .link = target}));
    }
    insert("a link for a directory, and a file through it", raw({.path = "share", .type = '2', .link = "../../.."}), 4);
    insert("a hard link with content", raw_file({.path = "share/a", .size = 4, .type = '1', .link = "x"}, "evil"));
    replace("a character device", raw({.path = "share/help.txt", .type = '3'}));
    replace("a block device", raw({.path = "share/help.txt", .type = '4'}));
    replace("a pipe", raw({.path = "share/help.txt", .type = '6'}));
    replace("a contiguous file", raw_file({.path = "share/help.txt", .size = 4, .type = '7'}, "help"));
    replace("a type that nobody has defined", raw_file({.path = "share/help.txt", .size = 4, .type = 'Z'}, "help"));
    insert("a directory", raw({.path = "share/data/", .type = '5', .mode = 0777}));
    insert("a volume's label", raw({.path = "label", .type = 'V'}));
    insert("the rest of a file of another volume", raw_file({.path = "share/a", .size = 4, .type = 'M'}, "evil"));
    insert("a directory's listing (GNU)", raw_file({.path = "share/", .size = 4, .type = 'D'}, "Yx\0\0"));
    replace("a sparse file of old GNU", raw_file({.path = "share/help.txt", .size = 4, .type = 'S'}, "help"));
  }

  void add_headers() {
    const std::string& help = pieces_[kHelp];
    std::string wrong = help;
    wrong[148] = wrong[148] == '7' ? '6' : '7';
    replace("a wrong checksum", wrong);
    replace("a set-user-id bit", raw_file({.path = "share/help.txt", .size = 4, .mode = 04644}, "help"));
    replace("a set-group-id bit", raw_file({.path = "share/help.txt", .size = 4, .mode = 02644}, "help"));
    replace("a sticky bit", raw_file({.path = "share/help.txt", .size = 4, .mode = 01644}, "help"));
    replace("a mode that all may write", raw_file({.path = "share/help.txt", .size = 4, .mode = 0666}, "help"));
    replace("another owner", with_bytes(help, 108, "000001 "));
    replace("an owner's name", with_bytes(help, 265, "root"));
    replace("a time", with_bytes(help, 136, "14000000000 "));
    replace("a time before 1970", with_bytes(help, 136, "\xff\xff\xff\xff\xff\xff\xff\xff\xff\xff\xff\xfe"));
    replace("a header of old tar", with_bytes(help, 257, std::string(8, '\0')));
    replace("a header of GNU", with_bytes(help, 257, "ustar  "));
    replace("bytes in the header's filling", with_bytes(help, 500, "evil"));
    std::string filled = help;
    filled.back() = 'x';
    replace("bytes in the file's filling", filled);
    replace("letters for a size", with_bytes(help, 124, "0000000000z "));
  }

  void add_extensions() {
    const auto extended = [&](const std::string& name, const std::string& records, char type = 'x') {
      insert(name, pax(records, type));
    };
    extended("an extended path that climbs out", pax_record("path", "../../precious"));
    extended("an extended path of the same", pax_record("path", "share/help.txt"));
    extended("an extended path of 300 characters", pax_record("path", "share/" + std::string(300, 'a')));
    extended("an extended size", pax_record("size", "1048576"));
    extended("an extended size below zero", pax_record("size", "-1"));
    extended("an extended link", pax_record("linkpath", "/etc/passwd"));
    extended("an extended owner", pax_record("uid", "0"));
    extended("an extended time", pax_record("mtime", "1e99"));
    extended("an extended character set", pax_record("hdrcharset", "BINARY") + pax_record("path", "\xff"));
    extended("an extended attribute", pax_record("SCHILY.xattr.security.capability", std::string("\1\0\0\2", 4)));
    extended("an access list", pax_record("SCHILY.acl.access", "user::rwx"));
    extended("flags of a file", pax_record("SCHILY.fflags", "immutable"));
    extended("a global header with a path", pax_record("path", "../../precious"), 'g');
    extended("a sparse map 0.1", pax_record("GNU.sparse.map", "0,1,1099511627776,1"));
    extended("a sparse size 1.0", pax_record("GNU.sparse.major", "1") + pax_record("GNU.sparse.minor", "0") +
                                      pax_record("GNU.sparse.realsize", "1099511627776"));
    extended("a record that says to be longer than all", "99999999999999999999 path=x\n");
    extended("a record that says to be 0 long", "0 path=x\n");
    extended("a record without its end", "20 path=share/help.tx");
    extended("a record with a null byte", pax_record("path", std::string("share/help.txt\0x", 16)));
    extended("a header of 900 KiB", pax_record("comment", std::string(900'000, 'c')));
    std::string many;
    for (int i = 0; i < 3000; ++i) many += pax(pax_record("comment", "x"));
    insert("three thousand headers", many);
    insert("a long name of GNU", raw_file({.path = "././@LongLink", .size = 15, .type = 'L'}, "../../precious"));
    insert("a long link of GNU", raw_file({.path = "././@LongLink", .size = 15, .type = 'K'}, "../../precious"));
    insert("a long name of 1 GiB", raw({.path = "././@LongLink", .size = 1u << 30, .type = 'L'}));
  }

  void add_order() {
    insert("a file twice", pieces_[3], 4);
    insert("a file twice with other content", raw_file({.path = "share/help.txt", .size = 4}, "evil"));
    insert("a second manifest", pieces_[0], 3);
    insert("a file that nobody lists", raw_file({.path = "share/evil", .size = 4}, "evil"));
    Pieces pieces = pieces_;
    pieces.push_back(raw_file({.path = "share/more", .size = 4}, "evil"));
    add_pieces("a file after the last", pieces);
    pieces = pieces_;
    std::swap(pieces[1], pieces[2]);
    add_pieces("files in another order", pieces);
    pieces = pieces_;
    pieces.erase(pieces.begin());
    add_pieces("no manifest", pieces);
    pieces = pieces_;
    std::swap(pieces[0], pieces[kHelp]);
    add_pieces("the manifest last", pieces);
    pieces = pieces_;
    pieces.pop_back();
    add_pieces("a file less", pieces);
    add_pieces("no file at all", {});
    insert("a block of zeros between", std::string(512, '\0'));
  }

  void add_sizes() {
    replace("a size of more than it has", raw({.path = "share/help.txt", .size = 1u << 30}));
    replace("a size of 8 GiB", with_bytes(pieces_[kHelp], 124, "77777777777 "));
    replace("a size of 2^63",
            with_bytes(pieces_[kHelp], 124, std::string_view("\x80\0\0\0\x7f\xff\xff\xff\xff\xff\xff\xff", 12)));
    replace("a size below zero", with_bytes(pieces_[kHelp], 124, "\xff\xff\xff\xff\xff\xff\xff\xff\xff\xff\xff\xff"));
    replace("another content of the same size", raw_file({.path = "share/help.txt", .size = 4}, "evil"));
    const std::string zeros(std::size_t{48} << 20, '\0');
    replace("48 MiB of zeros in a few bytes", raw_file({.path = "share/help.txt", .size = zeros.size()}, zeros));
    std::string manifest = raw({.path = "manifest.textproto", .size = (1u << 20) + 1});
    Pieces pieces = pieces_;
    pieces[0] = manifest;
    add_pieces("a manifest above its limit", pieces);
    const std::string junk(200'000, '{');
    pieces[0] = raw_file({.path = "manifest.textproto", .size = junk.size()}, junk);
    add_pieces("a manifest of braces", pieces);
    std::string nested;
    for (int i = 0; i < 20'000; ++i) nested += "files {";
    pieces[0] = raw_file({.path = "manifest.textproto", .size = nested.size()}, nested);
    add_pieces("a manifest without an end", pieces);
  }

  void add_streams() {
    add("nothing", "");
    add("a tar that is not compressed", tar_);
    add("gzip's first bytes", "\x1f\x8b\x08" + honest_);
    add("xz's first bytes", std::string("\xfd"
                                        "7zXZ\0",
                                        6) +
                                honest_);
    add("zip's first bytes", "PK\x03\x04" + honest_);
    add("zstd of before 1.0", "\x27\xb5\x2f\xfd" + honest_.substr(4));
    add("a skippable frame first", std::string("\x50\x2a\x4d\x18\x04\0\0\0evil", 12) + honest_);
    add("a skippable frame last", honest_ + std::string("\x50\x2a\x4d\x18\x04\0\0\0evil", 12));
    add("a second frame", honest_ + honest_);
    add("a byte more", honest_ + "x");
    add("half of it", honest_.substr(0, honest_.size() / 2));
    add("a window of 16 MiB", compress(tar_, 24));
    add("a window of 128 MiB", compress(tar_, 27));
    std::string dictionary = honest_;
    dictionary[4] = static_cast<char>(dictionary[4] | 1);  // the header says that a dictionary's number follows
    add("a dictionary that nobody has", dictionary);
    std::string changed = honest_;
    changed[changed.size() / 2] = static_cast<char>(changed[changed.size() / 2] ^ 0x20);
    add("a changed byte", changed);
    changed = honest_;
    changed.back() = static_cast<char>(changed.back() ^ 1);
    add("a wrong checksum of the frame", changed);
    std::string blocks("\x28\xb5\x2f\xfd\x00\x58", 6);
    for (int i = 0; i < 200'000; ++i) blocks.append("\0\0\0", 3);
    add("blocks of nothing without end", blocks);
    add_tar("a second archive behind the first", tar_ + tar_);
    add_tar("one block of zeros more", tar_ + std::string(512, '\0'));
    add_tar("an archive without its end", tar_.substr(0, tar_.size() - 1024));
    add_tar("an archive cut in a header", tar_.substr(0, 700));
    add_tar("200 MiB of zeros behind the archive", tar_ + std::string(std::size_t{200} << 20, '\0'));
    add_tar("a cpio archive", "070707" + std::string(2000, '0'));
  }

  const std::string& honest_;
  const Pieces pieces_;
  const std::string tar_;
  std::vector<HostileArchiveKind> kinds_;
};

}  // namespace

std::vector<HostileArchiveKind> hostile_corpus(const std::string& honest) { return Corpus(honest).make(); }

}  // namespace fiona::marketplace::testing
