#include "screen.hpp"

#include <algorithm>
#include <clocale>
#include <cstdio>

#include <fiona/error.hpp>

#include "inert.hpp"

#define NCURSES_NOMACROS
#include <ncurses.h>

namespace fiona::console {
namespace {

/// The beginning that takes at most so many columns.
std::string cut_to(const std::string& text, std::size_t columns) {
  std::string cut;
  std::size_t taken = 0;
  for (std::string_view rest = text; !rest.empty();) {
    const std::size_t bytes = decode(rest).bytes;
    const std::size_t wide = display_width(rest.substr(0, bytes));
    if (taken + wide > columns) break;
    taken += wide;
    cut += rest.substr(0, bytes);
    rest.remove_prefix(bytes);
  }
  return cut;
}

constexpr int kEscapeDelayMs = 25;
constexpr int kEscape = 27;

}  // namespace

Screen::Screen() {
  std::setlocale(LC_CTYPE, "");
  ::set_escdelay(kEscapeDelayMs);
  if (::newterm(nullptr, stdout, stdin) == nullptr)
    throw Error(ErrorCode::Failed, {.what = "this terminal cannot show a full screen",
                                    .next = "set TERM to what it is; top --json needs none"});
  ::cbreak();
  ::noecho();
  ::keypad(stdscr, true);
  ::nodelay(stdscr, true);
  ::curs_set(0);
}

Screen::~Screen() {
  SCREEN* terminal = ::set_term(nullptr);
  ::set_term(terminal);
  ::endwin();
  ::delscreen(terminal);
}

Screen::Key Screen::read(char& character) {
  const int key = ::getch();
  switch (key) {
    case ERR: return Key::None;
    case KEY_UP: return Key::Up;
    case KEY_DOWN: return Key::Down;
    case KEY_PPAGE: return Key::PageUp;
    case KEY_NPAGE: return Key::PageDown;
    case KEY_RESIZE: return Key::Resized;
    case KEY_ENTER:
    case '\r':
    case '\n': return Key::Enter;
    case KEY_BACKSPACE:
    case kEscape: return Key::Back;
    default: break;
  }
  character = key > 0 && key < 128 ? static_cast<char>(key) : '\0';
  return Key::Character;
}

void Screen::write(int line, const std::string& text, bool marked) {
  const std::string cut = cut_to(inert(text), static_cast<std::size_t>(std::max(1, COLS)));
  ::move(line, 0);
  if (marked) ::attron(A_REVERSE);
  ::addnstr(cut.data(), static_cast<int>(cut.size()));
  if (marked) ::attroff(A_REVERSE);
  ::clrtoeol();
}

void Screen::show(const Frame& frame) {
  const int head = static_cast<int>(frame.head.size());
  const auto room = static_cast<std::size_t>(std::max(1, LINES - head - 1));
  const std::size_t last = frame.rows.empty() ? 0 : std::min(frame.selected, frame.rows.size() - 1);
  first_row_ = std::min(first_row_, last);
  if (last >= first_row_ + room) first_row_ = last - room + 1;
  ::erase();
  for (int i = 0; i < std::min(head, LINES - 1); ++i) write(i, frame.head[static_cast<std::size_t>(i)], false);
  for (std::size_t i = 0; i < room && first_row_ + i < frame.rows.size(); ++i) {
    const std::size_t row = first_row_ + i;
    write(head + static_cast<int>(i), (row == last ? "> " : "  ") + frame.rows[row], row == last);
  }
  write(LINES - 1, frame.foot, false);
  ::refresh();
}

}  // namespace fiona::console
