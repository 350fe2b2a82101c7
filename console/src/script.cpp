#include "script.hpp"

#include <cerrno>
#include <cstring>
#include <fstream>
#include <sstream>

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

}  // namespace

std::string read_text(const std::filesystem::path& file) {
  std::error_code problem;
  const auto status = std::filesystem::status(file, problem);
  if (!std::filesystem::exists(status))
    throw Error(ErrorCode::NotFound, ErrorText{.what = "there is no such file", .where = file.string()});
  if (std::filesystem::is_directory(status))
    throw Error(ErrorCode::Usage,
                ErrorText{.what = "this is a directory", .where = file.string(), .expected = "a system file"});
  std::ifstream in(file, std::ios::binary);
  constexpr std::size_t kMost = (16U << 20U) + 1;  // one more than a script may have: it says that it is too long
  std::string text(kMost, '\0');
  if (in) in.read(text.data(), static_cast<std::streamsize>(kMost));
  if (!in && !in.eof())
    throw Error(ErrorCode::Failed, ErrorText{.what = fmt::format("the file cannot be read: {}", std::strerror(errno)),
                                             .where = file.string()});
  text.resize(static_cast<std::size_t>(in.gcount()));
  return text;
}

std::vector<Line> read_script(const std::filesystem::path& file) {
  std::vector<Line> lines;
  for (const WordLine& words : split_script(read_text(file), file.string())) lines.push_back(read_line(words));
  return lines;
}

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
