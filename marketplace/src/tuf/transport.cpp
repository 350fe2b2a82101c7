#include <curl/curl.h>
#include <fcntl.h>
#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <csignal>
#include <cstdlib>
#include <exception>
#include <optional>

#include "../files.hpp"
#include "digest.hpp"
#include "fiona/trust/tuf_client.hpp"
#include "locations.hpp"
#include "refuse.hpp"

namespace fiona::tuf {
namespace {

namespace filesystem = std::filesystem;

constexpr std::string_view kFileScheme = "file://";

[[noreturn]] void refuse_endless(const std::string& where, std::uint64_t most) {
  refuse(ErrorCode::BadSignature, ErrorText{.what = "endless data: this file is larger than it may be",
                                            .where = where,
                                            .expected = fmt::format("at most {} bytes", most),
                                            .next = "try another mirror, and tell the repository's keeper"});
}

class DirectoryTransport final : public Transport {
 public:
  bool fetch(const std::string& base, const std::string& path, std::uint64_t most, const Sink& sink) override {
    const filesystem::path file = location(base, percent_decoded(path));
    const marketplace::FileDescriptor opened = marketplace::open_regular(AT_FDCWD, file, file);
    if (!opened) return false;
    std::array<char, 1 << 16> buffer;
    for (std::uint64_t left = most;;) {
      const std::size_t count = marketplace::read_some(opened.number(), buffer.data(), buffer.size(), file);
      if (count == 0) return true;
      if (count > left) refuse_endless(file.string(), most);
      left -= count;
      sink({buffer.data(), count});
    }
  }

 private:
  static filesystem::path location(const std::string& base, const std::string& path) {
    const filesystem::path relative{path};
    const bool inside = !path.empty() && relative.is_relative() && path.find('\0') == std::string::npos &&
                        std::ranges::none_of(relative, [](const auto& name) { return name == ".." || name == "."; });
    if (!inside) {
      refuse(ErrorCode::NotAllowed, ErrorText{.what = "the repository names a file outside of its directory",
                                              .where = path,
                                              .next = "tell the keeper of the repository"});
    }
    return (base.starts_with(kFileScheme) ? percent_decoded(base.substr(kFileScheme.size())) : base) / relative;
  }
};

/// What libcurl calls back with.
struct CurlTransfer {
  const Transport::Sink* sink;
  std::uint64_t left;
  bool endless = false;
  std::exception_ptr failure;
};

std::size_t receive(char* bytes, std::size_t one, std::size_t count, void* user) {
  auto& transfer = *static_cast<CurlTransfer*>(user);
  const std::size_t size = one * count;
  transfer.endless = size > transfer.left;
  if (transfer.endless) return CURL_WRITEFUNC_ERROR;
  transfer.left -= size;
  try {
    (*transfer.sink)({bytes, size});
    return size;
  } catch (...) {  // not through C
    transfer.failure = std::current_exception();
    return CURL_WRITEFUNC_ERROR;
  }
}

/// A signal that a program has put off until it listens again ends a transfer: it may last.
int ends(void*, curl_off_t, curl_off_t, curl_off_t, curl_off_t) {
  sigset_t waiting;
  if (::sigpending(&waiting) != 0) return 0;
  return sigismember(&waiting, SIGINT) == 1 || sigismember(&waiting, SIGTERM) == 1 ||
         sigismember(&waiting, SIGHUP) == 1;
}

class CurlTransport final : public Transport {
 public:
  explicit CurlTransport(const Limits& limits) : limits_(limits), curl_(curl_easy_init(), curl_easy_cleanup) {
    if (!curl_)
      refuse(ErrorCode::Failed, {.what = "libcurl cannot be used", .next = "see whether memory is short: free -m"});
  }

  bool fetch(const std::string& base, const std::string& path, std::uint64_t most, const Sink& sink) override {
    const std::string url = base.substr(0, base.find_last_not_of('/') + 1) + "/" + path;
    CurlTransfer transfer{&sink, most, false, nullptr};
    prepare(url, most, transfer);
    const CURLcode code = curl_easy_perform(curl_.get());
    if (transfer.failure) std::rethrow_exception(transfer.failure);
    if (transfer.endless || code == CURLE_FILESIZE_EXCEEDED) refuse_endless(url, most);
    if (code == CURLE_OK) return true;
    long status = 0;
    curl_easy_getinfo(curl_.get(), CURLINFO_RESPONSE_CODE, &status);
    // Some stores of files say 403 for what they do not have.
    if (code == CURLE_HTTP_RETURNED_ERROR && (status == 404 || status == 403)) return false;
    report(url, code, status);
  }

 private:
  template <typename Value>
  void set(CURLoption option, Value value) {
    curl_easy_setopt(curl_.get(), option, value);
  }

  void prepare(const std::string& url, std::uint64_t most, CurlTransfer& transfer) {
    curl_easy_reset(curl_.get());  // keeps the connection
    const auto time_for_bytes =
        std::chrono::milliseconds(most * 1000 / std::max<std::uint64_t>(limits_.least_bytes_per_second, 1));
    set(CURLOPT_URL, url.c_str());
    set(CURLOPT_PATH_AS_IS, 1L);
    set(CURLOPT_PROTOCOLS_STR, "http,https");
    // Never back from https to http.
    set(CURLOPT_REDIR_PROTOCOLS_STR, url.starts_with("https:") ? "https" : "http,https");
    set(CURLOPT_FOLLOWLOCATION, 1L);
    set(CURLOPT_MAXREDIRS, 5L);
    set(CURLOPT_FAILONERROR, 1L);
    set(CURLOPT_NOSIGNAL, 1L);
    set(CURLOPT_USERAGENT, "fiona");
    // As curl's own program does: of an office's own authorities the system need not know.
    for (const char* name : {"SSL_CERT_FILE", "CURL_CA_BUNDLE"}) {
      if (const char* file = std::getenv(name); file && *file) set(CURLOPT_CAINFO, file);
    }
    set(CURLOPT_NOPROGRESS, 0L);
    set(CURLOPT_XFERINFOFUNCTION, &ends);
    set(CURLOPT_ERRORBUFFER, error_.data());
    set(CURLOPT_CONNECTTIMEOUT_MS, static_cast<long>(limits_.connect.count()));
    set(CURLOPT_TIMEOUT_MS, static_cast<long>((limits_.connect + limits_.patience + time_for_bytes).count()));
    set(CURLOPT_LOW_SPEED_LIMIT, static_cast<long>(limits_.least_bytes_per_second));
    set(CURLOPT_LOW_SPEED_TIME, std::max<long>(1, static_cast<long>(limits_.patience.count() / 1000)));
    set(CURLOPT_MAXFILESIZE_LARGE, static_cast<curl_off_t>(most));
    set(CURLOPT_WRITEFUNCTION, &receive);
    set(CURLOPT_WRITEDATA, &transfer);
    error_[0] = '\0';
  }

  [[noreturn]] void report(const std::string& url, CURLcode code, long status) const {
    if (code == CURLE_OPERATION_TIMEDOUT) {
      refuse(ErrorCode::Unreachable,
             ErrorText{.what = "slow retrieval: the server does not send, or too slowly",
                       .where = url,
                       .expected = fmt::format("at least {} bytes per second", limits_.least_bytes_per_second),
                       .found = error_.data(),
                       .next = "try again later or from another mirror"});
    }
    if (code == CURLE_PEER_FAILED_VERIFICATION || code == CURLE_SSL_CACERT_BADFILE) {
      refuse(ErrorCode::Unreachable,
             ErrorText{.what = "nobody whom this machine knows vouches for the server's certificate",
                       .where = url,
                       .found = error_.data(),
                       .next = "let update-ca-certificates add who does, or name a file: CURL_CA_BUNDLE=FILE"});
    }
    refuse(ErrorCode::Unreachable,
           ErrorText{.what = code == CURLE_HTTP_RETURNED_ERROR ? fmt::format("the server answered {}", status)
                                                               : "the server cannot be reached",
                     .where = url,
                     .found = error_[0] ? error_.data() : curl_easy_strerror(code),
                     .next = "check the address and the network, then try again"});
  }

  const Limits limits_;
  std::unique_ptr<CURL, void (*)(CURL*)> curl_;
  std::array<char, CURL_ERROR_SIZE> error_{};
};

/// Chooses by the base.
class AnyTransport final : public Transport {
 public:
  explicit AnyTransport(const Limits& limits) : limits_(limits) {}

  bool fetch(const std::string& base, const std::string& path, std::uint64_t most, const Sink& sink) override {
    if (is_directory_location(base)) return directory_.fetch(base, path, most, sink);
    if (!base.starts_with("http://") && !base.starts_with("https://")) {
      refuse(ErrorCode::Usage, ErrorText{.what = "this is no place that a repository can be read from",
                                         .expected = "a directory, file://, http:// or https://",
                                         .found = base.substr(0, 80)});
    }
    if (!curl_) curl_.emplace(limits_);
    return curl_->fetch(base, path, most, sink);
  }

 private:
  const Limits limits_;
  DirectoryTransport directory_;
  std::optional<CurlTransport> curl_;
};

}  // namespace

std::unique_ptr<Transport> make_transport(const Limits& limits) { return std::make_unique<AnyTransport>(limits); }

bool is_directory_location(std::string_view base) {
  return base.starts_with(kFileScheme) || base.find("://") == std::string_view::npos;
}

std::string percent_encoded(std::string_view name) {
  std::string encoded;
  for (const char c : name) {
    const bool plain = (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') || c == '-' ||
                       c == '.' || c == '_' || c == '~';
    encoded += plain ? std::string(1, c) : fmt::format("%{:02X}", static_cast<unsigned char>(c));
  }
  return encoded;
}

std::string percent_encoded_file(std::string_view name) {
  if (name == "." || name == "..") return name.size() == 1 ? "%2E" : "%2E%2E";
  return percent_encoded(name);
}

std::string percent_encoded_path(std::string_view path) {
  std::string encoded;
  for (;;) {
    const std::size_t slash = path.find('/');
    encoded += percent_encoded_file(path.substr(0, slash));
    if (slash == std::string_view::npos) return encoded;
    encoded += '/';
    path.remove_prefix(slash + 1);
  }
}

std::string percent_decoded(std::string_view text) {
  std::string decoded;
  for (std::size_t i = 0; i < text.size(); ++i) {
    const std::string byte = text[i] == '%' && i + 2 < text.size() ? from_hex(text.substr(i + 1, 2)) : std::string();
    decoded += byte.empty() ? std::string(1, text[i]) : byte;
    if (!byte.empty()) i += 2;
  }
  return decoded;
}

}  // namespace fiona::tuf
