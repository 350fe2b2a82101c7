#include "system_check.hpp"

#include <algorithm>
#include <map>
#include <set>

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <fiona/contract.hpp>
#include <fiona/marketplace/manifest.hpp>
#include <fiona/params.hpp>

#include "script.hpp"
#include "system_view.hpp"
#include "verb_table.hpp"
#include "watch_list.hpp"

namespace fiona::console {
namespace {

/// The system that a file would make, line by line, without making it.
class Checker {
 public:
  explicit Checker(const Catalogue& catalogue) : catalogue_(catalogue) {}

  void check(std::string_view text, const std::string& origin) {
    std::vector<WordLine> lines;
    try {
      lines = split_script(text, origin);
    } catch (const LineError& error) {
      // The grammar of one line is gone, so where the next command begins is a guess: the rest is not read.
      result_.errors.push_back(error);
      return;
    }
    for (const WordLine& words : lines) {
      ++result_.lines;
      try {
        take(read_line(words));
      } catch (const LineError& error) {
        result_.errors.push_back(error);
      }
    }
  }

  CheckResult finish() {
    for (const auto& [name, instance] : known_.instances) add_spots(name, instance);
    if (begun_)
      result_.errors.push_back(
          begun_->error(begun_->verb, {.what = "this transaction is not committed", .next = "commit"}));
    result_.instances = known_.instances.size();
    return std::move(result_);
  }

 private:
  struct Instance {
    KnownComponent known;  ///< without a component where the plugin is a path: then nothing is known of it
  };

  void take(const Line& line) {
    static const std::map<std::string, void (Checker::*)(const Line&)> kChecks{
        {"load", &Checker::take_load},       {"unload", &Checker::take_unload}, {"wire", &Checker::take_wire},
        {"unwire", &Checker::take_unwire},   {"swap", &Checker::take_swap},     {"begin", &Checker::take_begin},
        {"commit", &Checker::take_commit},   {"abort", &Checker::take_abort},   {"set", &Checker::take_set},
        {"state", &Checker::take_mode},      {"wait", &Checker::take_mode},     {"watch", &Checker::take_watch},
        {"record", &Checker::take_record},   {"get", &Checker::take_instance},  {"call", &Checker::take_call},
        {"send", &Checker::take_call},       {"source", &Checker::take_source}, {"expect", &Checker::take_expect},
        {"sleep", &Checker::take_sleep},     {"market", &Checker::take_market}, {"run", &Checker::take_run},
        {"upgrade", &Checker::take_instance}};
    if (const auto found = kChecks.find(line.verb.text); found != kChecks.end()) (this->*found->second)(line);
  }

  void take_load(const Line& line) {
    const Word& plugin = line.positional[0];
    const bool is_path = !marketplace::library_path(plugin.text).empty();
    std::vector<KnownComponent> found = is_path ? std::vector<KnownComponent>{} : catalogue_.find(plugin.text);
    if (is_path)
      result_.remarks.push_back(fmt::format("{}: what {} is cannot be known without opening it",
                                            place_text(line.words, plugin.place), plugin.text));
    // An instance that cannot be loaded is remembered too: the lines that use it are not wrong for that.
    const KnownComponent known = found.size() == 1 ? found.front() : KnownComponent{};
    const Word* as = line.clause("as");
    const std::string name = as != nullptr                ? as->text
                             : known.component != nullptr ? known.component->name()
                                                          : plugin.text.substr(plugin.text.rfind('/') + 1);
    if (known_.instances.contains(name))
      throw line.error(as != nullptr ? *as : plugin, {.what = fmt::format("there is an instance '{}' already", name),
                                                      .next = "give it another name: as NAME"});
    if (name == "host")
      throw line.error(as != nullptr ? *as : plugin,
                       {.what = "'host' is the host's own name", .next = "give it another name: as NAME"});
    known_.instances[name] = {known};
    if (!is_path) check_found(line, plugin, found);
    if (const Word* mode = line.clause("at")) check_mode(line, *mode, known_.instances[name]);
    check_rights(line, plugin, known);
    check_parameters(line, known_.instances[name]);
  }

  /// What its manifest asks for, and what the operator alone gives: the host looks at those.
  static bool is_of_sandbox(std::string_view right) {
    return right == "confined" || right == "unconfined" || marketplace::opens_sandbox(right);
  }

  void check_rights(const Line& line, const Word& plugin, const KnownComponent& known) {
    if (known.component == nullptr) return;
    const auto& asked = known.component->rights();
    const Word* granted = line.clause("with");
    if (granted == nullptr && !asked.empty()) {
      result_.remarks.push_back(fmt::format("{}: {} asks for the right '{}' and does not get it: load {} with {}",
                                            place_text(line.words, plugin.place), plugin.text, asked[0], plugin.text,
                                            asked[0]));
    }
    if (granted == nullptr || is_of_sandbox(granted->text) ||
        std::find(asked.begin(), asked.end(), granted->text) != asked.end())
      return;
    throw line.error(*granted, {.what = fmt::format("{} has no use for the right '{}'", plugin.text, granted->text),
                                .next = "leave it out"});
  }

  void check_found(const Line& line, const Word& plugin, const std::vector<KnownComponent>& found) const {
    if (found.empty()) {
      throw line.error(plugin,
                       {.what = fmt::format("no plugin '{}' is installed or in the marketplace", plugin.text),
                        .next = fmt::format("market search {}", typed_text(plugin.text)),
                        .near = nearest_names(plugin.text, catalogue_.names())},
                       ErrorCode::NotFound);
    }
    const KnownPlugin* first = found.front().plugin;
    if (found.size() > 1) {
      std::vector<std::string> names;
      for (const KnownComponent& known : found) names.push_back(known.load_name());
      throw line.error(plugin, {.what = fmt::format("'{}' means several components", plugin.text),
                                .expected = fmt::format("{}", fmt::join(names, ", "))});
    }
    if (!first->installed && !known_.offered.contains(first->name())) {
      throw line.error(plugin,
                       {.what = fmt::format("the plugin '{}' is not installed; the marketplace has it", plugin.text),
                        .next = fmt::format("market install {}", first->name())},
                       ErrorCode::NotFound);
    }
  }

  void check_parameters(const Line& line, const Instance& instance) {
    if (line.arguments.empty() || instance.known.component == nullptr) return;
    const std::string& type = instance.known.component->parameters();
    if (type.empty())
      throw line.error(
          line.arguments.front().name,
          {.what = fmt::format("{} has no parameters", instance.known.component->name()), .next = "leave them out"});
    const std::unique_ptr<google::protobuf::Message> draft =
        instance.known.plugin->installed ? catalogue_.types_of(*instance.known.plugin).make(type) : nullptr;
    if (draft == nullptr) {
      result_.remarks.push_back(fmt::format("{}: the parameters of {} can be checked once it is installed",
                                            place_text(line.words, line.verb.place), instance.known.plugin->name()));
      return;
    }
    set_declared_defaults(*draft);
    const std::vector<control::Argument> arguments = line.control_arguments();
    for (std::size_t i = 0; i < arguments.size(); ++i) {
      try {
        set_fields(*draft, std::span(&arguments[i], 1));
      } catch (const Error& error) {
        throw LineError(line.words, line.arguments[i].name.place, error.text(), error.code());
      }
    }
  }

  Instance& instance_of(const Line& line, const Word& word) {
    const std::string name = word.text.substr(0, word.text.find('.'));
    const auto found = known_.instances.find(name);
    if (found != known_.instances.end()) return found->second;
    std::vector<std::string> known;
    for (const auto& [other, instance] : known_.instances) known.push_back(other);
    throw line.error(
        word, {.what = fmt::format("no line above loads an instance '{}'", name), .near = nearest_names(name, known)},
        ErrorCode::NotFound);
  }

  /// The port, or nothing where the plugin's interface is not known.
  const fiona::PortInterface* port_of(const Line& line, const Word& word) {
    const control::PortName name = port_name(word, line.words);
    const Instance& instance = instance_of(line, word);
    if (instance.known.component == nullptr) return nullptr;
    std::vector<std::string> known;
    for (const auto& port : instance.known.component->ports()) {
      if (port.name() == name.port()) return &port;
      known.push_back(port.name());
    }
    throw line.error(word,
                     {.what = fmt::format("{} has no port '{}'", name.instance(), name.port()),
                      .expected = fmt::format("{}", fmt::join(known, ", ")),
                      .near = nearest_names(name.port(), known)},
                     ErrorCode::NotFound);
  }

  void take_wire(const Line& line) {
    const Word& client = line.positional[0];
    const auto* required = port_of(line, client);
    if (const Word* every = line.clause("every")) count_of(*every, line.words);
    if (required != nullptr && required->direction() != fiona::REQUIRES)
      throw line.error(
          client, {.what = fmt::format("{} is a provided port", client.text), .expected = "wire REQUIRED to PROVIDED"},
          ErrorCode::WiringInvalid);
    std::vector<Word> providers = line.clause_words("else");
    if (const Word* hold = line.argument("hold")) check_hold(line, *hold, providers.empty());
    providers.insert(providers.begin(), *line.clause("to"));
    for (auto one = providers.begin(); one != providers.end(); ++one) {
      if (std::any_of(providers.begin(), one, [&](const Word& other) { return other.text == one->text; }))
        throw line.error(*one, {.what = fmt::format("{} is named twice", one->text),
                                .expected = "each alternative once, the best first"});
      check_provider(line, required, *one);
    }
    known_.wired.insert(client.text);
  }

  static void check_hold(const Line& line, const Word& hold, bool alone) {
    const double hold_ms = duration_ms(hold, line.words);
    if (alone)
      throw line.error(hold, {.what = "a hold time is for a wire with alternatives", .next = "else INSTANCE.PORT"});
    if (hold_ms > 3'600'000) throw line.error(hold, {.what = "the hold time is out of range", .expected = "0s .. 1h"});
  }

  void check_provider(const Line& line, const fiona::PortInterface* required, const Word& provider) {
    const auto* provided = port_of(line, provider);
    if (provided != nullptr && provided->direction() != fiona::PROVIDES)
      throw line.error(
          provider,
          {.what = fmt::format("{} is a required port", provider.text), .expected = "wire REQUIRED to PROVIDED"},
          ErrorCode::WiringInvalid);
    if (required != nullptr && provided != nullptr) check_contract(line, *required, provider, *provided);
  }

  void check_contract(const Line& line, const fiona::PortInterface& required, const Word& provider,
                      const fiona::PortInterface& provided) {
    const Word& client = line.positional[0];
    const auto found = service_of(instance_of(line, client), required.service());
    const auto offered = service_of(instance_of(line, provider), provided.service());
    std::optional<std::string> difference;
    if (found != nullptr && offered != nullptr)
      difference = contract_difference(*found, *offered);
    else if (required.service() != provided.service())
      difference = "the services differ";
    if (!difference) return;
    const std::vector<std::string> fitting = providers_of(required.service());
    throw line.error(
        provider,
        {.what = fmt::format("{} requires {}, {} provides {}: {}", client.text, short_name(required.service()),
                             provider.text, short_name(provided.service()), *difference),
         .next = fitting.empty()
                     ? ""
                     : fmt::format("these provide {}: {}", short_name(required.service()), fmt::join(fitting, ", "))},
        ErrorCode::WiringInvalid);
  }

  const google::protobuf::ServiceDescriptor* service_of(const Instance& instance, const std::string& service) const {
    return catalogue_.types_of(*instance.known.plugin).service(service);
  }

  std::vector<std::string> providers_of(const std::string& service) const {
    std::vector<std::string> ports;
    for (const auto& [name, instance] : known_.instances) {
      if (instance.known.component == nullptr) continue;
      for (const auto& port : instance.known.component->ports()) {
        if (port.direction() == fiona::PROVIDES && port.service() == service) ports.push_back(name + "." + port.name());
      }
    }
    return ports;
  }

  void check_mode(const Line& line, const Word& mode, const Instance& instance) const {
    if (instance.known.component == nullptr) return;
    std::vector<std::string> known{"neutral", "deactivated"};
    for (const auto& one : instance.known.component->modes()) known.push_back(one.name());
    if (instance.known.component->modes().empty()) known.emplace_back("active");
    if (line.verb.text == "wait") known.insert(known.end(), {"init", "failed", "shutdown"});
    if (std::find(known.begin(), known.end(), mode.text) != known.end()) return;
    throw line.error(mode,
                     {.what = fmt::format("{} has no mode '{}'", instance.known.component->name(), mode.text),
                      .expected = fmt::format("{}", fmt::join(known, ", ")),
                      .near = nearest_names(mode.text, known)},
                     ErrorCode::NotFound);
  }

  void take_unload(const Line& line) {
    instance_of(line, line.positional[0]);
    known_.instances.erase(line.positional[0].text);
  }
  void take_unwire(const Line& line) {
    port_of(line, line.positional[0]);
    known_.wired.erase(line.positional[0].text);
  }
  void take_swap(const Line& line) {
    instance_of(line, line.positional[0]);
    instance_of(line, *line.clause("for"));
  }
  void take_begin(const Line& line) {
    if (begun_) throw line.error(line.verb, {.what = "a transaction has begun already", .next = "commit, or abort"});
    begun_ = line;
    before_ = known_;
  }
  void take_commit(const Line& line) {
    if (!begun_) throw line.error(line.verb, {.what = "no transaction has begun", .next = "begin"});
    begun_.reset();
  }
  /// Nothing of it comes.
  void take_abort(const Line& line) {
    take_commit(line);
    known_ = before_;
  }
  void take_set(const Line& line) {
    if (line.positional[0].text == "host") return check_host(line);
    check_parameters(line, instance_of(line, line.positional[0]));
  }
  void check_host(const Line& line) const {
    const std::vector<std::string> known{"clock", "deliveries", "speed", "start"};
    for (const TypedArgument& argument : line.arguments) {
      if (std::find(known.begin(), known.end(), argument.name.text) == known.end())
        throw line.error(argument.name,
                         {.what = fmt::format("the host has no parameter '{}'", argument.name.text),
                          .expected = "clock, deliveries, speed, start",
                          .near = nearest_names(argument.name.text, known)},
                         ErrorCode::NotFound);
      const bool sound =
          argument.name.text != "clock" || argument.value.text == "system" || argument.value.text == "virtual";
      if (!sound)
        throw line.error(argument.value, {.what = fmt::format("there is no clock '{}'", argument.value.text),
                                          .expected = "system, virtual"});
    }
  }
  void take_mode(const Line& line) {
    const Instance& instance = instance_of(line, line.positional[0]);
    if (const Word* within = line.clause("for")) duration_ms(*within, line.words);
    if (line.positional.size() > 1) check_mode(line, line.positional[1], instance);
  }
  void take_call(const Line& line) {
    const control::PortName target = port_name(line.positional[0], line.words);
    Word instance = line.positional[0];
    instance.text = target.instance();
    instance_of(line, instance);
    if (const Word* within = line.clause("for")) duration_ms(*within, line.words);
  }
  void take_instance(const Line& line) {
    if (line.positional[0].text != "host") instance_of(line, line.positional[0]);
  }
  void take_watch(const Line& line) {
    if (line.positional[0].text == "stop") return;
    const WatchRequest request = watch_request(line);
    check_watched(line, line.positional[0], request.port.port());
  }
  void take_record(const Line& line) {
    if (line.positional[0].text == "stop") return;
    const std::vector<WatchRequest> requests = record_requests(line);
    for (std::size_t i = 0; i < requests.size(); ++i)
      check_watched(line, line.positional[i + 1], requests[i].port.port());
  }
  /// A port or probe of an instance, where the plugin's interface is known.
  void check_watched(const Line& line, const Word& word, const std::string& name) {
    const Instance& instance = instance_of(line, word);
    if (instance.known.component == nullptr) return;
    std::vector<std::string> known;
    for (const auto& port : instance.known.component->ports()) known.push_back(port.name());
    for (const ProbeInfo& probe : probes_of(*instance.known.component)) known.push_back(probe.name);
    if (std::find(known.begin(), known.end(), name) != known.end()) return;
    throw line.error(
        word,
        {.what = fmt::format("{} has no port or probe '{}'", word.text.substr(0, word.text.find('.')), name),
         .near = nearest_names(name, known)},
        ErrorCode::NotFound);
  }
  void take_expect(const Line& line) {
    Word port = line.positional[0];
    const std::size_t first = port.text.find('.');
    const std::size_t second = first == std::string::npos ? first : port.text.find('.', first + 1);
    if (first == std::string::npos)
      throw line.error(port, {.what = fmt::format("'{}' names no field and no probe", port.text),
                              .expected = "instance.port.field, instance.probe"});
    if (second != std::string::npos) port.text.resize(second);
    check_watched(line, line.positional[0], port.text.substr(first + 1));
    if (const Word* within = line.clause("for")) duration_ms(*within, line.words);
  }
  void take_sleep(const Line& line) { duration_ms(line.positional[0], line.words); }
  void take_run(const Line& line) {
    throw line.error(
        line.verb, {.what = "a system file cannot start a host", .next = "source FILE runs the lines of another file"});
  }
  void take_market(const Line& line) {
    for (std::size_t i = 1; i < line.positional.size() && line.positional[0].text == "install"; ++i) {
      for (const KnownComponent& known :
           catalogue_.find(line.positional[i].text.substr(0, line.positional[i].text.find('@'))))
        known_.offered.insert(known.plugin->name());
    }
  }
  void take_source(const Line& line) {
    const std::filesystem::path file = named_file(line.words, line.positional[0].text);
    if (!sourcing_.insert(file.lexically_normal().string()).second)
      throw line.error(line.positional[0],
                       {.what = "files source each other in a circle", .next = "take one of them out"});
    if (++sourced_ > kMostSourced)
      throw line.error(line.positional[0], {.what = fmt::format("more than {} files are sourced", kMostSourced),
                                            .next = "source parts of them one after the other"});
    try {
      check(read_text(file), file.string());
    } catch (const Error& error) {
      sourcing_.erase(file.lexically_normal().string());
      throw LineError(line.words, line.positional[0].place, error.text(), error.code());
    }
    sourcing_.erase(file.lexically_normal().string());
  }

  void add_spots(const std::string& name, const Instance& instance) {
    if (instance.known.component == nullptr) return;
    for (const auto& port : instance.known.component->ports()) {
      const std::string full = name + "." + port.name();
      if (port.direction() == fiona::REQUIRES && !known_.wired.contains(full))
        result_.spots.push_back({full, port.service(), port.optional(), providers_of(port.service())});
    }
  }

  const Catalogue& catalogue_;
  CheckResult result_;
  /// What the lines so far have made.
  struct Known {
    std::map<std::string, Instance> instances{};
    std::set<std::string> wired{};
    std::set<std::string> offered{};  ///< by `market install` lines above
  };
  Known known_;
  Known before_;  ///< the transaction that has begun
  std::size_t sourced_ = 0;
  std::set<std::string> sourcing_;
  std::optional<Line> begun_;
};

}  // namespace

CheckResult check_text(std::string_view text, const std::string& origin, const Catalogue& catalogue) {
  Checker checker(catalogue);
  checker.check(text, origin);
  return checker.finish();
}

CheckResult check_system(const std::filesystem::path& file, const Catalogue& catalogue) {
  return check_text(read_text(file), file.string(), catalogue);
}

}  // namespace fiona::console
