#pragma once

#include <chrono>
#include <filesystem>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "bus_proxy.hpp"
#include "clock_master.hpp"
#include "cpu_share.hpp"
#include "fiona/error.hpp"
#include "group_output.hpp"
#include "group_subjects.hpp"
#include "hang_watch.hpp"
#include "os/limits.hpp"
#include "os/message_stream.hpp"
#include "os/process.hpp"
#include "os/process_template.hpp"
#include "os/shared_memory.hpp"
#include "runtime.hpp"
#include "supervisor_link.hpp"

namespace fiona::host {

/// A process of the host that holds instances: the host's own (`main`), or a child.
class Group {
 public:
  /// `link_key`: one that it has already; empty: a new one.
  explicit Group(std::string name, std::string link_key = {});
  virtual ~Group() = default;
  Group(const Group&) = delete;
  Group& operator=(const Group&) = delete;

  const std::string& name() const { return name_; }
  /// [control thread] Does it and returns the answer. Throws Error: what the group refused, or Unreachable when the
  /// group is gone, or did not answer in the time that such a request may take: then it does not begin it any more.
  wire::GroupMessage request(wire::GroupRequest request);
  /// [control thread] As `request`, but others may be asked before what is returned is called: it waits for the answer,
  /// and throws. Only a process that is another's, and answers, leaves anything to wait for.
  virtual std::function<void()> begin(wire::GroupRequest request);
  /// [control thread] Does it when it comes to it: nobody waits for that, or is told that it was refused.
  virtual void tell(wire::GroupRequest request);
  /// [control thread] As `tell`; until it has answered it is silent.
  virtual void ask(wire::GroupRequest request) { tell(std::move(request)); }
  /// [control thread] For what is to be so whether or not somebody waits: does it before this returns if the group
  /// answers, and otherwise once it does. A group that is gone has nothing to do. Throws Error: what the group refused.
  void inform(wire::GroupRequest request);
  /// [control thread] Throws Error Unreachable if it does not answer.
  virtual void require_answer() {}
  /// [control thread] Asks for its status, so that several groups find it out at the same time.
  virtual void ask_status() {}
  /// [control thread] What it was asked for; none if it is gone, or has not answered that for so long.
  virtual std::optional<wire::GroupStatusReply> status(std::chrono::milliseconds patience);
  /// Since when it has not answered; none: it answers, as far as is known.
  virtual std::optional<std::chrono::steady_clock::time_point> silent_since() const { return std::nullopt; }

  virtual std::string endpoint() const = 0;
  virtual pid_t process() const = 0;
  virtual bool alive() const = 0;
  /// Its name towards the processes that it opens links to: where it listens, so that what both ends of a link count
  /// can be compared. No other process of the host has had it.
  virtual std::string link_name() const { return endpoint(); }
  /// What its own links are opened with: each peer is given a key that is made of it and the peer's name.
  const std::string& link_key() const { return link_key_; }
  /// [control thread] Tells it that another process has gone; does not wait for it.
  virtual void peer_lost(const wire::PeerLost& gone) = 0;

 protected:
  virtual wire::GroupMessage perform(const wire::GroupRequest& request, std::chrono::milliseconds deadline) = 0;

 private:
  const std::string name_;
  const std::string link_key_;
};

/// `main`: the runtime in the host's own process.
class MainGroup final : public Group {
 public:
  MainGroup(Pool& pool, Clock& clock, PluginLibraries& libraries, std::string endpoint, std::string memory_key,
            Runtime::OnEvent on_event);
  std::string endpoint() const override { return runtime_.endpoint(); }
  pid_t process() const override;
  bool alive() const override { return true; }
  Links& links() { return runtime_.links(); }
  /// [control thread] Of an instance that does not come back from its work.
  void give_up(const std::string& instance, const std::string& reason) { runtime_.give_up(instance, reason); }
  /// [control thread] As that of the runtime.
  void let_failed_go() { runtime_.let_failed_go(); }
  /// [control thread] Whether the strand is of an instance that was destroyed and had not come free.
  bool has_left(const Liveness::Slot* slot) const { return runtime_.has_left(slot); }
  void peer_lost(const wire::PeerLost& gone) override;
  std::map<std::string, FrameCounts> frame_counts() { return runtime_.frame_counts(); }

 private:
  wire::GroupMessage perform(const wire::GroupRequest& request, std::chrono::milliseconds deadline) override;
  VirtualClock* const clock_;  ///< null: the system's
  Runtime runtime_;
};

/// Throws Error NotAllowed when one more process than `peers` (groups, and clients that no host has started) could
/// bring this process or a group to the end of its descriptors: ZeroMQ ends a process that cannot accept a connection.
void require_descriptors_for(const std::string& newcomer, std::size_t peers, std::uint64_t of_group);
/// Throws Error NotAllowed where this process may have fewer than a host without groups needs.
void require_descriptors_to_start();

/// How often groups are looked at, whether they stand still.
inline constexpr std::chrono::milliseconds kWatchEvery{100};
/// The same while somebody waits for its answer: what looking late adds to a bound, he waits longer.
inline constexpr std::chrono::milliseconds kWatchWaiting{25};

/// What the instances of a group may take for their end, when the run ends.
inline constexpr std::chrono::seconds kEndsItself{2};

/// Within which groups that are to be adopted answer, all together.
inline constexpr std::chrono::seconds kAdoptionDeadline{3};

/// The program of each, beside that of the host.
inline constexpr const char* kGroupProgram = "fiona-group";

/// A child process that ends when the host's end of its socket closes.
class ChildGroup final : public Group {
 public:
  using Time = std::chrono::steady_clock::time_point;

  /// How its process is started. A virtual clock is followed through `master`; the system's is shared by its origin.
  struct Start {
    std::string endpoint;
    const Clock& clock;
    ClockMaster* master = nullptr;
    std::size_t threads = 0;               ///< of its pool; 0: one per core
    HangWatch::Parts parts;                ///< what its instances may be doing; none: it is not ended when it hangs
    wire::Confinement confinement{};       ///< what it may take and reach
    std::filesystem::path folder{};        ///< in which it listens: made with it, and removed at its end
    double cores = 0;                      ///< that it may take in the long run; 0: as many as there are
    std::string host{};                    ///< where `main` listens
    std::string memory_key{};              ///< of the host's processes; a sandbox is not told
    SupervisorLink* supervisor = nullptr;  ///< keeps it for a host after this one; none: it ends with this one
    std::shared_ptr<os::ProcessTemplate>
        copied{};                       ///< shared by its copies, for it ends with the last; none: it is none
    std::function<void()> meanwhile{};  ///< what is done again and again while it is waited for
  };
  /// Starts the process and waits until it is ready. Throws Error with how it ended if it does not become so.
  ChildGroup(std::string name, const Start& start, Runtime::OnEvent on_event);
  /// Asks one that a host before this one has started what it holds, and does not wait for its answer: many are asked
  /// before any is waited for. Where it speaks another protocol it is an ended group from the beginning.
  ChildGroup(KeptGroup kept, const Start& start, Runtime::OnEvent on_event);
  ~ChildGroup() override;
  /// [control thread] Takes it over; what it holds is in `adopted`. It is ended where it has not answered by then.
  void finish_adoption(Time deadline);
  /// None: it was started by this host, or has ended.
  const std::optional<wire::Adopted>& adopted() const { return adopted_; }
  /// [control thread] Ends it.
  void end_now(const std::string& why);

  std::string endpoint() const override { return endpoint_; }
  pid_t process() const override { return child_->id(); }
  bool alive() const override { return end_.empty(); }
  std::function<void()> begin(wire::GroupRequest request) override;
  void tell(wire::GroupRequest request) override { send(request); }
  void ask(wire::GroupRequest request) override;
  void peer_lost(const wire::PeerLost& gone) override;
  void require_answer() override;
  void ask_status() override;
  std::optional<wire::GroupStatusReply> status(std::chrono::milliseconds patience) override;
  std::optional<Time> silent_since() const override;
  /// Somebody up the stack reads what it says.
  bool is_waited_for() const { return is_waited_for_; }
  /// Somebody reads the answer to what it was asked last.
  bool is_read_later() const { return is_read_later_; }

  /// Readable when it has said something, and when it has ended.
  int descriptor() const { return wake_.get(); }
  /// [control thread] Passes on the events that have come. False once the process is gone.
  bool serve();
  /// The walls of its sandbox; none: it has the rights of its user.
  const wire::Ready& ready() const { return ready_; }
  const wire::Confinement& confinement() const { return confinement_; }
  const std::filesystem::path& folder() const { return folder_; }
  os::Usage usage() const { return os::usage_of(process()).value_or(os::Usage()); }
  std::uint64_t dropped_output() const { return output_.dropped(); }
  const CpuShare& cpu() const { return cpu_; }
  /// What holds it to its share of the CPU, since it has taken more; empty: nothing has to.
  const std::string& cpu_held_by() const { return cpu_held_by_; }
  /// [control thread] Passes on what it writes. Ends it once it stands still, or one of its instances does not come
  /// back from its work.
  void watch(Time now);
  /// How it ended; empty while it lives.
  const std::string& end() const { return end_; }
  /// [control thread] True once: of its end those are told who use it, and what follows from it is done.
  bool is_told_first() { return !std::exchange(is_told_, true); }
  bool is_lost_first() { return !std::exchange(is_lost_, true); }

 private:
  struct Unstarted {};
  ChildGroup(std::string name, const Start& start, Runtime::OnEvent on_event, Unstarted);
  /// A request whose answer has not come: until it comes nothing more is asked for.
  struct Unanswered {
    std::uint64_t id = 0;
    Time since{};
    std::chrono::milliseconds most{0};       ///< that it may take
    std::chrono::milliseconds looked_at{0};  ///< of the time since, that in which it was
  };
  wire::GroupMessage perform(const wire::GroupRequest& request, std::chrono::milliseconds deadline) override;
  bool ask_if_it_answers(wire::GroupRequest& request);
  bool wait_readable(Time deadline) const;
  bool receive();
  std::optional<wire::GroupMessage> wait_for(std::uint64_t id, Time deadline);
  std::optional<wire::GroupMessage> read_until(std::uint64_t id, Time deadline);
  void take(const wire::GroupMessage& message);
  Error unreachable() const;
  Error not_started() const;
  Error not_of_this_build() const;
  /// `why` we ended it; empty: it ended by itself.
  void note_end(const std::string& why = "");
  bool await_end();
  bool send(wire::GroupRequest& request);
  void pass_on(const wire::GroupMessage& event);

  void end_if_greedy();
  void end_if_crowded(Time now);
  void end_if_silent(std::chrono::milliseconds passed);
  void watch_bus(Time now);
  void hold_cpu();
  void hand_to_supervisor(os::PacketSocket adoption, const std::string& memory_key);

  const std::string endpoint_;
  const std::filesystem::path folder_;
  const wire::Confinement confinement_;
  wire::Ready ready_;
  const Clock& clock_;
  ClockMaster* const master_;
  SupervisorLink* const supervisor_;
  const std::shared_ptr<os::ProcessTemplate> copied_;
  const std::function<void()> meanwhile_;
  bool is_waited_for_ = false;
  bool is_read_later_ = false;
  os::PacketSocket adoption_end_;  ///< where nobody else keeps it: the group takes its closing for the host's end
  std::uint64_t adoption_ = 0;     ///< the request of it; 0: it could not be asked
  std::optional<wire::Adopted> adopted_;
  std::vector<wire::GroupMessage> early_;  ///< what it says before it has told what it holds
  const Runtime::OnEvent on_event_;
  CpuShare cpu_;
  std::string cpu_held_by_;
  std::unique_ptr<BusProxy> bus_;  ///< none: it reaches no service on D-Bus
  std::unique_ptr<os::ChildProcess> child_;
  std::unique_ptr<os::MessageStream> stream_;
  GroupOutput output_;
  std::unique_ptr<os::SharedMemory> liveness_;
  std::unique_ptr<HangWatch> hangs_;  ///< none: nobody watches
  Time watched_{};
  Time counted_{};       ///< when its sockets were, last
  os::Descriptor wake_;  ///< of both: a process that has ended may have left its socket to a child of its own
  std::uint64_t next_id_ = 1;
  std::optional<Unanswered> unanswered_;
  GroupSubjects subjects_;
  Disbelief disbelief_;
  std::string end_;
  bool is_told_ = false;
  bool is_lost_ = false;
};

}  // namespace fiona::host
