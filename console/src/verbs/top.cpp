#include <unistd.h>

#include <algorithm>
#include <deque>
#include <optional>
#include <utility>

#include <fmt/format.h>
#include <fmt/ranges.h>

#include "../screen.hpp"
#include "../top_view.hpp"
#include "verbs.hpp"

namespace fiona::console::verbs {
namespace {

using std::chrono::milliseconds;
using Order = TopView::Order;

constexpr milliseconds kPeriod{1000};
constexpr milliseconds kShortest{100};
constexpr milliseconds kLongest{10'000};
/// What the console has to say meanwhile, for afterwards.
constexpr std::size_t kMostKept = 1000;
constexpr std::size_t kPage = 10;

Order order_of(const Line& line) {
  const Word* word = line.argument("sort");
  if (word == nullptr) return Order::Busy;
  const auto found = std::find(TopView::kOrders.begin(), TopView::kOrders.end(), word->text);
  if (found != TopView::kOrders.end()) return static_cast<Order>(found - TopView::kOrders.begin());
  const std::vector<std::string> known(TopView::kOrders.begin(), TopView::kOrders.end());
  throw line.error(*word, {.what = fmt::format("there is no column '{}' to sort by", word->text),
                           .expected = fmt::format("{}", fmt::join(known, ", ")),
                           .near = nearest_names(word->text, known)});
}

milliseconds period_of(const Line& line, const char* clause, milliseconds otherwise) {
  const Word* word = line.clause(clause);
  return word == nullptr ? otherwise : milliseconds(static_cast<std::int64_t>(duration_ms(*word, line.words)));
}

/// Holds what is said while the screen is taken, and says it when it is free again.
class Meanwhile {
 public:
  explicit Meanwhile(Output& out)
      : out_(out), before_(out.exchange_sink([this](Stream stream, std::string_view lines) {
          if (kept_.size() == kMostKept) kept_.pop_front();
          kept_.emplace_back(stream, lines);
        })) {}
  Meanwhile(const Meanwhile&) = delete;
  Meanwhile& operator=(const Meanwhile&) = delete;
  ~Meanwhile() {
    for (const auto& [stream, lines] : kept_) before_(stream, lines);
    out_.exchange_sink(std::move(before_));
  }

 private:
  Output& out_;
  std::deque<std::pair<Stream, std::string>> kept_;
  Output::Sink before_;
};

class FullScreen {
 public:
  FullScreen(Session& session, Order order, milliseconds period)
      : session_(session), order_(order), period_(std::clamp(period, kShortest, kLongest)), meanwhile_(session.out) {}
  FullScreen(const FullScreen&) = delete;
  FullScreen& operator=(const FullScreen&) = delete;
  ~FullScreen() {
    session_.reactor.remove(STDIN_FILENO);
    if (timer_) session_.reactor.cancel_timer(*timer_);
  }

  /// Until q is typed, or for so long.
  void serve(std::optional<milliseconds> limit) {
    session_.reactor.add_terminal([] {});  // wakes the wait; the keys are taken below
    refresh();
    std::optional<SteadyTime> deadline;
    if (limit) deadline = std::chrono::steady_clock::now() + *limit;
    session_.reactor.run_until([this] { return take_keys(); }, deadline);
  }

 private:
  void refresh() {
    view_.update(session_.snapshot(), std::chrono::steady_clock::now());
    draw();
    timer_ = session_.reactor.add_timer(std::chrono::steady_clock::now() + period_, [this] { refresh(); });
  }

  /// Whether that was all.
  bool take_keys() {
    char character = 0;
    for (Screen::Key key = screen_.read(character); key != Screen::Key::None; key = screen_.read(character)) {
      if (key == Screen::Key::Character && character == 'q') return true;
      take(key, character);
      draw();
    }
    return false;
  }

  void take(Screen::Key key, char character) {
    const auto names = view_.names(order_);
    const auto at = static_cast<std::size_t>(std::find(names.begin(), names.end(), selected_) - names.begin());
    const std::size_t row = at == names.size() ? 0 : at;
    const auto select = [&](std::size_t to) {
      if (!names.empty() && !inside_) selected_ = names[std::min(to, names.size() - 1)];
    };
    switch (key) {
      case Screen::Key::Up: return select(row == 0 ? 0 : row - 1);
      case Screen::Key::Down: return select(row + 1);
      case Screen::Key::PageUp: return select(row < kPage ? 0 : row - kPage);
      case Screen::Key::PageDown: return select(row + kPage);
      case Screen::Key::Enter:
        select(row);
        inside_ = !names.empty();
        return;
      case Screen::Key::Back: inside_ = false; return;
      case Screen::Key::Character: return take_character(character);
      default: return;
    }
  }

  void take_character(char character) {
    const auto count = static_cast<unsigned>(TopView::kOrders.size());
    if (character == 's') order_ = static_cast<Order>((static_cast<unsigned>(order_) + 1) % count);
    if (character == '+') period_ = std::max(kShortest, period_ / 2);
    if (character == '-') period_ = std::min(kLongest, period_ * 2);
    if (character == 'k') take(Screen::Key::Up, 0);
    if (character == 'j') take(Screen::Key::Down, 0);
  }

  void draw() {
    const auto names = view_.names(order_);
    if (!names.empty() && std::find(names.begin(), names.end(), selected_) == names.end()) {
      selected_ = names.front();
      inside_ = false;
    }
    const Table table = inside_ ? view_.ports(selected_) : view_.instances(order_);
    Screen::Frame frame;
    frame.rows = table.lines();
    frame.head = {view_.headline() + (inside_ ? "  ports of " + selected_ : ""), "  " + frame.rows.front()};
    frame.rows.erase(frame.rows.begin());
    const auto at = std::find(names.begin(), names.end(), selected_);
    frame.selected = inside_ || at == names.end() ? 0 : static_cast<std::size_t>(at - names.begin());
    frame.foot =
        fmt::format("q quit  {}  s sort: {}  + - every {:g} s", inside_ ? "escape back" : "enter ports",
                    TopView::kOrders[static_cast<std::size_t>(order_)], static_cast<double>(period_.count()) / 1000);
    screen_.show(frame);
  }

  Session& session_;
  Order order_;
  milliseconds period_;
  Meanwhile meanwhile_;
  Screen screen_;  // gives the terminal back before what was said meanwhile is told
  TopView view_;
  std::string selected_;
  bool inside_ = false;  ///< its ports are shown
  std::optional<std::uint64_t> timer_;
};

/// Without a terminal: a table each period, as long as it is to go on; one, if that is not said.
void print_tables(Session& session, Order order, milliseconds period, std::optional<milliseconds> limit) {
  TopView view;
  view.update(session.snapshot(), std::chrono::steady_clock::now());
  const auto end = std::chrono::steady_clock::now() + limit.value_or(period);
  do {
    session.reactor.run_until([] { return false; }, std::chrono::steady_clock::now() + period);
    view.update(session.snapshot(), std::chrono::steady_clock::now());
    session.out.text(view.headline());
    session.out.table(view.instances(order), "nothing is loaded");
  } while (std::chrono::steady_clock::now() + period <= end);
}

}  // namespace

void top(Session& session, const Line& line) {
  const Order order = order_of(line);
  std::optional<milliseconds> limit;
  if (line.clause("for") != nullptr) limit = period_of(line, "for", {});
  const bool terminal = ::isatty(STDIN_FILENO) != 0 && ::isatty(STDOUT_FILENO) != 0;
  if (terminal && !session.out.manner.json && session.setting != Setting::Script)
    return FullScreen(session, order, period_of(line, "every", kPeriod)).serve(limit);
  print_tables(session, order, std::clamp(period_of(line, "every", kPeriod), kShortest, kLongest), limit);
}

}  // namespace fiona::console::verbs
