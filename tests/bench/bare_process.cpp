// A process with libzmq and protobuf and no more: one publisher and one subscriber, a message each millisecond. What a
// host with two instances is compared with. Says READY when messages have come, and ends with its standard input.
#include <google/protobuf/wrappers.pb.h>
#include <poll.h>

#include <atomic>
#include <chrono>
#include <cstdio>
#include <string>
#include <thread>
#include <zmq.hpp>

int main() {
  constexpr int kWarm = 1000;
  zmq::context_t context;
  zmq::socket_t publisher(context, zmq::socket_type::pub);
  publisher.bind("inproc://samples");
  std::atomic<int> received{0};
  std::thread subscriber([&] {
    zmq::socket_t socket(context, zmq::socket_type::sub);
    socket.set(zmq::sockopt::subscribe, "");
    socket.connect("inproc://samples");
    zmq::message_t message;
    google::protobuf::BytesValue sample;
    while (socket.recv(message) && message.size() > 0) {
      if (sample.ParseFromArray(message.data(), static_cast<int>(message.size()))) ++received;
    }
  });
  google::protobuf::BytesValue sample;
  sample.set_value(std::string(64, 'x'));
  bool told = false;
  for (pollfd input{0, POLLIN, 0}; ::poll(&input, 1, 1) == 0;) {
    publisher.send(zmq::message_t(sample.SerializeAsString()), zmq::send_flags::none);
    if (told || received < kWarm) continue;
    told = true;
    std::printf("READY\n");
    std::fflush(stdout);
  }
  publisher.send(zmq::message_t(), zmq::send_flags::none);
  subscriber.join();
  return received < kWarm;
}
