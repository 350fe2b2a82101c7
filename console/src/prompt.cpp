#include "prompt.hpp"

#include <algorithm>

#include <fmt/format.h>

#include "catalogue.hpp"
#include "completion.hpp"
#include "grammar.hpp"
#include "line_editor.hpp"
#include "locations.hpp"
#include "verb_table.hpp"
#include "watch_list.hpp"

namespace fiona::console {
namespace {

constexpr std::chrono::milliseconds kCompletionLimit{150};
constexpr std::chrono::seconds kSnapshotLife{1};

/// Names from the running host, asked at most once a second and never for longer than the limit.
class LivingNames final : public Names {
 public:
  explicit LivingNames(Session& session) : session_(session) {}

  const control::System* system() override {
    const auto now = std::chrono::steady_clock::now();
    if (asked_ && now - *asked_ < kSnapshotLife) return known_ ? &system_ : nullptr;
    asked_ = now;
    known_ = false;
    if (!session_.connected()) return nullptr;
    control::Request request;
    request.mutable_snapshot();
    system_ = session_.host().call(std::move(request), kCompletionLimit).system();
    known_ = true;
    return &system_;
  }

  std::vector<std::string> plugins() override {
    std::vector<std::string> names;
    const Catalogue catalogue(session_.options.store);
    for (const KnownPlugin& plugin : catalogue.plugins()) {
      if (plugin.installed) names.insert(names.end(), {plugin.manifest.name(), plugin.name()});
    }
    return names;
  }

  std::vector<std::string> packages() override {
    std::vector<std::string> names;
    const Catalogue catalogue(session_.options.store);
    for (const KnownPlugin& plugin : catalogue.plugins()) names.push_back(plugin.name());
    return names;
  }

  std::vector<std::string> files(std::string_view begin) override {
    namespace fs = std::filesystem;
    const std::size_t slash = begin.rfind('/');
    const std::string directory = slash == std::string_view::npos ? "" : std::string(begin.substr(0, slash + 1));
    std::vector<std::string> names;
    std::error_code problem;
    constexpr std::size_t kMost = 10'000;
    for (const auto& entry : fs::directory_iterator(directory.empty() ? "." : directory, problem)) {
      if (names.size() < kMost)
        names.push_back(directory + entry.path().filename().string() + (entry.is_directory(problem) ? "/" : ""));
    }
    return names;
  }

 private:
  Session& session_;
  control::System system_;
  bool known_ = false;
  std::optional<SteadyTime> asked_;
};

class Prompt {
 public:
  Prompt(Session& session, const PromptOptions& options)
      : session_(session),
        options_(options),
        names_(session),
        editor_(session.reactor, history_file(), [this](std::string_view typed) { return complete(typed, names_); }),
        before_(
            session.out.exchange_sink([this](Stream stream, std::string_view lines) { editor_.print(stream, lines); })),
        setting_(session.setting) {
    session.setting = Setting::Prompt;
  }
  Prompt(const Prompt&) = delete;
  Prompt& operator=(const Prompt&) = delete;
  ~Prompt() {
    if (run_ && session_.connected()) session_.host().forget(*run_);
    session_.setting = setting_;
    session_.out.exchange_sink(std::move(before_));
  }

  void serve() {
    session_.host().set_author("console");
    if (options_.let_run) let_run();
    while (!session_.finished && !left_) {
      if (!session_.connected()) return gone();
      try {
        serve_line();
      } catch (const Interrupted&) {
        interrupted();
      }
    }
  }

 private:
  void serve_line() {
    const bool more = !typed_.empty();
    const auto line = editor_.read(asking_ ? "stop the host and its system? (yes/no) "
                                   : more            ? "     > "
                                   : session_.batch ? fmt::format("fiona({})> ", session_.batch->changes.size())
                                                     : "fiona> ",
                                   [this] { return !session_.connected(); });
    if (!session_.connected()) return;
    if (asking_) return take_answer(line);
    if (!line) return leave();
    typed_ += (more ? "\n" : "") + *line;
    if (continues(typed_)) return;
    const std::string typed = std::exchange(typed_, {});
    editor_.remember(joined(typed));
    run(typed);
  }

  static std::string joined(std::string line) {
    for (std::size_t at = 0; (at = line.find("\\\n", at)) != std::string::npos;) line.replace(at, 2, "");
    return line;
  }

  void run(const std::string& typed) {
    try {
      const WordLine words = split_line(typed);
      if (words.empty()) return;
      ending_ = words.items.front().word.is_plain("quit");
      session_.run(words);
    } catch (const Interrupted&) {
      session_.out.remark("interrupted");
    } catch (const Error& error) {
      session_.out.error(error);
    }
    ending_ = false;
  }

  void let_run() {
    control::Request request;
    request.mutable_run();
    run_ = session_.host().begin(std::move(request), [this](const control::Reply& reply) {
      if (reply.has_ended() && !ending_)
        session_.out.remark(fmt::format("the run ended{}{} (exit code {}); `quit` ends the host",
                                        reply.ended().reason().empty() ? "" : ": ", reply.ended().reason(),
                                        reply.ended().exit_code()));
    });
  }

  void leave() {
    if (options_.started_host)
      asking_ = true;
    else
      left_ = true;
  }

  void take_answer(const std::optional<std::string>& answer) {
    asking_ = false;
    if (answer && !answer->starts_with('y') && !answer->starts_with('Y')) return;
    run("quit");
  }

  void interrupted() {
    typed_.clear();
    asking_ = false;
    const std::size_t stopped = session_.connected() ? session_.watches().stop("") : 0;
    session_.out.remark(stopped > 0 ? fmt::format("stopped {} watch{}", stopped, stopped == 1 ? "" : "es")
                                    : "Ctrl-D leaves");
  }

  void gone() const {
    if (options_.started_host) return;  // its own exit code says why
    throw Error(ErrorCode::Unreachable, ErrorText{.what = "the host has gone", .next = "fiona ls hosts"});
  }

  Session& session_;
  const PromptOptions options_;
  LivingNames names_;
  LineEditor editor_;
  Output::Sink before_;
  const Setting setting_;
  std::string typed_;
  std::optional<std::uint64_t> run_;
  bool asking_ = false;
  bool ending_ = false;  // by a line of ours, which needs no news about it
  bool left_ = false;
};

}  // namespace

void run_prompt(Session& session, const PromptOptions& options) { Prompt(session, options).serve(); }

}  // namespace fiona::console
