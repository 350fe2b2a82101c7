#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "fiona/wire.pb.h"
#include "types.hpp"

namespace fiona::host {

/// How far two differ: the median and the most of many distances. Bounded: of very many it keeps each n-th for the
/// median.
class Distances {
 public:
  void add(double distance);
  std::uint64_t count() const { return count_; }
  double most() const { return most_; }
  double median() const;

 private:
  static constexpr std::size_t kMostKept = 16'384;
  std::vector<double> kept_;
  std::uint64_t stride_ = 1;
  std::uint64_t count_ = 0;
  double most_ = 0;
};

/// Compares what ports push with what those push that are to take their place, while both run. Compared are the fields
/// that are numbers with a fraction: coordinates of one frame as a distance, angles of a full circle the short way
/// round. An object that says that it is not valid is counted and not compared.
class Comparison {
 public:
  explicit Comparison(const Types& types) : types_(types) {}

  /// Before the first `note`: both ports, and the taps that tell what they say.
  void add(const control::PortName& old, std::uint64_t old_tap, const control::PortName& next, std::uint64_t next_tap);
  /// [one thread at a time] Something has happened in the system; why the swap cannot be made, once that is known.
  std::optional<control::Failure> note(const wire::GroupMessage& event);

  // Once it has ended.
  std::vector<control::Agreement> agreements() const;
  /// Why the swap should not be made: the new one says nothing valid, and the old one did.
  std::optional<control::Failure> objection() const;
  std::vector<std::uint64_t> taps() const;

 private:
  /// One number, or the coordinates of one frame, in a part of an object.
  struct Field {
    std::vector<const google::protobuf::FieldDescriptor*> path{};  ///< of the part
    std::vector<const google::protobuf::FieldDescriptor*> coordinates{};
    std::string name{};
    std::string unit{};
    double circle = 0;  ///< of an angle: the full turn in its unit; 0: none
    Distances distances{};

    std::optional<double> between(const google::protobuf::Message& a, const google::protobuf::Message& b) const;
  };

  struct Side {
    control::PortName name;
    std::uint64_t tap = 0;
    std::uint64_t messages = 0;
    std::uint64_t valid = 0;
    std::shared_ptr<google::protobuf::Message> newest;  ///< that is valid
  };
  struct Pair {
    Side old;
    Side next;
    std::shared_ptr<const google::protobuf::Message> first;  ///< of the type that is compared
    std::vector<Field> fields;
  };
  static void collect(const google::protobuf::Descriptor& type,
                      std::vector<const google::protobuf::FieldDescriptor*> path, std::vector<Field>& fields);
  void take(Pair& pair, Side& side, const wire::Tapped& tapped);

  const Types& types_;
  std::vector<Pair> pairs_;
};

}  // namespace fiona::host
