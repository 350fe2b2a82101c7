// The page beyond its machine: what the local authority vouches for, and that the server speaks TLS and nothing else.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <openssl/err.h>
#include <openssl/pem.h>
#include <openssl/ssl.h>
#include <openssl/x509v3.h>

#include <filesystem>
#include <string>
#include <thread>

#include "../temporary_directory.hpp"
#include "fiona/error.hpp"
#include "local_authority.hpp"
#include "web_server.hpp"

namespace fiona::smart_web_interface {
namespace {

using namespace std::chrono_literals;
using ::testing::HasSubstr;

template <auto release>
struct Frees {
  template <class T>
  void operator()(T* one) const {
    release(one);
  }
};
using Certificate = std::unique_ptr<X509, Frees<X509_free>>;
using Bytes = std::unique_ptr<BIO, Frees<BIO_free_all>>;

Bytes bytes_of(const std::string& text) { return Bytes(BIO_new_mem_buf(text.data(), static_cast<int>(text.size()))); }

Certificate certificate_of(const std::string& pem) {
  return Certificate(PEM_read_bio_X509(bytes_of(pem).get(), nullptr, nullptr, nullptr));
}

struct Visit {
  const char* address = nullptr;
  const char* name = nullptr;
  std::time_t at = 0;  ///< 0: now
};

/// What OpenSSL says of a server's certificate to who trusts the authority: "ok", or why it is refused.
std::string judged(const std::string& authority, X509* server, const Visit& visit) {
  const auto trusted = certificate_of(authority);
  const std::unique_ptr<X509_STORE, Frees<X509_STORE_free>> store(X509_STORE_new());
  X509_STORE_add_cert(store.get(), trusted.get());
  const std::unique_ptr<X509_STORE_CTX, Frees<X509_STORE_CTX_free>> check(X509_STORE_CTX_new());
  X509_STORE_CTX_init(check.get(), store.get(), server, nullptr);
  X509_VERIFY_PARAM* const wanted = X509_STORE_CTX_get0_param(check.get());
  X509_VERIFY_PARAM_set_purpose(wanted, X509_PURPOSE_SSL_SERVER);
  if (visit.address) X509_VERIFY_PARAM_set1_ip_asc(wanted, visit.address);
  if (visit.name) X509_VERIFY_PARAM_set1_host(wanted, visit.name, 0);
  if (visit.at != 0) X509_VERIFY_PARAM_set_time(wanted, visit.at);
  X509_verify_cert(check.get());
  return X509_verify_cert_error_string(X509_STORE_CTX_get_error(check.get()));
}

class LocalAuthorityTest : public ::testing::Test {
 protected:
  LocalAuthorityTest() { begin(); }
  void begin() {
    store_.reset();
    store_ = std::make_unique<records::RecordStore>(folder_.path / "web.db", "pages");
  }

  tests::TemporaryDirectory folder_;
  std::unique_ptr<records::RecordStore> store_;
  const LocalAuthority::Time now_ = std::chrono::system_clock::now();
};

TEST_F(LocalAuthorityTest, VouchesForTheServersAddressAndForNoOther) {
  const LocalAuthority authority(*store_, now_);
  for (const char* address : {"192.168.1.20", "fd00::7"}) {
    const auto server = certificate_of(authority.prove(address, now_).certificate);
    EXPECT_EQ(judged(authority.certificate(), server.get(), {.address = address}), "ok");
    EXPECT_EQ(judged(authority.certificate(), server.get(), {.address = "192.168.1.21"}), "IP address mismatch");
  }
}

TEST_F(LocalAuthorityTest, WhatItSignsForANameIsTakenByNobody) {
  const LocalAuthority authority(*store_, now_);
  const std::string kept = store_->get("authority", "pem").value();
  const auto stolen = bytes_of(kept);
  const Certificate issuer(PEM_read_bio_X509(stolen.get(), nullptr, nullptr, nullptr));
  const std::unique_ptr<EVP_PKEY, Frees<EVP_PKEY_free>> key(
      PEM_read_bio_PrivateKey(stolen.get(), nullptr, nullptr, nullptr));
  const auto forged = certificate_of(authority.prove("192.168.1.20", now_).certificate);
  X509_EXTENSION_free(X509_delete_ext(forged.get(), X509_get_ext_by_NID(forged.get(), NID_subject_alt_name, -1)));
  const std::unique_ptr<X509_EXTENSION, Frees<X509_EXTENSION_free>> name(
      X509V3_EXT_conf_nid(nullptr, nullptr, NID_subject_alt_name, "DNS:bank.example"));
  X509_add_ext(forged.get(), name.get(), -1);
  ASSERT_GT(X509_sign(forged.get(), key.get(), EVP_sha256()), 0);
  EXPECT_EQ(judged(authority.certificate(), forged.get(), {.name = "bank.example"}), "permitted subtree violation");
}

TEST_F(LocalAuthorityTest, IsTheSameAfterARestartUntilItNearsItsEnd) {
  const std::string first = LocalAuthority(*store_, now_).fingerprint();
  EXPECT_EQ(first.size(), 95U);
  begin();
  EXPECT_EQ(LocalAuthority(*store_, now_ + 24h * 365).fingerprint(), first);
  EXPECT_NE(LocalAuthority(*store_, now_ + 24h * 3000).fingerprint(), first);
}

TEST_F(LocalAuthorityTest, IsLeftAsItIsByAClockThatIsBehindAndTheClockIsTold) {
  const std::string first = LocalAuthority(*store_, now_).fingerprint();
  try {
    LocalAuthority(*store_, LocalAuthority::Time(1h));
    FAIL() << "it was used, or made anew";
  } catch (const Error& error) {
    EXPECT_EQ(error.text().what,
              "the page's authority begins later than now: the clock is wrong, or was when it was made");
    EXPECT_EQ(error.text().where, (folder_.path / "web.db").string());
    EXPECT_EQ(error.text().found, "1970-01-01 01:00 UTC");
    EXPECT_THAT(error.text().next, HasSubstr("set the clock"));
  }
  begin();
  const LocalAuthority again(*store_, now_);
  EXPECT_EQ(again.fingerprint(), first);
  EXPECT_FALSE(again.is_replaced());
}

TEST_F(LocalAuthorityTest, SaysWhetherDevicesHaveToBePairedAgain) {
  EXPECT_FALSE(LocalAuthority(*store_, now_).is_replaced());
  EXPECT_FALSE(LocalAuthority(*store_, now_).is_replaced());
  EXPECT_TRUE(LocalAuthority(*store_, now_ + 24h * 3000).is_replaced());
}

TEST_F(LocalAuthorityTest, AServersCertificateEndsAfterTheTimeThatBrowsersTake) {
  const LocalAuthority authority(*store_, now_);
  const auto server = certificate_of(authority.prove("192.168.1.20", now_).certificate);
  const auto at = [&](auto later) { return Visit{.at = std::chrono::system_clock::to_time_t(now_ + later)}; };
  EXPECT_EQ(judged(authority.certificate(), server.get(), at(24h * 824)), "ok");
  EXPECT_EQ(judged(authority.certificate(), server.get(), at(24h * 826)), "certificate has expired");
}

TEST_F(LocalAuthorityTest, WhatIsKeptAndIsNoneIsRefused) {
  store_->put("authority", "pem", "-----BEGIN CERTIFICATE-----\nrubbish");
  try {
    LocalAuthority(*store_, now_);
    FAIL() << "it was taken";
  } catch (const Error& error) {
    EXPECT_EQ(error.text().what, "what is kept of the page's authority is none");
    EXPECT_EQ(error.text().where, (folder_.path / "web.db").string());
  }
}

/// A server with a proof at this machine's own address, and what a client gets of it.
class TlsServerTest : public LocalAuthorityTest {
 protected:
  std::string host() const { return "127.0.0.1:" + std::to_string(server_.port()); }
  std::string request(const std::string& origin) const {
    return "POST /api/session HTTP/1.1\r\nHost: " + host() + "\r\nOrigin: " + origin +
           "\r\nContent-Type: application/json\r\nContent-Length: 2\r\nConnection: close\r\n\r\n{}";
  }
  /// All that comes after the request has been sent.
  static std::string exchange(BIO* connection, const std::string& request) {
    std::string all;
    if (BIO_do_connect(connection) != 1) return "no connection";
    BIO_write(connection, request.data(), static_cast<int>(request.size()));
    char bytes[4096];
    for (int n = 0; (n = BIO_read(connection, bytes, sizeof bytes)) > 0;)
      all.append(bytes, static_cast<std::size_t>(n));
    ERR_clear_error();
    return all;
  }
  /// By who trusts the authority, and speaks up to this version.
  std::string over_tls(const std::string& request, int version = TLS1_3_VERSION) const {
    const std::unique_ptr<SSL_CTX, Frees<SSL_CTX_free>> context(SSL_CTX_new(TLS_client_method()));
    SSL_CTX_set_security_level(context.get(), 0);  // else an old version is not even offered
    SSL_CTX_set_max_proto_version(context.get(), version);
    SSL_CTX_set_verify(context.get(), SSL_VERIFY_PEER, nullptr);
    X509_STORE_add_cert(SSL_CTX_get_cert_store(context.get()), certificate_of(authority_.certificate()).get());
    X509_VERIFY_PARAM_set1_ip_asc(SSL_CTX_get0_param(context.get()), "127.0.0.1");
    const Bytes connection(BIO_new_ssl_connect(context.get()));
    BIO_set_conn_hostname(connection.get(), host().c_str());
    return exchange(connection.get(), request);
  }
  std::string over_tcp(const std::string& request) const {
    const Bytes connection(BIO_new_connect(host().c_str()));
    return exchange(connection.get(), request);
  }

  const LocalAuthority authority_{*store_, now_};
  Board board_;
  WebServer server_{{.address = "127.0.0.1",
                     .proof = authority_.prove("127.0.0.1", now_),
                     .files = {{"authority.crt", authority_.certificate()}},
                     .board = board_,
                     .on_call =
                         [](ApiCall call, const std::string&, const std::shared_ptr<Responder>& respond) {
                           respond->answer({200, call.body});
                         },
                     .is_open = [](const std::string&) { return false; }}};
};

TEST_F(TlsServerTest, WhoTrustsTheAuthorityIsServed) {
  EXPECT_EQ(server_.url(), "https://" + host());
  for (const int version : {TLS1_2_VERSION, TLS1_3_VERSION}) {
    EXPECT_THAT(over_tls(request("https://" + host()), version), HasSubstr("HTTP/1.1 200 OK"));
  }
}

/// How a server that knows no patience ends a connection over which `sent` comes, and then a byte each 20 ms.
std::string end_of(const std::string& sent, bool drips) {
  Board board;
  const WebServer server({.address = "127.0.0.1",
                          .files = {},
                          .board = board,
                          .on_call = nullptr,
                          .is_open = nullptr,
                          .request_time = 200ms,
                          .idle_time = 400ms});
  const Bytes connection(BIO_new_connect(server.url().substr(7).c_str()));
  if (BIO_do_connect(connection.get()) != 1) return "no connection";
  BIO_write(connection.get(), sent.data(), static_cast<int>(sent.size()));
  const auto begun = std::chrono::steady_clock::now();
  while (server.connections() > 0 && std::chrono::steady_clock::now() - begun < 10s) {
    if (drips) BIO_write(connection.get(), "a", 1);
    std::this_thread::sleep_for(20ms);
  }
  return server.connections() > 0 ? "it is kept" : "closed";
}

TEST(WebServerTimes, HoldForARequestAsAWholeHoweverSlowlyItComes) {
  EXPECT_EQ(end_of("", false), "closed");
  for (const bool drips : {false, true}) {
    EXPECT_EQ(end_of("GET / HTTP/1.1\r\nHost: ", drips), "closed");
    EXPECT_EQ(end_of("POST /api/login HTTP/1.1\r\nHost: a\r\nContent-Length: 60000\r\n\r\n", drips), "closed");
  }
  EXPECT_EQ(end_of("GET /no HTTP/1.1\r\nHost: a\r\n\r\n", false), "closed") << "idle";
}

TEST_F(TlsServerTest, WithoutTlsNothingIsServed) {
  EXPECT_THAT(over_tcp(request("http://" + host())), ::testing::Not(HasSubstr("HTTP")));
  for (int i = 0; i < 1000 && server_.connections() > 0; ++i) std::this_thread::sleep_for(5ms);
  EXPECT_EQ(server_.connections(), 0U);
}

TEST_F(TlsServerTest, VersionsOfTlsThatAreWeakAreRefused) {
  EXPECT_EQ(over_tls(request("https://" + host()), TLS1_1_VERSION), "no connection");
}

TEST_F(TlsServerTest, APageWithoutTlsIsAnotherPage) {
  EXPECT_THAT(over_tls(request("http://" + host())), HasSubstr("the request comes from another page"));
}

TEST_F(TlsServerTest, TheAuthoritysCertificateIsThereForWhoIsToTrustIt) {
  const std::string answer =
      over_tls("GET /authority.crt HTTP/1.1\r\nHost: " + host() + "\r\nConnection: close\r\n\r\n");
  EXPECT_THAT(answer, HasSubstr("application/x-x509-ca-cert"));
  EXPECT_THAT(answer, HasSubstr(authority_.certificate()));
}

TEST_F(TlsServerTest, BeyondThisMachineNothingIsServedWithoutAProof) {
  try {
    WebServer({.address = "192.0.2.7", .files = {}, .board = board_, .on_call = nullptr, .is_open = nullptr});
    FAIL() << "it is served";
  } catch (const Error& error) {
    EXPECT_EQ(error.text().what, "beyond this machine the page is served over TLS only");
  }
}

}  // namespace
}  // namespace fiona::smart_web_interface
