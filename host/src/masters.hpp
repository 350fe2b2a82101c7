#pragma once

#include "component_watches.hpp"
#include "engine.hpp"

namespace fiona::host {

/// Answers what components ask for: changes, which are transactions of the engine like any other, the system as it is,
/// and what they watch. Only those that were granted the right `master` get it. All functions [control thread].
class Masters {
 public:
  Masters(System& system, Engine& engine, Engine::Later later)
      : system_(system),
        engine_(engine),
        later_(std::move(later)),
        watches_(system),
        self_(std::make_shared<Masters*>(this)) {}
  ~Masters() { *self_ = nullptr; }
  Masters(const Masters&) = delete;
  Masters& operator=(const Masters&) = delete;

  /// Answered when it has been done, by way of the component's group; if the component is there by then.
  void serve(const wire::Asked& asked);
  /// For what they watch.
  void on_event(const wire::GroupMessage& event) { watches_.on_event(event); }
  /// From time to time, for what was unloaded.
  void end_left() { watches_.end_left(); }

 private:
  void require_right(const std::string& instance) const;
  void perform(const wire::Asked& asked, const Rights& rights);
  void transact(const wire::Asked& asked, const Rights& rights);
  void answer(const wire::Asked& asked, control::Reply reply);

  System& system_;
  Engine& engine_;
  const Engine::Later later_;
  ComponentWatches watches_;
  const std::shared_ptr<Masters*> self_;  ///< null once it is gone
};

}  // namespace fiona::host
