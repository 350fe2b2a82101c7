#pragma once

#include <cstddef>
#include <string>
#include <vector>

namespace fiona::console {

/// The whole terminal, from the constructor to the destructor, which gives it back as it was. One at a time: the
/// library behind it (ncurses) has one state per process.
class Screen {
 public:
  /// Throws fiona::Error (Failed) where the terminal cannot be used so.
  Screen();
  Screen(const Screen&) = delete;
  Screen& operator=(const Screen&) = delete;
  ~Screen();

  enum class Key { None, Up, Down, PageUp, PageDown, Enter, Back, Resized, Character };
  /// What was typed, without waiting; of Character, `character` says which.
  Key read(char& character);

  /// What to show: lines that stay at the top, rows of which one may be selected and which scroll with it, one at the
  /// bottom. Made inert; what does not fit is cut.
  struct Frame {
    std::vector<std::string> head;
    std::vector<std::string> rows;
    std::size_t selected = 0;
    std::string foot;
  };
  void show(const Frame& frame);

 private:
  void write(int line, const std::string& text, bool marked);
  std::size_t first_row_ = 0;
};

}  // namespace fiona::console
