#include "os/process_template.hpp"

#include <fcntl.h>
#include <poll.h>
#include <sched.h>
#include <sys/prctl.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <algorithm>
#include <charconv>
#include <chrono>
#include <csignal>
#include <cstring>
#include <string_view>

#include "os/read_pages.hpp"

namespace fiona::os {
namespace {

constexpr const char* kTemplate = "--template";
/// ld.so(8): all names of functions are looked up when it starts, and not again in each copy.
constexpr const char* kBindNow = "LD_BIND_NOW";
/// Of a template's own words: the room for those of a copy.
constexpr std::size_t kRoom = 480;
/// Where the template has its socket: above all numbers that copies are given descriptors at.
constexpr int kSocket = 8;
/// Above that, and out of the way of what it opens by itself.
constexpr int kFirstMoved = 16;
/// It does nothing else; but the machine may have too much to do.
constexpr std::chrono::seconds kPatience{1};

/// A request: the numbers of the descriptors in the copy, each a character, and the words, with a NUL before each.
std::string request_for(const std::vector<std::string>& words, const std::vector<std::pair<int, int>>& inherited) {
  std::string text;
  for (const auto& [ours, theirs] : inherited) text += static_cast<char>('0' + theirs);
  for (const std::string& word : words) text += '\0' + word;
  return text;
}

std::vector<std::string> words_of(std::string_view request) {
  std::vector<std::string> words;
  for (std::size_t at = request.find('\0'); at != std::string_view::npos;) {
    const std::size_t end = request.find('\0', at + 1);
    words.emplace_back(request.substr(at + 1, end == std::string_view::npos ? end : end - at - 1));
    at = end;
  }
  return words;
}

/// As fork(), but the copy is a child of this process's own parent, who waits for it. glibc has no call for that: what
/// fork() would keep in order beyond this is of threads, and there is one; its number is told where glibc has it.
pid_t copy_as_sibling() {
  int* thread_number = nullptr;
  if (::prctl(PR_GET_TID_ADDRESS, &thread_number) != 0 || !thread_number) return -1;
  constexpr unsigned long kHow = CLONE_PARENT | CLONE_CHILD_SETTID | CLONE_CHILD_CLEARTID | SIGCHLD;
  // clone(2): the last two change places from one processor to another, and of them only the number's is looked at.
  return static_cast<pid_t>(::syscall(SYS_clone, kHow, nullptr, nullptr, thread_number, thread_number));
}

/// The descriptors to their numbers there; the template's own socket is not for a copy.
void take_over(std::string_view numbers, std::vector<Descriptor>& descriptors) {
  std::vector<Descriptor> moved;
  for (const auto& one : descriptors) moved.emplace_back(::fcntl(one.get(), F_DUPFD_CLOEXEC, kFirstMoved));
  descriptors.clear();
  for (std::size_t i = 0; i < moved.size(); ++i) ::dup2(moved[i].get(), numbers[i] - '0');
}

/// proc_pid_cmdline(5): what is shown is what lies where the words of the program were put when it was started.
void show_words(int argc, char** argv, const std::vector<std::string>& words) {
  char* at = argv[0] + std::strlen(argv[0]) + 1;
  char* const end = argv[argc - 1] + std::strlen(argv[argc - 1]);
  std::fill(at, end, '\0');
  for (const std::string& word : words) {
    const std::size_t length = std::min<std::size_t>(word.size(), static_cast<std::size_t>(end - at));
    at = std::copy_n(word.data(), length, at);
    if (at != end) ++at;
  }
}

}  // namespace

ProcessTemplate::ProcessTemplate(const std::filesystem::path& program)
    : process_([&] {
        auto [ours, theirs] = PacketSocket::pair();
        socket_ = std::move(ours);
        return ChildProcess(program, {kTemplate, std::string(kRoom, '.')}, {{theirs.descriptor(), kSocket}}, false,
                            {std::string(kBindNow) + "=1"});
      }()) {}

std::unique_ptr<ChildProcess> ProcessTemplate::copy(const std::vector<std::string>& words,
                                                    const std::vector<std::pair<int, int>>& inherited) {
  std::vector<int> ours;
  for (const auto& [here, there] : inherited) ours.push_back(here);
  if (socket_ && socket_.send(request_for(words, inherited), ours) == PacketSocket::Sent::Yes) {
    if (auto made = announced()) return made;
    process_.kill();  // a copy that it has made nevertheless announces itself, or closes its end of the socket
    if (auto made = announced()) return made;
    process_.end_group();  // or one that had not left it yet would stay, as a child of ours that nobody waits for
  }
  socket_.close();
  return nullptr;
}

std::unique_ptr<ChildProcess> ProcessTemplate::announced() const {
  Packet said;
  pid_t id = -1;
  if (socket_.receive_until(std::chrono::steady_clock::now() + kPatience, said))
    std::from_chars(said.text.data(), said.text.data() + said.text.size(), id);
  if (id <= 0) return nullptr;
  Descriptor handle(static_cast<int>(::syscall(SYS_pidfd_open, id, 0)));
  return std::make_unique<ChildProcess>(id, std::move(handle), nullptr);
}

bool is_template(int argc, char** argv) { return argc == 3 && argv[1] == std::string_view(kTemplate); }

std::vector<std::string> wait_to_be_copied(int argc, char** argv) {
  PacketSocket socket{Descriptor(kSocket)};
  ::unsetenv(kBindNow);  // what a copy starts is none of this
  let_go_of_read_pages();
  while (true) {
    pollfd wait{socket.descriptor(), POLLIN, 0};
    ::poll(&wait, 1, -1);
    Packet request;
    const auto got = socket.receive(request);
    if (got == PacketSocket::Got::End) ::_exit(0);
    if (got == PacketSocket::Got::Nothing) continue;
    const std::string_view numbers = std::string_view(request.text).substr(0, request.text.find('\0'));
    const bool whole = request.descriptors.size() == numbers.size();
    const pid_t id = whole ? copy_as_sibling() : -1;
    if (id == 0) {
      ::setpgid(0, 0);
      socket.send(std::to_string(::getpid()));
      socket.close();
      take_over(numbers, request.descriptors);
      auto words = words_of(request.text);
      show_words(argc, argv, words);
      return words;
    }
    if (id < 0) socket.send(std::to_string(id));
  }
}

}  // namespace fiona::os
