#include "refuse.hpp"

#include "fiona/unicode.hpp"

namespace fiona::tuf {
namespace {

constexpr std::size_t kMostShown = 300;

void make_inert(std::string& text) {
  std::string_view rest = text;
  std::string inert;
  while (!rest.empty() && inert.size() < kMostShown) {
    const unicode::Character next = unicode::decode(rest);
    const bool shown = next.valid && !unicode::is_hidden(next.code);
    inert += shown ? std::string(rest.substr(0, next.bytes)) : "?";
    rest.remove_prefix(next.bytes);
  }
  text = inert + (rest.empty() ? "" : "…");
}

}  // namespace

void refuse(ErrorCode code, ErrorText text) {
  for (std::string* part : {&text.what, &text.where, &text.expected, &text.found, &text.next}) make_inert(*part);
  throw Error(code, std::move(text));
}

}  // namespace fiona::tuf
