// Promise R10 of the page's server: a page that stands still hurts itself only. It reads nothing of its stream any
// more, over a real connection, while what all pages are shown changes and another page reads.
#include <gtest/gtest.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <fstream>
#include <iostream>
#include <string>
#include <thread>
#include <vector>

#include "../pulse.hpp"
#include "board.hpp"
#include "web_server.hpp"

/// AddressSanitizer would keep up to 256 MiB of what has been freed.
extern "C" const char* __asan_default_options() {  // NOLINT: its name
  return "quarantine_size_mb=1";
}

namespace fiona::smart_web_interface {
namespace {

using namespace std::chrono_literals;
using Steady = std::chrono::steady_clock;

constexpr double kPatience_ms = 1000;
constexpr std::size_t kText_bytes = 64 * 1024;
constexpr auto kEvery = 10ms;
constexpr double kSet_ms = 1;
constexpr double kLongestSet_ms = 6;  ///< as other short forms, where a sanitizer may be in
constexpr double kGrowth_kib = 4 * 1024;

double resident_kib() {
  std::ifstream file("/proc/self/status");
  for (std::string line; std::getline(file, line);) {
    if (line.starts_with("RssAnon:")) return std::stod(line.substr(8));
  }
  return 0;
}

/// How long this thread has waited for a processor so far.
double waited_for_cpu_ms() {
  std::ifstream file("/proc/thread-self/schedstat");
  double ran_ns = 0, waited_ns = 0;
  file >> ran_ns >> waited_ns;
  return waited_ns / 1e6;
}

double ms_since(std::int64_t begun_ns) {
  return static_cast<double>(Steady::now().time_since_epoch().count() - begun_ns) / 1e6;
}

/// A page's stream, of which it reads what it likes.
class Page {
 public:
  explicit Page(std::uint16_t port) {
    const int few = 4096;  // so that it does not read for long on its behalf
    ::setsockopt(socket_, SOL_SOCKET, SO_RCVBUF, &few, sizeof few);
    sockaddr_in to{};
    to.sin_family = AF_INET;
    to.sin_port = htons(port);
    to.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    EXPECT_EQ(::connect(socket_, reinterpret_cast<const sockaddr*>(&to), sizeof to), 0);
    const std::string host = "127.0.0.1:" + std::to_string(port);
    const std::string request = "POST /api/events HTTP/1.1\r\nHost: " + host + "\r\nOrigin: http://" + host +
                                "\r\nSec-Fetch-Site: same-origin\r\nContent-Type: application/json\r\n"
                                "Authorization: Bearer abc\r\nContent-Length: 2\r\n\r\n{}";
    EXPECT_EQ(::send(socket_, request.data(), request.size(), MSG_NOSIGNAL), static_cast<ssize_t>(request.size()));
  }
  ~Page() { ::close(socket_); }
  Page(const Page&) = delete;
  Page& operator=(const Page&) = delete;

  /// The moment that the next text says it was set at, in nanoseconds; 0: none came within this time.
  std::int64_t next_ns(std::chrono::milliseconds within) {
    const auto end = Steady::now() + within;
    while (Steady::now() < end) {
      const std::size_t begin = text_.find("\"<");
      const std::size_t stop = text_.find(">\"", begin == std::string::npos ? 0 : begin);
      if (begin != std::string::npos && stop != std::string::npos) {
        const std::int64_t at_ns = std::stoll(text_.substr(begin + 2));
        text_.erase(0, stop + 2);
        return at_ns;
      }
      timeval most{0, 50'000};
      ::setsockopt(socket_, SOL_SOCKET, SO_RCVTIMEO, &most, sizeof most);
      char bytes[16 * 1024];
      const ssize_t size = ::recv(socket_, bytes, sizeof bytes, 0);
      if (size > 0) text_.append(bytes, static_cast<std::size_t>(size));
      if (size == 0) return 0;
    }
    return 0;
  }

 private:
  const int socket_ = ::socket(AF_INET, SOCK_STREAM, 0);
  std::string text_;
};

class PageThatStandsStill : public ::testing::Test {
 protected:
  /// As a component that learns something does; milliseconds that it took, but for what it waited for a processor.
  double set() {
    const std::int64_t now_ns = Steady::now().time_since_epoch().count();
    std::string text = "\"<" + std::to_string(now_ns) + " " + std::string(kText_bytes, 'x') + ">\"";
    const double waited_before_ms = waited_for_cpu_ms();
    const std::int64_t begun_ns = Steady::now().time_since_epoch().count();
    board_.set("place", std::move(text));
    const double took_ms = ms_since(begun_ns);
    return took_ms - (waited_for_cpu_ms() - waited_before_ms);
  }
  bool await_connections(std::size_t count) {
    for (const auto end = Steady::now() + 10s; Steady::now() < end; std::this_thread::sleep_for(5ms)) {
      if (server_.connections() == count) return true;
    }
    return false;
  }

  Board board_;
  WebServer server_{{.address = "127.0.0.1",
                     .files = {},
                     .board = board_,
                     .on_call = nullptr,
                     .is_open = [](const std::string&) { return true; },
                     .request_time = std::chrono::milliseconds(static_cast<int>(kPatience_ms))}};
};

TEST_F(PageThatStandsStill, HoldsUpNeitherWhoSetsNorAnotherPageAndIsLetGoOf) {
  Page well(server_.port());
  ASSERT_TRUE(await_connections(1));
  std::atomic<bool> ends{false};
  std::atomic<int> heard{0};
  double oldest_ms = 0;
  std::thread reads([&] {
    while (!ends) {
      if (const std::int64_t at_ns = well.next_ns(100ms)) {
        oldest_ms = std::max(oldest_ms, ms_since(at_ns));
        ++heard;
      }
    }
  });
  for (int i = 0; i < 50; ++i, std::this_thread::sleep_for(kEvery)) set();  // until all has been there once
  const double before_kib = resident_kib();
  double grown_kib = 0;
  std::vector<double> took_ms;
  const tests::Pulse pulse;
  {
    const Page still(server_.port());
    EXPECT_TRUE(await_connections(2));
    const auto end = Steady::now() + 10s;
    while (server_.connections() == 2 && Steady::now() < end) {
      took_ms.push_back(set());
      grown_kib = std::max(grown_kib, resident_kib() - before_kib);
      std::this_thread::sleep_for(kEvery);
    }
    EXPECT_EQ(server_.connections(), 1U) << "who takes nothing is let go of";
  }
  ends = true;
  reads.join();
  EXPECT_GT(took_ms.size(), 20U) << "it has stood still for a while";
  std::sort(took_ms.begin(), took_ms.end());
  EXPECT_LE(took_ms[took_ms.size() / 2], kSet_ms) << "most of all sets find it standing still";
  EXPECT_LE(took_ms.back(), kLongestSet_ms + pulse.longest_ms()) << "and so does the slowest of them";
  EXPECT_GT(heard, 50);
  EXPECT_LT(oldest_ms, kPatience_ms) << "the other one does not wait for it to be let go of";
  EXPECT_LE(grown_kib, kGrowth_kib) << "of " << took_ms.size() * kText_bytes / 1024 << " KiB that it has not read";
  std::cout << took_ms.size() << " changes of " << kText_bytes / 1024 << " KiB while it stood still: set in "
            << took_ms[took_ms.size() / 2] << " ms (p50), " << took_ms.back()
            << " at most (the machine stood still for up to " << pulse.longest_ms() << "); the other page had " << heard
            << " of all, after " << oldest_ms << " ms at most; memory " << grown_kib << " KiB more at most\n";
}

TEST_F(PageThatStandsStill, HasTheNewestAndNothingOldOnceItGoesOn) {
  Page still(server_.port());
  ASSERT_TRUE(await_connections(1));
  // More than the system keeps for a connection, and less than its patience.
  for (int i = 0; i < 100; ++i) set();
  const std::int64_t newest_ns = Steady::now().time_since_epoch().count();
  set();
  int read = 0;
  std::int64_t last_ns = 0;
  while (last_ns < newest_ns) {
    const std::int64_t at_ns = still.next_ns(5s);
    ASSERT_GT(at_ns, last_ns) << "none, or an older one after a newer one";
    last_ns = at_ns;
    ++read;
  }
  EXPECT_LT(read, 101) << "what was replaced meanwhile is skipped";
}

}  // namespace
}  // namespace fiona::smart_web_interface
