#include "relay.hpp"

#include <fcntl.h>
#include <linux/if.h>
#include <linux/if_tun.h>
#include <poll.h>
#include <sched.h>
#include <sys/ioctl.h>
#include <unistd.h>

#include <algorithm>
#include <cstring>

namespace fiona::conformance {
namespace {

/// What a way may hold; beyond that it loses packets, as any router does.
constexpr std::size_t kMostUnderWay = 10'000;
constexpr std::size_t kLargestPacket = 65'536;
constexpr std::chrono::milliseconds kLate{30};

/// A device of the network namespace that the calling thread is in.
os::Descriptor open_tun(const std::string& name) {
  os::Descriptor device(::open("/dev/net/tun", O_RDWR | O_NONBLOCK | O_CLOEXEC));
  ifreq request{};
  request.ifr_flags = IFF_TUN | IFF_NO_PI;
  name.copy(request.ifr_name, IFNAMSIZ - 1);
  if (device.get() < 0 || ::ioctl(device.get(), TUNSETIFF, &request) != 0) return {};
  return device;
}

}  // namespace

Relay::Relay(unsigned seed) : random_(seed) {
  if (!missing().empty()) return;
  std::thread(&Relay::open_devices, this).join();  // a thread of its own changes its namespace
  const auto address = [](const std::string& name, const std::string& own, const std::string& other) {
    return "ip addr add " + own + " peer " + other + " dev " + name;
  };
  const std::string a = network() + "a";
  const std::string b = network() + "b";
  require(here_device_.get() >= 0 && there_device_.get() >= 0 && shell(address(a, here(), there())) &&
              shell("ip link set " + a + " up") && in(address(b, there(), here())) && in("ip link set " + b + " up"),
          "TUN devices: /dev/net/tun, and root (CAP_NET_ADMIN)");
  if (missing().empty()) thread_ = std::thread(&Relay::carry, this);
}

Relay::~Relay() {
  stopping_ = true;
  if (thread_.joinable()) thread_.join();
}

void Relay::open_devices() {
  here_device_ = open_tun(network() + "a");
  const os::Descriptor space(::open(("/var/run/netns/" + network()).c_str(), O_RDONLY | O_CLOEXEC));
  if (space.get() < 0 || ::setns(space.get(), CLONE_NEWNET) != 0) return;
  there_device_ = open_tun(network() + "b");
}

void Relay::set(const Weather& weather) {
  const std::lock_guard lock(mutex_);
  weather_ = weather;
}

Relay::Counts Relay::counts() {
  const std::lock_guard lock(mutex_);
  return counts_;
}

void Relay::carry() {
  while (!stopping_) {
    const auto until = under_way_.empty()
                           ? std::chrono::milliseconds(50)
                           : std::chrono::ceil<std::chrono::milliseconds>(under_way_.begin()->first - Clock::now());
    pollfd waits[] = {{here_device_.get(), POLLIN, 0}, {there_device_.get(), POLLIN, 0}};
    ::poll(waits, 2, static_cast<int>(std::clamp<std::int64_t>(until.count(), 0, 50)));
    take(here_device_.get(), there_device_.get());
    take(there_device_.get(), here_device_.get());
    deliver_due();
  }
}

void Relay::take(int from, int to) {
  char packet[kLargestPacket];
  for (ssize_t size = 0; (size = ::read(from, packet, sizeof packet)) > 0;) plan(to, {packet, packet + size});
}

void Relay::plan(int to, std::vector<char> bytes) {
  const std::lock_guard lock(mutex_);
  ++counts_.carried;
  if (under_way_.size() >= kMostUnderWay) return void(++counts_.lost);
  const double delay_ms = std::max(0.0, weather_.delay_ms + (2 * by_chance() - 1) * weather_.jitter_ms);
  auto due =
      Clock::now() + std::chrono::duration_cast<Clock::duration>(std::chrono::duration<double, std::milli>(delay_ms));
  if (by_chance() < weather_.late) {
    ++counts_.late;
    due += kLate;
  } else {
    due = newest_[to] = std::max(due, newest_[to]);
  }
  if (by_chance() < weather_.twice) {
    ++counts_.twice;
    under_way_.emplace(due, Packet{to, bytes});
  }
  under_way_.emplace(due, Packet{to, std::move(bytes)});
}

void Relay::deliver_due() {
  while (!under_way_.empty() && under_way_.begin()->first <= Clock::now()) {
    const Packet& packet = under_way_.begin()->second;
    if (::write(packet.to, packet.bytes.data(), packet.bytes.size()) < 0) {
      const std::lock_guard lock(mutex_);
      ++counts_.lost;
    }
    under_way_.erase(under_way_.begin());
  }
}

}  // namespace fiona::conformance
