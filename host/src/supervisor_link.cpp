#include "supervisor_link.hpp"

#include <charconv>

namespace fiona::host {
namespace {

using Steady = std::chrono::steady_clock;

/// For a supervisor that does nothing but read; one that takes longer has been stopped, and is not waited for.
constexpr std::chrono::milliseconds kPatience{500};
constexpr std::chrono::seconds kKeptWithin{5};

std::string line_of(std::string_view word, pid_t process) {
  return std::string(word) + " " + std::to_string(process) + "\n";
}

}  // namespace

std::vector<KeptGroup> SupervisorLink::take_kept() {
  const auto deadline = Steady::now() + kKeptWithin;
  os::Packet packet;
  while (!all_ && socket_.receive_until(deadline, packet)) take(packet);
  return std::exchange(kept_, {});
}

void SupervisorLink::receive() {
  os::Packet packet;
  while (!gone_) {
    const auto got = socket_.receive(packet);
    if (got == os::PacketSocket::Got::Nothing) return;
    gone_ = got == os::PacketSocket::Got::End;
    if (!gone_) take(packet);
  }
}

void SupervisorLink::take(os::Packet& packet) {
  const std::string_view text = packet.text;
  const std::size_t end = text.find('\n');
  const std::string_view line = text.substr(0, end);
  if (line == kAll) all_ = true;
  if (line == kMakeWay) upgrade_answer_ = "";
  if (line == kEnd) told_to_end_ = true;
  const std::size_t blank = line.find(' ');
  if (end == std::string_view::npos || blank == std::string_view::npos) return;
  pid_t process = -1;
  std::from_chars(line.data() + blank + 1, line.data() + line.size(), process);
  const std::string_view word = line.substr(0, blank);
  const std::string_view rest = text.substr(end + 1);
  if (word == kEnded) ends_[process] = rest;
  if (word == kRefused) upgrade_answer_ = rest;
  if (word != kKeep || packet.descriptors.size() != 4) return;
  KeptGroup kept;
  kept.process = process;
  if (!kept.told.ParseFromArray(rest.data(), static_cast<int>(rest.size()))) return;
  kept.adoption = std::move(packet.descriptors[0]);
  kept.liveness = std::move(packet.descriptors[1]);
  kept.output = std::move(packet.descriptors[2]);
  kept.handle = std::move(packet.descriptors[3]);
  kept_.push_back(std::move(kept));
}

void SupervisorLink::beat() {
  const auto now = Steady::now();
  if (now - beaten_ < kBeatEvery) return;
  beaten_ = now;
  receive();  // what nobody has asked for does not stay in the socket
  static_cast<void>(socket_.send(kBeat));
}

void SupervisorLink::quits() { static_cast<void>(socket_.send_within(kPatience, kQuits)); }

void SupervisorLink::ends(const std::string& why) {
  static_cast<void>(socket_.send_within(kPatience, line_of(kEnds, 0) + why));
}

void SupervisorLink::upgrade(std::chrono::milliseconds trial) {
  static_cast<void>(socket_.send_within(kPatience, line_of(kUpgrade, static_cast<pid_t>(trial.count()))));
}

std::optional<std::string> SupervisorLink::upgrade_answer() {
  receive();
  if (gone_) return "the supervisor has gone";
  return std::exchange(upgrade_answer_, std::nullopt);
}

bool SupervisorLink::is_told_to_end() {
  receive();
  return told_to_end_;
}

bool SupervisorLink::keep(const KeptGroup& group) {
  const std::string text = line_of(kKeep, group.process) + group.told.SerializeAsString();
  return socket_.send_within(kPatience, text,
                             {group.adoption.get(), group.liveness.get(), group.output.get(), group.handle.get()});
}

void SupervisorLink::drop(pid_t process) {
  ends_.erase(process);
  static_cast<void>(socket_.send_within(kPatience, line_of(kDrop, process)));
}

std::string SupervisorLink::end_of(pid_t process) {
  receive();
  const auto found = ends_.find(process);
  return found == ends_.end() ? "" : found->second;
}

}  // namespace fiona::host
