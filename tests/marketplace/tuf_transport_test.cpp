// How files come from directories and servers, and what servers may not do.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <unistd.h>

#include <atomic>
#include <fiona/error.hpp>
#include <fiona/trust/tuf_client.hpp>
#include <functional>
#include <string>
#include <thread>

#include "support.hpp"

namespace fiona::tuf {
namespace {

using ::testing::HasSubstr;

// A server on loopback that answers each connection as the test says, with its request's first line.
class OddServer {
 public:
  using Answer = std::function<void(int connection, const std::string& request, const std::atomic<bool>& ended)>;

  explicit OddServer(Answer answer) : answer_(std::move(answer)), listener_(::socket(AF_INET, SOCK_STREAM, 0)) {
    sockaddr_in address{};
    address.sin_family = AF_INET;
    address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    socklen_t size = sizeof address;
    if (::bind(listener_, reinterpret_cast<sockaddr*>(&address), size) != 0 || ::listen(listener_, 8) != 0 ||
        ::getsockname(listener_, reinterpret_cast<sockaddr*>(&address), &size) != 0) {
      ADD_FAILURE() << "no server";
    }
    port_ = ntohs(address.sin_port);
    thread_ = std::thread([this] { serve(); });
  }
  ~OddServer() {
    ended_ = true;
    ::shutdown(listener_, SHUT_RDWR);
    thread_.join();
    ::close(listener_);
  }

  std::string url() const { return "http://127.0.0.1:" + std::to_string(port_); }

 private:
  void serve() {
    for (int connection; (connection = ::accept(listener_, nullptr, nullptr)) >= 0;) {
      std::string request(4096, '\0');
      const ssize_t count = ::recv(connection, request.data(), request.size(), 0);
      request.resize(count > 0 ? static_cast<std::size_t>(count) : 0);
      answer_(connection, request.substr(0, request.find('\r')), ended_);
      ::close(connection);
    }
  }

  Answer answer_;
  int listener_;
  int port_ = 0;
  std::atomic<bool> ended_ = false;
  std::thread thread_;
};

bool say(int connection, std::string_view bytes) {
  return ::send(connection, bytes.data(), bytes.size(), MSG_NOSIGNAL) == static_cast<ssize_t>(bytes.size());
}

std::string fetched(const std::string& base, const std::string& path, std::uint64_t most, const Limits& limits = {}) {
  std::string bytes;
  try {
    if (!make_transport(limits)->fetch(base, path, most, [&](std::string_view piece) { bytes += piece; }))
      return "absent";
  } catch (const Error& error) {
    return error.what();
  }
  return bytes;
}

TEST(TufTransport, AServersFileIsFetched) {
  const OddServer server{[](int connection, const std::string& request, const auto&) {
    say(connection, "HTTP/1.1 200 OK\r\nContent-Length: " + std::to_string(request.size()) + "\r\n\r\n" + request);
  }};
  EXPECT_EQ(fetched(server.url() + "/metadata/", "1.a%2Fb.json", 100), "GET /metadata/1.a%2Fb.json HTTP/1.1");
}

TEST(TufTransport, MissingAndForbiddenFilesAreAbsent) {
  for (const char* status : {"404 Not Found", "403 Forbidden"}) {
    const OddServer server{[status](int connection, const std::string&, const auto&) {
      say(connection, std::string("HTTP/1.1 ") + status + "\r\nContent-Length: 0\r\n\r\n");
    }};
    EXPECT_EQ(fetched(server.url(), "x", 100), "absent") << status;
  }
}

TEST(TufTransport, AServerThatFailsIsNotAFileThatIsAbsent) {
  const OddServer server{[](int connection, const std::string&, const auto&) {
    say(connection, "HTTP/1.1 500 Oh\r\nContent-Length: 0\r\n\r\n");
  }};
  EXPECT_THAT(fetched(server.url(), "x", 100), HasSubstr("the server answered 500"));
}

TEST(TufTransport, AServerThatIsNotThereIsUnreachable) {
  std::string url;
  {
    const OddServer server{[](int, const std::string&, const auto&) {}};
    url = server.url();
  }
  EXPECT_THAT(fetched(url, "x", 100), HasSubstr("the server cannot be reached"));
}

TEST(TufTransport, EndlessDataEndsAtTheLimit) {
  const OddServer server{[](int connection, const std::string&, const auto& ended) {
    say(connection, "HTTP/1.1 200 OK\r\n\r\n");
    while (!ended && say(connection, std::string(1 << 16, 'x'))) {
    }
  }};
  EXPECT_THAT(fetched(server.url(), "x", 100'000), HasSubstr("endless data: this file is larger than it may be"));
}

TEST(TufTransport, ATooLargeLengthIsRefusedBeforeTheBytes) {
  const OddServer server{[](int connection, const std::string&, const auto&) {
    say(connection, "HTTP/1.1 200 OK\r\nContent-Length: 101\r\n\r\n");
  }};
  EXPECT_THAT(fetched(server.url(), "x", 100), HasSubstr("endless data"));
}

TEST(TufTransport, SlowRetrievalIsGivenUp) {
  const OddServer server{[](int connection, const std::string&, const auto& ended) {
    say(connection, "HTTP/1.1 200 OK\r\nContent-Length: 100\r\n\r\n");
    while (!ended && say(connection, "x")) std::this_thread::sleep_for(std::chrono::milliseconds(50));
  }};
  Limits limits;
  limits.connect = limits.patience = std::chrono::milliseconds(300);
  EXPECT_THAT(fetched(server.url(), "x", 100, limits), HasSubstr("slow retrieval"));
}

TEST(TufTransport, AServerThatNeverAnswersIsGivenUp) {
  const OddServer server{[](int, const std::string&, const auto& ended) {
    while (!ended) std::this_thread::sleep_for(std::chrono::milliseconds(10));
  }};
  Limits limits;
  limits.connect = limits.patience = std::chrono::milliseconds(300);
  EXPECT_THAT(fetched(server.url(), "x", 100, limits), HasSubstr("slow retrieval"));
}

TEST(TufTransport, ATruncatedAnswerIsAFailure) {
  const OddServer server{[](int connection, const std::string&, const auto&) {
    say(connection, "HTTP/1.1 200 OK\r\nContent-Length: 10\r\n\r\nxxx");
  }};
  EXPECT_THAT(fetched(server.url(), "x", 100), HasSubstr("the server cannot be reached"));
}

TEST(TufTransport, NoServerLeadsToAFileOfThisMachine) {
  const OddServer server{[](int connection, const std::string&, const auto&) {
    say(connection, "HTTP/1.1 302 Found\r\nLocation: file:///etc/passwd\r\nContent-Length: 0\r\n\r\n");
  }};
  EXPECT_THAT(fetched(server.url(), "x", 100'000), HasSubstr("the server cannot be reached"));
}

TEST(TufTransport, RedirectionsEnd) {
  const OddServer server{[](int connection, const std::string&, const auto&) {
    say(connection, "HTTP/1.1 302 Found\r\nLocation: /again\r\nContent-Length: 0\r\n\r\n");
  }};
  EXPECT_THAT(fetched(server.url(), "x", 100), HasSubstr("the server cannot be reached"));
}

TEST(TufTransport, ADirectoryIsReadWithAndWithoutScheme) {
  const marketplace::testing::Scratch scratch;
  marketplace::testing::write_file(scratch / "a b/1.x.json", "content");
  const std::string place = (scratch / "a b").string();
  EXPECT_EQ(fetched(place, "1.x.json", 100), "content");
  EXPECT_EQ(fetched("file://" + scratch.path().string() + "/a%20b", "1.x.json", 100), "content");
  EXPECT_EQ(fetched(place, "2.x.json", 100), "absent");
  EXPECT_THAT(fetched(place, "1.x.json", 6), HasSubstr("endless data"));
}

TEST(TufTransport, NothingOutsideOfADirectoryIsRead) {
  const marketplace::testing::Scratch scratch;
  marketplace::testing::write_file(scratch / "secret", "content");
  marketplace::testing::write_file(scratch / "market/x", "content");
  for (const char* path : {"../secret", "%2E%2E/secret", "..%2Fsecret", "/etc/passwd", "%2Fetc/passwd", ""}) {
    EXPECT_THAT(fetched((scratch / "market").string(), path, 1000), HasSubstr("names a file outside of its directory"))
        << path;
  }
}

TEST(TufTransport, AFifoIsNotWaitedFor) {
  const marketplace::testing::Scratch scratch;
  marketplace::testing::write_file(scratch / "market/x", "content");
  ASSERT_EQ(::mkfifo((scratch / "market/timestamp.json").c_str(), 0600), 0);
  EXPECT_THAT(fetched((scratch / "market").string(), "timestamp.json", 1000), HasSubstr("not a regular file"));
}

TEST(TufTransport, OtherSchemesAreRefused) {
  EXPECT_THAT(fetched("ftp://127.0.0.1", "x", 100), HasSubstr("this is no place that a repository can be read from"));
}

}  // namespace
}  // namespace fiona::tuf
