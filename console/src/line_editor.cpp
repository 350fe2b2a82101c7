#include "line_editor.hpp"

#include <algorithm>
#include <climits>
#include <clocale>
#include <csignal>
#include <cstdio>
#include <cstdlib>

#include <fcntl.h>
#include <fmt/format.h>
#include <histedit.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include "inert.hpp"

namespace fiona::console {
namespace {

constexpr int kMostHistory = 1000;
/// Of lines in the file, from where on the oldest are left out: not at each line.
constexpr int kLongestFile = 2 * kMostHistory;
constexpr std::size_t kMostListed = 200;
constexpr char kEndOfFile = 4;  // Ctrl-D

std::size_t terminal_columns() {
  const std::size_t known = Output::terminal_columns();
  return known > 0 ? known : 80;
}

std::string common_beginning(const std::vector<std::string>& candidates) {
  std::string common = candidates.front();
  for (const std::string& candidate : candidates) {
    const auto [end, other] = std::mismatch(common.begin(), common.end(), candidate.begin(), candidate.end());
    common.erase(end, common.end());
  }
  // Nor does half a character of UTF-8 stand alone.
  const auto is_inside = [](char byte) { return (static_cast<unsigned char>(byte) & 0xC0U) == 0x80U; };
  std::size_t end = common.size();
  while (end > 0 && end < candidates.front().size() && is_inside(candidates.front()[end])) --end;
  common.resize(end);
  return common;
}

/// In as many columns as the terminal has room for.
std::string listed(const std::vector<std::string>& candidates) {
  const std::size_t shown = std::min(candidates.size(), kMostListed);
  std::size_t width = 0;
  for (std::size_t i = 0; i < shown; ++i) width = std::max(width, display_width(candidates[i]) + 2);
  const std::size_t columns = std::max<std::size_t>(1, terminal_columns() / width);
  std::string text;
  for (std::size_t i = 0; i < shown; ++i) {
    const bool last = (i + 1) % columns == 0 || i + 1 == shown;
    text += inert(candidates[i]) + (last ? "\n" : std::string(width - display_width(candidates[i]), ' '));
  }
  if (shown < candidates.size()) text += fmt::format("… and {} more\n", candidates.size() - shown);
  return text;
}

/// Nobody else changes the history's file while this lives.
class HistoryLock {
 public:
  explicit HistoryLock(const std::filesystem::path& file)
      : folder_(::open(file.parent_path().c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC)) {
    // A prompt that is stopped may have it: then a line may be lost, and nobody waits.
    constexpr int kTries = 50;
    for (int i = 0; folder_ >= 0 && ::flock(folder_, LOCK_EX | LOCK_NB) != 0 && i < kTries; ++i) ::usleep(10'000);
  }
  HistoryLock(const HistoryLock&) = delete;
  HistoryLock& operator=(const HistoryLock&) = delete;
  ~HistoryLock() {
    if (folder_ >= 0) ::close(folder_);
  }

 private:
  const int folder_;
};

}  // namespace

void LineEditor::End::operator()(::editline* editor) const { el_end(editor); }
void LineEditor::End::operator()(struct ::history* lines) const { history_end(lines); }

namespace {

LineEditor::Remembered remembered(int most) {
  LineEditor::Remembered lines(history_init());
  HistEvent event{};
  history(lines.get(), &event, H_SETSIZE, most);
  return lines;
}

/// Its last lines only, once there are too many. A reader, or a power cut, sees the old file or the new one.
void shorten(const std::filesystem::path& file) {
  const auto all = remembered(INT_MAX);
  HistEvent event{};
  if (history(all.get(), &event, H_LOAD, file.c_str()) < kLongestFile) return;
  const auto last = remembered(kMostHistory);
  history(last.get(), &event, H_LOAD, file.c_str());
  const std::string fresh = file.string() + ".new";
  if (history(last.get(), &event, H_SAVE, fresh.c_str()) < 0 || ::rename(fresh.c_str(), file.c_str()) != 0)
    ::unlink(fresh.c_str());
}

/// After those of other prompts.
void append(const std::filesystem::path& file, const std::string& line) {
  const auto one = remembered(1);
  HistEvent event{};
  history(one.get(), &event, H_ENTER, line.c_str());
  const HistoryLock lock(file);
  const int descriptor = ::open(file.c_str(), O_WRONLY | O_APPEND | O_CREAT | O_CLOEXEC, 0600);
  std::FILE* stream = descriptor < 0 ? nullptr : ::fdopen(descriptor, "a");
  if (stream == nullptr) return;
  std::fseek(stream, 0, SEEK_END);  // the first line of an empty file is the format's own
  history(one.get(), &event, H_SAVE_FP, stream);
  std::fclose(stream);
}

}  // namespace

LineEditor::LineEditor(Reactor& reactor, std::filesystem::path history_file, Completer completer)
    : reactor_(reactor),
      file_(std::move(history_file)),
      completer_(std::move(completer)),
      lines_(remembered(kMostHistory)) {
  std::setlocale(LC_CTYPE, "");
  editor_.reset(el_init("fiona", stdin, stdout, stderr));
  const auto bind = [this](const char* key, const char* function) {
    el_set(editor_.get(), EL_BIND, key, function, static_cast<char*>(nullptr));
  };
  // It keeps what it is given; of what is not wide it makes copies that it never lets go of.
  const auto add = [this](const wchar_t* name, const wchar_t* does, unsigned char (*function)(::editline*, wint_t)) {
    el_wset(editor_.get(), EL_ADDFN, name, does, function);
  };
  el_set(editor_.get(), EL_CLIENTDATA, this);
  el_set(editor_.get(), EL_PROMPT, &LineEditor::prompt_of);
  el_set(editor_.get(), EL_HIST, history, lines_.get());
  el_set(editor_.get(), EL_EDITOR, "emacs");
  add(L"fiona-complete", L"what could stand here", &LineEditor::on_complete);
  bind("^I", "fiona-complete");
  bind("^R", "em-inc-search-prev");
  for (const char* key : {"\\e[1~", "\\e[7~", "\\e[H"}) bind(key, "ed-move-to-beg");
  for (const char* key : {"\\e[4~", "\\e[8~", "\\e[F"}) bind(key, "ed-move-to-end");
  bind("\\e[3~", "ed-delete-next-char");
  bind("\\e[2~", "em-toggle-overwrite");
  for (const char* key : {"\\e[1;5C", "\\e[5C", "\\e\\e[C"}) bind(key, "em-next-word");
  for (const char* key : {"\\e[1;5D", "\\e[5D", "\\e\\e[D"}) bind(key, "ed-prev-word");
  el_source(editor_.get(), nullptr);  // ~/.editrc
  if (file_.empty()) return;
  std::error_code problem;
  std::filesystem::create_directories(file_.parent_path(), problem);
  const HistoryLock lock(file_);
  shorten(file_);
  HistEvent event{};
  history(lines_.get(), &event, H_LOAD, file_.c_str());
}

LineEditor::~LineEditor() {
  if (editing_) end_editing();
}

LineEditor& LineEditor::of(::editline* editor) {
  void* self = nullptr;
  el_get(editor, EL_CLIENTDATA, &self);
  return *static_cast<LineEditor*>(self);
}

char* LineEditor::prompt_of(::editline* editor) { return of(editor).prompt_.data(); }

void LineEditor::remember(const std::string& line) {
  const bool blank = line.find_first_not_of(" \t\n") == std::string::npos;
  if (blank || line == last_remembered_) return;
  last_remembered_ = line;
  HistEvent event{};
  history(lines_.get(), &event, H_ENTER, line.c_str());
  if (!file_.empty()) append(file_, line);
}

void LineEditor::begin_editing() {
  done_ = false;
  line_.reset();
  editing_ = true;
  el_resize(editor_.get());
  el_set(editor_.get(), EL_UNBUFFERED, 1);
  reactor_.add_terminal([this] { read_character(); });
  reactor_.on_continued([this] { take_terminal_back(); });
}

/// No exception passes through the editor's library.
void LineEditor::read_character() {
  int size = 0;
  const char* typed = el_gets(editor_.get(), &size);
  if (terminated_) throw Terminated();
  if (typed == nullptr || size <= 0) return;
  const char last = typed[size - 1];
  done_ = last == '\n' || last == '\r' || (size == 1 && last == kEndOfFile);
  if (done_ && last != kEndOfFile) line_ = std::string(typed, static_cast<std::size_t>(size) - 1);
}

void LineEditor::end_editing() {
  editing_ = false;
  reactor_.on_continued(nullptr);
  reactor_.remove(STDIN_FILENO);
  el_set(editor_.get(), EL_UNBUFFERED, 0);
}

std::optional<std::string> LineEditor::read(const std::string& prompt, const std::function<bool()>& ended) {
  prompt_ = prompt;
  begin_editing();
  try {
    reactor_.run_until([this, &ended] { return done_ || ended(); });
  } catch (...) {
    end_editing();
    std::fputs("\n", stdout);
    std::fflush(stdout);
    throw;
  }
  const bool unfinished = !done_;
  end_editing();
  if (unfinished || !line_) {
    std::fputs("\n", stdout);
    std::fflush(stdout);
  }
  return line_;
}

std::string LineEditor::typed() const {
  const LineInfo* line = el_line(editor_.get());
  return {line->buffer, line->cursor};
}

/// Adds what all that could stand here have in common; lists them where that is no more than is typed.
unsigned char LineEditor::on_complete(::editline* library, wint_t) {
  LineEditor& editor = of(library);
  const std::string typed = editor.typed();
  // The completer may wait for the host, and a key must not be read inside of reading a key.
  editor.reactor_.remove(STDIN_FILENO);
  Completion completion;
  try {
    completion = editor.completer_(typed);
  } catch (const Terminated&) {
    editor.terminated_ = true;
  } catch (const std::exception&) {
    completion.candidates.clear();  // nothing to offer; the key does nothing
  }
  editor.reactor_.add_terminal([&editor] { editor.read_character(); });
  if (completion.candidates.empty()) return CC_ERROR;
  const std::string common = common_beginning(completion.candidates);
  const bool only = completion.candidates.size() == 1;
  const std::string more = common.substr(std::min(common.size(), typed.size() - completion.start)) +
                           (only && !common.ends_with('=') && !common.ends_with('/') ? " " : "");
  if (!more.empty()) return el_insertstr(library, more.c_str()) < 0 ? CC_ERROR : CC_REFRESH;
  editor.print(Stream::Out, listed(completion.candidates));
  return CC_NORM;
}

/// After Ctrl-Z and `fg`: the shell has had the terminal meanwhile.
void LineEditor::take_terminal_back() {
  const LineInfo* line = el_line(editor_.get());
  const std::string typed(line->buffer, line->lastchar);
  el_set(editor_.get(), EL_UNBUFFERED, 0);
  el_set(editor_.get(), EL_UNBUFFERED, 1);
  if (typed.empty()) return;
  el_insertstr(editor_.get(), typed.c_str());
  std::fputs("\r\033[J", stdout);  // the prompt without it
  std::fflush(stdout);
  el_set(editor_.get(), EL_REFRESH);
}

std::size_t LineEditor::cursor_row() const {
  return (display_width(prompt_) + display_width(typed())) / terminal_columns();
}

void LineEditor::print(Stream stream, std::string_view lines) {
  std::FILE* file = stream == Stream::Out ? stdout : stderr;
  const bool above = editing_ && !done_;
  if (above) {
    // To the first row of what is typed, then everything from there on away.
    std::fputs("\r", stdout);
    for (std::size_t row = cursor_row(); row > 0; --row) std::fputs("\033[A", stdout);
    std::fputs("\033[J", stdout);
    std::fflush(stdout);
  }
  std::fwrite(lines.data(), 1, lines.size(), file);
  std::fflush(file);
  if (above) el_set(editor_.get(), EL_REFRESH);
}

}  // namespace fiona::console
