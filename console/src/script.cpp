#include "script.hpp"

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstring>
#include <fstream>
#include <sstream>
#include <utility>

#include <fmt/format.h>

#include "verb_table.hpp"

namespace fiona::console {
namespace {

/// Puts the settings of a script in place, and the old ones back.
class ScriptSetting {
 public:
  explicit ScriptSetting(Session& session) : session_(session), setting_(session.setting) {
    session.setting = Setting::Script;
  }
  ScriptSetting(const ScriptSetting&) = delete;
  ScriptSetting& operator=(const ScriptSetting&) = delete;
  ~ScriptSetting() { session_.setting = setting_; }

 private:
  Session& session_;
  const Setting setting_;
};

std::vector<std::string> system_files_in(const std::filesystem::path& folder) {
  constexpr std::size_t kMost = 1000;
  std::vector<std::string> files;
  std::error_code failure;
  for (std::filesystem::directory_iterator entry(folder.empty() ? "." : folder, failure);
       !failure && files.size() < kMost && entry != std::filesystem::directory_iterator(); entry.increment(failure)) {
    if (entry->path().extension() == ".fiona") files.push_back((folder / entry->path().filename()).string());
  }
  std::sort(files.begin(), files.end());
  return files;
}

std::vector<Line> own_lines(const std::filesystem::path& file) {
  std::vector<Line> lines;
  for (const WordLine& words : split_script(read_text(file), file.string())) lines.push_back(read_line(words));
  return lines;
}

/// The lines of a script, with those of the files that it sources in their place.
class Sourcing {
 public:
  std::vector<Line> lines_of(const std::filesystem::path& file) {
    open_.push_back(file.lexically_normal());
    add(own_lines(file));
    return std::move(lines_);
  }

 private:
  void add(std::vector<Line> own) {
    for (Line& line : own) line.verb.text == "source" ? add_sourced(line) : lines_.push_back(std::move(line));
  }

  void add_sourced(const Line& source) {
    const Word& name = source.positional[0];
    const auto file = named_file(source.words, name.text).lexically_normal();
    if (std::find(open_.begin(), open_.end(), file) != open_.end())
      throw source.error(name, {.what = "files source each other in a circle", .next = "take this line out"});
    if (++sourced_ > kMostSourced)
      throw source.error(name, {.what = fmt::format("more than {} files are sourced", kMostSourced),
                                .next = "source parts of them one after the other"});
    open_.push_back(file);
    add(lines_at(source, file));
    open_.pop_back();
  }

  /// Where there is no such file, the line that names it is told.
  static std::vector<Line> lines_at(const Line& source, const std::filesystem::path& file) {
    try {
      return own_lines(file);
    } catch (const LineError&) {
      throw;
    } catch (const Error& error) {
      throw LineError(source.words, source.positional[0].place, error.text(), error.code());
    }
  }

  std::vector<Line> lines_;
  std::vector<std::filesystem::path> open_;  ///< those that are being read, each sourced by the one before
  std::size_t sourced_ = 0;
};

}  // namespace

std::string read_text(const std::filesystem::path& file) {
  std::error_code problem;
  const auto status = std::filesystem::status(file, problem);
  if (!std::filesystem::exists(status))
    throw Error(ErrorCode::NotFound,
                ErrorText{.what = "there is no such file",
                          .where = file.string(),
                          .next = "name a system file, or an installed system: fiona market list",
                          .near = nearest_names(file.string(), system_files_in(file.parent_path()))});
  if (std::filesystem::is_directory(status)) {
    constexpr std::size_t kMost = 3;
    auto inside = system_files_in(file);
    inside.resize(std::min(inside.size(), kMost));
    throw Error(ErrorCode::Usage, ErrorText{.what = "this is a directory",
                                            .where = file.string(),
                                            .expected = "a system file, or the name of an installed system",
                                            .near = std::move(inside)});
  }
  std::ifstream in(file, std::ios::binary);
  constexpr std::size_t kMost = kLongestScript + 1;  // one more than it may have: a script says that it is too long
  std::string text;
  for (std::array<char, 1U << 16U> block{}; in && text.size() < kMost;) {
    in.read(block.data(), block.size());
    text.append(block.data(), static_cast<std::size_t>(in.gcount()));
  }
  if (!in && !in.eof())
    throw Error(ErrorCode::Failed, ErrorText{.what = fmt::format("the file cannot be read: {}", std::strerror(errno)),
                                             .where = file.string(),
                                             .next = "see what it allows: ls -l " + file.string()});
  return text;
}

std::vector<Line> read_script(const std::filesystem::path& file) { return Sourcing().lines_of(file); }

void run_script(Session& session, const std::vector<Line>& lines, const std::function<void(const Line&)>& before) {
  const ScriptSetting setting(session);
  const bool began = session.batch.has_value();
  const Line* open = nullptr;
  try {
    for (const Line& line : lines) {
      if (before) before(line);
      session.run(line);
      if (session.finished) return;
      if (line.verb.text == "begin") open = &line;
    }
    if (session.batch && !began && open)
      throw open->error(open->verb,
                        {.what = "this transaction is not committed: nothing of it was done", .next = "commit"});
  } catch (...) {
    if (!began) session.batch.reset();  // no half transaction is left
    throw;
  }
}

}  // namespace fiona::console
