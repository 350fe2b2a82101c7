#pragma once

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "fiona/sink.hpp"
#include "fiona/wire_end.hpp"

namespace fiona {

class Clock;
class Hull;

/// A wire within one process: hands parcels to the inbox at its end, every `prescale`-th of a push.
class LocalWire final : public Sink, public std::enable_shared_from_this<LocalWire> {
 public:
  /// Of a send, query or event: to the provider's inbox.
  LocalWire(std::string name, Inbox& inbox);
  /// Of a push: to the client's end.
  LocalWire(std::string name, std::shared_ptr<WireEnd> end, std::uint32_t prescale);
  Outcome deliver(Parcel parcel) override;
  void repeat(Parcel parcel) override;
  void lease(bool held, const std::string& reason) override;
  bool has_room(std::size_t bytes, const std::function<void()>& notice) override;
  void attached(std::uint64_t sequence, Duration cycle) override;
  /// [any thread] From the next put on.
  void set_prescale(std::uint32_t prescale);
  /// [any thread] After it returned nothing more reaches the inbox; what is open on it has ended with Disconnected.
  void cut(const std::string& reason);
  /// [any thread] Cuts it if it ends at a port of this hull.
  void cut_from(const Hull& hull, const std::string& reason);
  /// [any thread] Whether a query that was asked over it has not ended.
  bool has_open();
  const std::string& name() const { return name_; }

 private:
  static constexpr std::size_t kLeastOpen = 64;

  Outcome pass(std::unique_lock<std::mutex>& lock, Parcel parcel);
  Outcome hand_over(Parcel parcel);
  void keep_open(const std::shared_ptr<ReplySink>& request);
  void cut_if(const std::function<bool(const Inbox&)>& is_meant, const std::string& reason);
  void stage(std::unique_lock<std::mutex>& lock, const Object* object, std::string_view word, Job deliver);
  void give_up_in_turn(const std::shared_ptr<ReplySink>& reply);
  std::optional<std::size_t> room_at_end(std::size_t cost);
  void tell_room(std::size_t room);
  void has_been_told(std::size_t room);

  const std::string name_;              ///< "client.port<provider.port", orders deliveries in virtual time
  const std::shared_ptr<WireEnd> end_;  ///< of a push
  std::mutex mutex_;
  std::uint32_t prescale_;
  Inbox* inbox_;  ///< null once cut
  Clock& clock_;
  std::vector<std::weak_ptr<ReplySink>> open_;  ///< requests of a query
  std::size_t most_open_ = kLeastOpen;
  std::uint64_t puts_ = 0;
  std::uint64_t staged_ = 0;
  KnownRoom room_;
  std::function<void()> notice_;  ///< of who waits for room
  const std::string room_name_;   ///< orders what is said of room in virtual time
  std::atomic<std::uint64_t> rooms_staged_{0};
};

}  // namespace fiona
