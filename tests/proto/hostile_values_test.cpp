// Every field of every object that a service of the catalogue carries, with every value that could harm whoever
// computes with it: refused by the rules that the hull applies, in a sentence that names the field, or within them.
#include <gmock/gmock.h>
#include <google/protobuf/message.h>
#include <google/protobuf/stubs/logging.h>
#include <gtest/gtest.h>

#include <cmath>
#include <cstdio>
#include <functional>
#include <limits>
#include <set>
#include <vector>

#include "fiona/hmi.pb.h"
#include "fiona/localisation.pb.h"
#include "fiona/navigation.pb.h"
#include "fiona/options.pb.h"
#include "fiona/perception.pb.h"
#include "fiona/rules.hpp"
#include "fiona/security.pb.h"
#include "fiona/sensors.pb.h"

namespace fiona::catalogue {
namespace {

using google::protobuf::Descriptor;
using google::protobuf::FieldDescriptor;
using ::testing::HasSubstr;

using Path = std::vector<const FieldDescriptor*>;

std::set<const Descriptor*> objects() {
  std::set<const Descriptor*> all;
  for (const auto* file : {sensors::GetIMU::descriptor()->file(), perception::CommObstacle::descriptor()->file(),
                           localisation::CommStep::descriptor()->file(), navigation::CommPath::descriptor()->file(),
                           security::CommSession::descriptor()->file(), hmi::NextTurn::descriptor()->file()}) {
    for (int i = 0; i < file->service_count(); ++i) {
      for (int k = 0; k < file->service(i)->method_count(); ++k) {
        all.insert(file->service(i)->method(k)->input_type());
        all.insert(file->service(i)->method(k)->output_type());
      }
    }
  }
  all.erase(None::descriptor());
  return all;
}

/// Each field, through one element of each list of objects.
void each_field(const Descriptor& type, Path& path, const std::function<void(const Path&)>& visit) {
  for (int i = 0; i < type.field_count(); ++i) {
    path.push_back(type.field(i));
    visit(path);
    if (path.back()->cpp_type() == FieldDescriptor::CPPTYPE_MESSAGE)
      each_field(*path.back()->message_type(), path, visit);
    path.pop_back();
  }
}

/// The object that holds the last field of the path.
Object& holder(Object& object, const Path& path) {
  Object* at = &object;
  for (auto one = path.begin(); one + 1 != path.end(); ++one) {
    const auto& reflect = *at->GetReflection();
    at = (*one)->is_repeated() ? reflect.AddMessage(at, *one) : reflect.MutableMessage(at, *one);
  }
  return *at;
}

template <class T>
void put(Object& object, const FieldDescriptor& field, T value) {
  const auto& reflect = *object.GetReflection();
  const bool add = field.is_repeated();
  using std::string;
  if constexpr (std::is_same_v<T, double>)
    add ? reflect.AddDouble(&object, &field, value) : reflect.SetDouble(&object, &field, value);
  if constexpr (std::is_same_v<T, float>)
    add ? reflect.AddFloat(&object, &field, value) : reflect.SetFloat(&object, &field, value);
  if constexpr (std::is_same_v<T, std::int32_t>)
    add ? reflect.AddInt32(&object, &field, value) : reflect.SetInt32(&object, &field, value);
  if constexpr (std::is_same_v<T, std::uint32_t>)
    add ? reflect.AddUInt32(&object, &field, value) : reflect.SetUInt32(&object, &field, value);
  if constexpr (std::is_same_v<T, google::protobuf::int64>)
    add ? reflect.AddInt64(&object, &field, value) : reflect.SetInt64(&object, &field, value);
  if constexpr (std::is_same_v<T, google::protobuf::uint64>)
    add ? reflect.AddUInt64(&object, &field, value) : reflect.SetUInt64(&object, &field, value);
  if constexpr (std::is_same_v<T, string>)
    add ? reflect.AddString(&object, &field, value) : reflect.SetString(&object, &field, value);
}

class HostileValues : public ::testing::Test {
 protected:
  ~HostileValues() override {
    if (tried_ > 0) std::printf("%d values of %zu objects\n", tried_, objects().size());
  }
  /// With this done to the field at the end of the path, and to nothing else.
  std::optional<std::string> refusal_of(const Descriptor& type, const Path& path,
                                        const std::function<void(Object&, const FieldDescriptor&)>& change) {
    const std::unique_ptr<Object> object(
        google::protobuf::MessageFactory::generated_factory()->GetPrototype(&type)->New());
    change(holder(*object, path), *path.back());
    ++tried_;
    return ObjectRules(type).first_violation(*object);
  }

  template <class T>
  void expect_right(const Descriptor& type, const Path& path, T value) {
    const FieldDescriptor& field = *path.back();
    const auto& options = field.options();
    const auto number = static_cast<double>(value);
    const bool allowed = (std::isfinite(number) || options.GetExtension(fiona::allow_not_finite)) &&
                         !(options.HasExtension(fiona::min) && number < options.GetExtension(fiona::min)) &&
                         !(options.HasExtension(fiona::max) && number > options.GetExtension(fiona::max));
    // Where a list has a length, that many, the last of them hostile.
    const int size = field.is_repeated() ? std::max(1, static_cast<int>(options.GetExtension(fiona::size))) : 1;
    const auto refusal = refusal_of(type, path, [&](Object& object, const FieldDescriptor& one) {
      for (int i = 1; i < size; ++i) put<T>(object, one, T{});
      put<T>(object, one, value);
    });
    const bool covariance = options.GetExtension(fiona::covariance);
    if (allowed && !refusal) return;
    if (covariance && refusal && number < 0) return;
    EXPECT_EQ(!refusal, allowed) << type.full_name() << ": " << field.full_name() << " = " << number << ": "
                                 << refusal.value_or("taken");
    EXPECT_THAT(refusal.value_or(field.name()), HasSubstr(field.name()));
  }

  template <class T>
  void expect_right_for_limits(const Descriptor& type, const Path& path) {
    using Limits = std::numeric_limits<T>;
    std::vector<T> values{Limits::min(), Limits::max(), Limits::lowest()};
    if constexpr (Limits::is_iec559) {
      for (const T value : {Limits::quiet_NaN(), Limits::infinity(), -Limits::infinity(), Limits::denorm_min()})
        values.push_back(value);
    }
    for (const T value : values) expect_right<T>(type, path, value);
  }

  void expect_length_kept(const Descriptor& type, const Path& path) {
    const FieldDescriptor& field = *path.back();
    const auto most = static_cast<int>(
        std::max(field.options().GetExtension(fiona::size), field.options().GetExtension(fiona::max_size)));
    if (!field.is_repeated() && field.cpp_type() != FieldDescriptor::CPPTYPE_STRING) return;
    ASSERT_GT(most, 0) << field.full_name() << " has no bound";
    const auto refusal = refusal_of(type, path, [&](Object& object, const FieldDescriptor& one) {
      if (!one.is_repeated()) return put(object, one, std::string(static_cast<std::size_t>(most) + 1, 'x'));
      for (int i = 0; i <= most; ++i) add_default(object, one);
    });
    ASSERT_TRUE(refusal) << field.full_name();
    EXPECT_THAT(*refusal, HasSubstr(field.name()));
  }

  static void add_default(Object& object, const FieldDescriptor& field) {
    const auto& reflect = *object.GetReflection();
    switch (field.cpp_type()) {
      case FieldDescriptor::CPPTYPE_DOUBLE: return reflect.AddDouble(&object, &field, 0);
      case FieldDescriptor::CPPTYPE_FLOAT: return reflect.AddFloat(&object, &field, 0);
      case FieldDescriptor::CPPTYPE_INT32: return reflect.AddInt32(&object, &field, 0);
      case FieldDescriptor::CPPTYPE_UINT32: return reflect.AddUInt32(&object, &field, 0);
      case FieldDescriptor::CPPTYPE_INT64: return reflect.AddInt64(&object, &field, 0);
      case FieldDescriptor::CPPTYPE_UINT64: return reflect.AddUInt64(&object, &field, 0);
      case FieldDescriptor::CPPTYPE_BOOL: return reflect.AddBool(&object, &field, false);
      case FieldDescriptor::CPPTYPE_ENUM: return reflect.AddEnumValue(&object, &field, 0);
      case FieldDescriptor::CPPTYPE_STRING: return reflect.AddString(&object, &field, "");
      case FieldDescriptor::CPPTYPE_MESSAGE: reflect.AddMessage(&object, &field);
    }
  }

  int tried_ = 0;
};

TEST_F(HostileValues, OfEveryNumberAreRefusedByNameUnlessTheFieldAllowsThem) {
  Path path;
  for (const Descriptor* type : objects()) {
    each_field(*type, path, [&](const Path& at) {
      switch (at.back()->cpp_type()) {
        case FieldDescriptor::CPPTYPE_DOUBLE: return expect_right_for_limits<double>(*type, at);
        case FieldDescriptor::CPPTYPE_FLOAT: return expect_right_for_limits<float>(*type, at);
        case FieldDescriptor::CPPTYPE_INT32: return expect_right_for_limits<std::int32_t>(*type, at);
        case FieldDescriptor::CPPTYPE_UINT32: return expect_right_for_limits<std::uint32_t>(*type, at);
        case FieldDescriptor::CPPTYPE_INT64: return expect_right_for_limits<google::protobuf::int64>(*type, at);
        case FieldDescriptor::CPPTYPE_UINT64: return expect_right_for_limits<google::protobuf::uint64>(*type, at);
        default: return;
      }
    });
  }
  EXPECT_GT(tried_, 1000);
}

TEST_F(HostileValues, AListOrTextThatIsTooLongIsRefusedByName) {
  Path path;
  for (const Descriptor* type : objects())
    each_field(*type, path, [&](const Path& at) { expect_length_kept(*type, at); });
  EXPECT_GT(tried_, 50);
}

TEST_F(HostileValues, ANumberThatIsNoEnumeratorIsRefusedByName) {
  Path path;
  for (const Descriptor* type : objects()) {
    each_field(*type, path, [&](const Path& at) {
      if (at.back()->cpp_type() != FieldDescriptor::CPPTYPE_ENUM) return;
      for (const int number : {-1, 1000, std::numeric_limits<int>::min(), std::numeric_limits<int>::max()}) {
        const auto refusal = refusal_of(*type, at, [&](Object& object, const FieldDescriptor& one) {
          const auto& reflect = *object.GetReflection();
          one.is_repeated() ? reflect.AddEnumValue(&object, &one, number) : reflect.SetEnumValue(&object, &one, number);
        });
        ASSERT_TRUE(refusal) << at.back()->full_name() << " = " << number;
        EXPECT_THAT(*refusal, HasSubstr(at.back()->name()));
        EXPECT_THAT(*refusal, HasSubstr(std::to_string(number)));
      }
    });
  }
  EXPECT_GT(tried_, 20);
}

TEST_F(HostileValues, TextThatIsNoUtf8DoesNotParse) {
  const google::protobuf::LogSilencer quiet;
  Path path;
  int texts = 0;
  for (const Descriptor* type : objects()) {
    each_field(*type, path, [&](const Path& at) {
      if (at.back()->type() != FieldDescriptor::TYPE_STRING) return;
      ++texts;
      const auto* prototype = google::protobuf::MessageFactory::generated_factory()->GetPrototype(type);
      const std::unique_ptr<Object> sent(prototype->New()), received(prototype->New());
      put(holder(*sent, at), *at.back(), std::string("ok"));
      std::string bytes = sent->SerializeAsString();
      bytes.replace(bytes.rfind("ok"), 2, "\xC3\x28");
      EXPECT_FALSE(received->ParseFromString(bytes)) << at.back()->full_name();
    });
  }
  EXPECT_GT(texts, 10);
}

TEST_F(HostileValues, AMatrixThatIsNoCovarianceIsRefusedByName) {
  Path path;
  int matrices = 0;
  for (const Descriptor* type : objects()) {
    each_field(*type, path, [&](const Path& at) {
      if (!at.back()->options().GetExtension(fiona::covariance)) return;
      ++matrices;
      const auto refusal = refusal_of(*type, at, [](Object& object, const FieldDescriptor& field) {
        for (const double element : {1., 2., 0., 2., 1., 0., 0., 0., 1.}) put(object, field, element);
      });
      ASSERT_TRUE(refusal) << at.back()->full_name();
      EXPECT_THAT(*refusal, HasSubstr(at.back()->name() + " is no covariance"));
    });
  }
  EXPECT_GE(matrices, 3);
}

}  // namespace
}  // namespace fiona::catalogue
