#include "fiona/params.hpp"

#include <fmt/format.h>
#include <google/protobuf/descriptor.h>
#include <google/protobuf/text_format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>
#include <vector>

#include "fiona/component.hpp"
#include "fiona/error.hpp"
#include "fiona/hull.hpp"
#include "fiona/rules.hpp"
#include "fiona/secrets.hpp"
#include "value_text.hpp"

namespace fiona {

using google::protobuf::Descriptor;
using google::protobuf::FieldDescriptor;
using google::protobuf::Message;

namespace {

std::vector<std::string> field_names(const Descriptor& type) {
  std::vector<std::string> names;
  for (int i = 0; i < type.field_count(); ++i) names.push_back(type.field(i)->name());
  return names;
}

/// Follows the dots of `path` to the message that holds its last field.
std::pair<Message*, const FieldDescriptor*> locate(Message& root, const std::string& path) {
  Message* message = &root;
  std::size_t begin = 0;
  while (true) {
    const std::size_t dot = path.find('.', begin);
    const std::string name = path.substr(begin, dot == std::string::npos ? dot : dot - begin);
    const FieldDescriptor* field = message->GetDescriptor()->FindFieldByName(name);
    if (!field) {
      const auto known = field_names(*message->GetDescriptor());
      throw Error(ErrorCode::NotFound, {.what = "there is no parameter '" + path + "'",
                                        .expected = fmt::format("one of {}", fmt::join(known, ", ")),
                                        .near = nearest_names(name, known)});
    }
    if (dot == std::string::npos) return {message, field};
    if (field->is_repeated() || field->cpp_type() != FieldDescriptor::CPPTYPE_MESSAGE) {
      throw Error(ErrorCode::NotFound, {.what = "parameter '" + name + "' has no fields of its own",
                                        .where = path,
                                        .next = "set " + name + " itself"});
    }
    message = message->GetReflection()->MutableMessage(message, field);
    begin = dot + 1;
  }
}

using Visit =
    std::function<void(const std::string& name, const Message&, const Message& other, const FieldDescriptor&)>;

/// Of two messages of one type, side by side.
void for_each_leaf(const Message& message, const Message& other, const std::string& prefix, const Visit& visit) {
  const Descriptor& type = *message.GetDescriptor();
  for (int i = 0; i < type.field_count(); ++i) {
    const FieldDescriptor& field = *type.field(i);
    const std::string name = prefix + field.name();
    if (field.cpp_type() == FieldDescriptor::CPPTYPE_MESSAGE && !field.is_repeated()) {
      for_each_leaf(message.GetReflection()->GetMessage(message, &field),
                    other.GetReflection()->GetMessage(other, &field), name + ".", visit);
    } else {
      visit(name, message, other, field);
    }
  }
}

/// A stranger's package may bring any type: the fields of one that contains itself have no end, those of one whose
/// fields have many levels hardly one.
class BoundedFields {
 public:
  static void require(const Descriptor& type) { BoundedFields().visit(type); }

 private:
  static constexpr std::size_t kMost = 4096;

  void visit(const Descriptor& type) {
    if (std::find(path_.begin(), path_.end(), &type) != path_.end()) {
      refuse("contains itself: " + type.full_name());
    }
    path_.push_back(&type);
    for (int i = 0; i < type.field_count(); ++i) {
      const FieldDescriptor& field = *type.field(i);
      if (++fields_ > kMost) refuse("has more than " + std::to_string(kMost) + " fields");
      if (field.cpp_type() == FieldDescriptor::CPPTYPE_MESSAGE && !field.is_repeated()) visit(*field.message_type());
    }
    path_.pop_back();
  }
  [[noreturn]] void refuse(const std::string& what) const {
    const Descriptor& whole = *path_.front();
    throw Error(ErrorCode::Usage, {.what = "the parameters' type " + what,
                                   .where = whole.full_name(),
                                   .expected = "fields that have an end, at most " + std::to_string(kMost),
                                   .next = "correct it in " + whole.file()->name()});
  }

  std::vector<const Descriptor*> path_;
  std::size_t fields_ = 0;
};

}  // namespace

void set_fields(Object& message, std::span<const control::Argument> changes) {
  for (const auto& change : changes) {
    if (change.name().empty()) {
      detail::merge_text(message, change.value());
      continue;
    }
    auto [holder, field] = locate(message, change.name());
    detail::set_field(*holder, *field, change.value(), change.name());
  }
  if (const auto violation = ObjectRules(*message.GetDescriptor()).first_violation(message)) {
    throw Error(ErrorCode::Usage, "refused: " + *violation);
  }
}

std::vector<control::Argument> differences(const Object& values, const Object& others) {
  std::vector<control::Argument> changed;
  for_each_leaf(values, others, "", [&](const auto& name, const auto& holder, const auto& other, const auto& field) {
    if (detail::field_text(holder, field) == detail::field_text(other, field)) return;
    auto& one = changed.emplace_back();
    one.set_name(name);
    *one.mutable_value() = detail::field_value(holder, field);
  });
  return changed;
}

namespace {

void set_bounded_defaults(Object& message) {
  const Descriptor& type = *message.GetDescriptor();
  for (int i = 0; i < type.field_count(); ++i) {
    const FieldDescriptor& field = *type.field(i);
    if (field.cpp_type() == FieldDescriptor::CPPTYPE_MESSAGE && !field.is_repeated()) {
      if (field.real_containing_oneof()) continue;  // none of its members is the default one
      set_bounded_defaults(*message.GetReflection()->MutableMessage(&message, &field));
      continue;
    }
    const std::string& text = field.options().GetExtension(fiona::default_value);
    if (!text.empty()) detail::set_field(message, field, detail::parse_default(field, text), field.full_name());
  }
  if (const auto violation = ObjectRules(type).first_violation(message)) {
    throw Error(ErrorCode::Usage, {.what = "the declared default breaks its own rule: " + *violation,
                                   .where = type.full_name(),
                                   .next = "correct (fiona.default_value) in " + type.file()->name()});
  }
}

}  // namespace

void set_declared_defaults(Object& message) {
  BoundedFields::require(*message.GetDescriptor());
  set_bounded_defaults(message);
}

namespace detail {

ParamsBase::ParamsBase(Component& owner, std::unique_ptr<Object> defaults, Check check, std::function<void()> changed)
    : hull_(owner.hull()),
      defaults_(std::move(defaults)),
      check_(std::move(check)),
      changed_(std::move(changed)),
      current_(defaults_) {
  if (hull_.params_) {
    throw Error(ErrorCode::Usage, {.what = "a component has one parameter message",
                                   .where = hull_.name(),
                                   .next = "put the members of both into one message"});
  }
  if (const auto secret = first_secret(*defaults_->GetDescriptor())) {
    throw Error(ErrorCode::Usage, {.what = "'" + *secret +
                                           "' is secret, and no parameter is: each is shown, saved and "
                                           "kept in the journal",
                                   .where = hull_.name(),
                                   .next = "let a parameter name a file that holds it"});
  }
  hull_.params_ = this;
}

void ParamsBase::apply(std::span<const control::Argument> changes) {
  std::shared_ptr<Object> draft(current_->New());
  draft->CopyFrom(*current_);
  try {
    set_fields(*draft, changes);
    if (check_) check_(*draft);
    take(std::move(draft));
  } catch (const Error& error) {
    ErrorText text = error.text();
    if (text.where.empty()) text.where = hull_.name();
    if (text.next.empty()) text.next = "get " + hull_.name();
    throw Error(error.code(), std::move(text));
  }
}

/// What `changed` throws at is taken back, and is a refusal too.
void ParamsBase::take(std::shared_ptr<const Object> values) {
  const auto switch_to = [this](std::shared_ptr<const Object> next) {
    const std::lock_guard lock(mutex_);
    return std::exchange(current_, std::move(next));
  };
  auto former = switch_to(std::move(values));
  if (!changed_ || hull_.mode() == kModeInit) return;
  try {
    changed_();
  } catch (...) {
    switch_to(std::move(former));
    throw;
  }
}

void ParamsBase::take_back(std::shared_ptr<const Object> former) {
  try {
    take(std::move(former));
  } catch (const std::exception& error) {
    hull_.events().logged(hull_.name(), LogLevel::Error,
                          std::string("parameters that came too late could not be taken back: ") + error.what());
  }
}

std::shared_ptr<const Object> ParamsBase::snapshot() const {
  const std::lock_guard lock(mutex_);
  return current_;
}

std::vector<control::ParameterStatus> ParamsBase::status() const {
  std::vector<control::ParameterStatus> all;
  const auto values = snapshot();
  for_each_leaf(*values, *defaults_, "",
                [&](const auto& name, const auto& holder, const auto& other, const auto& field) {
                  auto& one = all.emplace_back();
                  one.set_name(name);
                  one.set_value(field_text(holder, field));
                  one.set_default_value(field_text(other, field));
                  one.set_type(type_text(field));
                  one.set_unit(field.options().GetExtension(fiona::unit));
                  one.set_range(range_text(field));
                  one.set_doc(field.options().GetExtension(fiona::doc));
                });
  return all;
}

std::vector<control::Argument> ParamsBase::differences() const { return fiona::differences(*snapshot(), *defaults_); }

}  // namespace detail
}  // namespace fiona
