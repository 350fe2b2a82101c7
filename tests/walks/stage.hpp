#pragma once

#include <functional>
#include <map>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "fiona/component.hpp"
#include "fiona/hull.hpp"
#include "fiona/local_wire.hpp"
#include "fiona/testing/inline_executor.hpp"

namespace fiona::walks {

/// Several components, wired as a host would wire them, on one thread and one virtual clock.
class Stage final : private HullEvents {
 public:
  ~Stage() override {
    for (const auto& cut : cuts_) cut();
    for (auto& [name, hull] : hulls_) hull->shut_down(kDefaultDeadline);
  }

  template <class C>
  C& add(const std::string& name) {
    auto& hull = hulls_[name];
    hull = std::make_unique<Hull>(name, Hull::Surroundings{executor_, clock_, *this, {}});
    C* component = nullptr;
    hull->create([&component](Hull& of) {
      auto made = std::make_unique<C>(of);
      component = made.get();
      return made;
    });
    return *component;
  }

  void set(const std::string& name, const std::string& parameter, const control::Value& value) {
    control::Argument argument;
    argument.set_name(parameter);
    *argument.mutable_value() = value;
    hulls_.at(name)->set_parameters({&argument, 1}, kDefaultDeadline);
  }
  void set(const std::string& name, const std::string& parameter, const std::string& text) {
    control::Value value;
    value.set_text(text);
    set(name, parameter, value);
  }
  void set(const std::string& name, const std::string& parameter, bool flag) {
    control::Value value;
    value.set_flag(flag);
    set(name, parameter, value);
  }
  void set(const std::string& name, const std::string& parameter, int number) {
    control::Value value;
    value.set_integer(number);
    set(name, parameter, value);
  }

  /// "nav.location" to "phone.truth".
  void wire(const std::string& client, const std::string& provider) {
    auto& required = dynamic_cast<RequiredPort&>(port(client));
    auto& provided = dynamic_cast<ProvidedPort&>(port(provider));
    const auto end = required.end_for(provider);
    const std::string name = client + "<" + provider;
    if (auto* push = dynamic_cast<detail::PushProvider*>(&provided)) {
      end->set_connection(Connection::Connected, provider);
      const auto local = std::make_shared<LocalWire>(name, end, 1);
      push->attach(local);
      cuts_.push_back([push, local] { push->detach(*local); });
    } else {
      end->set_target(std::make_shared<LocalWire>(name, *provided.inbox()));
      end->set_connection(Connection::Connected, provider);
    }
    cuts_.push_back([end] {
      end->set_target(nullptr);
      end->set_connection(Connection::Unwired, "");
    });
  }

  void start() {
    for (auto& [name, hull] : hulls_) hull->set_mode(kModeActive, kDefaultDeadline);
  }
  void advance(Duration duration) {
    clock_.stop_at(clock_.now() + duration, [this] { clock_.hold(); });
    clock_.release();
    executor_.help();
  }
  TimePoint now() const { return clock_.now(); }
  /// What the components have said, and why one has failed.
  const std::vector<std::string>& log() const { return log_; }

 private:
  Port& port(const std::string& name) {
    const auto dot = name.find('.');
    Port* found = hulls_.at(name.substr(0, dot))->find_port(name.substr(dot + 1));
    if (!found) throw Error(ErrorCode::NotFound, "there is no port " + name);
    return *found;
  }

  void mode_changed(const std::string& name, const std::string& mode, const std::string& reason) override {
    if (!reason.empty()) log_.push_back(name + " is " + mode + ": " + reason);
  }
  void run_ended(const std::string&, int, const std::string&) override {}
  void logged(const std::string& name, LogLevel level, std::string_view text) override {
    if (level >= LogLevel::Warning) log_.push_back(name + ": " + std::string(text));
  }
  void asked(const std::string&, std::uint64_t, const control::Request&) override {}

  testing::InlineExecutor executor_;
  VirtualClock clock_;
  std::vector<std::string> log_;
  std::map<std::string, std::unique_ptr<Hull>> hulls_;
  std::vector<std::function<void()>> cuts_;  ///< end the wires, as long as both of their ends are there
};

}  // namespace fiona::walks
