// The components that run under the peers' harness: plugins like any other, but for the switchboard through which the
// harness' loops reach them.
#include <dlfcn.h>
#include <fiona/plugin.hpp>

#include <condition_variable>
#include <cstring>
#include <mutex>

#include "fiona/peer/peer.fiona.hpp"
#include "switchboard.hpp"

namespace fiona::peer {
namespace {

Switchboard& switchboard() {
  const auto find = reinterpret_cast<SwitchboardFunction>(::dlsym(RTLD_DEFAULT, kSwitchboardSymbol));
  if (!find) throw Error(ErrorCode::Usage, "these components live in the peers' harness only: ./dev peers");
  return *find();
}

}  // namespace

/// The harness' loop decides when it puts, so the strand is lent to the harness' thread: nothing else runs on it.
class Provider final : public Component, private Publisher {
 public:
  using Component::Component;
  void on_mode(std::string_view mode) override {
    if (mode == kModeActive) lend_.at(now());
  }

 private:
  void lend() { switchboard().lend(name(), *this); }
  void prepare(std::string_view data) override {
    next_ = blobs_.make();
    next_->mutable_data()->assign(data);
    window_ = window_of(data.size());
  }
  void send(std::string_view header) override {
    if (++number_ > room_) room_ = switchboard().gate().room_for(number_, window_);
    next_->set_number(number_);
    std::memcpy(next_->mutable_data()->data(), header.data(), header.size());
    blobs_.put(std::move(next_));
  }

  std::shared_ptr<Blob> next_;
  std::uint64_t number_ = 0;
  std::uint64_t room_ = 0;
  std::uint64_t window_ = 0;
  Provides<Blobs> blobs_{*this, "blobs"};
  Timer lend_{*this, &Provider::lend};
};

class Consumer final : public Component {
 public:
  using Component::Component;
  void on_start() override {
    ear_ = &switchboard().ear(name());
    switchboard().start(name());
  }

 private:
  void on_blob(const Blob& blob) {
    ear_->hear(blob.data());
    if (told_ != 0 && blob.number() < told_ + window_of(blob.data().size()) / 4) return;
    told_ = blob.number();
    Seen seen;
    seen.set_consumer(params_->index());
    seen.set_number(told_);
    static_cast<void>(progress_.send(std::move(seen)));
  }

  Ear* ear_ = nullptr;
  std::uint64_t told_ = 0;
  Params<ConsumerParams> params_{*this};
  Requires<Blobs> blobs_{*this, "blobs", &Consumer::on_blob, {.optional = true}};
  Requires<Progress> progress_{*this, "progress", {.optional = true}};
};

/// Beside the provider, whose strand is not free to hear how far the consumers are.
class Keeper final : public Component {
 public:
  using Component::Component;

 private:
  void on_seen(const Seen& seen) { switchboard().gate().seen(seen.consumer(), seen.number()); }
  Provides<Progress> progress_{*this, "progress", &Keeper::on_seen};
};

class Answerer final : public Component {
 public:
  using Component::Component;
  void on_start() override { switchboard().start(name()); }

 private:
  Blob on_question(const Blob& question) { return question; }
  Provides<Echo> echo_{*this, "echo", &Answerer::on_question};
};

class Questioner final : public Component, private Asker {
 public:
  using Component::Component;
  void on_start() override { switchboard().start(name(), this); }

 private:
  /// On the harness' thread.
  void call(std::string_view question) override {
    std::unique_lock lock(mutex_);
    answered_ = false;
    hull().strand().post([this, question] { hull().spawn(ask(question), [] {}); });
    if (!changed_.wait_for(lock, kRunEnds, [this] { return answered_; })) throw std::runtime_error("no answer");
  }
  Async<> ask(std::string_view data) {
    Blob question;
    question.mutable_data()->assign(data);
    const auto answer = co_await echo_.query(std::move(question));
    if (!answer || (*answer)->data().size() != data.size()) throw std::runtime_error("a question was not answered");
    const std::lock_guard lock(mutex_);
    answered_ = true;
    changed_.notify_one();
  }

  std::mutex mutex_;
  std::condition_variable changed_;
  bool answered_ = false;
  Requires<Echo> echo_{*this, "echo"};
};

}  // namespace fiona::peer

FIONA_PLUGIN(plugin) {
  plugin.add<fiona::peer::Provider>("provider", "publishes for the harness");
  plugin.add<fiona::peer::Consumer>("consumer", "hands what comes to the harness");
  plugin.add<fiona::peer::Keeper>("keeper", "knows how far the consumers are");
  plugin.add<fiona::peer::Answerer>("answerer", "answers with what was asked");
  plugin.add<fiona::peer::Questioner>("questioner", "asks for the harness");
}
