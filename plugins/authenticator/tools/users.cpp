// fiona-users: who may log in. Passwords come from the terminal, without echo, or from standard input; never from the
// command line, which other processes see and shells keep.
#include <sys/resource.h>
#include <termios.h>
#include <unistd.h>

#include <algorithm>
#include <charconv>
#include <csignal>
#include <filesystem>
#include <iostream>
#include <optional>
#include <string>
#include <system_error>
#include <vector>

#include "accounts.hpp"
#include "fiona/error.hpp"
#include "fiona/records/data_directory.hpp"
#include "fiona/tool.hpp"

namespace {

using fiona::Error;
using fiona::ErrorCode;
using fiona::authenticator::Accounts;
using fiona::authenticator::Secret;

constexpr const char* kUsage = R"(usage: fiona-users [--database FILE] COMMAND

  add NAME [--level N]   a new user; level 0 to 9, 0 if none is given
  passwd NAME            another password; ends the user's sessions
  level NAME N           another level
  disable NAME           nobody logs in as NAME any more; ends the user's sessions
  enable NAME            takes that back
  remove NAME            forgets the user; ends the user's sessions
  list                   all users with their levels

Passwords are asked for. Without a terminal the first line of standard input is the password.
FILE is users.db in $XDG_STATE_HOME/fiona, else in ~/.local/state/fiona, as for the component authenticator.
)";

Error usage(std::string what) {
  return Error(ErrorCode::Usage, {.what = std::move(what), .next = "fiona-users --help"});
}

/// The terminal without echo, as long as this lives; also when the program is interrupted.
class Quiet {
 public:
  Quiet() {
    ::tcgetattr(STDIN_FILENO, &before_);
    termios quiet = before_;
    quiet.c_lflag &= ~static_cast<tcflag_t>(ECHO);
    quiet.c_lflag |= ECHONL;
    ::tcsetattr(STDIN_FILENO, TCSAFLUSH, &quiet);
    for (const int signal : {SIGINT, SIGTERM, SIGHUP}) std::signal(signal, &Quiet::restore_and_end);
  }
  ~Quiet() {
    ::tcsetattr(STDIN_FILENO, TCSAFLUSH, &before_);
    for (const int signal : {SIGINT, SIGTERM, SIGHUP}) std::signal(signal, SIG_DFL);
  }
  Quiet(const Quiet&) = delete;
  Quiet& operator=(const Quiet&) = delete;

 private:
  static void restore_and_end(int signal) {
    ::tcsetattr(STDIN_FILENO, TCSANOW, &before_);
    ::_exit(128 + signal);
  }
  inline static termios before_{};
};

Secret read_line(const char* prompt) {
  if (::isatty(STDIN_FILENO)) std::cerr << prompt << std::flush;
  std::string line;
  if (!std::getline(std::cin, line)) throw usage("there was no password to read");
  Secret secret(line);
  fiona::authenticator::wipe(line);
  return secret;
}

Secret new_password() {
  if (!::isatty(STDIN_FILENO)) return read_line("");
  const Quiet quiet;
  Secret once = read_line("password: ");
  const Secret again = read_line("again:    ");
  if (once.text() != again.text())
    throw Error(ErrorCode::Usage,
                {.what = "the two passwords are not the same: nothing has changed", .next = "type both again"});
  return once;
}

int number(const std::string& text) {
  int value = -1;
  const auto [end, fault] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (fault != std::errc() || end != text.data() + text.size()) throw usage("'" + text + "' is no level: 0 to 9");
  return value;
}

void list(const Accounts& accounts) {
  const auto all = accounts.all();
  std::size_t width = 4;
  for (const auto& [name, account] : all) width = std::max(width, name.size());
  std::cout << "name" << std::string(width - 2, ' ') << "level\n";
  for (const auto& [name, account] : all) {
    std::cout << name << std::string(width + 2 - name.size(), ' ') << account.level()
              << (account.disabled() ? "  disabled" : "") << '\n';
  }
}

/// Only `add` makes a database: a name that was mistyped is no new one.
void check_exists(const std::filesystem::path& file) {
  std::error_code unknown;
  for (const char* part : {"", ".key"}) {
    if (std::filesystem::exists(file.string() + part, unknown)) return;  // one alone is told when it is opened
  }
  throw Error(ErrorCode::NotFound, {.what = "there is no database of users",
                                    .where = file.string(),
                                    .next = "check its name; fiona-users --database FILE add NAME makes one"});
}

/// The value behind an option, which both are taken out.
std::optional<std::string> take_option(std::vector<std::string>& words, const std::string& option) {
  for (auto i = words.begin(); i != words.end(); ++i) {
    if (*i != option) continue;
    if (i + 1 == words.end()) throw usage(option + " needs a value");
    std::string value = *(i + 1);
    words.erase(i, i + 2);
    return value;
  }
  return std::nullopt;
}

void run(std::vector<std::string> words) {
  const auto database = take_option(words, "--database");
  const auto level = take_option(words, "--level");
  const std::string command = words.empty() ? "" : words.front();
  const std::size_t needed = command == "list" ? 1 : command == "level" ? 3 : 2;
  const std::vector<std::string> commands{"add", "passwd", "level", "disable", "enable", "remove", "list"};
  if (std::find(commands.begin(), commands.end(), command) == commands.end()) {
    throw usage(command.empty() ? "what is to be done?" : "there is no command '" + command + "'");
  }
  if (words.size() < needed) throw usage(command + " needs " + (needed == 3 ? "a name and a level" : "a name"));
  // The word may be a password, so it is not repeated.
  if (words.size() > needed && (command == "add" || command == "passwd"))
    throw usage("there is one word too many: passwords are asked for, the command line takes none");
  if (words.size() > needed) throw usage("'" + words[needed] + "' is one word too many");
  if (level && command != "add") throw usage("--level goes with add; to change it: fiona-users level NAME N");

  const auto file = database ? std::filesystem::path(*database) : fiona::records::data_file("users.db");
  if (command != "add") check_exists(file);
  fiona::records::RecordStore store(file, fiona::authenticator::kDatabaseKind);
  Accounts accounts(store);
  if (command == "list") return list(accounts);
  const std::string& name = words[1];
  if (command == "add") {
    accounts.add(name, new_password(), level ? number(*level) : 0);
  } else if (command == "passwd") {
    accounts.set_password(name, new_password());
  } else if (command == "level") {
    accounts.set_level(name, number(words[2]));
  } else if (command == "remove") {
    accounts.remove(name);
  } else {
    accounts.set_disabled(name, command == "disable");
  }
}

}  // namespace

int main(int argc, char** argv) {
  const rlimit none{};
  ::setrlimit(RLIMIT_CORE, &none);  // no password reaches a disk
  const std::vector<std::string> words(argv + 1, argv + argc);
  const auto asks_for_help = [](const std::string& word) { return word == "--help" || word == "-h"; };
  if (std::any_of(words.begin(), words.end(), asks_for_help) || (!words.empty() && words.front() == "help")) {
    std::cout << kUsage;
    return 0;
  }
  return fiona::run_tool([&] {
    run(words);
    return 0;
  });
}
