#pragma once

#include <string>

namespace fiona::conformance {

/// Runs it; whether it went well.
bool shell(const std::string& line);

/// A network namespace of its own, and two addresses for what leads there.
class Network {
 public:
  Network();
  ~Network();
  Network(const Network&) = delete;
  Network& operator=(const Network&) = delete;

  /// Why there is none, and what it would take; empty: there is one.
  const std::string& missing() const { return missing_; }
  const std::string& network() const { return name_; }
  const std::string& here() const { return here_; }
  const std::string& there() const { return there_; }
  /// In the namespace.
  bool in(const std::string& line) const { return shell("ip netns exec " + name_ + " " + line); }

 protected:
  void require(bool good, const std::string& what);

 private:
  const std::string name_;
  std::string here_;
  std::string there_;
  std::string missing_;
};

/// With a cable to it, which can be pulled, be slow, or lose what goes one way.
class Cable : public Network {
 public:
  Cable();
  ~Cable();
  void pull();
  void plug();
  /// Of what arrives at these ends, so many in a hundred get lost; 0: none. Needs nftables.
  void lose(int there_percent, int here_percent);
  /// So many bits a second in both directions; empty: as fast as it goes.
  void limit(const std::string& rate);
};

}  // namespace fiona::conformance
