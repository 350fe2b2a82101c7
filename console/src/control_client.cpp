#include "control_client.hpp"

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstring>

#include <fcntl.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

#include <fmt/format.h>
#include <fiona/error.hpp>

#include "inert.hpp"

namespace fiona::console {
namespace {

constexpr std::size_t kHeader = 4;
constexpr std::chrono::milliseconds kGivesUpWithin{500};

std::uint32_t length_at(std::string_view bytes) {
  std::uint32_t length = 0;
  for (std::size_t i = 0; i < kHeader; ++i) length |= std::uint32_t{static_cast<unsigned char>(bytes[i])} << (8 * i);
  return length;
}

std::string framed(const control::Request& request) {
  const std::string body = request.SerializeAsString();
  if (body.size() > FrameReader::kLargest) {
    throw Error(ErrorCode::Usage, ErrorText{.what = "the request is too large",
                                            .expected = "at most 16 MiB",
                                            .found = fmt::format("{} bytes", body.size())});
  }
  std::string frame;
  for (std::size_t i = 0; i < kHeader; ++i) frame += static_cast<char>(body.size() >> (8 * i) & 0xffU);
  return frame + body;
}

/// A host's text, inert. Its further lines, as when it quotes another error, are indented more than any line of ours,
/// so that none can be taken for one.
std::string quoted_lines(std::string_view text) {
  text = text.substr(0, text.find_last_not_of("\n ") + 1);
  std::string out;
  while (true) {
    const std::size_t end = text.find('\n');
    out += inert(text.substr(0, end));
    if (end == std::string_view::npos) return out;
    text.remove_prefix(std::min(text.find_first_not_of("\n ", end), text.size()));
    out += "\n    ";
  }
}

ErrorCode code_of(std::uint32_t code) {
  return code >= 1 && code <= 9 ? static_cast<ErrorCode>(code) : ErrorCode::Failed;
}

}  // namespace

bool FrameReader::next(control::Reply& reply) {
  const std::string_view rest = std::string_view(buffer_).substr(at_);
  if (rest.size() < kHeader) return false;
  const std::size_t length = length_at(rest);
  if (length > kLargest) {
    throw Error(ErrorCode::Failed, ErrorText{.what = "the host's answer is too large",
                                             .expected = "at most 16 MiB",
                                             .found = fmt::format("{} bytes", length)});
  }
  if (rest.size() < kHeader + length) return false;
  if (!reply.ParseFromArray(rest.data() + kHeader, static_cast<int>(length))) {
    throw Error(ErrorCode::Failed, ErrorText{.what = "the host's answer cannot be read",
                                             .next = "are `fiona` and `fiona-host` of one version?  fiona version"});
  }
  at_ += kHeader + length;
  if (at_ == buffer_.size() || at_ > kLargest) {
    buffer_.erase(0, at_);
    at_ = 0;
  }
  return true;
}

void throw_failure(const control::Failure& failure) {
  // Inert here, not only at the terminal: a newline in a field must not look like a line of ours.
  ErrorText text{.what = quoted_lines(failure.what()),
                 .where = inert(failure.where()),
                 .expected = quoted_lines(failure.expected()),
                 .found = quoted_lines(failure.found()),
                 .next = quoted_lines(failure.next())};
  for (const std::string& name : failure.near()) text.near.push_back(inert(name));
  throw RefusedChange(code_of(failure.code()), std::move(text), failure.change());
}

ControlClient::ControlClient(Reactor& reactor, Endpoint endpoint, std::chrono::milliseconds timeout, bool control)
    : reactor_(reactor), endpoint_(std::move(endpoint)), timeout_(timeout) {
  connect(control);
}

ControlClient::~ControlClient() {
  on_closed_ = nullptr;
  close();
}

void ControlClient::connect(bool control) {
  if (endpoint_.remote) {
    remote_ = std::make_unique<RemoteLink>(*endpoint_.remote, control);
    remote_->await_welcome(reactor_, timeout_);
    socket_ = remote_->descriptor();
  } else {
    connect_here();
  }
  reactor_.add(socket_, [this] { receive(); });
}

void ControlClient::connect_here() {
  const auto refuse = [this](const std::string& why) {
    throw Error(
        ErrorCode::Unreachable,
        ErrorText{.what = "no host answers: " + why, .where = endpoint_.text(), .next = "start one: fiona run FILE"});
  };
  sockaddr_un address{};
  address.sun_family = AF_UNIX;
  const std::string& path = endpoint_.socket.native();
  if (path.size() >= sizeof address.sun_path) refuse("the socket's path is too long");
  std::memcpy(address.sun_path, path.c_str(), path.size());
  socket_ = ::socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0);
  if (socket_ < 0) refuse(std::strerror(errno));
  const auto deadline = std::chrono::steady_clock::now() + timeout_;
  // A unix socket with a full backlog gives EAGAIN instead of a pending connection.
  while (::connect(socket_, reinterpret_cast<const sockaddr*>(&address), sizeof address) != 0) {
    const int problem = errno;
    const bool again = problem == EAGAIN && std::chrono::steady_clock::now() < deadline;
    if (problem != EINTR && !again) {
      ::close(socket_);
      socket_ = -1;
      refuse(std::strerror(problem));
    }
    if (again)
      reactor_.run_until([] { return false; }, std::chrono::steady_clock::now() + std::chrono::milliseconds(10));
  }
}

void ControlClient::send(const control::Request& request) {
  const std::string frame = framed(request);
  const auto deadline = std::chrono::steady_clock::now() + timeout_;
  std::string_view rest = frame;
  try {
    while (!rest.empty()) {
      const ssize_t sent = closed() ? -1 : ::send(socket_, rest.data(), rest.size(), MSG_NOSIGNAL);
      if (sent > 0) {
        rest.remove_prefix(static_cast<std::size_t>(sent));
      } else if (closed() || (errno != EAGAIN && errno != EINTR) || !reactor_.wait_writable(socket_, deadline)) {
        if (!closed()) receive();  // why it has closed, if it has
        if (refusal_) throw_failure(*refusal_);
        throw Error(ErrorCode::Unreachable,
                    ErrorText{.what = closed() ? farewell() : "the host does not take the request",
                              .where = endpoint_.text(),
                              .next = "it may be busy or gone: fiona ls; else start it again"});
      }
    }
  } catch (...) {
    if (!closed() && rest.size() != frame.size()) close();  // what would follow half a request is no request
    throw;
  }
}

void ControlClient::receive() {
  std::array<char, 65536> chunk;
  const ssize_t count = ::recv(socket_, chunk.data(), chunk.size(), 0);
  if (count < 0 && (errno == EAGAIN || errno == EINTR)) return;
  if (count <= 0) return close();
  frames_.append({chunk.data(), static_cast<std::size_t>(count)});
  control::Reply reply;
  try {
    while (!closed() && frames_.next(reply)) arrived(reply);
  } catch (const Error&) {
    close();  // after bytes that make no sense nothing later does
    throw;
  }
}

void ControlClient::arrived(const control::Reply& reply) {
  if (reply.id() == 0 && reply.has_failure()) refusal_ = reply.failure();
  const auto found = answers_.find(reply.id());
  if (found == answers_.end()) return;  // of a call that was given up, or of a watch that was stopped
  const Answer answer = found->second;
  answer(reply);
}

void ControlClient::close() {
  if (closed()) return;
  reactor_.remove(socket_);
  if (!remote_) ::close(socket_);
  socket_ = -1;
  if (on_closed_) on_closed_();
}

std::string ControlClient::farewell() const {
  const std::string reason = remote_ ? remote_->reason() : "";
  return reason.empty() ? "the host has gone" : "the host has gone: " + reason;
}

std::uint64_t ControlClient::begin(control::Request request, Answer answer) {
  request.set_id(++last_id_);
  request.set_author(author_);
  answers_[last_id_] = std::move(answer);
  try {
    send(request);
  } catch (...) {
    answers_.erase(request.id());
    throw;
  }
  return request.id();
}

void ControlClient::tell(control::Request request) {
  const std::uint64_t id = begin(std::move(request), [](const control::Reply&) {});
  forget(id);
}

control::Reply ControlClient::call(control::Request request) { return call(std::move(request), timeout_); }

control::Reply ControlClient::call(control::Request request, std::chrono::milliseconds timeout) {
  const auto deadline = std::chrono::steady_clock::now() + timeout;
  request.set_deadline_ms(static_cast<std::uint32_t>(timeout.count()));
  control::Reply reply;
  bool here = false;
  const std::uint64_t id = begin(std::move(request), [&reply, &here](const control::Reply& got) {
    reply = got;
    here = true;
  });
  // The host answers at its deadline; a little more lets its own words arrive instead of ours.
  return wait_for(id, reply, here, deadline + std::max(timeout / 10, std::chrono::milliseconds(50)));
}

control::Reply ControlClient::wait_for(std::uint64_t id, const control::Reply& reply, const bool& here,
                                       SteadyTime deadline) {
  bool in_time = false;
  try {
    in_time = reactor_.run_until([this, &here] { return here || closed(); }, deadline);
  } catch (...) {
    forget(id);
    throw;
  }
  forget(id);
  if (!here && refusal_) throw_failure(*refusal_);
  if (!here) {
    throw Error(ErrorCode::Unreachable, ErrorText{.what = in_time ? farewell() : "the host does not answer in time",
                                                  .where = endpoint_.text(),
                                                  .next = in_time ? "fiona ls hosts" : "more time: --timeout 10s"});
  }
  if (reply.has_failure()) throw_failure(reply.failure());
  return reply;
}

/// Throws Interrupted, with the news, where the host cannot let go of it, or has done it meanwhile.
void ControlClient::give_up(std::uint64_t id) {
  control::Request request;
  request.mutable_unwatch()->set_watch(id);
  try {
    if (!closed()) call(std::move(request), kGivesUpWithin);
  } catch (const Error&) {
    throw Interrupted(true);
  }
}

control::Reply ControlClient::call_waiting(control::Request request) {
  constexpr std::chrono::seconds kQuiet{5};
  const bool changes =
      (request.has_transact() && !request.transact().dry_run()) || (request.has_undo() && !request.undo().dry_run());
  control::Reply reply;
  bool here = false;
  const std::uint64_t id = begin(std::move(request), [&reply, &here](const control::Reply& got) {
    reply = got;
    here = true;
  });
  try {
    while (!reactor_.run_until([this, &here] { return here || closed(); }, std::chrono::steady_clock::now() + kQuiet)) {
      control::Request sign_of_life;
      sign_of_life.mutable_snapshot();
      call(std::move(sign_of_life), std::max<std::chrono::milliseconds>(timeout_, kQuiet));
    }
  } catch (const Interrupted&) {
    try {
      give_up(id);
    } catch (...) {
      forget(id);
      throw;
    }
    forget(id);
    if (here && !reply.has_failure()) throw Interrupted(true);
    throw;
  } catch (const Error& error) {
    forget(id);
    if (!changes || closed()) throw;
    throw Error(error.code(), {.what = "the host does not answer; the change may still be made",
                               .where = endpoint_.text(),
                               .next = "see what became of it: journal"});
  } catch (...) {
    forget(id);
    throw;
  }
  wait_for(id, reply, here, std::chrono::steady_clock::now());
  if (reply.has_ended()) throw RunEnded(reply.ended());
  return reply;
}

RunEnded::RunEnded(const control::Ended& end)
    : Error(ErrorCode::Failed, {.what = fmt::format("the run has ended meanwhile{}{} (exit code {})",
                                                    end.reason().empty() ? "" : ": ", end.reason(), end.exit_code()),
                                .next = "quit, and run it again"}),
      end_(end) {}

}  // namespace fiona::console
