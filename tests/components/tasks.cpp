// Tasks of every kind.
#include <stdexcept>
#include <string>
#include <thread>

#include "components.hpp"

namespace fiona::test {

/// Tells in samples what each of its tasks has done; all of them rest in the mode `rest`.
class Toiler final : public Component {
 public:
  using Component::Component;

 private:
  void on_sample(const Sample& sample) { newest_ = sample.number(); }
  void third() { thirds_.put(numbered(newest_)); }
  void follow() { follows_.put(numbered(++followed_)); }
  void tick() {}
  void look() { looks_.put(numbered((*slot_.latest())->number())); }
  void read(const OwnThread& own) {
    if (own.wait_for(1ms)) own.post([this] { reads_.put(numbered(++read_)); });
    if (const std::string text = params_.snapshot()->fail_with(); !text.empty()) throw std::runtime_error(text);
    while (own.stop_requested() && params_.snapshot()->stubborn()) std::this_thread::sleep_for(1ms);
  }
  static Sample numbered(std::uint64_t number) {
    Sample one;
    one.set_number(number);
    return one;
  }

  std::uint64_t newest_ = 0;
  std::uint64_t followed_ = 0;
  std::uint64_t read_ = 0;
  Modes modes_{*this, {{"toil", {"toil"}}, {"rest", {}}}};
  Params<ToilerParams> params_{*this};
  Requires<SampleNewest> samples_{*this, "samples", &Toiler::on_sample, {.optional = true}};
  Requires<SampleNewest> slot_{*this, "slot", {.optional = true}};
  Provides<SampleNewest> thirds_{*this, "thirds"};
  Provides<SampleNewest> follows_{*this, "follows"};
  Provides<SampleNewest> looks_{*this, "looks"};
  Provides<SampleNewest> reads_{*this, "reads"};
  Task tick_{*this, "tick", 20ms, &Toiler::tick, "toil"};
  Task third_{*this, "third", on(samples_, 3), &Toiler::third, "toil"};
  Task follow_{*this, "follow", after(third_), &Toiler::follow, "toil"};
  Task look_{*this, "look", on(slot_), &Toiler::look, "toil"};
  Task read_task_{*this, "read", free_running, &Toiler::read, "toil"};
};

void add_tasks(Plugin& plugin) { plugin.add<Toiler>("toiler", "has tasks of every kind"); }

}  // namespace fiona::test
