#include <algorithm>
#include <atomic>
#include <chrono>
#include <condition_variable>
#include <deque>
#include <memory>
#include <mutex>
#include <thread>

#include "bare_limits.hpp"

namespace fiona::bench {
namespace {

struct Message {
  std::int64_t sent_ns = 0;
  std::string payload;
};

std::shared_ptr<Message> filled(std::size_t bytes) {
  auto message = std::make_shared<Message>();
  message->payload.assign(bytes, 'x');
  return message;
}

class Queue {
 public:
  explicit Queue(std::size_t room = SIZE_MAX) : room_(room) {}
  void push(std::shared_ptr<const Message> message) {
    {
      std::unique_lock lock(mutex_);
      emptied_.wait(lock, [this] { return messages_.size() < room_; });
      messages_.push_back(std::move(message));
    }
    filled_.notify_one();
  }
  std::shared_ptr<const Message> pop() {
    std::unique_lock lock(mutex_);
    filled_.wait(lock, [this] { return !messages_.empty(); });
    auto message = std::move(messages_.front());
    messages_.pop_front();
    lock.unlock();
    if (room_ != SIZE_MAX) emptied_.notify_one();
    return message;
  }

 private:
  const std::size_t room_;
  std::mutex mutex_;
  std::condition_variable filled_;
  std::condition_variable emptied_;
  std::deque<std::shared_ptr<const Message>> messages_;
};

std::chrono::nanoseconds period(const Load& load) {
  return std::chrono::duration_cast<std::chrono::nanoseconds>(
      std::chrono::duration<double, std::milli>(load.period_ms));
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
  auto next = std::chrono::steady_clock::now();
  for (std::size_t i = 0; i < load.messages; ++i) {
    next += period(load);
    std::this_thread::sleep_until(next);
    auto message = filled(load.bytes);
    message->sent_ns = steady_ns();
    queue.push(std::move(message));
  }
  receiver.join();
  return summarise(std::move(latencies));
}

Latency round_trip_through_queues(const Load& load) {
  Queue there, back;
  std::thread answerer([&] {
    for (std::size_t i = 0; i < load.messages; ++i) back.push(filled(there.pop()->payload.size()));
  });
  std::vector<std::int64_t> latencies;
  for (std::size_t i = 0; i < load.messages; ++i) {
    const std::int64_t begun_ns = steady_ns();
    there.push(filled(load.bytes));
    back.pop();
    latencies.push_back(steady_ns() - begun_ns);
  }
  answerer.join();
  return summarise(std::move(latencies));
}

Latency stream_through_queues(const Load& load, std::size_t receivers, std::size_t window) {
  std::deque<Queue> queues;
  for (std::size_t i = 0; i < receivers; ++i) queues.emplace_back(window);
  std::vector<double> each_ns(receivers);
  std::vector<std::thread> threads;
  for (std::size_t i = 0; i < receivers; ++i) {
    threads.emplace_back([&, i] {
      std::int64_t begun_ns = 0;
      for (std::size_t n = 0; n < load.messages; ++n) {
        queues[i].pop();
        if (n == 0) begun_ns = steady_ns();
      }
      each_ns[i] = static_cast<double>(steady_ns() - begun_ns) / static_cast<double>(load.messages - 1);
    });
  }
  for (std::size_t n = 0; n < load.messages; ++n) {
    const std::shared_ptr<const Message> message = filled(load.bytes);
    for (Queue& queue : queues) queue.push(message);
  }
  for (auto& thread : threads) thread.join();
  return {*std::max_element(each_ns.begin(), each_ns.end()), 0};
}

Latency connect_to_queue(const Load& load) {
  std::mutex mutex;
  std::vector<Queue*> subscribers;
  std::atomic<bool> ends{false};
  std::thread publisher([&] {
    auto next = std::chrono::steady_clock::now();
    while (!ends) {
      next += period(load);
      std::this_thread::sleep_until(next);
      const auto message = filled(load.bytes);
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

}  // namespace fiona::bench
