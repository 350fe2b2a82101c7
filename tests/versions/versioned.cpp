// A component of which there are many versions, good ones and bad ones: the words in the file `behaviour` of its share
// folder say which this is; without a `version` there, its code does.
#include <dlfcn.h>
#include <signal.h>
#include <unistd.h>

#include <fiona/plugin.hpp>

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <sstream>
#include <stdexcept>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "fiona/test/test.fiona.hpp"

namespace fiona::test {
namespace {

using namespace std::chrono_literals;

std::string read(const std::filesystem::path& file) {
  std::stringstream text;
  text << std::ifstream(file).rdbuf();
  return text.str();
}

/// "version=2 dies_after_ms=500": the value behind a name, 0 where there is none.
double word(const std::string& behaviour, const std::string& name) {
  std::istringstream text(behaviour);
  for (std::string one; text >> one;) {
    if (one.starts_with(name + "=")) return std::atof(one.substr(name.size() + 1).c_str());
  }
  return 0;
}

std::filesystem::path beside_library() {
  Dl_info found{};
  ::dladdr(reinterpret_cast<const void*>(&beside_library), &found);
  const std::filesystem::path library = found.dli_fname ? found.dli_fname : "";
  return library.parent_path() / "versioned.share" / "behaviour";
}

const bool kOpened = [] {
  if (word(read(beside_library()), "dies_when_opened") > 0) ::raise(SIGABRT);
  return true;
}();

/// A test writes another number over this one in a copy of the library, which is another build then.
constexpr char kBuild[] = "this is build 0000000";

double build() {
  const volatile char* text = kBuild;  // read when it runs: what a compiler knew would not be another build
  double number = 0;
  for (std::size_t i = sizeof kBuild - 8; i + 1 < sizeof kBuild; ++i) number = 10 * number + (text[i] - '0');
  return number;
}

Duration from_ms(double ms) {
  return std::chrono::duration_cast<Duration>(std::chrono::duration<double, std::milli>(ms));
}

}  // namespace

/// Ticks, answers and gives orders, so that whoever hears it can tell which version it was, and whether anything is
/// missing.
class Versioned final : public Component {
 public:
  using Component::Component;
  void on_start() override {
    behaviour_ = read(resource("behaviour"));  // once: the next build may overwrite it
    std::this_thread::sleep_for(from_ms(word(behaviour_, "start_ms")));
    if (word(behaviour_, "refuses") > 0) throw std::runtime_error("the antenna does not fit");
    if (word(behaviour_, "dies_in_start") > 0) ::abort();
    if (word(behaviour_, "hangs_in_start") > 0) std::this_thread::sleep_for(1h);
  }
  void on_stop() override {
    const double ms = word(behaviour_, "stop_ms");
    std::this_thread::sleep_for(from_ms(ms));
    if (ms > 0) std::ofstream(beside_library().parent_path() / "stopped") << ms;
  }
  void on_mode(std::string_view mode) override {
    if (mode == kModeNeutral) std::this_thread::sleep_for(from_ms(word(behaviour_, "rest_ms")));
    if (mode != kModeActive) return;
    next_.at(now() + from_ms(word(behaviour_, "quiet_ms")));
    if (const double ms = word(behaviour_, "dies_after_ms"); ms > 0) end_.at(now() + from_ms(ms));
    if (const double ms = word(behaviour_, "hangs_after_ms"); ms > 0) end_.at(now() + from_ms(ms));
    if (const double ms = word(behaviour_, "fails_after_ms"); ms > 0) end_.at(now() + from_ms(ms));
    if (const double ms = word(behaviour_, "silent_after_ms"); ms > 0) end_.at(now() + from_ms(ms));
  }

 private:
  void tick() {
    next_.at(now() + from_ms(params_->period_ms()));
    if (silent_ || word(behaviour_, "silent") > 0) return;
    Sample sample;
    sample.set_number(++ticked_);
    const double version = word(behaviour_, "version");
    sample.set_value(version > 0 ? version : build());
    sample.set_sent_ns(born_.time_since_epoch().count());
    orders_.send(sample);
    leased_.put(sample);
    samples_.put(std::move(sample));
  }
  void end() {
    if (word(behaviour_, "dies_after_ms") > 0) ::abort();
    if (word(behaviour_, "hangs_after_ms") > 0) std::this_thread::sleep_for(1h);
    if (word(behaviour_, "fails_after_ms") > 0) throw std::runtime_error("the antenna fell off");
    silent_ = true;
  }
  void on_question(const Question& question, fiona::Reply<Reply> reply) {
    Reply answer;
    answer.set_number(question.number());
    if (waiting_.empty()) answer_.at(now() + 5ms);
    waiting_.emplace_back(std::move(answer), std::move(reply));
  }
  /// Later, so that there are questions on their way at every moment.
  void answer_waiting() {
    for (auto& [answer, reply] : std::exchange(waiting_, {})) {
      ++answered_;
      reply.answer(std::move(answer));
    }
  }
  TickerReport report(const Question&) {
    TickerReport report;
    report.set_ticked(ticked_);
    report.set_answered(answered_);
    return report;
  }

  const std::chrono::steady_clock::time_point born_ = std::chrono::steady_clock::now();  ///< each counts from 1
  std::string behaviour_;
  bool silent_ = false;
  std::uint64_t ticked_ = 0;
  std::uint64_t answered_ = 0;
  std::vector<std::pair<Reply, fiona::Reply<Reply>>> waiting_;
  Params<TickerParams> params_{*this};
  Provides<SampleNewest> samples_{*this, "samples"};
  Provides<SampleLeased> leased_{*this, "leased"};
  Provides<Echo> echo_{*this, "echo", &Versioned::on_question};
  Requires<Order> orders_{*this, "orders", {.optional = true}};
  Requires<SampleNewest> heard_{*this, "heard", {.optional = true}};
  Trigger<Question, TickerReport> report_{*this, "report", &Versioned::report};
  Timer next_{*this, &Versioned::tick};
  Timer end_{*this, &Versioned::end};
  Timer answer_{*this, &Versioned::answer_waiting};
};

}  // namespace fiona::test

FIONA_PLUGIN(plugin) { plugin.add<fiona::test::Versioned>("versioned", "says which version of it this is"); }
