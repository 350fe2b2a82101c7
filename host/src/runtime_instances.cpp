// The instances of one process: made, told their mode and parameters, ended.
#include <cxxabi.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <cstring>
#include <future>
#include <iostream>
#include <memory>
#include <optional>
#include <stdexcept>
#include <thread>
#include <vector>

#include "failure.hpp"
#include "fiona/describe.hpp"
#include "fiona/error.hpp"
#include "hang_watch.hpp"
#include "runtime.hpp"

namespace fiona::host {
namespace {

/// Of threads that constructors have ended, or do not give back, a process keeps as many; with the next it ends.
constexpr int kMostKept = 4;
std::atomic<int> kept_threads{0};

void keep_thread() {
  if (++kept_threads > kMostKept) std::abort();
}

/// Shared with the thread that it is made on, which may have it for ever.
struct Making {
  std::promise<void> made;
  bool ended = false;  ///< by its constructor: the thread
};

/// A forced unwind cannot be stopped, and who catches it and goes on ends the process: so that thread stays where it
/// is.
void make_here(Hull& hull, const Plugin::Entry& entry, Making& making) {
  try {
    hull.create(entry.make);
  } catch (const abi::__forced_unwind&) {
    std::cerr << "component '" << entry.name << "' has ended the thread that it was made on\n";
    keep_thread();
    making.ended = true;
    making.made.set_exception(std::make_exception_ptr(
        std::runtime_error("it has ended the thread that it was made on (pthread_exit, or a cancellation)")));
    while (true) ::pause();
  } catch (...) {
    const auto error = std::current_exception();  // none: of another language
    return making.made.set_exception(
        error ? error : std::make_exception_ptr(std::runtime_error("threw something that is not a std::exception")));
  }
  making.made.set_value();
}

/// By the rule for all that hangs, where nobody else can look: who does is the thread that waits. Empty: it is made.
std::string stuck(const std::future<void>& result, const std::string& instance) {
  constexpr std::chrono::milliseconds kLook{25};
  const auto liveness = std::make_shared<Liveness>();
  Liveness::Place place(liveness, instance);
  place.begins(Liveness::mark(kItsConstructor));
  HangWatch watch(liveness->page(), [](const std::string&) -> std::optional<HangWatch::Part> { return std::nullopt; });
  while (result.wait_for(kLook) == std::future_status::timeout) {
    const auto hangs = watch.look(std::chrono::steady_clock::now(), ::getpid());
    if (!hangs.empty()) return hangs.front().what();
  }
  return {};
}

/// On a thread of its own, which a constructor may end (pthread_exit) or keep: the one that does all for this process
/// could not be replaced. What a constructor that still runs has in hand is left to it.
void create_on_own_thread(std::unique_ptr<Hull>& hull, const Plugin::Entry& entry, Runtime::Watched watched) {
  const auto making = std::make_shared<Making>();
  std::future<void> result = making->made.get_future();
  std::thread maker([&hull = *hull, entry, making] { make_here(hull, entry, *making); });
  const std::string stuck_in = watched == Runtime::Watched::ByNobody ? stuck(result, hull->name()) : "";
  if (!stuck_in.empty()) {
    maker.detach();
    keep_thread();
    static_cast<void>(hull.release());
    throw std::runtime_error("it was " + stuck_in);
  }
  result.wait();
  making->ended ? maker.detach() : maker.join();
  result.get();
}

void make_component(std::unique_ptr<Hull>& hull, const Plugin::Entry& entry, const std::string& library,
                    Runtime::Watched watched) {
  try {
    create_on_own_thread(hull, entry, watched);
  } catch (const Error&) {
    throw;
  } catch (...) {
    throw Error(ErrorCode::ComponentFailed,
                {.what = "component '" + entry.name + "' cannot be made: " + detail::reason_of_exception(),
                 .where = library,
                 .expected = "a constructor that only declares; on_start() opens files and devices",
                 .next = "tell the publisher"});
  }
}

/// The component that is asked for: what makes it, and what its package says of it.
std::pair<const Plugin::Entry&, const ComponentInterface&> component_of(const Plugin& plugin,
                                                                        const wire::Create& request) {
  const auto entry = std::find_if(plugin.entries().begin(), plugin.entries().end(),
                                  [&](const Plugin::Entry& e) { return e.name == request.component(); });
  const auto& components = request.interface().components();
  const auto packaged = std::find_if(components.begin(), components.end(),
                                     [&](const ComponentInterface& c) { return c.name() == request.component(); });
  if (entry != plugin.entries().end() && packaged != components.end()) return {*entry, *packaged};
  std::vector<std::string> known;
  for (const auto& e : plugin.entries()) known.push_back(e.name);
  throw Error(ErrorCode::NotFound,
              {.what = "plugin '" + request.plugin() + "' has no component '" + request.component() + "'",
               .where = request.library(),
               .near = known});
}

/// Until it has its parameters.
void bring_up(std::unique_ptr<Hull>& hull, const Plugin::Entry& entry, const ComponentInterface& packaged,
              const wire::Create& request, Liveness::Place& thread, Runtime::Watched watched) {
  thread.begins(Liveness::mark(kItsConstructor));
  make_component(hull, entry, request.library(), watched);
  thread.rests();
  const auto difference = interface_difference(interface_of(*hull, entry.name, entry.doc), packaged);
  if (!difference.empty()) {
    throw Error(ErrorCode::Failed,
                {.what = "component '" + request.component() + "' is not what its package says: " + difference,
                 .where = request.library(),
                 .next = "install the package again, or ask the publisher to pack it again"});
  }
  const std::vector<control::Argument> parameters(request.parameters().begin(), request.parameters().end());
  hull->set_parameters(parameters, kDefaultDeadline);
}

}  // namespace

void Runtime::create(const wire::Create& request) {
  Liveness::Place thread(pool_.liveness(), request.instance());  // this one
  thread.begins(Liveness::mark(kItsLibrary));
  const Plugin& plugin = libraries_.open(request.plugin(), request.files(), request.interface());
  const auto [entry, packaged] = component_of(plugin, request);
  auto instance = std::make_unique<Instance>();
  instance->plugin = request.plugin();
  instance->version = request.version();
  instance->component = request.component();
  instance->doc = entry.doc;
  instance->hull =
      std::make_unique<Hull>(request.instance(), Hull::Surroundings{pool_, clock_, events_, request.share()});
  Hull& hull = *instance->hull;
  try {
    bring_up(instance->hull, entry, packaged, request, thread, watched_);
    const std::string mode = request.mode().empty() ? hull.main_modes().front() : request.mode();
    if (request.change() == 0) {
      hull.set_mode(mode, kLifeCycleDeadline);
    } else {
      hull.change_mode(mode, kLifeCycleDeadline, mode_set(request.change()));
    }
  } catch (const Error& error) {
    thread.rests();
    if (instance->hull && hull.shut_down(kLifeCycleDeadline)) leave(std::move(instance->hull));
    throw Error(error.code(), without_instance(error.text(), request.instance()));
  }
  instances_.emplace(request.instance(), std::move(instance));
}

void Runtime::set_parameters(const wire::SetParameters& request) {
  const std::vector<control::Argument> changes(request.parameters().begin(), request.parameters().end());
  find(request.instance()).hull->set_parameters(changes, kDefaultDeadline);
}

Hull::ModeDone Runtime::mode_set(std::uint64_t change) {
  return [this, change](const std::optional<Error>& error) {
    wire::GroupMessage message;
    message.mutable_mode_set()->set_change(change);
    if (error) *message.mutable_mode_set()->mutable_failure() = failure_of(*error);
    emit(std::move(message));
  };
}

void Runtime::set_mode(const wire::SetMode& request) {
  const Duration within = request.within_ms() > 0 ? from_milliseconds(request.within_ms()) : kLifeCycleDeadline;
  find(request.instance()).hull->change_mode(request.mode(), within, mode_set(request.change()));
}

/// What it would do next nobody waits for any more; its thread is the caller's to replace.
void Runtime::give_up(const std::string& name, const std::string& reason) {
  Instance& instance = find(name);
  Hull& hull = *instance.hull;
  instance.hangs = std::make_shared<std::atomic<bool>>(true);
  hull.strand().post([hangs = instance.hangs] { *hangs = false; });
  hull.fail(reason);
  hull.stop_threads();
  let_go(instance, reason);
  for (Port* port : hull.ports()) {
    if (Inbox* inbox = port->inbox()) inbox->clear(Outcome::Disconnected);
  }
}

void Runtime::let_failed_go() {
  if (clock_.staging()) return;
  for (const auto& [name, instance] : instances_) {
    if (instance->hull->has_failed() && !instance->let_go)
      let_go(*instance, "'" + name + "' has failed: " + instance->hull->reason());
  }
}

void Runtime::let_go(Instance& instance, const std::string& reason) {
  instance.let_go = true;
  links_.release(*instance.hull, reason, Connection::Lost);
  end_wires(*instance.hull, Connection::Lost, reason);
}

void Runtime::destroy(const wire::Destroy& request, wire::GroupMessage& reply) {
  Instance& instance = find(request.instance());
  instance.hull->abandon_changes();
  taps_.release(*instance.hull);
  links_.release(*instance.hull, "'" + request.instance() + "' has ended");
  end_wires(*instance.hull, Connection::Unwired, "'" + request.instance() + "' has ended");
  if (const auto runs = instance.hull->shut_down(instance.patience())) {
    reply.mutable_done()->set_note("'" + request.instance() + "' did not come free: " + *runs +
                                   " still runs, and its memory stays until the process ends");
    leave(std::move(instance.hull));
  }
  instances_.erase(request.instance());
}

/// It did not come free, and stays until the process ends. What its strand is stuck in shows as work in its slot, which
/// nobody gets after it.
void Runtime::leave(std::unique_ptr<Hull> hull) {
  static auto& all_that_stay = *new std::vector<std::unique_ptr<Hull>>;  // never destroyed
  const Hull& stays = *all_that_stay.emplace_back(std::move(hull));
  const Liveness::Page& page = pool_.liveness()->page();
  const std::size_t used = std::min<std::size_t>(page.used, Liveness::kSlots);
  for (const auto* slot = page.slots; slot != page.slots + used; ++slot) {
    const bool its = std::strncmp(slot->name, stays.name().c_str(), sizeof slot->name - 1) == 0;
    if (its && slot->work != 0) left_.insert(slot);
  }
}

}  // namespace fiona::host
