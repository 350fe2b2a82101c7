#include "registry.hpp"

#include <fmt/format.h>

#include <nlohmann/json.hpp>
#include <utility>
#include <vector>

namespace fiona::host {
namespace {

using nlohmann::json;

const std::string kHosts = "/fiona/hosts/";

std::string without_scheme(const std::string& address) { return address.substr(address.rfind('/') + 1); }

}  // namespace

std::optional<Registry::Host> Registry::host_in(const EtcdEntry& entry) {
  const json all = json::parse(entry.value, nullptr, false);
  if (!all.is_object()) return std::nullopt;
  const auto text = [&](const char* name) {
    const auto found = all.find(name);
    return found != all.end() && found->is_string() ? found->get<std::string>() : "";
  };
  const auto key = trust::Key::from_text(text("key"));
  const std::string address = text("address");
  if (!key || (!address.empty() && !trust::is_address(address))) return std::nullopt;
  return Host{address, *key, entry.changed};
}

Registry::Registry(const std::string& url, std::string name, const std::string& listens, const trust::Key& key,
                   OnLog on_log)
    : etcd_(url), name_(std::move(name)), listens_(without_scheme(listens)), key_(key), on_log_(std::move(on_log)) {
  problem_ = look();
  if (problem_ && problem_->code() == ErrorCode::NotAllowed) throw Error(*problem_);
  tell(problem_);
  thread_ = std::thread([this] { serve(); });
}

Registry::~Registry() {
  {
    const std::lock_guard lock(mutex_);
    stopping_ = true;
  }
  ends_.notify_all();
  thread_.join();
  if (lease_ == 0 || problem_) return;
  try {
    etcd_.revoke(lease_);
  } catch (const Error&) {
    return;  // it ends by itself
  }
}

void Registry::serve() {
  for (std::unique_lock lock(mutex_); !ends_.wait_for(lock, kLookEvery, [this] { return stopping_; });) {
    lock.unlock();
    auto problem = look();
    tell(problem);
    lock.lock();
    problem_ = std::move(problem);
  }
}

/// Each trouble once, and that it is over.
void Registry::tell(const std::optional<Error>& problem) {
  const std::string trouble = problem ? problem->what() : "";
  if (std::exchange(trouble_, trouble) == trouble) return;
  on_log_(trouble.empty() ? "the registry at " + etcd_.url() + " has this host's name again" : trouble);
}

std::optional<Error> Registry::look() {
  try {
    read_and_hold();
    return std::nullopt;
  } catch (const Error& error) {
    return error;
  }
}

void Registry::read_and_hold() {
  if (lease_ != 0 && !etcd_.keep_alive(lease_)) lease_ = 0;
  std::map<std::string, Host> hosts;
  std::int64_t holder = 0;
  for (const EtcdEntry& entry : etcd_.all(kHosts)) {
    const std::string name = entry.key.substr(kHosts.size());
    if (name == name_) holder = entry.lease;
    if (const auto host = host_in(entry)) hosts.emplace(name, *host);
  }
  if (lease_ != 0 && holder != lease_) {
    lease_ = 0;
    replaced_ = holder != 0;
    if (replaced_)
      on_log_(fmt::format("another run of this host has taken the name '{}' in the registry: this one is not found",
                          name_));
  }
  {
    const std::lock_guard lock(mutex_);
    hosts_ = std::move(hosts);
  }
  if (holder == 0) replaced_ = false;
  if (lease_ == 0 && !replaced_) hold();
}

void Registry::hold() {
  const std::int64_t lease = etcd_.grant(kLease);
  const std::string value = json{{"address", told_address()}, {"key", key_.text()}}.dump();
  const auto there = etcd_.put_first(kHosts + name_, value, lease);
  const auto other = there ? host_in(*there) : std::nullopt;
  if (!there || (other && other->key == key_ && etcd_.put_instead(*there, value, lease))) {
    lease_ = lease;
    return;
  }
  etcd_.revoke(lease);
  const std::string found = !other                   ? "something that is no host"
                            : other->address.empty() ? "a host with the key " + other->key.text()
                                                     : other->address + ", with the key " + other->key.text();
  throw Error(ErrorCode::NotAllowed,
              {.what = "the registry has the name '" + name_ + "' for another host",
               .where = etcd_.url(),
               .found = found,
               .next = fmt::format("choose another name, --host NAME; or end that one: its name is free {} s later",
                                   kLease.count())});
}

std::string Registry::told_address() const {
  const std::size_t colon = listens_.rfind(':');
  if (colon == std::string::npos) return "";
  const std::string host = listens_.substr(0, colon);
  if (host != "0.0.0.0" && host != "*" && host != "[::]") return listens_;
  const std::string& own = etcd_.own_address();
  return (own.find(':') == std::string::npos ? own : "[" + own + "]") + listens_.substr(colon);
}

std::map<std::string, Registry::Host> Registry::hosts() const {
  const std::lock_guard lock(mutex_);
  return hosts_;
}

std::string Registry::address_of(const std::string& name, const trust::Key& key) const {
  const std::lock_guard lock(mutex_);
  const auto found = hosts_.find(name);
  if (found != hosts_.end() && found->second.key == key && !found->second.address.empty())
    return "tcp://" + found->second.address;
  if (found == hosts_.end() && problem_ && problem_->code() != ErrorCode::NotAllowed)
    throw Error(problem_->code(), problem_->text());
  if (found == hosts_.end()) {
    std::vector<std::string> known;
    for (const auto& [other, host] : hosts_) known.push_back(other);
    throw Error(ErrorCode::NotFound,
                {.what = "the registry knows no host '" + name + "'",
                 .where = etcd_.url(),
                 .next = "on it: fiona run --host " + name + " --listen ADDRESS:PORT --registry " + etcd_.url(),
                 .near = nearest_names(name, known)});
  }
  if (found->second.key == key)
    throw Error(ErrorCode::NotFound, {.what = "host '" + name + "' listens nowhere: it leads",
                                      .next = "on it: --listen ADDRESS:PORT, without --peer"});
  throw Error(ErrorCode::NotAllowed, {.what = "the registry has host '" + name + "' with another key than --peer has",
                                      .found = found->second.key.text(),
                                      .next = "on it: fiona keys show"});
}

}  // namespace fiona::host
