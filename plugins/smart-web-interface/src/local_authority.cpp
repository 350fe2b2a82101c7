#include "local_authority.hpp"

#include <openssl/bio.h>
#include <openssl/ec.h>
#include <openssl/err.h>
#include <openssl/evp.h>
#include <openssl/pem.h>
#include <openssl/rand.h>
#include <openssl/x509.h>
#include <openssl/x509v3.h>

#include <array>
#include <chrono>
#include <cstdio>
#include <ctime>

#include "fiona/error.hpp"

namespace fiona::smart_web_interface {

template <auto release>
struct Releases {
  template <class T>
  void operator()(T* one) const {
    release(one);
  }
};
using Certificate = std::unique_ptr<X509, Releases<X509_free>>;
using Key = std::unique_ptr<EVP_PKEY, Releases<EVP_PKEY_free>>;
using Bytes = std::unique_ptr<BIO, Releases<BIO_free_all>>;
using Extension = std::unique_ptr<X509_EXTENSION, Releases<X509_EXTENSION_free>>;

namespace {

using Clock = std::chrono::system_clock;
constexpr std::string_view kAuthorityTable = "authority";
constexpr int kSerialBytes = 16;
/// The clocks of phones differ.
constexpr auto kBefore = std::chrono::hours(24);

void require(bool good, const char* what) {
  if (good) return;
  std::array<char, 256> why{};
  ERR_error_string_n(ERR_get_error(), why.data(), why.size());
  ERR_clear_error();
  throw Error(ErrorCode::Failed, {.what = std::string("the certificate of the page's server: ") + what + " failed",
                                  .found = why.data(),
                                  .next = "serve this machine alone: address=127.0.0.1"});
}

std::string pem_in(BIO* bytes) {
  char* data = nullptr;
  const long size = BIO_get_mem_data(bytes, &data);
  return {data, static_cast<std::size_t>(size)};
}

std::string pem_of(X509* certificate) {
  const Bytes out(BIO_new(BIO_s_mem()));
  require(out && PEM_write_bio_X509(out.get(), certificate) == 1, "writing it");
  return pem_in(out.get());
}

std::string pem_of(EVP_PKEY* key) {
  const Bytes out(BIO_new(BIO_s_secmem()));
  require(out && PEM_write_bio_PrivateKey(out.get(), key, nullptr, nullptr, 0, nullptr, nullptr) == 1,
          "writing its key");
  return pem_in(out.get());
}

Key new_key() {
  Key key(EVP_EC_gen("P-256"));
  require(key != nullptr, "making a key");
  return key;
}

void extend(X509* certificate, X509* issuer, int which, const std::string& value) {
  X509V3_CTX context;
  X509V3_set_ctx(&context, issuer, certificate, nullptr, nullptr, 0);
  const Extension extension(X509V3_EXT_nconf_nid(nullptr, &context, which, value.c_str()));
  require(extension && X509_add_ext(certificate, extension.get(), -1) == 1, value.c_str());
}

/// All but issuer, extensions and signature.
Certificate draft(EVP_PKEY* key, const std::string& name, LocalAuthority::Time now, std::chrono::seconds time) {
  Certificate one(X509_new());
  std::array<unsigned char, kSerialBytes> serial{};
  require(one && RAND_bytes(serial.data(), serial.size()) == 1, "a random number");
  serial[0] &= 0x7f;  // positive
  const std::unique_ptr<BIGNUM, Releases<BN_free>> number(BN_bin2bn(serial.data(), serial.size(), nullptr));
  auto* subject = X509_get_subject_name(one.get());
  require(number && BN_to_ASN1_INTEGER(number.get(), X509_get_serialNumber(one.get())) &&
              X509_set_version(one.get(), 2) == 1 &&
              ASN1_TIME_set(X509_getm_notBefore(one.get()), Clock::to_time_t(now - kBefore)) &&
              ASN1_TIME_set(X509_getm_notAfter(one.get()), Clock::to_time_t(now + time)) &&
              X509_NAME_add_entry_by_txt(subject, "O", MBSTRING_UTF8, reinterpret_cast<const unsigned char*>("FIONA"),
                                         -1, -1, 0) == 1 &&
              X509_NAME_add_entry_by_txt(subject, "CN", MBSTRING_UTF8,
                                         reinterpret_cast<const unsigned char*>(name.c_str()), -1, -1, 0) == 1 &&
              X509_set_pubkey(one.get(), key) == 1,
          "filling it in");
  return one;
}

void sign(X509* certificate, X509* issuer, EVP_PKEY* key) {
  require(X509_set_issuer_name(certificate, X509_get_subject_name(issuer)) == 1 &&
              X509_sign(certificate, key, EVP_sha256()) > 0,
          "signing it");
}

std::string hex(const unsigned char* bytes, std::size_t size) {
  std::string text;
  for (std::size_t i = 0; i < size; ++i) {
    std::array<char, 4> two{};
    std::snprintf(two.data(), two.size(), i == 0 ? "%02X" : ":%02X", bytes[i]);
    text += two.data();
  }
  return text;
}

std::string in_words(const std::tm& time) {
  std::array<char, 32> text{};
  std::strftime(text.data(), text.size(), "%Y-%m-%d %H:%M UTC", &time);
  return text.data();
}

}  // namespace

struct LocalAuthority::Parts {
  Certificate certificate{};
  Key key{};

  void make(Time now);
  bool read(const std::string& pem);
  void check_begun(Time now, const records::RecordStore& store) const;
  bool lasts_until(Time time) const;
};

/// Each has a name of its own, for a device may have been told to trust several.
void LocalAuthority::Parts::make(Time now) {
  key = new_key();
  std::array<unsigned char, 3> mark{};
  require(RAND_bytes(mark.data(), mark.size()) == 1, "a random number");
  certificate = draft(key.get(), "FIONA page authority " + hex(mark.data(), mark.size()), now, kTime);
  X509* const own = certificate.get();
  extend(own, own, NID_basic_constraints, "critical,CA:TRUE,pathlen:0");
  extend(own, own, NID_key_usage, "critical,keyCertSign");
  extend(own, own, NID_subject_key_identifier, "hash");
  extend(own, own, NID_name_constraints,
         "critical,permitted;IP:0.0.0.0/0.0.0.0,permitted;IP:::/::,permitted;DNS:invalid,permitted;email:invalid");
  sign(own, own, key.get());
}

bool LocalAuthority::Parts::read(const std::string& pem) {
  const Bytes in(BIO_new_mem_buf(pem.data(), static_cast<int>(pem.size())));
  certificate.reset(PEM_read_bio_X509(in.get(), nullptr, nullptr, nullptr));
  key.reset(PEM_read_bio_PrivateKey(in.get(), nullptr, nullptr, nullptr));
  const bool is_whole = certificate && key && X509_check_private_key(certificate.get(), key.get()) == 1;
  ERR_clear_error();
  return is_whole;
}

/// One start before the clock was set is not to part it from each device that trusts it.
void LocalAuthority::Parts::check_begun(Time now, const records::RecordStore& store) const {
  std::time_t seconds = Clock::to_time_t(now);
  const ASN1_TIME* const begin = X509_get0_notBefore(certificate.get());
  if (X509_cmp_time(begin, &seconds) < 0) return;
  std::tm says{}, begins{};
  ::gmtime_r(&seconds, &says);
  ASN1_TIME_to_tm(begin, &begins);
  throw Error(ErrorCode::Failed,
              {.what = "the page's authority begins later than now: the clock is wrong, or was when it was made",
               .where = store.file().string(),
               .expected = "a time after " + in_words(begins),
               .found = in_words(says),
               .next = "set the clock, and load it again; where the clock is right, name another database: devices "
                       "have to be paired again then"});
}

bool LocalAuthority::Parts::lasts_until(Time time) const {
  std::time_t last = Clock::to_time_t(time);
  return X509_cmp_time(X509_get0_notAfter(certificate.get()), &last) > 0;
}

LocalAuthority::LocalAuthority(records::RecordStore& store, Time now) : parts_(std::make_unique<Parts>()) {
  const auto kept = store.get(kAuthorityTable, "pem");
  if (kept && !parts_->read(*kept)) {
    throw Error(ErrorCode::Failed, {.what = "what is kept of the page's authority is none",
                                    .where = store.file().string(),
                                    .next = "name another database; devices have to be paired again then"});
  }
  if (kept) parts_->check_begun(now, store);
  if (kept && parts_->lasts_until(now + kServerTime)) return;
  replaced_ = kept.has_value();
  parts_->make(now);
  store.put(kAuthorityTable, "pem", pem_of(parts_->certificate.get()) + pem_of(parts_->key.get()));
}

LocalAuthority::~LocalAuthority() = default;

std::string LocalAuthority::certificate() const { return pem_of(parts_->certificate.get()); }

std::string LocalAuthority::fingerprint() const {
  std::array<unsigned char, EVP_MAX_MD_SIZE> digest{};
  unsigned int size = 0;
  require(X509_digest(parts_->certificate.get(), EVP_sha256(), digest.data(), &size) == 1, "its fingerprint");
  return hex(digest.data(), size);
}

ServerProof LocalAuthority::prove(const std::string& address, Time now) const {
  const Key key = new_key();
  const Certificate server = draft(key.get(), "FIONA page at " + address, now, kServerTime);
  X509* const authority = parts_->certificate.get();
  extend(server.get(), authority, NID_basic_constraints, "critical,CA:FALSE");
  extend(server.get(), authority, NID_key_usage, "critical,digitalSignature");
  extend(server.get(), authority, NID_ext_key_usage, "serverAuth");
  extend(server.get(), authority, NID_subject_alt_name, "IP:" + address);
  extend(server.get(), authority, NID_authority_key_identifier, "keyid");
  sign(server.get(), authority, parts_->key.get());
  return {pem_of(server.get()), pem_of(key.get())};
}

}  // namespace fiona::smart_web_interface
