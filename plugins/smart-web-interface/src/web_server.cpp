#include "web_server.hpp"

#include <utility>

#include <pthread.h>

#include <algorithm>
#include <atomic>
#include <boost/asio/io_context.hpp>
#include <boost/asio/ip/tcp.hpp>
#include <boost/asio/post.hpp>
#include <boost/asio/ssl/context.hpp>
#include <boost/asio/steady_timer.hpp>
#include <boost/beast/core.hpp>
#include <boost/beast/ssl.hpp>
#include <set>
#include <sstream>
#include <thread>
#include <type_traits>

#include "beast_request.hpp"
#include "fiona/error.hpp"

namespace fiona::smart_web_interface {

namespace asio = boost::asio;
namespace beast = boost::beast;
namespace http = beast::http;
namespace ssl = asio::ssl;
using boost::asio::ip::tcp;
using Fault = beast::error_code;

namespace {

constexpr std::size_t kFirstRead = 4096;
/// A page takes a server that is silent for three of them for gone.
constexpr auto kBeat = std::chrono::milliseconds(500);
constexpr const char* kAddresses = "see the machine's addresses: ip addr";
constexpr auto kRetryAccept = std::chrono::milliseconds(100);

beast::string_view type_of(std::string_view file) {
  if (file.ends_with(".html")) return "text/html; charset=utf-8";
  if (file.ends_with(".js")) return "text/javascript; charset=utf-8";
  if (file.ends_with(".css")) return "text/css; charset=utf-8";
  if (file.ends_with(".svg")) return "image/svg+xml";
  if (file.ends_with(".crt")) return "application/x-x509-ca-cert";
  return "application/octet-stream";
}

/// Of all answers: nothing from elsewhere is run, shown or asked, nobody frames or embeds the page, no address leaves
/// it.
void protect(http::fields& fields) {
  fields.set("Content-Security-Policy",
             "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; connect-src 'self'; "
             "base-uri 'none'; form-action 'none'; frame-ancestors 'none'; require-trusted-types-for 'script'; "
             "trusted-types 'none'");
  fields.set("X-Content-Type-Options", "nosniff");
  fields.set("Referrer-Policy", "no-referrer");
  fields.set("Cross-Origin-Opener-Policy", "same-origin");
  fields.set("Cross-Origin-Resource-Policy", "same-origin");
  fields.set("X-Frame-Options", "DENY");
  fields.set("Permissions-Policy", "geolocation=(), camera=(), microphone=()");
}

std::string event_text(const Board::News& news) { return "event: " + news.topic + "\ndata: " + news.text + "\n\n"; }

ssl::context context_of(const ServerProof& proof) {
  ssl::context context(ssl::context::tls_server);
  SSL_CTX_set_min_proto_version(context.native_handle(), TLS1_2_VERSION);
  // Nothing here needs a resumed session or a second handshake, which have had their faults.
  SSL_CTX_set_options(context.native_handle(), SSL_OP_NO_RENEGOTIATION | SSL_OP_NO_COMPRESSION | SSL_OP_NO_TICKET);
  SSL_CTX_set_session_cache_mode(context.native_handle(), SSL_SESS_CACHE_OFF);
  context.use_certificate_chain(asio::buffer(proof.certificate));
  context.use_private_key(asio::buffer(proof.key), ssl::context::pem);
  return context;
}

/// A JSON text that says one thing to a person.
std::string error_json(std::string_view text) {
  std::string json = R"({"error":")";
  for (const char c : text) {
    if (c == '"' || c == '\\') json += '\\';
    json += c;
  }
  return json + "\"}";
}

}  // namespace

Responder::~Responder() { answer({503, error_json("the system does not answer")}); }

void Responder::answer(WebReply reply) {
  if (auto send = std::exchange(send_, nullptr)) send(std::move(reply));
}

class WebServer::Impl : public std::enable_shared_from_this<Impl> {
 public:
  explicit Impl(Settings settings_) : settings(std::move(settings_)) { listen(); }
  void start() {
    accept();
    settings.board.on_change([weak = weak_from_this()] {
      if (const auto self = weak.lock()) self->news();
    });
    thread = std::thread([this] {
      pthread_setname_np(pthread_self(), "web server");
      context.run();
    });
  }
  void stop();

  void listen();
  void accept();
  void take(tcp::socket socket);
  void news();

  Settings settings;
  Site site;
  std::string url;
  std::optional<ssl::context> tls;
  asio::io_context context{1};
  tcp::acceptor acceptor{context};
  asio::steady_timer retry{context};
  std::set<std::shared_ptr<Connection>> connections;  ///< the server's thread only
  std::atomic<std::size_t> count{0};
  std::atomic<bool> news_posted{false};
  std::thread thread;
};

class WebServer::Connection {
 public:
  virtual ~Connection() = default;
  virtual void start() = 0;
  virtual void close() = 0;
  /// Sends what is new, if this is a stream and nothing of it is under way.
  virtual void news() = 0;
  virtual const std::string& from() const = 0;
};

/// One connection: requests one after the other, of which the last may become a stream. Over tcp, or TLS.
template <class Stream>
class WebServer::ConnectionOver final : public Connection, public std::enable_shared_from_this<ConnectionOver<Stream>> {
 public:
  template <class... Tls>
  ConnectionOver(std::shared_ptr<Impl> server, tcp::socket socket, std::string from, Tls&... tls)
      : server_(std::move(server)),
        stream_(std::move(socket), tls...),
        from_(std::move(from)),
        beat_(server_->context) {}

  const std::string& from() const override { return from_; }

  void start() override {
    if constexpr (std::is_same_v<Stream, beast::tcp_stream>) {
      read();
    } else {
      lowest().expires_after(server_->settings.request_time);
      stream_.async_handshake(ssl::stream_base::server,
                              [self = this->shared_from_this()](Fault fault) { fault ? self->close() : self->read(); });
    }
  }

  /// The next request. Its time begins with its first byte, and ends with its last, however slowly they come.
  void read() {
    parser_.emplace();
    set_bounds(*parser_);
    if (buffer_.size() > 0) return read_request();
    lowest().expires_after(std::exchange(silence_, server_->settings.idle_time));
    stream_.async_read_some(buffer_.prepare(kFirstRead),
                            [self = this->shared_from_this()](Fault fault, std::size_t size) {
                              if (fault) return self->refuse_or_close(fault);
                              self->buffer_.commit(size);
                              self->read_request();
                            });
  }

  void read_request() {
    lowest().expires_after(server_->settings.request_time);
    http::async_read(stream_, buffer_, *parser_, [self = this->shared_from_this()](Fault fault, std::size_t) {
      fault ? self->refuse_or_close(fault) : self->handle();
    });
  }

  void close() override {
    beat_.cancel();
    Fault ignored;
    lowest().socket().shutdown(tcp::socket::shutdown_both, ignored);
    lowest().close();
    if (server_->connections.erase(this->shared_from_this()) > 0) --server_->count;
  }

  void news() override {
    if (!streaming_ || writing_) return;
    std::string text;
    for (const Board::News& one : server_->settings.board.since(seen_)) text += event_text(one);
    if (!text.empty()) write(std::move(text));
  }

 private:
  beast::tcp_stream& lowest() { return beast::get_lowest_layer(stream_); }

  void refuse_or_close(const Fault& fault) {
    if (fault == http::error::end_of_stream || fault == ssl::error::stream_truncated ||
        fault == beast::error::timeout || fault == asio::error::eof || fault == asio::error::connection_reset ||
        fault == asio::error::operation_aborted) {
      return close();
    }
    last_ = true;
    const bool large = fault == http::error::body_limit || fault == http::error::header_limit;
    send(large ? 413 : 400, "application/json", error_json(large ? "the request is too large" : "this is no request"));
  }

  void handle() {
    last_ = !parser_->keep_alive();
    Route route = smart_web_interface::route(request_of(parser_->release()), server_->site);
    if (const auto* refusal = std::get_if<Refusal>(&route)) {
      send(refusal->status, "application/json", error_json(refusal->text));
    } else if (const auto* asset = std::get_if<AssetRequest>(&route)) {
      const std::string& bytes = server_->settings.files.at(asset->name);
      send(200, type_of(asset->name), bytes, asset->head);
    } else {
      call(std::get<ApiCall>(std::move(route)));
    }
  }

  void call(ApiCall call) {
    if (call.name != "session" && !server_->settings.is_open(call.bearer)) {
      return send(401, "application/json", error_json("the page's session has ended: open it with a new link"));
    }
    if (call.name == "events") {
      bearer_ = call.bearer;
      return begin_stream();
    }
    auto answer = [weak = this->weak_from_this(), context = std::weak_ptr(server_)](WebReply reply) {
      const auto server = context.lock();
      if (!server) return;
      asio::post(server->context, [weak, reply = std::move(reply)]() mutable {
        if (const auto self = weak.lock()) self->send(reply.status, "application/json", std::move(reply.json));
      });
    };
    // Calls have their own deadlines; a connection that waits for one is not idle.
    lowest().expires_never();
    server_->settings.on_call(std::move(call), from_, std::make_shared<Responder>(std::move(answer)));
  }

  void send(int status, beast::string_view type, std::string body, bool head = false) {
    response_ = {};
    response_.version(11);
    response_.result(static_cast<unsigned>(status));
    protect(response_);
    response_.set(http::field::content_type, type);
    // Files change with the version of the package, and answers are nobody else's.
    response_.set(http::field::cache_control, "no-store");
    response_.body() = std::move(body);
    response_.prepare_payload();
    if (head) response_.body().clear();
    response_.keep_alive(!last_);
    lowest().expires_after(server_->settings.request_time);
    serializer_.emplace(response_);
    serializer_->split(head);
    const auto done = [self = this->shared_from_this()](Fault fault, std::size_t) {
      fault || self->last_ ? self->close() : self->read();
    };
    if (head) {
      http::async_write_header(stream_, *serializer_, done);
    } else {
      http::async_write(stream_, *serializer_, done);
    }
  }

  void begin_stream() {
    http::response<http::empty_body> head{http::status::ok, 11};
    protect(head);
    head.set(http::field::content_type, "text/event-stream; charset=utf-8");
    head.set(http::field::cache_control, "no-store");
    head.set(http::field::connection, "close");
    std::string text = (std::ostringstream() << head.base()).str();
    streaming_ = true;
    write(std::move(text));
    beat();
  }

  void write(std::string text) {
    writing_ = true;
    text_ = std::move(text);
    lowest().expires_after(server_->settings.request_time);
    asio::async_write(stream_, asio::buffer(text_), [self = this->shared_from_this()](Fault fault, std::size_t) {
      self->writing_ = false;
      if (fault) return self->close();
      self->lowest().expires_never();
      self->news();
    });
  }

  /// A session that has ended ends its stream.
  void beat() {
    beat_.expires_after(kBeat);
    beat_.async_wait([self = this->shared_from_this()](Fault fault) {
      if (fault) return;
      if (!self->server_->settings.is_open(self->bearer_)) return self->close();
      if (!self->writing_) self->write(": \n\n");
      self->beat();
    });
  }

  const std::shared_ptr<Impl> server_;
  Stream stream_;
  const std::string from_;
  beast::flat_buffer buffer_{kMaxHeader + kMaxBody};
  std::chrono::milliseconds silence_ = server_->settings.request_time;  ///< before the next request's first byte
  std::optional<RequestParser> parser_;
  http::response<http::string_body> response_;
  std::optional<http::response_serializer<http::string_body>> serializer_;
  bool last_ = false;

  bool streaming_ = false;
  bool writing_ = false;
  std::string bearer_;
  std::string text_;
  std::uint64_t seen_ = 0;
  asio::steady_timer beat_;
};

bool WebServer::is_loopback(const std::string& text) {
  Fault fault;
  const auto address = asio::ip::make_address(text, fault);
  // Browsers know no zones ("fe80::1%eth0").
  const bool has_zone = text.find('%') != std::string::npos;
  if (!fault && !has_zone && !address.is_unspecified() && !address.is_multicast()) return address.is_loopback();
  throw Error(ErrorCode::Usage,
              {.what = "the page is not served at such an address",
               .expected = "127.0.0.1 or ::1 for this machine alone, or one numeric address by which others reach it",
               .found = text,
               .next = kAddresses});
}

void WebServer::Impl::listen() {
  const bool own_only = is_loopback(settings.address);
  if (!own_only && !settings.proof) {
    throw Error(ErrorCode::Usage, {.what = "beyond this machine the page is served over TLS only",
                                   .expected = "a proof of the server",
                                   .found = settings.address});
  }
  if (settings.proof) tls.emplace(context_of(*settings.proof));
  Fault fault;
  const auto address = asio::ip::make_address(settings.address);
  const tcp::endpoint endpoint(address, settings.port);
  acceptor.open(endpoint.protocol());
  acceptor.set_option(tcp::acceptor::reuse_address(true));
  acceptor.bind(endpoint, fault);
  if (!fault) acceptor.listen(tcp::acceptor::max_listen_connections, fault);
  if (fault) {
    const bool elsewhere = fault == boost::system::errc::address_not_available;
    throw Error(ErrorCode::Failed,
                {.what = "cannot listen at " + settings.address +
                         (elsewhere ? "" : ", port " + std::to_string(settings.port)) + ": " + fault.message(),
                 .where = settings.address,
                 .next = elsewhere ? kAddresses : "set another port, or 0 for one that is free"});
  }
  const std::string port = ":" + std::to_string(acceptor.local_endpoint().port());
  const std::string own = (address.is_v6() ? "[" + address.to_string() + "]" : address.to_string()) + port;
  site.hosts = {own};
  if (own_only) site.hosts.push_back("localhost" + port);
  site.scheme = tls ? "https://" : "http://";
  // Browsers leave out the port that is usual.
  if (acceptor.local_endpoint().port() == (tls ? 443 : 80)) {
    site.hosts.push_back(own.substr(0, own.size() - port.size()));
  }
  url = site.scheme + own;
  for (const auto& [name, bytes] : settings.files) site.files.emplace("/" + name, name);
  if (settings.files.contains("index.html")) site.files.emplace("/", "index.html");
}

void WebServer::Impl::accept() {
  acceptor.async_accept([self = shared_from_this()](Fault fault, tcp::socket socket) {
    if (fault == asio::error::operation_aborted) return;
    if (fault) {
      // Out of descriptors, most of all: to try again at once would only burn the CPU.
      self->retry.expires_after(kRetryAccept);
      self->retry.async_wait([self](Fault cancelled) {
        if (!cancelled) self->accept();
      });
      return;
    }
    self->take(std::move(socket));
    self->accept();
  });
}

void WebServer::Impl::take(tcp::socket socket) {
  Fault gone;
  const auto peer = socket.remote_endpoint(gone);
  if (gone || connections.size() >= kMaxConnections) return;
  std::string from = peer.address().to_string();
  const auto of_source =
      std::count_if(connections.begin(), connections.end(), [&](const auto& one) { return one->from() == from; });
  if (!peer.address().is_loopback() && static_cast<std::size_t>(of_source) >= kMaxOfSource) return;
  socket.set_option(tcp::no_delay(true), gone);
  std::shared_ptr<Connection> connection;
  if (tls) {
    connection = std::make_shared<ConnectionOver<beast::ssl_stream<beast::tcp_stream>>>(
        shared_from_this(), std::move(socket), std::move(from), *tls);
  } else {
    connection =
        std::make_shared<ConnectionOver<beast::tcp_stream>>(shared_from_this(), std::move(socket), std::move(from));
  }
  connections.insert(connection);
  ++count;
  connection->start();
}

/// One wake-up for whatever has changed until it comes.
void WebServer::Impl::news() {
  if (news_posted.exchange(true)) return;
  asio::post(context, [self = shared_from_this()] {
    self->news_posted = false;
    const auto all = self->connections;  // one that fails leaves the set
    for (const auto& connection : all) connection->news();
  });
}

void WebServer::Impl::stop() {
  settings.board.on_change(nullptr);
  asio::post(context, [this] {
    Fault ignored;
    acceptor.close(ignored);
    retry.cancel();
    const auto all = connections;
    for (const auto& connection : all) connection->close();
  });
  thread.join();
}

WebServer::WebServer(Settings settings) : impl_(std::make_shared<Impl>(std::move(settings))) { impl_->start(); }

WebServer::~WebServer() { impl_->stop(); }

std::uint16_t WebServer::port() const {
  const std::string& url = impl_->url;
  return static_cast<std::uint16_t>(std::stoul(url.substr(url.rfind(':') + 1)));
}

std::string WebServer::url() const { return impl_->url; }

std::size_t WebServer::connections() const { return impl_->count; }

}  // namespace fiona::smart_web_interface
