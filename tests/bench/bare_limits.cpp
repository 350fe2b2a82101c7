#include "bare_limits.hpp"

#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <condition_variable>
#include <cstdio>
#include <cstring>
#include <deque>
#include <filesystem>
#include <memory>
#include <mutex>
#include <stdexcept>
#include <thread>
#include <zmq.hpp>

namespace fiona::bench {
namespace {

struct Message {
  std::int64_t sent_ns = 0;
  std::string payload;
};

class Queue {
 public:
  void push(std::shared_ptr<const Message> message) {
    {
      const std::lock_guard lock(mutex_);
      messages_.push_back(std::move(message));
    }
    filled_.notify_one();
  }
  std::shared_ptr<const Message> pop() {
    std::unique_lock lock(mutex_);
    filled_.wait(lock, [this] { return !messages_.empty(); });
    auto message = std::move(messages_.front());
    messages_.pop_front();
    return message;
  }

 private:
  std::mutex mutex_;
  std::condition_variable filled_;
  std::deque<std::shared_ptr<const Message>> messages_;
};

/// Calls `send` once a period.
template <class F>
void pace(const Load& load, F send) {
  auto next = std::chrono::steady_clock::now();
  for (std::size_t i = 0; i < load.messages; ++i) {
    next += std::chrono::duration_cast<std::chrono::nanoseconds>(std::chrono::duration<double, std::milli>(load.period_ms));
    std::this_thread::sleep_until(next);
    send();
  }
}

}  // namespace

std::int64_t steady_ns() { return std::chrono::steady_clock::now().time_since_epoch().count(); }

Latency summarise(std::vector<std::int64_t> all) {
  std::sort(all.begin(), all.end());
  return {static_cast<double>(all.at(all.size() / 2)), static_cast<double>(all.at(all.size() * 99 / 100))};
}

Latency through_queue(const Load& load) {
  Queue queue;
  std::vector<std::int64_t> latencies;
  std::thread receiver([&] {
    for (std::size_t i = 0; i < load.messages; ++i) {
      const auto message = queue.pop();
      latencies.push_back(steady_ns() - message->sent_ns);
    }
  });
  pace(load, [&] {
    auto message = std::make_shared<Message>();
    message->payload.assign(load.bytes, 'x');
    message->sent_ns = steady_ns();
    queue.push(std::move(message));
  });
  receiver.join();
  return summarise(std::move(latencies));
}

int receive_zeromq(const std::string& endpoint, std::size_t messages) {
  zmq::context_t context;
  zmq::socket_t socket(context, zmq::socket_type::pull);
  socket.connect(endpoint);
  std::vector<std::int64_t> latencies;
  for (std::size_t i = 0; i < messages; ++i) {
    zmq::message_t message;
    if (!socket.recv(message)) return 1;
    std::int64_t sent_ns = 0;
    std::memcpy(&sent_ns, message.data(), sizeof sent_ns);
    latencies.push_back(steady_ns() - sent_ns);
  }
  const Latency latency = summarise(std::move(latencies));
  std::printf("%.0f %.0f\n", latency.median_ns, latency.p99_ns);
  return 0;
}

Latency through_zeromq(const Load& load, const std::string& self) {
  const auto path = std::filesystem::temp_directory_path() / ("fiona-bench-" + std::to_string(::getpid()) + ".ipc");
  const std::string endpoint = "ipc://" + path.string();
  zmq::context_t context;
  zmq::socket_t socket(context, zmq::socket_type::push);
  socket.bind(endpoint);
  const std::string command = self + " --zeromq-receiver " + endpoint + " " + std::to_string(load.messages);
  FILE* receiver = ::popen(command.c_str(), "r");
  if (!receiver) throw std::runtime_error("the receiver does not start: " + command);
  pace(load, [&] {
    zmq::message_t message(load.bytes);
    std::memset(message.data(), 'x', load.bytes);
    const std::int64_t now_ns = steady_ns();
    std::memcpy(message.data(), &now_ns, sizeof now_ns);
    socket.send(message, zmq::send_flags::none);
  });
  Latency latency;
  const int read = std::fscanf(receiver, "%lf %lf", &latency.median_ns, &latency.p99_ns);
  ::pclose(receiver);
  std::filesystem::remove(path);
  if (read != 2) throw std::runtime_error("the receiver told no figures");
  return latency;
}

namespace {

/// An endpoint of its own, and the other process at it.
class Partner {
 public:
  Partner(const std::string& self, const std::string& role, const std::string& arguments)
      : path_(std::filesystem::temp_directory_path() / ("fiona-bench-" + std::to_string(::getpid()) + ".ipc")) {
    const std::string command = self + " " + role + " " + endpoint() + arguments;
    process_ = ::popen(command.c_str(), "r");
    if (!process_) throw std::runtime_error("the partner does not start: " + command);
  }
  ~Partner() {
    ::pclose(process_);
    std::filesystem::remove(path_);
    std::filesystem::remove(path_.string() + ".end");
  }
  Partner(const Partner&) = delete;
  Partner& operator=(const Partner&) = delete;
  std::string endpoint() const { return "ipc://" + path_.string(); }
  double figure() {
    double value = 0;
    if (std::fscanf(process_, "%lf", &value) != 1) throw std::runtime_error("the partner told no figure");
    return value;
  }

 private:
  const std::filesystem::path path_;
  FILE* process_ = nullptr;
};

}  // namespace

Latency query_through_zeromq(const Load& load, const std::string& self) {
  Partner partner(self, "--zeromq-answerer", "");
  zmq::context_t context;
  zmq::socket_t socket(context, zmq::socket_type::req);
  socket.bind(partner.endpoint());
  std::vector<std::int64_t> latencies;
  for (std::size_t i = 0; i < load.messages; ++i) {
    const std::int64_t begun_ns = steady_ns();
    zmq::message_t question(load.bytes);
    std::memset(question.data(), 'x', load.bytes);
    socket.send(question, zmq::send_flags::none);
    zmq::message_t answer;
    if (!socket.recv(answer)) throw std::runtime_error("no answer");
    latencies.push_back(steady_ns() - begun_ns);
  }
  socket.send(zmq::message_t(), zmq::send_flags::none);
  return summarise(std::move(latencies));
}

int answer_zeromq(const std::string& endpoint) {
  zmq::context_t context;
  zmq::socket_t socket(context, zmq::socket_type::rep);
  socket.connect(endpoint);
  for (zmq::message_t question; socket.recv(question) && question.size() > 0;) {
    zmq::message_t answer(question.data(), question.size());
    socket.send(answer, zmq::send_flags::none);
  }
  return 0;
}

Latency stream_through_zeromq(const Load& load, std::size_t receivers, const std::string& self) {
  Partner partner(self, "--zeromq-counter", " " + std::to_string(load.messages) + " " + std::to_string(receivers));
  zmq::context_t context;
  zmq::socket_t socket(context, zmq::socket_type::xpub);
  socket.set(zmq::sockopt::xpub_nodrop, true);
  if (load.bytes > 4096) socket.set(zmq::sockopt::sndhwm, 4);
  socket.set(zmq::sockopt::xpub_verboser, true);
  socket.bind(partner.endpoint());
  for (std::size_t i = 0; i < receivers; ++i) {
    zmq::message_t subscription;
    if (!socket.recv(subscription)) throw std::runtime_error("no subscriber");
  }
  for (std::size_t i = 0; i < load.messages; ++i) {
    zmq::message_t message(load.bytes);
    std::memset(message.data(), 'x', load.bytes);
    socket.send(message, zmq::send_flags::none);
  }
  return {partner.figure(), 0};
}

int count_zeromq(const std::string& endpoint, std::size_t messages, std::size_t receivers) {
  zmq::context_t context;
  std::vector<std::thread> threads;
  std::vector<double> each_ns(receivers);
  for (std::size_t i = 0; i < receivers; ++i) {
    threads.emplace_back([&, i] {
      zmq::socket_t socket(context, zmq::socket_type::sub);
      socket.set(zmq::sockopt::subscribe, "");
      socket.connect(endpoint);
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
  return 0;
}

Latency connect_to_queue(const Load& load) {
  std::mutex mutex;
  std::vector<Queue*> subscribers;
  std::atomic<bool> ends{false};
  std::thread publisher([&] {
    auto next = std::chrono::steady_clock::now();
    while (!ends) {
      next += std::chrono::duration_cast<std::chrono::nanoseconds>(std::chrono::duration<double, std::milli>(load.period_ms));
      std::this_thread::sleep_until(next);
      auto message = std::make_shared<Message>();
      message->payload.assign(load.bytes, 'x');
      const std::lock_guard lock(mutex);
      for (Queue* one : subscribers) one->push(message);
    }
  });
  std::vector<std::int64_t> latencies;
  for (std::size_t i = 0; i < load.messages; ++i) {
    Queue queue;
    const std::int64_t begun_ns = steady_ns();
    {
      const std::lock_guard lock(mutex);
      subscribers.push_back(&queue);
    }
    queue.pop();
    latencies.push_back(steady_ns() - begun_ns);
    const std::lock_guard lock(mutex);
    subscribers.clear();
  }
  ends = true;
  publisher.join();
  return summarise(std::move(latencies));
}

Latency connect_over_zeromq(const Load& load, const std::string& self) {
  Partner partner(self, "--zeromq-publisher", " " + std::to_string(load.period_ms));
  zmq::context_t context;
  zmq::socket_t end(context, zmq::socket_type::pair);
  end.connect(partner.endpoint() + ".end");
  const auto first_message = [&] {
    zmq::socket_t socket(context, zmq::socket_type::sub);
    socket.connect(partner.endpoint());
    socket.set(zmq::sockopt::subscribe, "");
    zmq::message_t message;
    if (!socket.recv(message)) throw std::runtime_error("no message");
  };
  first_message();  // the publisher's process has to start
  std::vector<std::int64_t> latencies;
  for (std::size_t i = 0; i < load.messages; ++i) {
    const std::int64_t begun_ns = steady_ns();
    first_message();
    latencies.push_back(steady_ns() - begun_ns);
  }
  end.send(zmq::message_t(), zmq::send_flags::none);
  return summarise(std::move(latencies));
}

int publish_zeromq(const std::string& endpoint, double period_ms) {
  zmq::context_t context;
  zmq::socket_t socket(context, zmq::socket_type::pub);
  socket.bind(endpoint);
  zmq::socket_t end(context, zmq::socket_type::pair);
  end.bind(endpoint + ".end");
  auto next = std::chrono::steady_clock::now();
  zmq::message_t word;
  while (!end.recv(word, zmq::recv_flags::dontwait)) {
    next += std::chrono::duration_cast<std::chrono::nanoseconds>(std::chrono::duration<double, std::milli>(period_ms));
    std::this_thread::sleep_until(next);
    socket.send(zmq::message_t(64), zmq::send_flags::none);
  }
  return 0;
}

}  // namespace fiona::bench
