#include "reactor.hpp"

#include <algorithm>
#include <array>
#include <cerrno>
#include <climits>
#include <csignal>
#include <system_error>
#include <vector>

#include <poll.h>
#include <sys/signalfd.h>
#include <unistd.h>

namespace fiona::console {
namespace {

int poll_timeout_ms(std::optional<SteadyTime> deadline) {
  if (!deadline) return -1;
  const auto left = std::chrono::ceil<std::chrono::milliseconds>(*deadline - std::chrono::steady_clock::now());
  return static_cast<int>(std::clamp<std::int64_t>(left.count(), 0, 3'600'000));
}

}  // namespace

Reactor::~Reactor() {
  if (signals_ >= 0) ::close(signals_);
}

void Reactor::take_signals() {
  sigset_t taken;
  sigemptyset(&taken);
  for (const int signal : {SIGINT, SIGTERM, SIGHUP, SIGCONT}) sigaddset(&taken, signal);
  ::sigprocmask(SIG_BLOCK, &taken, nullptr);
  ::signal(SIGPIPE, SIG_IGN);
  signals_ = ::signalfd(-1, &taken, SFD_CLOEXEC | SFD_NONBLOCK);
  if (signals_ < 0) throw std::system_error(errno, std::generic_category(), "signalfd");
  add(signals_, [this] { take_signal(); });
}

void Reactor::take_signal() {
  signalfd_siginfo info{};
  if (signals_ < 0 || ::read(signals_, &info, sizeof info) <= 0) return;
  if (info.ssi_signo == SIGCONT) {
    if (continued_) continued_();
    return take_signal();
  }
  if (info.ssi_signo == SIGINT) throw Interrupted();
  throw Terminated();
}

void Reactor::add(int descriptor, std::function<void()> ready) { descriptors_[descriptor] = std::move(ready); }

void Reactor::add_terminal(std::function<void()> ready) {
  add(STDIN_FILENO, [ready = std::move(ready)] {
    pollfd keys{STDIN_FILENO, POLLIN, 0};
    // Whoever reads the keys takes the end of a closed terminal for a key that has not come yet, for ever.
    if (::poll(&keys, 1, 0) > 0 && (keys.revents & (POLLHUP | POLLERR | POLLNVAL)) != 0) throw Terminated();
    ready();
  });
}

void Reactor::remove(int descriptor) { descriptors_.erase(descriptor); }

std::uint64_t Reactor::add_timer(SteadyTime when, std::function<void()> expired) {
  timers_[++last_timer_] = {when, std::move(expired)};
  return last_timer_;
}

void Reactor::cancel_timer(std::uint64_t timer) { timers_.erase(timer); }

bool Reactor::run_until(const std::function<bool()>& done, std::optional<SteadyTime> deadline) {
  while (!done()) {
    if (deadline && std::chrono::steady_clock::now() >= *deadline) return false;
    serve_once(deadline);
  }
  return true;
}

void Reactor::serve_once(std::optional<SteadyTime> deadline) {
  for (const auto& [number, timer] : timers_) deadline = deadline ? std::min(*deadline, timer.when) : timer.when;
  std::vector<pollfd> waiting;
  for (const auto& [descriptor, ready] : descriptors_) waiting.push_back({descriptor, POLLIN, 0});
  const int count = ::poll(waiting.data(), waiting.size(), poll_timeout_ms(deadline));
  if (count < 0 && errno != EINTR) throw std::system_error(errno, std::generic_category(), "poll");
  for (const pollfd& entry : waiting) {
    // A callback may have removed this descriptor, or a later one.
    const auto found = descriptors_.find(entry.fd);
    if (count <= 0 || entry.revents == 0 || found == descriptors_.end()) continue;
    const auto ready = found->second;
    ready();
  }
  expire_timers();
}

void Reactor::expire_timers() {
  const auto now = std::chrono::steady_clock::now();
  for (auto next = timers_.begin(); next != timers_.end();) {
    if (next->second.when > now) {
      ++next;
      continue;
    }
    const auto expired = std::move(next->second.expired);
    timers_.erase(next);
    expired();
    next = timers_.begin();
  }
}

bool Reactor::wait_writable(int descriptor, std::optional<SteadyTime> deadline) {
  while (true) {
    std::array<pollfd, 2> waiting{{{descriptor, POLLOUT, 0}, {signals_, POLLIN, 0}}};
    const int count = ::poll(waiting.data(), waiting.size(), poll_timeout_ms(deadline));
    if (count > 0 && waiting[1].revents != 0) take_signal();
    if (count > 0 && waiting[0].revents != 0) return true;
    if (count == 0 || (count < 0 && errno != EINTR)) return false;
  }
}

bool Reactor::write_all(int descriptor, std::string_view bytes) {
  while (!bytes.empty()) {
    if (!wait_writable(descriptor)) return false;
    // No more than what a pipe that can be written takes at once.
    const ssize_t count = ::write(descriptor, bytes.data(), std::min<std::size_t>(bytes.size(), PIPE_BUF));
    if (count < 0 && errno != EINTR && errno != EAGAIN) return false;
    if (count > 0) bytes.remove_prefix(static_cast<std::size_t>(count));
  }
  return true;
}

bool Reactor::read_all(int descriptor, std::size_t most, std::string& bytes) {
  std::optional<int> ended;
  add(descriptor, [&] {
    std::array<char, 1U << 16U> block;
    const ssize_t count = ::read(descriptor, block.data(), block.size());
    if (count > 0) bytes.append(block.data(), static_cast<std::size_t>(count));
    if (count == 0 || (count < 0 && errno != EINTR && errno != EAGAIN)) ended = count == 0 ? 0 : errno;
  });
  try {
    run_until([&] { return ended || bytes.size() >= most; });
  } catch (...) {
    remove(descriptor);
    throw;
  }
  remove(descriptor);
  errno = ended.value_or(0);
  return errno == 0;
}

}  // namespace fiona::console
