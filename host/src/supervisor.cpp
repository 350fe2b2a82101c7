#include "supervisor.hpp"

#include <fcntl.h>
#include <poll.h>
#include <signal.h>
#include <sys/prctl.h>
#include <sys/signalfd.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <charconv>
#include <cstdio>
#include <cstring>
#include <fstream>
#include <iostream>
#include <sstream>
#include <thread>

#include "fiona/error.hpp"
#include "supervisor_link.hpp"

namespace fiona::host {
namespace {

using Steady = std::chrono::steady_clock;

/// Where the host finds them.
constexpr int kReadyInHost = 3;
constexpr int kLifelineInHost = 4;
constexpr int kLinkInHost = 5;
constexpr std::size_t kMostReady = 64 * 1024;
constexpr int kFailed = static_cast<int>(ErrorCode::ComponentFailed);
constexpr int kInterrupted = 130;

std::pair<os::Descriptor, os::Descriptor> make_pipe() {
  int ends[2];
  if (::pipe2(ends, O_CLOEXEC) != 0) {
    throw Error(ErrorCode::Failed,
                {.what = "no pipe can be made",
                 .found = std::strerror(errno),
                 .next = "fiona doctor; end what holds many descriptors, or raise the limit: ulimit -n"});
  }
  return {os::Descriptor(ends[0]), os::Descriptor(ends[1])};
}

/// Of this process: those that have lost their own parent among them.
std::vector<pid_t> children() {
  std::ifstream file("/proc/self/task/" + std::to_string(::getpid()) + "/children");
  std::vector<pid_t> all;
  for (pid_t one = 0; file >> one;) all.push_back(one);
  return all;
}

std::string seconds(std::chrono::milliseconds time) {
  char text[32];
  std::snprintf(text, sizeof text, "%.1f s", static_cast<double>(time.count()) / 1e3);
  return text;
}

void say(const std::string& line) { std::cerr << "supervisor: " + line + "\n"; }

}  // namespace

void Supervisor::start(Time now) {
  auto [ready, ready_there] = make_pipe();
  auto [lifeline_there, lifeline] = make_pipe();
  auto [ours, theirs] = os::PacketSocket::pair();
  std::vector<std::string> arguments = options_.arguments;
  for (const auto& [flag, number] :
       {std::pair("--ready-fd", kReadyInHost), {"--lifeline-fd", kLifelineInHost}, {"--supervisor-fd", kLinkInHost}}) {
    arguments.insert(arguments.end(), {flag, std::to_string(number)});
  }
  if (starts_ > 0) {
    std::erase(arguments, "--restore");
    arguments.insert(arguments.end(),
                     {"--restore", "--restarts", std::to_string(starts_), "--restart-reason", reason_});
  }
  if (taken_back_) arguments.emplace_back("--taken-back");
  try {
    host_ = std::make_unique<os::ChildProcess>(program_.next(), arguments,
                                               std::vector<std::pair<int, int>>{{ready_there.get(), kReadyInHost},
                                                                                {lifeline_there.get(), kLifelineInHost},
                                                                                {theirs.descriptor(), kLinkInHost}},
                                               false, std::vector<std::string>(), program_.path());
  } catch (const Error& error) {
    if (!program_.on_trial()) throw;
    take_back("cannot be started: " + error.text().found);
    return start(now);
  }
  ++starts_;
  taken_back_ = false;
  ready_ = std::move(ready);
  ::fcntl(ready_.get(), F_SETFL, O_NONBLOCK);
  lifeline_ = std::move(lifeline);
  link_ = std::move(ours);
  said_ready_.clear();
  why_.clear();
  said_why_.clear();
  heard_ = false;
  silent_ = milliseconds(0);
  looked_ = now;
  outgoing_.clear();
  for (const auto& [process, kept] : kept_) {
    outgoing_.push_back({"", process});
    if (!kept.end.empty())
      outgoing_.push_back({std::string(SupervisorLink::kEnded) + " " + std::to_string(process) + "\n" + kept.end});
  }
  outgoing_.push_back({std::string(SupervisorLink::kAll)});
}

int Supervisor::run(int signals) {
  // Groups whose host has gone become children of this process, and not of the machine's first one.
  ::prctl(PR_SET_CHILD_SUBREAPER, 1);
  start(Steady::now());
  while (true) {
    if (const auto code = look(signals)) return end_all(*code);
  }
}

/// What keeps it from being started may pass: it counts as one that has ended.
std::optional<int> Supervisor::start_again(Time now) {
  try {
    start(now);
    return std::nullopt;
  } catch (const Error& error) {
    return start_later("the host could not be started: " + error.text().what + ": " + error.text().found, now);
  }
}

/// Unless that has been too often.
std::optional<int> Supervisor::start_later(const std::string& what, Time now) {
  due_ = supervision_.ended("host", now);
  if (due_) {
    say(what + "; it is started again");
    return std::nullopt;
  }
  say(what + "; it is left, after " + std::to_string(Supervision::kRestarts) + " restarts within " +
      std::to_string(Supervision::kWithin.count()) + " s");
  return kFailed;
}

int Supervisor::wait_ms(Time now) const {
  Time until = now + kLook;
  if (due_) until = std::min(until, *due_);
  if (tried_until_) until = std::min(until, *tried_until_);
  if (stopping_) until = std::min(until, *stopping_);
  if (check_) until = std::min(until, check_->until());
  if (crowded_) until = std::min(until, now + os::PacketSocket::kCrowded);
  return static_cast<int>(std::max<std::int64_t>(0, std::chrono::ceil<milliseconds>(until - now).count()));
}

std::optional<int> Supervisor::look(int signals) {
  const bool waits_for_room = !outgoing_.empty() && !crowded_;
  // Of a number below 0 poll takes no notice.
  std::vector<pollfd> waits{{stopping_ ? -1 : options_.lifeline.get(), POLLIN, 0},
                            {signals, POLLIN, 0},
                            {host_ ? host_->descriptor() : -1, POLLIN, 0},
                            {ready_.get(), POLLIN, 0},
                            {link_.descriptor(), static_cast<short>(waits_for_room ? POLLIN | POLLOUT : POLLIN), 0},
                            {check_ ? check_->descriptor() : -1, POLLIN, 0}};
  for (const auto& [process, kept] : kept_) {
    if (kept.orphan && kept.end.empty()) waits.push_back({kept.descriptors[3].get(), POLLIN, 0});
  }
  ::poll(waits.data(), waits.size(), wait_ms(Steady::now()));
  const Time now = Steady::now();
  if (waits[1].revents != 0) {
    signalfd_siginfo taken{};
    static_cast<void>(::read(signals, &taken, sizeof taken));
    if (!host_) return kInterrupted;
    ::kill(host_->id(), SIGTERM);  // it is a child that has not been reaped: the number is its own
    stop(now);
  }
  if (waits[0].revents != 0) {
    if (!host_) return 0;
    stop(now);
  }
  forward_ready();
  serve_host();
  look_at_check(now);
  look_at_trial(now);
  reap_orphans();
  end_if_hung(now);
  if (host_ && !host_->end().empty()) return host_ended(now);
  if (due_ && now >= *due_) {
    due_.reset();
    supervision_.take_due(now);
    return start_again(now);
  }
  return std::nullopt;
}

/// The host is told, before its lifeline ends: without a word that is how it learns of a supervisor that was killed.
/// Whatever it does, it ends.
void Supervisor::stop(Time now) {
  if (link_) static_cast<void>(link_.send(SupervisorLink::kEnd));
  lifeline_.reset();
  if (!stopping_) stopping_ = now + kEndsWithin;
}

/// Only what the first one says is anybody's business but ours.
void Supervisor::forward_ready() {
  char chunk[4096];
  while (ready_) {
    const ssize_t got = ::read(ready_.get(), chunk, sizeof chunk);
    if (got < 0) return;
    if (got == 0) return ready_.reset();
    const std::string_view text(chunk, static_cast<std::size_t>(got));
    if (said_ready_.size() < kMostReady) said_ready_ += text;
    if (options_.ready) static_cast<void>(::write(options_.ready.get(), text.data(), text.size()));
    if (!said_ready_.starts_with("READY\n")) continue;
    if (!was_ready_) program_.hold(host_->id());
    was_ready_ = true;
    options_.ready.reset();
    if (program_.on_trial() && !tried_until_) tried_until_ = Steady::now() + trial_;
  }
}

void Supervisor::serve_host() {
  os::Packet packet;
  while (link_ && link_.receive(packet) == os::PacketSocket::Got::Packet) take(packet);
  pass_on();
}

void Supervisor::take(os::Packet& packet) {
  silent_ = milliseconds(0);
  heard_ = true;
  const std::string_view text = packet.text;
  if (text == SupervisorLink::kQuits) quits_ = true;
  const std::size_t blank = text.find(' ');
  const std::size_t end = text.find('\n');
  if (blank == std::string_view::npos || end == std::string_view::npos || end < blank) return;
  pid_t process = 0;
  std::from_chars(text.data() + blank + 1, text.data() + end, process);
  const std::string_view word = text.substr(0, blank);
  if (word == SupervisorLink::kUpgrade) {
    return begin_upgrade(milliseconds(process), Steady::now());
  }
  if (word == SupervisorLink::kEnds) said_why_ = text.substr(end + 1);
  if (word == SupervisorLink::kDrop) kept_.erase(process);
  if (word != SupervisorLink::kKeep || process <= 0) return;
  if (packet.descriptors.size() != 4) {
    return say("the group of process " + std::to_string(process) +
               " would end with its host: there are no descriptors left to keep it by");
  }
  kept_[process] = Kept{std::string(text), std::move(packet.descriptors), false, ""};
}

void Supervisor::pass_on() {
  crowded_ = false;
  while (link_ && !outgoing_.empty()) {
    const Outgoing& next = outgoing_.front();
    std::string_view text = next.text;
    std::vector<int> descriptors;
    if (const auto kept = kept_.find(next.kept); kept != kept_.end()) {
      text = kept->second.text;
      for (const auto& one : kept->second.descriptors) descriptors.push_back(one.get());
    }
    const auto sent = text.empty() ? os::PacketSocket::Sent::Yes : link_.send(text, descriptors);
    crowded_ = sent == os::PacketSocket::Sent::Crowded;
    if (crowded_ || sent == os::PacketSocket::Sent::Full) return;
    outgoing_.pop_front();
  }
}

void Supervisor::end_if_hung(Time now) {
  const auto passed = std::chrono::duration_cast<milliseconds>(now - std::exchange(looked_, now));
  if (!host_) return;
  silent_ += std::min(passed, 2 * kLook);
  if (stopping_ && now >= *stopping_) why_ = "it did not come to its end within " + seconds(kEndsWithin);
  if (makes_way_ && now >= *makes_way_) why_ = "it did not make way within " + seconds(kMakesWayWithin);
  const milliseconds hang = program_.on_trial() && !heard_ ? std::min(kFirstSign, options_.hang) : options_.hang;
  if (!stopping_ && silent_ >= hang) why_ = "it did not answer for " + seconds(hang);
  if (!why_.empty()) host_->kill();
}

/// The one that runs is not touched before it is known that the other can be started.
void Supervisor::begin_upgrade(milliseconds trial, Time now) {
  if (check_ || makes_way_ || stopping_) return;
  if (tried_until_) return refuse_upgrade("the last upgrade is still on trial");
  try {
    check_ = std::make_unique<ProgramCheck>(program_.path(), now);
    asked_trial_ = trial;
  } catch (const Error& error) {
    refuse_upgrade(program_.path().string() + ": " + error.text().what + ": " + error.text().found);
  }
}

void Supervisor::look_at_check(Time now) {
  if (!check_) return;
  const auto verdict = check_->verdict(now);
  if (!verdict) return;
  check_.reset();
  if (!verdict->empty()) return refuse_upgrade(program_.path().string() + " --version " + *verdict);
  program_.forget_refusal();
  makes_way_ = now + kMakesWayWithin;
  trial_ = asked_trial_;
  outgoing_.push_back({std::string(SupervisorLink::kMakeWay)});
  pass_on();
}

void Supervisor::refuse_upgrade(const std::string& why) {
  outgoing_.push_back({std::string(SupervisorLink::kRefused) + " 0\n" + why});
  pass_on();
}

/// One that has been there for so long is the one to go back to.
void Supervisor::look_at_trial(Time now) {
  if (!host_ || !tried_until_ || now < *tried_until_) return;
  tried_until_.reset();
  program_.hold(host_->id());
}

void Supervisor::take_back(const std::string& end) {
  program_.refuse();
  taken_back_ = true;
  const std::string_view what(end);
  reason_ =
      "the new build " + std::string(what.substr(what.starts_with("it ") ? 3 : 0)) + "; the one before it runs again";
  say(reason_);
}

/// Who has lost its host and is not kept has nobody left; how the others end, the next host is told.
void Supervisor::reap_orphans() {
  for (auto& [process, kept] : kept_) {
    if (!kept.orphan || !kept.end.empty()) continue;
    const auto status = os::reap(process);
    if (!status && os::is_child(process)) continue;
    kept.end = status ? os::text_of_end(*status) : "ended before its host";
    if (host_)
      outgoing_.push_back({std::string(SupervisorLink::kEnded) + " " + std::to_string(process) + "\n" + kept.end});
  }
  const auto all = children();
  if (host_ && !host_->end().empty()) return pass_on();  // what it has said of its own is to be heard first
  for (const pid_t child : all) {
    if ((host_ && child == host_->id()) || (check_ && child == check_->process()) || kept_.contains(child)) continue;
    ::kill(child, SIGKILL);
    os::reap(child);
  }
  pass_on();
}

std::optional<int> Supervisor::host_ended(Time now) {
  serve_host();  // what it said before
  forward_ready();
  int code = kFailed;
  const std::string end = host_->end();
  if (std::sscanf(end.c_str(), "exited with code %d", &code) != 1) code = kFailed;
  if (stopping_ && end == os::text_of_end(SIGTERM)) code = kInterrupted;  // it had not come so far as to hear it
  const bool never_ready = !said_ready_.starts_with("READY\n");
  reason_ = !why_.empty() ? why_ : !said_why_.empty() ? said_why_ : end;
  if (never_ready && !said_ready_.empty()) reason_ += ": " + said_ready_.substr(0, said_ready_.find('\n'));
  if (never_ready && was_ready_ && !said_ready_.empty() && !program_.on_trial())
    std::cerr << "the host did not start: " + said_ready_;
  host_.reset();
  check_.reset();
  tried_until_.reset();
  const bool made_way = std::exchange(makes_way_, std::nullopt).has_value();
  if (!made_way) trial_ = kTrial;  // what was said was of another build
  link_.close();
  ready_.reset();
  lifeline_.reset();
  for (auto& [process, kept] : kept_) kept.orphan = true;
  reap_orphans();
  if (stopping_ || quits_) return code;
  if (!was_ready_) return code;  // it could not be started: it has said why
  if (made_way || program_.on_trial()) {
    if (made_way) reason_ = "upgraded";
    if (!made_way) take_back(reason_);
    return start_again(now);
  }
  return start_later("the host has ended: " + reason_, now);
}

/// Nobody is left behind.
int Supervisor::end_all(int code) {
  host_.reset();
  kept_.clear();  // groups end by themselves now
  const Time until = Steady::now() + kRestWithin;
  for (auto left = children(); !left.empty() && Steady::now() < until; left = children()) {
    for (const pid_t child : left) {
      ::kill(child, SIGKILL);
      os::reap(child);
    }
    std::this_thread::sleep_for(milliseconds(2));
  }
  return code;
}

}  // namespace fiona::host
