#include "failure.hpp"

#include "fiona/readable_text.hpp"
#include "os/message_stream.hpp"

namespace fiona::host {

control::Failure failure_of(const Error& error) {
  control::Failure failure;
  failure.set_code(static_cast<std::uint32_t>(error.code()));
  failure.set_what(readable_text(error.text().what));
  failure.set_where(readable_text(error.text().where));
  failure.set_expected(readable_text(error.text().expected));
  failure.set_found(readable_text(error.text().found));
  failure.set_next(readable_text(error.text().next));
  for (const auto& name : error.text().near) failure.add_near(readable_text(name));
  return failure;
}

control::Failure failure_of_exception() {
  control::Failure failure;
  try {
    throw;
  } catch (const Error& error) {
    return failure_of(error);
  } catch (const std::exception& error) {
    failure.set_code(static_cast<std::uint32_t>(ErrorCode::Failed));
    failure.set_what(readable_text(error.what()));
  } catch (...) {
    failure.set_code(static_cast<std::uint32_t>(ErrorCode::Failed));
    failure.set_what("something that is not a std::exception was thrown");
  }
  return failure;
}

Error error_of(const control::Failure& failure) {
  return Error(static_cast<ErrorCode>(failure.code()), {.what = failure.what(),
                                                        .where = failure.where(),
                                                        .expected = failure.expected(),
                                                        .found = failure.found(),
                                                        .next = failure.next(),
                                                        .near = {failure.near().begin(), failure.near().end()}});
}

void throw_failure(const control::Failure& failure) { throw error_of(failure); }

std::optional<std::string> fault_of(const std::function<void()>& work) {
  try {
    work();
    return std::nullopt;
  } catch (...) {
    return std::string("a fault of the host, which goes on: ") + error_of(failure_of_exception()).what();
  }
}

Error too_large(const google::protobuf::MessageLite& message) {
  return Error(ErrorCode::Failed, {.what = "what there is to tell is too large",
                                   .expected = std::to_string(os::MessageStream::kMaxMessage) + " bytes at most",
                                   .found = std::to_string(message.ByteSizeLong()) + " bytes",
                                   .next = "ask for a part of it"});
}

ErrorText without_instance(ErrorText text, const std::string& instance) {
  if (text.where.empty()) text.where = instance;
  if (text.next == "show " + instance || text.next == "get " + instance) {
    text.next = "'" + instance + "' was not loaded: correct that, then load it again";
  }
  return text;
}

}  // namespace fiona::host
