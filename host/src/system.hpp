#pragma once

#include <chrono>
#include <filesystem>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "attachments.hpp"
#include "comparison.hpp"
#include "connector.hpp"
#include "fiona/control.pb.h"
#include "fiona/pool.hpp"
#include "groups.hpp"
#include "host_links.hpp"
#include "last_words.hpp"
#include "led_instances.hpp"
#include "mailbox.hpp"
#include "model.hpp"
#include "open_taps.hpp"
#include "package.hpp"
#include "supervision.hpp"
#include "trial.hpp"
#include "types.hpp"
#include "upgrade.hpp"
#include "virtual_time.hpp"
#include "waits.hpp"

namespace fiona::host {

/// A running system: instances in groups, and the wires between them. One model, changed by one thread. What needs
/// little of the rest is a class of its own: Groups, Connector, Attachments, OpenTaps, LedInstances. Each other subject
/// has a source of its own: the headings of the private parts name them.
class System {
 public:
  struct Options {
    std::string name{};
    std::filesystem::path store{};
    std::filesystem::path unsigned_packages{};  ///< a store of what nobody signs for; empty: none
    std::filesystem::path directory{};          ///< for the sockets of links
    std::size_t threads = 0;
    /// Of the machine's time: how long virtual time may stand for the same reason before whoever waits is told.
    std::chrono::milliseconds standstill{5000};
    /// How long all groups together may take to tell their status, before one is shown as silent.
    std::chrono::milliseconds patience{300};
    HostOptions hosts{};              ///< over tcp; by default none
    std::filesystem::path plugins{};  ///< libraries that a leading host may have loaded though they are in no package
    bool ends_hung_groups = true;     ///< those that stand still; and instances of `main` that do have failed
    bool restarts_groups = true;      ///< those whose process has ended
    os::Limits group_limits{};        ///< of each group, other than `main`
    bool tries_libraries = true;      ///< in a process that is thrown away, before `main` opens them
    /// That groups are copies of, as long as it lives; else the first one starts it, and the last one ends it.
    std::weak_ptr<os::ProcessTemplate> group_template{};
    SupervisorLink* supervisor = nullptr;  ///< none: nobody starts this host again
    std::uint64_t restarts = 0;            ///< how often it has done so
    std::string restart_reason{};          ///< how the last one has ended
    bool taken_back = false;               ///< it was of a build that has not come up, or not gone on
    std::vector<LastWords> last_words{};   ///< of hosts before whose system is resumed
  };
  /// [any thread] What happened in a group; watched values included.
  using OnEvent = std::function<void(const wire::GroupMessage&)>;

  System(Options options, OnEvent on_event);
  ~System();

  const Model& model() const { return model_; }
  const Packages& packages() const { return packages_; }

  /// Of a system that is empty: from now on it is what these changes lead to. Groups of the host before that are as
  /// they are meant to be go on, with the wires between them; all else is made again. What refuses to be made is lost,
  /// and what cannot even be asked for any more, as its package has gone, is left out: both with the reason. An
  /// instance of `main` that has ended a host before is in a group of its own. What there is to tell people, line by
  /// line.
  std::vector<std::string> resume(std::vector<control::Change> changes);
  /// Makes one change, other than of a mode, or throws Error and has changed nothing; the note is for people. One that
  /// `restores` what was so before wires to who has failed, too: that wire waits.
  control::Done perform(const control::Change& change, bool restores = false);
  /// Whether a load may be made so that nobody waits for the component meanwhile.
  bool loads_later(const control::Load& request) const;
  /// Makes an instance. Answered with Done once it is in its mode, or with why it does not get there: then `unload`
  /// takes it away. Throws Error, and has changed nothing, if it cannot be made.
  void begin_load(const control::Load& request, Waits::Answer answer);
  /// It is in its mode: the wires that have waited for it are opened.
  control::Done end_load(const control::Load& request);
  /// Answered when the change of mode has been made, or why not; throws Error if it cannot be.
  void state(std::uint64_t owner, std::uint64_t id, const control::State& request, Waits::Answer answer);
  /// A change of mode has been made: from now on it is what the system is meant to be.
  void note_state(const control::State& request);
  /// Uses a query or send port, or a trigger; answered with how it ended.
  void call(std::uint64_t owner, std::uint64_t id, const control::Call& request, Waits::Answer answer);

  /// An upgrade, with all that is left to the host. Throws Error if it cannot be.
  control::Upgrade completed(control::Upgrade request) const;
  /// In this order, each once the one before has been answered with Done: another version of an instance is made beside
  /// it; it must say what the other one says; it takes its wires over. Until then `drop_candidate` takes it away.
  void begin_upgrade(const control::Upgrade& request, Waits::Answer answer);
  void check_upgrade(Waits::Answer answer);
  control::Done take_over(bool keeps);
  void drop_candidate();
  /// Whether there is one that takes its place again.
  bool stands_by(const std::string& name) const;
  void watch_upgrade(const std::string& name, double left_ms, Waits::Answer answer);
  void end_watch(const std::string& name);
  void dispose_standby(const std::string& name);
  /// What an upgrade that went wrong has left lost is started again, or left.
  void leave_to_supervision(const std::string& name);

  /// What both say of the ports that the swaps would move is compared for so long on the system's clock. Answered with
  /// Done, its agreements in it, or with why none of them should be made: what would take over says nothing valid. What
  /// is returned is its number, and what is to be untapped then.
  std::pair<std::uint64_t, std::vector<std::uint64_t>> compare(const std::vector<control::Replace>& swaps,
                                                               double within_ms, Waits::Answer answer);
  /// The comparison of that number is answered with this.
  void end_comparison(std::uint64_t number, const control::Reply& reply) { waits_->end(kNobody, number, reply); }

  /// [control thread] Answers what a component has asked for; nobody is told if it has gone meanwhile.
  void answer(const wire::Asked& asked, const control::Reply& reply);
  /// Whether it was the instance of this name that asked, as far as its own host can tell; an instance that another
  /// host leads asks that one.
  bool has_asked(const wire::Asked& asked) const;
  /// Tells the life of an instance from that of others of its name, before it or after it; empty: there is none.
  std::string life_of(const std::string& instance) const;

  control::System snapshot();
  const Types& types() const { return types_; }
  Waits& waits() { return *waits_; }

  /// Starts to deliver what a push port or a probe says, as Tapped events with this number of `new_tap`, until `untap`
  /// or TapEnded; a required port stands for its provider's.
  void tap(std::uint64_t tap, const control::Watch& request, bool is_own = false);
  std::uint64_t new_tap() { return next_tap_++; }
  void untap(std::uint64_t tap) { taps_.close(tap); }
  /// The value of now of a probe; its type is empty while it has none.
  wire::Tapped read(const control::PortName& probe);
  /// What INSTANCE.NAME.FIELD names, which may be a probe of the hull: `nav.location.rate`.
  control::Expect expected(control::Expect request);
  /// False while it is being loaded: what becomes of it then is told to whoever loads it.
  bool is_loaded(const std::string& name) const {
    return model_.find(name) && (!is_being_made(name) || lost_.contains(name));
  }
  /// Whether the instance is in this mode already, and the mode it is in.
  std::pair<bool, std::string> has_mode(const std::string& instance, const std::string& mode);

  /// Gives a process outside the client's end of a wire, for as long as `owner` holds it. When it ends before, there is
  /// a WireLost event.
  control::Attached attach(std::uint64_t owner, const control::Attach& request);
  void detach(std::uint64_t owner, std::uint64_t wire) { attachments_.detach(owner, wire); }
  void detach_all(std::uint64_t owner) { attachments_.detach_all(owner); }

  Clock& clock() { return *clock_; }
  /// While virtual time is held: waits until all processes have done what they were told, so that the next line finds
  /// the same state each time. Bounded by `standstill`.
  void settle();
  /// Call it at least once a second while the clock is virtual: ends all waits with an error that names what runs when
  /// virtual time has stood too long.
  void watch_time();
  bool has_virtual_clock() const { return virtual_time_ != nullptr; }
  /// The groups that are child processes: poll their descriptors, call `serve_group` when readable.
  std::vector<ChildGroup*> child_groups();
  /// While there are groups, or are to be, or other hosts that this one leads.
  bool watches_groups() {
    return watches_main() || !child_groups().empty() || supervision_.any_waits() ||
           (hosts_ && !hosts_->peers().empty());
  }
  /// Whether a group is to be started again, later.
  bool awaits_restart() const { return supervision_.any_waits(); }
  /// Call it every `kWatchEvery` while it watches groups: ends those that hang, starts again those that have ended.
  /// What there is to tell people, line by line.
  std::vector<std::string> watch_groups();
  /// The instances of `main` have their end, and nothing else of the system: another host goes on with it.
  void end_main();
  /// All instances of this host's processes have their end, as far as they come to it within `kEndsItself`. What they
  /// say has come by then.
  void end_instances();
  SupervisorLink* supervisor() const { return options_.supervisor; }
  /// Of plugins, in `main`.
  std::size_t open_libraries() const { return libraries_.size(); }
  /// Threads of `main` that its instances have kept, and that have been replaced. The host ends with one more than
  /// `kMostKeptThreads`.
  std::size_t kept_threads() const { return kept_threads_; }
  static constexpr std::size_t kMostKeptThreads = 4;
  void serve_group(ChildGroup& group);  ///< passes on what it has said; notes its end
  void serve_group(const std::string& name);
  /// A wire has been lost on its client's side.
  void on_wire_lost(std::uint64_t wire, const std::string& reason);

  /// Readable when something has happened between hosts, then call `serve_hosts`; -1 without tcp.
  int hosts_descriptor() const { return hosts_ ? hosts_->descriptor() : -1; }
  /// What there is to tell people, line by line.
  std::vector<std::string> serve_hosts();
  /// Each host that this one leads is there, or has been tried in vain.
  bool has_met_peers() const;
  /// Where it listens for a host that leads; empty: nowhere.
  std::string listens() const { return hosts_ && hosts_->leader() ? hosts_->leader()->address() : ""; }

 private:
  using Wire = Connector::Wire;
  /// Of an instance; `order` tells it from one that has its name later.
  struct HangOfMain {
    Hang hang;
    std::optional<std::uint64_t> order;
  };
  /// What is being made just now, and part of the model once it is.
  struct Creating {
    std::string name;
    const Model::Instance* made = nullptr;
  };
  /// An instance on its way to its first mode.
  struct Making {
    std::uint64_t change = 0;
    std::shared_ptr<const Package> package{};
  };
  struct Lost {
    std::string reason;
    bool away = false;  ///< its host is silent: it may come back
    std::chrono::steady_clock::time_point since = std::chrono::steady_clock::now();
  };

  /// A version of an instance beside the one that serves: about to take its place, ready to take it again, or on its
  /// way out. Both have the name; its process is another one.
  struct Beside {
    std::string name{};
    Model::Instance made{};
    std::multimap<PortKey, Wire> wires{};  ///< of what it requires
    std::vector<std::uint64_t> taps{};     ///< of those that check it, or the one that serves
    bool is_back = false;                  ///< it has served before, and has nothing to prove
    std::optional<std::chrono::steady_clock::time_point> rests_at{};  ///< what it was asked is answered by then
  };
  /// How often a wire is tried again whose processes could be asked.
  static constexpr std::chrono::seconds kOpensWaiting{1};
  static constexpr std::uint64_t kNobody = 0;  ///< the owner of waits that no client has

  // ---- system.cpp
  /// Where the host's processes listen for each other: apart from the control socket, so that a sandbox holds no more.
  std::filesystem::path links_directory() const { return options_.directory / "links"; }
  void number_from(std::uint64_t first);  ///< of wires, taps and work
  void prepare_links() const;
  std::unique_ptr<SystemClock> system_clock() const;
  std::shared_ptr<os::ProcessTemplate> template_for(const wire::Confinement& confinement);
  ChildGroup::Start start_of_group(const std::string& name, const Model::Instance* first,
                                   const std::filesystem::path& folder);
  void use_clock(std::unique_ptr<Clock> clock);
  void end_threads();
  void deliver(const wire::GroupMessage& event);
  void deliver_from(const std::string& group, wire::GroupMessage event);
  void deliver_from_child(const std::string& group, wire::GroupMessage event);
  bool may_end_run(const std::string& group, const std::string& instance) const;

  // ---- system_groups.cpp
  Group& group(const std::string& name, const Model::Instance* first = nullptr);
  /// Of an instance that is to be made. Throws Error NotAllowed if it may not be there.
  Group& group_for(const Model::Instance& made);
  const Model::Instance* first_in(const std::string& group) const;
  wire::Confinement confinement_of_group(const Model::Instance* first, const std::filesystem::path& folder) const;
  /// Of an instance that lives; throws Error Unreachable otherwise.
  Group& group_of(const std::string& instance, const Model& model);
  void retire_if_empty(const Group& target);
  void leave_group(const std::string& name);
  const Model::Instance* made_in(const std::string& group, const std::string& name) const;
  HangWatch::Parts parts(const std::string& group) const;
  bool watches_main() const { return main_hangs_ && pool_->liveness()->page().used > 0; }
  void give_up(const HangOfMain& found);
  void look_at_main(std::chrono::steady_clock::time_point now);
  std::optional<std::uint64_t> order_of(const std::string& instance) const;
  void watch_others();
  void tell_ended(ChildGroup& gone);
  void lose_if_gone(const std::string& group);
  void lose(ChildGroup& gone);
  void tell_group_ended(const std::string& group, const std::string& reason);
  void tell_failed(const std::string& instance, const std::string& reason);

  // ---- system_supervision.cpp
  std::vector<wire::GroupRequest> ends_of(const std::string& group) const;
  void start_again_later(const std::string& group, const std::string& reason);
  std::map<std::uint64_t, std::string> lost_in(const std::string& group) const;
  std::string start_again(const std::string& group);
  void make_again(Group& target, const std::string& name);
  void made_again(const std::string& group, const std::string& name, const control::Reply& reply);
  void is_back(const std::string& name);
  bool is_reached(const std::string& name) const;
  void open_waiting(std::chrono::steady_clock::time_point now);
  void open_again(const std::string& instance, const control::PortName& client, const Model::Wire& wanted);

  // ---- system_resume.cpp
  std::vector<std::string> adopt_groups();
  std::string difference_from(const ChildGroup& group) const;
  void note_wires();
  std::vector<std::string> end_surplus();
  void make_missing();
  std::vector<std::string> finish_making();
  void correct_ports();
  void correct_ports(const std::string& group, const wire::GroupStatusReply& there);
  void open_missing();

  // ---- system_instances.cpp
  control::Done load(const control::Load& request, const Model& next);
  /// `within_ms`: a second more than its life-cycle calls have.
  void bring_up(Group& target, const std::string& name, const Model::Instance& made, const control::Load& request,
                Waits::Answer answer, double within_ms = 11'000);
  void create(Group& target, const std::string& name, const Model::Instance& made, const control::Load& request,
              std::uint64_t change = 0);
  control::Done told_of_load(const std::string& name, const Model& next);
  std::string name_of(const control::Load& request) const;
  /// It is no more on its way.
  void made_known(const std::string& group, const std::string& name) { making_.erase({group, name}); }
  bool is_being_made(const std::string& name) const;
  void lose_what_is_made(const std::string& group, const std::string& end);
  void discard(const std::string& group, const std::string& name);
  control::Done unload(const control::Unload& request);
  std::string destroyed(Group& target, wire::GroupRequest destroy);
  control::Done set(const control::Set& request, const Model& next);

  // ---- system_upgrade.cpp
  std::string fresh_group(const std::string& instance) const;
  Model upgraded(const Beside& version) const;
  void wake(const std::string& name, Waits::Answer answer);
  void listen_to(const std::shared_ptr<Deliveries>& check, double within_ms, const std::function<void()>& begin,
                 Waits::EndOf end_of, Waits::Answer answer);
  Group& candidate_group();
  void wire_candidate(const Model& next, bool sends_too);
  Wire open_for_candidate(const control::PortName& client, const control::PortName& provider, const Model& next,
                          std::uint64_t replaces = 0);
  void switch_clients(const std::string& name, const Model& next, control::Done& done);
  void switch_back(const std::string& name);
  void hand_over(const Model& next, const Model::Instance& old, bool keeps);
  void untap_candidate();
  void dispose_later(Beside version);
  void end_leaving(const std::string& group);
  void cut_beside(Beside& version);
  void look_after_versions(std::chrono::steady_clock::time_point now);
  void destroy_version(Beside& version);
  void end_group(const std::string& name);
  void set_beside(const std::string& group, const std::string& name, bool is_beside);
  bool is_beside(const std::string& group, const std::string& name);

  // ---- system_calls.cpp
  static wire::GroupRequest mode_request(const std::string& name, const std::string& mode, std::uint64_t change,
                                         double within_ms = 0);
  static Waits::EndOf end_of_mode(std::uint64_t change, const std::string& done = "");
  control::PortName callee(const control::PortName& name);
  control::Called called(const wire::CallEnded& ended, TimePoint begun) const;

  // ---- system_wires.cpp
  control::Done wire(const control::Wire& request, const Model& next, bool restores);
  control::Done set_prescale(const control::PortName& client, const Model::Wire& before, const Model::Wire& wanted);
  control::Done wire_one(const control::PortName& client, const Model& next, bool restores);
  control::Done wire_several(const control::PortName& client, const Model& next, bool restores);
  Wire open_or_wait(const control::PortName& client, const control::PortName& provider, const Model& next,
                    const Wire& old, control::Done& done, std::optional<Error>* refusal = nullptr);
  void arrange(const control::PortName& client, const std::vector<control::PortName>& providers, double hold_ms,
               const std::vector<std::uint64_t>& retires, const Model& model, control::Done* cost);
  static wire::GroupRequest prescaled(std::uint64_t wire, std::uint32_t prescale);
  void take_back_wires(const control::PortName& client, const std::vector<Wire>& made);
  void await_provider(const control::PortName& client, const Wire& wire, const Model& model);
  void leave_for_later(const control::PortName& client, Wire& wire, const std::string& reason);
  control::Done unwire(const control::Unwire& request);
  std::string connect_waiting(const std::string& provider, const Model& next);
  std::vector<std::string> leave_wires(const std::string& instance);
  void lose_wires(const std::string& gone, const std::string& reason);
  const Wire* wire_to(const PortKey& client, const control::PortName& provider) const;
  control::PortName served_by(const control::PortName& client);

  // ---- system_status.cpp
  std::map<std::uint64_t, control::InstanceStatus> status_of_groups(control::System& all);
  control::InstanceStatus status_as_asked_for(const std::string& name) const;
  void complete_status(control::InstanceStatus& status) const;
  void complete_port(const PortKey& client, const Model::Wire& wanted, control::PortStatus& status) const;
  const char* transport(const std::string& client, const Wire& wire) const;

  // ---- system_time.cpp
  void set_clock(const ClockSettings& next);

  // ---- system_hosts.cpp
  std::string serve_host(const HostChange& change);
  std::string host_of(const std::string& group) const;
  std::string host_of_instance(const std::string& name) const;
  void add_hosts(control::System& all);
  void make_led(Model next, const std::string& name, const control::Load& request);
  std::string destroy_led(const std::string& name);
  void forget_led(const std::string& group, const std::string& reason);
  bool tell_leader(const wire::GroupMessage& event);

  // ---- system_leading.cpp
  Group& main_of(const std::string& host);
  Group* remote_group(const std::string& name);
  std::string on_host_joined(const HostChange& change);
  void on_host_lost(const std::string& host, const std::string& reason, bool for_good);
  bool crosses(const PortKey& client, const Wire& wire, const std::string& host);
  void resume_wires(const std::string& host);
  void on_remote_group_ended(const HostChange& change);
  void lose_remote(RemoteGroup& group, const std::string& reason);

  // ---- system_rejoin.cpp
  std::vector<std::string> resume_groups(const std::string& host, std::chrono::steady_clock::time_point due);
  std::vector<std::string> resume_late(std::chrono::steady_clock::time_point now);
  std::optional<wire::Adopted> resume(RemoteGroup& group, std::vector<std::string>& lines);
  void make_agree(RemoteGroup& group, const wire::Adopted& held, std::vector<std::string>& lines);
  void correct_parameters(RemoteGroup& group, const control::InstanceStatus& is, std::vector<std::string>& lines);
  void correct_mode(RemoteGroup& group, const control::InstanceStatus& is, std::vector<std::string>& lines);
  void correct_wires(RemoteGroup& group, const wire::Adopted& held, std::vector<std::string>& lines);
  void take_back_wire(RemoteGroup& group, const wire::HeldWire& found, std::vector<std::string>& lines);

  const Options options_;
  const OnEvent on_event_;
  const Packages packages_;
  Types types_;
  Model model_;
  PluginLibraries libraries_;  ///< of `main`; kept when the clock changes
  Trials trials_;
  std::unique_ptr<Clock> clock_;
  std::unique_ptr<VirtualTime> virtual_time_;  ///< none: the clock is the system's
  std::unique_ptr<Pool> pool_;                 ///< ends before the clock that its strands live by
  std::unique_ptr<HangWatch> main_hangs_;      ///< none: nobody watches `main`
  std::size_t kept_threads_ = 0;
  std::unique_ptr<Waits> waits_;
  std::weak_ptr<os::ProcessTemplate> template_{options_.group_template};
  Groups groups_;
  Creating creating_;
  std::map<std::pair<std::string, std::string>, Making> making_;  ///< by group and instance: of two versions each
  std::optional<Beside> candidate_;
  std::map<std::string, Beside> standbys_;  ///< by instance
  std::vector<Beside> leaving_;
  std::map<std::string, std::chrono::steady_clock::time_point> ending_;  ///< groups, once empty; by then at the latest
  std::mutex beside_mutex_;
  std::set<std::pair<std::string, std::string>> beside_;  ///< group, instance; guarded by beside_mutex_
  Mailbox<std::function<void()>> made_;                   ///< what is to be done when one has been made again, or not
  std::map<std::string, Lost> lost_;                      ///< instances whose group is gone, and why
  /// Instances of led hosts that are in another mode than is meant, and since when that is known.
  std::map<std::string, std::chrono::steady_clock::time_point> strayed_;
  std::multiset<std::string> changing_;  ///< instances on their way to another mode, as was asked for
  Supervision supervision_;
  std::vector<KeptGroup> kept_;  ///< until they are adopted
  std::string memory_key_;       ///< by which the processes of this host share memory, but for sandboxes
  Connector connector_;
  std::multimap<PortKey, Wire> wires_;  ///< by the client's port
  Attachments attachments_{groups_, [this](const wire::GroupMessage& event) { deliver(event); }};
  OpenTaps taps_{groups_, [this](const wire::GroupMessage& event) { deliver(event); }};
  std::vector<HangOfMain> found_hangs_;  ///< not dealt with yet
  std::chrono::steady_clock::time_point watched_others_{};
  std::chrono::steady_clock::time_point opened_waiting_{};
  std::uint64_t refused_ends_ = 0;  ///< of the run
  std::uint64_t next_tap_ = 1;
  std::uint64_t next_work_ = 1;
  std::uint64_t next_order_ = 1;
  std::unique_ptr<HostLinks> hosts_;        ///< none: no tcp
  std::set<std::string> waiting_for_host_;  ///< groups that are to be made again once their host has joined
  LedInstances led_;
};

}  // namespace fiona::host
