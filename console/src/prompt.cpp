#include "prompt.hpp"

#include <algorithm>

#include <sys/resource.h>

#include <fmt/format.h>

#include "grammar.hpp"
#include "line_editor.hpp"
#include "living_names.hpp"
#include "locations.hpp"
#include "typed_secrets.hpp"
#include "verb_table.hpp"
#include "watch_list.hpp"

namespace fiona::console {
namespace {

constexpr std::chrono::milliseconds kRetryPeriod{500};

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
    session.is_guest = !options.started_host;
    ask_before_ = std::exchange(session.ask, [this](const std::string& question) -> std::optional<bool> {
      const bool ending = std::exchange(ending_, false);
      const auto answer = editor_.read(question, [this] { return has_ended(); });
      const bool agreed = answer && (answer->starts_with('y') || answer->starts_with('Y'));
      ending_ = ending && agreed;
      return agreed;
    });
  }
  Prompt(const Prompt&) = delete;
  Prompt& operator=(const Prompt&) = delete;
  ~Prompt() {
    if (session_.connected()) session_.host().on_closed(nullptr);
    if (run_ && session_.connected()) session_.host().forget(*run_);
    if (retry_) session_.reactor.cancel_timer(*retry_);
    session_.setting = setting_;
    session_.is_guest = false;
    session_.ask = std::move(ask_before_);
    session_.out.exchange_sink(std::move(before_));
  }

  void serve() {
    attach();
    if (options_.let_run) let_run();
    while (!session_.finished && !left_) {
      if (has_ended()) return void(session_.finished = ended_with_);
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
    const auto line = editor_.read(asking_          ? "stop the host and its system? (yes/no) "
                                   : more           ? "     > "
                                   : session_.batch ? fmt::format("fiona({})> ", session_.batch->changes.size())
                                                    : "fiona> ",
                                   [this] { return has_ended(); });
    if (has_ended()) return;
    if (asking_) return take_answer(line);
    if (!line) return leave();
    typed_ += (more ? "\n" : "") + *line;
    if (continues(typed_)) return;
    const std::string typed = std::exchange(typed_, {});
    editor_.remember(kept_part(joined(typed), session_, names_));
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
    } catch (const Interrupted& interrupted) {
      session_.out.remark(interrupted.what());
    } catch (const Error& error) {
      session_.out.error(error);
    }
    ending_ = false;
    if (goes_on() && !session_.connected() && !session_.finished && !retry_) retry_later();
  }

  void let_run() {
    control::Request request;
    request.mutable_run();
    run_ = session_.host().begin(std::move(request), [this](const control::Reply& reply) {
      if (reply.has_ended() && reply.ended().reason() == "quit") ended_with_ = reply.ended().exit_code();
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

  /// A host that this process started; its own exit code says why.
  bool has_ended() const {
    return options_.started_host && !session_.connected() && !(options_.comes_back && options_.comes_back());
  }

  void attach() {
    ControlClient& host = session_.host();
    host.set_author("console");
    if (const RemoteLink* remote = host.remote())
      session_.out.remark(fmt::format("this console may {} at host '{}'", remote->level(), remote->host()));
    if (goes_on()) host.on_closed([this] { lost(); });
  }

  /// Also when its host has gone.
  bool goes_on() const { return !options_.started_host || options_.comes_back; }

  void lost() {
    if (ending_ || session_.finished) return;
    session_.out.remark(fmt::format("{}; this prompt goes on when it is back, Ctrl-D leaves", session_.farewell()));
    retry_later();
  }

  void retry_later() {
    retry_ = session_.reactor.add_timer(std::chrono::steady_clock::now() + kRetryPeriod, [this] { retry(); });
  }

  void retry() {
    retry_.reset();
    try {
      attach();
    } catch (const Error&) {
      return retry_later();
    } catch (const Interrupted&) {
      retry_later();
      throw;
    }
    if (options_.let_run) let_run();
    session_.out.remark("the host is back");
  }

  Session& session_;
  const PromptOptions options_;
  LivingNames names_;
  LineEditor editor_;
  Output::Sink before_;
  const Setting setting_;
  std::function<std::optional<bool>(const std::string&)> ask_before_;
  std::string typed_;
  std::optional<std::uint64_t> retry_;
  std::optional<std::uint64_t> run_;
  bool asking_ = false;
  bool ending_ = false;  // by a line of ours, which needs no news about it
  bool left_ = false;
  std::optional<int> ended_with_;  ///< what somebody else has typed: quit CODE
};

}  // namespace

void run_prompt(Session& session, const PromptOptions& options) {
  // What is typed may be a password, and none reaches a disk. What this process starts may leave cores again.
  rlimit cores{};
  ::getrlimit(RLIMIT_CORE, &cores);
  cores.rlim_cur = 0;
  ::setrlimit(RLIMIT_CORE, &cores);
  Prompt(session, options).serve();
}

}  // namespace fiona::console
