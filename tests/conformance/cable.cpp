#include "cable.hpp"

#include <unistd.h>

#include <cstdlib>

#include "fiona/error.hpp"

namespace fiona::conformance {

bool shell(const std::string& line) { return std::system((line + " >/dev/null 2>&1").c_str()) == 0; }

/// Addresses follow from the process's number, as does the name: tests run side by side.
Network::Network() : name_("fi" + std::to_string(::getpid())) {
  const auto id = static_cast<unsigned>(::getpid());
  const std::string net = "10." + std::to_string(224 + (id >> 14) % 16) + "." + std::to_string(id >> 6 & 255) + ".";
  here_ = net + std::to_string((id & 63) * 4 + 1);
  there_ = net + std::to_string((id & 63) * 4 + 2);
  require(shell("command -v ip"), "the program ip (Debian package iproute2)");
  require(shell("ip netns add " + name_) && in("ip link set lo up"),
          "network namespaces, which need root (CAP_SYS_ADMIN, CAP_NET_ADMIN)");
}

Network::~Network() { shell("ip netns del " + name_); }

void Network::require(bool good, const std::string& what) {
  if (!good && missing_.empty()) missing_ = "this test needs " + what;
}

namespace {

void must(bool good, const std::string& what) {
  if (!good) throw Error(ErrorCode::Failed, what + " did not work");
}

}  // namespace

Cable::Cable() {
  const std::string& name = network();
  require(shell("ip link add " + name + "a type veth peer name " + name + "b netns " + name) &&
              shell("ip addr add " + here() + "/30 dev " + name + "a") && shell("ip link set " + name + "a up") &&
              in("ip addr add " + there() + "/30 dev " + name + "b") && in("ip link set " + name + "b up"),
          "pairs of virtual network devices (veth), which need root (CAP_NET_ADMIN)");
}

Cable::~Cable() {
  shell("nft delete table netdev " + network() + "a");
  shell("ip link del " + network() + "a");
}

void Cable::pull() { must(in("ip link set " + network() + "b down"), "pulling the cable"); }
void Cable::plug() { must(in("ip link set " + network() + "b up"), "plugging the cable in again"); }

/// Where packets arrive: what is refused where they leave is no loss to tcp, which is told of it.
void Cable::lose(int there_percent, int here_percent) {
  const auto lose_at = [this](const std::string& end, int percent, const auto& run) {
    const std::string table = "netdev " + network() + end;
    run("nft delete table " + table);
    if (percent == 0) return;
    const std::string which = percent >= 100 ? "" : "numgen random mod 100 < " + std::to_string(percent);
    must(run("nft 'add table " + table + "; add chain " + table + " in { type filter hook ingress device " + network() +
             end + " priority 0; }; add rule " + table + " in " + which + " drop'"),
         "nft");
  };
  lose_at("b", there_percent, [this](const std::string& line) { return in(line); });
  lose_at("a", here_percent, [](const std::string& line) { return shell(line); });
}

void Cable::limit(const std::string& rate) {
  shell("tc qdisc del dev " + network() + "a root");
  in("tc qdisc del dev " + network() + "b root");
  if (rate.empty()) return;
  const std::string tbf = " root tbf rate " + rate + " burst 16kb latency 200ms";
  must(shell("tc qdisc add dev " + network() + "a" + tbf) && in("tc qdisc add dev " + network() + "b" + tbf), "tc");
}

}  // namespace fiona::conformance
