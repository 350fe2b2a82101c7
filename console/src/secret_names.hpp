#pragma once

#include <cstddef>
#include <functional>
#include <set>
#include <string>
#include <string_view>

#include <google/protobuf/descriptor.h>

namespace fiona::console {

/// What fields are called whose values are neither shown nor kept (`fiona.secret`): those of the platform, and of types
/// that this console has met since. By their names alone, so that also a line that nobody understands is kept to it.
class SecretNames {
 public:
  /// Those of a type, at any depth, as well.
  void learn(const google::protobuf::Descriptor& type);

  /// Where in a typed line the first value of such a field begins, of `name=value` or in `{name: value}`; of a call
  /// also after a blank, where the `=` was forgotten. All from there on may belong to it; npos: there is none.
  std::size_t begin_in(std::string_view line) const;

 private:
  std::set<std::string, std::less<>> names_{"password", "session"};  ///< to ask the platform's types takes a while
};

}  // namespace fiona::console
