#pragma once

#include <fiona/marketplace/version.hpp>
#include <string>
#include <string_view>
#include <vector>

#include "fiona/manifest.pb.h"

namespace fiona::marketplace {

/// Versions between bounds: ">= 1.2.0, < 2.0.0". Without a bound: all.
class VersionRange {
 public:
  enum class Comparison { Less, LessEqual, Equal, GreaterEqual, Greater };
  struct Bound {
    Comparison comparison;
    Version version;
  };

  /// Reads bounds that are separated by commas; throws fiona::Error (Failed) that names `where` and says what is
  /// expected.
  static VersionRange parse(std::string_view text, const std::string& where);

  const std::vector<Bound>& bounds() const noexcept { return bounds_; }
  bool has(const Version& version) const;
  /// ">= 1.2.0, < 2.0.0"; empty for all.
  std::string text() const;

 private:
  std::vector<Bound> bounds_;
};

/// ">=" and so on.
std::string_view comparison_text(VersionRange::Comparison comparison);

/// What a manifest's `requirements` and `conflicts` say: a package, and which versions of it are meant.
struct Requirement {
  std::string package;  ///< "publisher/name"
  VersionRange versions;

  /// Reads "publisher/name [BOUNDS]"; throws fiona::Error (Failed) that names `where`.
  static Requirement parse(std::string_view text, const std::string& where);
  /// "acme/maps >= 1.2.0, < 2.0.0".
  std::string text() const;
};

/// Whether a package requires another one, in whatever version.
bool requires_package(const Manifest& manifest, const std::string& package);

}  // namespace fiona::marketplace
