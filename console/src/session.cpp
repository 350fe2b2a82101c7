#include "session.hpp"

#include <utility>

#include <fmt/format.h>

#include "catalogue.hpp"
#include "locations.hpp"
#include "verb_table.hpp"
#include "watch_list.hpp"

namespace fiona::console {
namespace {

/// The options of one line, for as long as the line runs.
class LineOptions {
 public:
  LineOptions(Session& session, const Line& line)
      : session_(session), manner_(session.out.manner), options_(session.options) {
    Manner& manner = session.out.manner;
    manner.json = manner.json || line.has("--json");
    manner.quiet = manner.quiet || line.has("-q");
    manner.verbose = manner.verbose || line.has("-v");
    if (const Word* store = line.option("--store")) session.options.store = store->text;
    if (const Word* timeout = line.option("--timeout")) {
      session.options.timeout = std::chrono::milliseconds(static_cast<std::int64_t>(duration_ms(*timeout, line.words)));
    }
    take_endpoint(line);
  }
  LineOptions(const LineOptions&) = delete;
  LineOptions& operator=(const LineOptions&) = delete;
  ~LineOptions() {
    session_.out.manner = manner_;
    session_.options = options_;
  }

 private:
  void take_endpoint(const Line& line) {
    for (const char* name : {"--at", "--host", "--control"}) {
      const auto found = line.options.find(name);
      if (found == line.options.end()) continue;
      const auto& [key, word] = found->second;
      const std::string given = key.text.empty() ? word.text : key.text + "=" + word.text;  // ADDRESS:PORT=KEY
      if (session_.setting != Setting::Shell)
        throw line.error(given.empty() ? line.verb : word,
                         {.what = fmt::format("{} {} when `fiona` starts, not in the middle", name,
                                              given.empty() ? "is said" : "chooses the host"),
                          .next = fmt::format("from a shell: fiona {}{}{} …", name, given.empty() ? "" : " ", given)});
      if (std::string_view(name) == "--at") session_.options.at = given;
      if (std::string_view(name) == "--host") session_.options.host = given;
      if (std::string_view(name) == "--control") session_.options.control = true;
    }
  }

  Session& session_;
  const Manner manner_;
  const Options options_;
};

/// The word that an error is about: the one that it names as its place, quotes, or has as a port.
const Word* blamed(const Line& line, const ErrorText& text) {
  const auto names = [&text, &line](const std::string& word) {
    const auto quoted = [&text](const std::string& name) {
      return text.what.find("'" + name + "'") != std::string::npos;
    };
    const bool is_port = word.find('.') != std::string::npos;
    return word.size() > 1 && (text.where == word || text.where.ends_with("." + word) || quoted(word) ||
                               quoted(loadable(line.words, word)) || quoted(word.substr(0, word.find('.'))) ||
                               (is_port && text.what.find(word) != std::string::npos));
  };
  for (std::size_t i = 1; i < line.words.items.size(); ++i) {
    const WordLine::Item& item = line.words.items[i];
    if (item.name && names(item.name->text)) return &*item.name;
    if (names(item.word.text)) return &item.word;
  }
  return nullptr;
}

/// The error as one of this line, with a caret under the word that it is about; in a file at least with the line.
[[noreturn]] void rethrow_at(const Line& line, const Error& error) {
  const Word* word = blamed(line, error.text());
  if (word == nullptr && line.words.origin.empty()) throw Error(error);
  throw LineError(line.words, word == nullptr ? line.verb.place : word->place, error.text(), error.code());
}

}  // namespace

Session::Session(Reactor& reactor_in, Output& output, Options options_in)
    : reactor(reactor_in), out(output), options(std::move(options_in)), watches_(std::make_unique<WatchList>(*this)) {}

Session::~Session() = default;

Endpoint Session::endpoint() const { return endpoint_ ? *endpoint_ : chosen_endpoint(options.at, options.host); }

ControlClient& Session::host() {
  if (endpoint_ && !connected() && !endpoint_->remote && !answers(endpoint_->socket)) {
    const std::string name = endpoint_->socket.stem().string();
    throw Error(ErrorCode::Unreachable,
                ErrorText{.what = fmt::format("host {} has gone", name),
                          .where = endpoint_->text(),
                          .next = fmt::format(
                              "start it again: fiona run FILE --host {}; another one: fiona --host NAME", name)});
  }
  if (!connected()) connect(endpoint());
  client_->set_timeout(options.timeout);  // of this line
  return *client_;
}

ControlClient* Session::host_if_running() {
  if (connected()) return client_.get();
  if (!endpoint_ && options.at.empty() && options.host.empty() && running_hosts().empty()) return nullptr;
  if (endpoint_ && !endpoint_->remote && !answers(endpoint_->socket)) return nullptr;
  return &host();
}

Catalogue Session::catalogue() { return Catalogue(options.store, unsigned_packages()); }

std::filesystem::path Session::unsigned_packages() {
  try {
    const auto socket = endpoint().socket;
    std::error_code failure;
    const auto store = unsigned_packages_of(socket);
    if (!socket.empty() && std::filesystem::exists(store, failure)) return store;
  } catch (const Error&) {
    // No host, or several.
  }
  return {};
}

void Session::connect(const Endpoint& endpoint) {
  client_ = std::make_unique<ControlClient>(reactor, endpoint, options.timeout, options.control);
  endpoint_ = endpoint;
  watches_->resume();
}

void Session::lose_host() { client_.reset(); }

void Session::disconnect() {
  watches_->clear();
  client_.reset();
}

control::System Session::snapshot() {
  control::Request request;
  request.mutable_snapshot();
  return std::move(*call(std::move(request)).mutable_system());
}

void Session::run(const WordLine& words) { run(read_line(words)); }

void Session::run(const Line& line) {
  const LineOptions scoped(*this, line);
  const Verb& verb = *find_verb(line.verb.text);
  if (batch && !verb.in_transaction)
    throw line.error(
        line.verb, {.what = fmt::format("'{}' cannot stand in a transaction", verb.name), .next = "commit, or abort"});
  try {
    verb.handler(*this, line);
  } catch (const LineError&) {
    reactor.take_signal();
    throw;
  } catch (const Error& error) {
    reactor.take_signal();  // what it has cut short is no failure
    rethrow_at(line, error);
  } catch (const std::filesystem::filesystem_error& problem) {  // of a path that cannot even be looked at
    throw line.error(line.verb,
                     {.what = problem.code().message(), .found = problem.path1().string(), .next = "give another path"},
                     ErrorCode::Failed);
  }
}

}  // namespace fiona::console
