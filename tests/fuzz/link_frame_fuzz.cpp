// Frames of links between processes: whatever a peer sends over a real link, the ends of its wires get only objects
// that keep their rules, and each request ends exactly once.
#include <google/protobuf/stubs/logging.h>

#include <condition_variable>
#include <cstdint>
#include <cstdlib>
#include <memory>
#include <mutex>
#include <string>
#include <string_view>
#include <vector>
#include <zmq.hpp>

#include "fiona/component.hpp"
#include "fiona/localisation.fiona.hpp"
#include "fiona/navigation.fiona.hpp"
#include "fiona/rules.hpp"
#include "fiona/testing/bench.hpp"
#include "links.hpp"

namespace {

using fiona::host::LinkSocket;
using fiona::host::RemoteWire;
using fiona::localisation::CommLocation;
using fiona::navigation::CommCoordConv;
using fiona::navigation::CommCoordConvRequest;
using fiona::wire::Frame;

constexpr const char* kPeer = "peer";
constexpr std::uint64_t kLastFrame = UINT64_MAX;  // names no wire: it says that all before it has been read
constexpr std::size_t kMostMessages = 64;

class Ends final : public fiona::Component {
 public:
  using Component::Component;

 private:
  void on_location(const CommLocation& location) {
    if (rules_.first_violation(location)) std::abort();
  }
  CommCoordConv convert(const CommCoordConvRequest& request) {
    CommCoordConv answer;
    answer.set_map_name(request.map_name());
    return answer;
  }

  const fiona::ObjectRules rules_{*CommLocation::descriptor()};
  fiona::Requires<fiona::localisation::LocationProvider> location_{*this, "location", &Ends::on_location};
  fiona::Provides<fiona::navigation::CoordinateConversion> conversion_{*this, "conversion", &Ends::convert};
  fiona::Requires<fiona::navigation::CoordinateConversion> asked_{*this, "asked"};
};

struct CountedReply final : fiona::ReplySink {
  void answer(fiona::Outcome outcome, std::string, std::shared_ptr<const fiona::Object> object) override {
    if (++answers > 1 || (outcome == fiona::Outcome::Ok) != (object != nullptr)) std::abort();
  }
  int answers = 0;
};

/// A listening link and a peer of it, in one process.
class LinkAndPeer {
 public:
  LinkAndPeer() {
    bench_.start();
    link_.socket().bind("inproc://fuzz");
    peer_.set(zmq::sockopt::routing_id, kPeer);
    peer_.connect("inproc://fuzz");
    link_.start();
  }
  ~LinkAndPeer() { link_.stop(); }

  void run(const std::vector<std::string_view>& messages) {
    open_wires();
    for (const auto message : messages) peer_.send(zmq::buffer(message));
    send_last();
    {
      std::unique_lock lock(mutex_);
      changed_.wait(lock, [this] { return all_read_; });
    }
    bench_.advance(std::chrono::milliseconds(1));
    close_wires();
    for (zmq::message_t answer; peer_.recv(answer, zmq::recv_flags::dontwait);) continue;
  }

 private:
  void open_wires() {
    const std::lock_guard lock(mutex_);
    all_read_ = false;
    std::uint64_t number = 0;
    for (const char* name : {"location", "conversion", "asked"}) {
      wires_.push_back(std::make_shared<RemoteWire>(link_, kPeer, ++number, *bench_.hull().find_port(name)));
    }
    for (int i = 0; i < 2; ++i) {
      replies_.push_back(std::make_shared<CountedReply>());
      wires_.back()->deliver({{std::make_shared<CommCoordConvRequest>(), 0, {}, 0}, replies_.back()});
    }
  }

  void close_wires() {
    for (const auto& wire : wires_) wire->cut("the test ends");
    for (const auto& reply : replies_) {
      if (reply->answers != 1) std::abort();
    }
    wires_.clear();
    replies_.clear();
  }

  void send_last() {
    Frame frame;
    frame.set_wire(kLastFrame);
    const std::string text = frame.SerializeAsString();
    const std::string length{static_cast<char>(text.size()), 0, 0, 0};
    peer_.send(zmq::buffer(length + text));
  }

  void on_frame(const Frame& frame, std::string_view object) {
    const std::lock_guard lock(mutex_);
    if (frame.wire() == kLastFrame) {
      all_read_ = true;
      changed_.notify_one();
    } else if (frame.wire() >= 1 && frame.wire() <= wires_.size()) {
      wires_[frame.wire() - 1]->on_frame(frame, object);
    }
  }

  std::mutex mutex_;
  std::condition_variable changed_;
  bool all_read_ = false;
  std::vector<std::shared_ptr<RemoteWire>> wires_;
  std::vector<std::shared_ptr<CountedReply>> replies_;
  fiona::testing::Bench<Ends> bench_;
  zmq::context_t context_;
  fiona::Pool pool_{2};
  LinkSocket link_{
      pool_, context_, zmq::socket_type::router,
      [this](const std::string&, const Frame& frame, std::string_view object) { on_frame(frame, object); }};
  zmq::socket_t peer_{context_, zmq::socket_type::dealer};
};

}  // namespace

// Messages, each behind its length in two bytes.
extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  static const auto kLogBefore = google::protobuf::SetLogHandler(nullptr);  // it tells of each garbled message
  static_cast<void>(kLogBefore);
  static LinkAndPeer link;
  std::string_view rest(reinterpret_cast<const char*>(data), size);
  std::vector<std::string_view> messages;
  while (rest.size() > 2 && messages.size() < kMostMessages) {
    const auto byte = [&rest](std::size_t at) { return static_cast<std::size_t>(static_cast<std::uint8_t>(rest[at])); };
    const std::size_t length = byte(0) | byte(1) << 8;
    rest.remove_prefix(2);
    messages.push_back(rest.substr(0, length));
    rest.remove_prefix(messages.back().size());
  }
  link.run(messages);
  return 0;
}
