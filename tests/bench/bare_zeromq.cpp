#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <cstdio>
#include <cstring>
#include <filesystem>
#include <stdexcept>
#include <thread>
#include <zmq.hpp>

#include "bare_limits.hpp"

namespace fiona::bench {
namespace {

// The pairs of the example in zmq_curve(7): what they keep secret here is nothing, what they cost is the same.
constexpr const char* kServerOpen = "rq:rM>}U?@Lns47E1%kR.o@n%FcmmsL/@{H8]yf7";
constexpr const char* kServerSecret = "JTKVSB%%)wK0E.X)V>+}o?pNmC{O&4W4b!Ni{Lh6";
constexpr const char* kClientOpen = "Yne@$w-vo<fVvi]a<NY6T1ed:M$fCG*[IaLV{hID";
constexpr const char* kClientSecret = "D:)Q[IlAW!ahhC2ac:9*A}h:p?([4%wOTJ%JR%cs";

std::filesystem::path ipc_path(const std::string& name) {
  return std::filesystem::temp_directory_path() / ("fiona-bench-" + std::to_string(::getpid()) + name);
}

/// Where it listens then.
std::string listen(zmq::socket_t& socket, bool tcp) {
  if (!tcp) {
    const std::string endpoint = "ipc://" + ipc_path(".ipc").string();
    socket.bind(endpoint);
    return endpoint;
  }
  socket.set(zmq::sockopt::curve_server, true);
  socket.set(zmq::sockopt::curve_secretkey, kServerSecret);
  socket.bind("tcp://127.0.0.1:*");
  return socket.get(zmq::sockopt::last_endpoint);
}

void connect(zmq::socket_t& socket, const std::string& endpoint) {
  if (endpoint.starts_with("tcp:")) {
    socket.set(zmq::sockopt::curve_serverkey, kServerOpen);
    socket.set(zmq::sockopt::curve_publickey, kClientOpen);
    socket.set(zmq::sockopt::curve_secretkey, kClientSecret);
  }
  socket.connect(endpoint);
}

zmq::message_t filled_message(std::size_t bytes) {
  zmq::message_t message(bytes);
  std::memset(message.data(), 'x', bytes);
  return message;
}

void sleep_until_next(std::chrono::steady_clock::time_point& next, double period_ms) {
  next += std::chrono::duration_cast<std::chrono::nanoseconds>(std::chrono::duration<double, std::milli>(period_ms));
  std::this_thread::sleep_until(next);
}

/// This program once more, as the other process.
class Partner {
 public:
  Partner(const Medium& medium, const std::string& role, const std::string& arguments) {
    const std::string command = medium.self + " " + role + " " + arguments;
    process_ = ::popen(command.c_str(), "r");
    if (!process_) throw std::runtime_error("the partner does not start: " + command);
  }
  ~Partner() {
    ::pclose(process_);
    for (const char* name : {".ipc", ".end"}) std::filesystem::remove(ipc_path(name));
  }
  Partner(const Partner&) = delete;
  Partner& operator=(const Partner&) = delete;
  double figure() {
    double value = 0;
    if (std::fscanf(process_, "%lf", &value) != 1) throw std::runtime_error("the partner told no figure");
    return value;
  }
  std::string word() {
    char text[256];
    if (std::fscanf(process_, "%255s", text) != 1) throw std::runtime_error("the partner told no word");
    return text;
  }

 private:
  FILE* process_ = nullptr;
};

void receive(const std::string& endpoint, std::size_t messages) {
  zmq::context_t context;
  zmq::socket_t socket(context, zmq::socket_type::pull);
  connect(socket, endpoint);
  std::vector<std::int64_t> latencies;
  for (std::size_t i = 0; i < messages; ++i) {
    zmq::message_t message;
    if (!socket.recv(message)) throw std::runtime_error("no message");
    std::int64_t sent_ns = 0;
    std::memcpy(&sent_ns, message.data(), sizeof sent_ns);
    latencies.push_back(steady_ns() - sent_ns);
  }
  const Latency latency = summarise(std::move(latencies));
  std::printf("%.0f %.0f\n", latency.median_ns, latency.p99_ns);
}

void answer(const std::string& endpoint) {
  zmq::context_t context;
  zmq::socket_t socket(context, zmq::socket_type::rep);
  connect(socket, endpoint);
  for (zmq::message_t question; socket.recv(question) && question.size() > 0;) {
    zmq::message_t answer(question.data(), question.size());
    socket.send(answer, zmq::send_flags::none);
  }
}

void count(const std::string& endpoint, std::size_t messages, std::size_t receivers) {
  zmq::context_t context;
  std::vector<std::thread> threads;
  std::vector<double> each_ns(receivers);
  for (std::size_t i = 0; i < receivers; ++i) {
    threads.emplace_back([&, i] {
      zmq::socket_t socket(context, zmq::socket_type::sub);
      socket.set(zmq::sockopt::subscribe, "");
      connect(socket, endpoint);
      std::int64_t begun_ns = 0;
      zmq::message_t message;
      for (std::size_t n = 0; n < messages && socket.recv(message); ++n) {
        if (n == 0) begun_ns = steady_ns();
      }
      each_ns[i] = static_cast<double>(steady_ns() - begun_ns) / static_cast<double>(messages - 1);
    });
  }
  for (auto& thread : threads) thread.join();
  std::printf("%.0f\n", *std::max_element(each_ns.begin(), each_ns.end()));
}

/// Until something is said to it.
void publish(bool tcp, double period_ms, const std::string& end_endpoint) {
  zmq::context_t context;
  zmq::socket_t socket(context, zmq::socket_type::pub);
  socket.set(zmq::sockopt::linger, 0);  // or its end waits for subscribers that have stopped reading
  std::printf("%s\n", listen(socket, tcp).c_str());
  std::fflush(stdout);
  zmq::socket_t end(context, zmq::socket_type::pair);
  end.connect(end_endpoint);
  auto next = std::chrono::steady_clock::now();
  zmq::message_t word;
  while (!end.recv(word, zmq::recv_flags::dontwait)) {
    sleep_until_next(next, period_ms);
    socket.send(zmq::message_t(64), zmq::send_flags::none);
  }
}

}  // namespace

Latency through_zeromq(const Load& load, const Medium& medium) {
  zmq::context_t context;
  zmq::socket_t socket(context, zmq::socket_type::push);
  Partner receiver(medium, "--receive", listen(socket, medium.tcp) + " " + std::to_string(load.messages));
  auto next = std::chrono::steady_clock::now();
  for (std::size_t i = 0; i < load.messages; ++i) {
    sleep_until_next(next, load.period_ms);
    zmq::message_t message = filled_message(load.bytes);
    const std::int64_t now_ns = steady_ns();
    std::memcpy(message.data(), &now_ns, sizeof now_ns);
    socket.send(message, zmq::send_flags::none);
  }
  const double median_ns = receiver.figure();
  return {median_ns, receiver.figure()};
}

Latency query_through_zeromq(const Load& load, const Medium& medium) {
  zmq::context_t context;
  zmq::socket_t socket(context, zmq::socket_type::req);
  Partner partner(medium, "--answer", listen(socket, medium.tcp));
  std::vector<std::int64_t> latencies;
  for (std::size_t i = 0; i < load.messages; ++i) {
    const std::int64_t begun_ns = steady_ns();
    zmq::message_t question = filled_message(load.bytes);
    socket.send(question, zmq::send_flags::none);
    zmq::message_t answer;
    if (!socket.recv(answer)) throw std::runtime_error("no answer");
    latencies.push_back(steady_ns() - begun_ns);
  }
  socket.send(zmq::message_t(), zmq::send_flags::none);
  return summarise(std::move(latencies));
}

Latency stream_through_zeromq(const Load& load, std::size_t receivers, const Medium& medium) {
  zmq::context_t context;
  zmq::socket_t socket(context, zmq::socket_type::xpub);
  socket.set(zmq::sockopt::xpub_nodrop, true);
  if (load.bytes > 4096) socket.set(zmq::sockopt::sndhwm, 4);
  socket.set(zmq::sockopt::xpub_verboser, true);
  Partner partner(medium, "--count",
                  listen(socket, medium.tcp) + " " + std::to_string(load.messages) + " " + std::to_string(receivers));
  for (std::size_t i = 0; i < receivers; ++i) {
    zmq::message_t subscription;
    if (!socket.recv(subscription)) throw std::runtime_error("no subscriber");
  }
  for (std::size_t i = 0; i < load.messages; ++i) {
    zmq::message_t message = filled_message(load.bytes);
    socket.send(message, zmq::send_flags::none);
  }
  return {partner.figure(), 0};
}

Latency connect_over_zeromq(const Load& load, const Medium& medium) {
  zmq::context_t context;
  zmq::socket_t end(context, zmq::socket_type::pair);
  const std::string end_endpoint = "ipc://" + ipc_path(".end").string();
  end.bind(end_endpoint);
  Partner partner(medium, "--publish",
                  std::string(medium.tcp ? "tcp " : "ipc ") + std::to_string(load.period_ms) + " " + end_endpoint);
  const std::string endpoint = partner.word();
  std::vector<std::int64_t> latencies;
  for (std::size_t i = 0; i < load.messages; ++i) {
    const std::int64_t begun_ns = steady_ns();
    zmq::socket_t socket(context, zmq::socket_type::sub);
    connect(socket, endpoint);
    socket.set(zmq::sockopt::subscribe, "");
    zmq::message_t message;
    if (!socket.recv(message)) throw std::runtime_error("no message");
    latencies.push_back(steady_ns() - begun_ns);
  }
  end.send(zmq::message_t(), zmq::send_flags::none);
  return summarise(std::move(latencies));
}

int other_side(int argc, char** argv) {
  const std::vector<std::string> words(argv + 1, argv + argc);
  if (words.size() == 3 && words[0] == "--receive") return receive(words[1], std::stoul(words[2])), 0;
  if (words.size() == 2 && words[0] == "--answer") return answer(words[1]), 0;
  if (words.size() == 4 && words[0] == "--count") return count(words[1], std::stoul(words[2]), std::stoul(words[3])), 0;
  if (words.size() == 4 && words[0] == "--publish") return publish(words[1] == "tcp", std::stod(words[2]), words[3]), 0;
  return -1;
}

}  // namespace fiona::bench
