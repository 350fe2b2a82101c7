#include "system.hpp"

#include <algorithm>
#include <bit>
#include <iostream>

#include "confinement.hpp"
#include "fiona/error.hpp"
#include "link_keys.hpp"

namespace fiona::host {

System::System(Options options, OnEvent on_event)
    : options_(std::move(options)),
      on_event_(std::move(on_event)),
      packages_(options_.store, options_.unsigned_packages),
      connector_({.model = model_,
                  .groups = groups_,
                  .group_of = [this](const std::string& instance, const Model& model) -> Group& {
                    return group_of(instance, model);
                  },
                  .host_of = [this](const std::string& group) { return host_of(group); },
                  .main_of = [this](const std::string& host) -> Group& { return main_of(host); }}),
      led_({.host = options_.name,
            .plugins = options_.plugins,
            .packages = packages_,
            .model = model_,
            .groups = groups_,
            .make = [this](Model next, const std::string& name,
                           const control::Load& request) { make_led(std::move(next), name, request); },
            .destroy = [this](const std::string& name) { return destroy_led(name); }}) {
  if (options_.supervisor) kept_ = options_.supervisor->take_kept();
  memory_key_ = kept_.empty() ? random_bytes(kKeyBytes) : kept_.front().told.memory_key();
  prepare_links();
  use_clock(system_clock());
  // Nothing that a host before this one has numbered is taken for something of ours.
  next_order_ += options_.restarts << 16U;
  number_from(1 + (options_.restarts << 24U));
  if (!options_.hosts.any()) {
    if (options_.hosts.registry.empty()) return;
    throw Error(ErrorCode::Usage, {.what = "a registry is for hosts that work with others",
                                   .next = "add --listen ADDRESS:PORT, or --peer NAME=KEY"});
  }
  if (!options_.hosts.listen.empty()) number_from(LedInstances::kOwnNumbers + (options_.restarts << 24U));
  hosts_ = std::make_unique<HostLinks>(
      options_.hosts, options_.name, *pool_, *clock_, groups_.main().links(),
      [this](wire::GroupMessage event) { deliver_from("", std::move(event)); },
      [](const std::string& text) { std::cerr << text << "\n"; });
}

void System::number_from(std::uint64_t first) {
  connector_.number_from(first);
  next_tap_ = next_work_ = first;
}

/// Those of a host of this name that was killed are of no use, but for those of groups that go on.
void System::prepare_links() const {
  namespace fs = std::filesystem;
  const auto is_kept = [this](const fs::path& left) {
    return std::any_of(kept_.begin(), kept_.end(), [&](const KeptGroup& one) {
      return one.told.folder() == left || one.told.confinement().buses() == left;
    });
  };
  for (const fs::path& directory : {links_directory(), options_.directory / kBusesFolder}) {
    fs::create_directories(directory);
    fs::permissions(directory, fs::perms::owner_all);
    for (const auto& left : fs::directory_iterator(directory)) {
      const bool is_ours = left.path().filename().string().starts_with(options_.name + ".");
      if (is_ours && !is_kept(left.path())) fs::remove_all(left.path());
    }
  }
}

System::~System() { end_threads(); }

/// That by which the groups live that go on; else a new one.
std::unique_ptr<SystemClock> System::system_clock() const {
  if (kept_.empty()) return std::make_unique<SystemClock>();
  const wire::KeptGroup& one = kept_.front().told;
  return std::make_unique<SystemClock>(SystemClock::Origin{one.clock_steady_ns(), one.clock_start_ns()});
}

/// Groups, then the clock's thread, which posts, then the pool's; the clock last: a strand tells it that it is idle
/// after its last job has ended.
void System::end_threads() {
  if (virtual_time_) clock_->stop();  // it asks the groups how far they are
  if (hosts_) hosts_->stop();
  groups_.end_all();
  virtual_time_.reset();
  if (waits_) waits_->stop();
  if (clock_) clock_->stop();
  hosts_.reset();
  main_hangs_.reset();
  pool_.reset();
  waits_.reset();
}

void System::use_clock(std::unique_ptr<Clock> clock) {
  end_threads();
  clock_ = std::move(clock);
  pool_ = std::make_unique<Pool>(options_.threads, std::make_shared<Liveness>());
  const bool is_virtual = dynamic_cast<VirtualClock*>(clock_.get()) != nullptr;
  if (options_.ends_hung_groups && !is_virtual) {
    main_hangs_ = std::make_unique<HangWatch>(pool_->liveness()->page(), parts(std::string(kMainGroup)));
  }
  waits_ = std::make_unique<Waits>(*clock_, *pool_);
  const std::string endpoint = "ipc://" + (links_directory() / (options_.name + ".main.ipc")).string();
  auto main = std::make_unique<MainGroup>(
      *pool_, *clock_, libraries_, endpoint, memory_key_,
      [this](wire::GroupMessage event) { deliver_from(std::string(kMainGroup), std::move(event)); });
  if (auto* simulated = dynamic_cast<VirtualClock*>(clock_.get())) {
    const auto frames = [&main = *main] { return main.frame_counts(); };
    virtual_time_ = std::make_unique<VirtualTime>(*simulated, endpoint, frames, options_.standstill);
  }
  groups_.put(std::move(main));
}

/// Waits first, on the thread where it happened; then whoever else listens.
void System::deliver(const wire::GroupMessage& event) {
  waits_->on_event(event, types_);
  const bool led = tell_leader(event);
  if (event.has_run_ended() && !led) waits_->end_run(event.run_ended().exit_code(), event.run_ended().reason());
  on_event_(event);
}

/// Who is in a sandbox ends what is in it, and no run, unless it may change the system anyway.
void System::deliver_from_child(const std::string& group, wire::GroupMessage event) {
  if (!event.has_run_ended() || may_end_run(group, event.run_ended().instance()))
    return deliver_from(group, std::move(event));
  const std::string& name = event.run_ended().instance();
  if (std::has_single_bit(++refused_ends_))
    std::cerr << "'" << name
              << "' asked for the end of the run, which is not for a component in a sandbox: let fiona run "
              << "--for T end it, or load it with unconfined; refused so far: " << refused_ends_ << "\n";
}

bool System::may_end_run(const std::string& group, const std::string& instance) const {
  const ChildGroup* child = groups_.child(group);
  if (!child || !child->confinement().sandboxed()) return true;
  const Model::Instance* one = creating_.name == instance ? creating_.made : model_.find(instance);
  return one && one->is_master();
}

/// Of a group of this host; none: of another host, which has looked at it.
void System::deliver_from(const std::string& group, wire::GroupMessage event) {
  if (event.has_asked()) event.mutable_asked()->set_group(group);
  if (event.has_mode_changed() && is_beside(group, event.mode_changed().instance()))
    event.mutable_mode_changed()->set_instance(beside_name(event.mode_changed().instance()));
  deliver(event);
}

control::Done System::perform(const control::Change& change, bool restores) {
  if (options_.supervisor) options_.supervisor->beat();
  settle();
  Model next = model_;
  next.make(change, packages_);
  const control::Done done = [&] {
    switch (change.what_case()) {
      case control::Change::kLoad: return load(change.load(), next);
      case control::Change::kUnload: return unload(change.unload());
      case control::Change::kWire: return wire(change.wire(), next, restores);
      case control::Change::kUnwire: return unwire(change.unwire());
      case control::Change::kSet: return set(change.set(), next);
      default:
        throw Error(ErrorCode::Usage,
                    {.what = "the change is not one step", .expected = "load, unload, wire, unwire or set"});
    }
  }();
  model_ = std::move(next);
  return done;
}

}  // namespace fiona::host
