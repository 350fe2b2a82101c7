#pragma once

#include <map>
#include <memory>
#include <string>

#include "fiona/control.pb.h"
#include "mcap_writer.hpp"
#include "types.hpp"

namespace fiona::console {

/// What ports say, in a file (McapWriter): a channel for each port, with its name; when a message has come and when it
/// was true, both since 1970-01-01 UTC (of a virtual clock since it started). Fields that are marked `(fiona.secret)`
/// are left out.
class Recording {
 public:
  /// Throws Error (Failed): it is there already, or cannot be written. So do the others.
  explicit Recording(const std::string& file) : file_(file), writer_(file) {}

  void take(const std::string& port, const control::Sample& sample);
  /// What has come so far is in the file: called each second, for ports may be silent.
  void flush() { writer_.flush(); }
  void finish() { writer_.finish(); }

  const std::string& file() const { return file_; }
  const McapWriter& written() const { return writer_; }
  std::size_t ports() const { return ports_.size(); }
  std::uint64_t lost() const { return lost_; }  ///< the host has left them out, as this console was slow

 private:
  struct Port {
    std::string type{};
    McapWriter::Channel channel = 0;
    std::unique_ptr<TypeSet> types{};                    ///< of what has secrets
    std::unique_ptr<google::protobuf::Message> whole{};  ///< the same
  };
  Port& port_of(const std::string& name, const control::Sample& sample);

  const std::string file_;
  McapWriter writer_;
  std::map<std::string, Port> ports_;
  std::uint64_t lost_ = 0;
};

}  // namespace fiona::console
