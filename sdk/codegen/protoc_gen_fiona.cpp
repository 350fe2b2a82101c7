// The protoc plugin that turns a proto `service` with a (fiona.contract) into a C++ service type:
//   protoc --plugin=protoc-gen-fiona --fiona_out=DIR file.proto   ->   DIR/file.fiona.hpp
#include <google/protobuf/compiler/code_generator.h>
#include <google/protobuf/compiler/plugin.h>
#include <google/protobuf/descriptor.h>
#include <google/protobuf/io/printer.h>
#include <google/protobuf/io/zero_copy_stream.h>

#include <map>
#include <memory>
#include <optional>
#include <string>

#include "fiona/options.pb.h"

namespace {

using google::protobuf::Descriptor;
using google::protobuf::FileDescriptor;
using google::protobuf::MethodDescriptor;
using google::protobuf::ServiceDescriptor;

std::string with_colons(std::string name) {
  for (std::size_t dot = 0; (dot = name.find('.', dot)) != std::string::npos; dot += 2) name.replace(dot, 1, "::");
  return name;
}

std::string cpp_type(const Descriptor& message) {
  std::string nested = message.name();
  for (const Descriptor* outer = message.containing_type(); outer; outer = outer->containing_type()) {
    nested = outer->name() + "_" + nested;
  }
  return "::" + with_colons(message.file()->package()) + "::" + nested;
}

/// What a pattern demands of a service's methods, or the complaint.
struct Base {
  std::string text;
  std::string error;
};

Base wrong(const ServiceDescriptor& service, const std::string& expected) {
  return {"", service.file()->name() + ": service " + service.name() + ": " + expected};
}

bool is_none(const Descriptor& message) { return message.full_name() == "fiona.None"; }

Base one_way(const ServiceDescriptor& service, const std::string& pattern, bool from_client) {
  const auto* method = service.FindMethodByName("Object");
  const std::string expected = from_client ? "a send has one method: rpc Object(X) returns (fiona.None)"
                                           : "a push has one method: rpc Object(fiona.None) returns (X)";
  if (!method || service.method_count() != 1) return wrong(service, expected);
  const Descriptor& object = from_client ? *method->input_type() : *method->output_type();
  const Descriptor& other = from_client ? *method->output_type() : *method->input_type();
  if (is_none(object) || !is_none(other)) return wrong(service, expected);
  return {"::fiona::" + pattern + "<" + cpp_type(object) + ">", ""};
}

Base query(const ServiceDescriptor& service) {
  const auto* method = service.FindMethodByName("Query");
  if (!method || service.method_count() != 1) {
    return wrong(service, "a query has one method: rpc Query(Request) returns (Answer)");
  }
  return {"::fiona::Query<" + cpp_type(*method->input_type()) + ", " + cpp_type(*method->output_type()) + ">", ""};
}

Base event(const ServiceDescriptor& service) {
  const auto* event = service.FindMethodByName("Event");
  const auto* state = service.FindMethodByName("State");
  if (!event || !state || service.method_count() != 2) {
    return wrong(
        service,
        "an event has two methods: rpc Event(Activation) returns (Result) and rpc State(S) returns (fiona.None)");
  }
  return {"::fiona::Event<" + cpp_type(*event->input_type()) + ", " + cpp_type(*event->output_type()) + ", " +
              cpp_type(*state->input_type()) + ">",
          ""};
}

Base base_of(const ServiceDescriptor& service) {
  switch (service.options().GetExtension(fiona::contract).pattern()) {
    case fiona::SEND: return one_way(service, "Send", true);
    case fiona::PUSH_NEWEST: return one_way(service, "PushNewest", false);
    case fiona::PUSH_TIMED: return one_way(service, "PushTimed", false);
    case fiona::QUERY: return query(service);
    case fiona::EVENT: return event(service);
    default: return wrong(service, "option (fiona.contract) names no pattern");
  }
}

class Generator final : public google::protobuf::compiler::CodeGenerator {
 public:
  std::uint64_t GetSupportedFeatures() const override { return FEATURE_PROTO3_OPTIONAL; }

  bool Generate(const FileDescriptor* file, const std::string&, google::protobuf::compiler::GeneratorContext* context,
                std::string* error) const override {
    const std::string stem = file->name().substr(0, file->name().size() - std::string(".proto").size());
    const std::unique_ptr<google::protobuf::io::ZeroCopyOutputStream> stream(context->Open(stem + ".fiona.hpp"));
    google::protobuf::io::Printer printer(stream.get(), '$');
    printer.Print("// Generated from $file$; do not edit.\n#pragma once\n\n", "file", file->name());
    printer.Print("#include <fiona/service.hpp>\n\n#include \"$stem$.pb.h\"\n\n", "stem", stem);
    printer.Print("namespace $space$ {\n", "space", with_colons(file->package()));
    for (int i = 0; i < file->service_count(); ++i) {
      const Base base = base_of(*file->service(i));
      if (!base.error.empty()) {
        *error = base.error;
        return false;
      }
      print_service(printer, *file->service(i), base.text);
    }
    printer.Print("\n}  // namespace $space$\n", "space", with_colons(file->package()));
    return true;
  }

 private:
  static void print_service(google::protobuf::io::Printer& printer, const ServiceDescriptor& service,
                            const std::string& base) {
    const std::map<std::string, std::string> words{{"name", service.name()},
                                                   {"full", service.full_name()},
                                                   {"base", base},
                                                   {"doc", service.options().GetExtension(fiona::service_doc)}};
    printer.Print(words,
                  "\n/// $doc$\n"
                  "struct $name$ : $base$ {\n"
                  "  static const ::fiona::ServiceInfo& info() {\n"
                  "    static const ::fiona::ServiceInfo info(\n"
                  "        *::google::protobuf::DescriptorPool::generated_pool()->FindServiceByName(\"$full$\"));\n"
                  "    return info;\n"
                  "  }\n"
                  "};\n");
  }
};

}  // namespace

int main(int argc, char** argv) {
  const Generator generator;
  return google::protobuf::compiler::PluginMain(argc, argv, &generator);
}
