// fiona-host: the process that holds a running system. People start it through `fiona run`.
#include <fcntl.h>
#include <signal.h>
#include <sys/prctl.h>
#include <sys/signalfd.h>
#include <unistd.h>

#include <google/protobuf/stubs/logging.h>

#include <boost/program_options.hpp>
#include <iostream>
#include <memory>
#include <string>
#include <utility>

#include "control_server.hpp"
#include "fiona/error.hpp"
#include "fiona/tool.hpp"
#include "group.hpp"
#include "last_words.hpp"
#include "os/process.hpp"
#include "os/spare_descriptor.hpp"
#include "os/unix_socket.hpp"
#include "os/unread.hpp"

namespace {

namespace options = boost::program_options;

/// All that it does at its end, calls of life cycles included; and where threads are kept, which do not end.
constexpr std::chrono::seconds kEndsWithin{20};
constexpr std::chrono::seconds kKeptThreads{1};

struct Flags {
  std::string name = "main";
  std::string socket;
  std::string store;
  std::string unsigned_packages;
  std::string keys;
  std::string listen;
  std::string serve;
  std::string registry;
  std::vector<std::string> peers;
  std::string plugins;
  std::string journal;
  std::string restart_reason;
  std::uint64_t restarts = 0;
  int supervisor = -1;
  std::size_t threads = 0;
  int ready = -1;
  int lifeline = -1;
  std::uint64_t group_memory = 0;
  std::uint64_t group_threads = 0;
  std::uint64_t group_descriptors = 0;
  double group_cores = 0;
  bool restore = false;
  bool taken_back = false;
  bool version = false;
  bool help = false;
};

Flags parse(int argc, char** argv, options::options_description& description) {
  Flags flags;
  auto add = description.add_options();
  add("name", options::value(&flags.name)->default_value("main"),
      "the host's name, one per user and run-time directory");
  add("socket", options::value(&flags.socket), "where it listens for consoles");
  add("store", options::value(&flags.store), "the installed packages");
  add("listen", options::value(&flags.listen),
      "tcp://ADDRESS:PORT where a host that leads may connect; port 0: a free one");
  add("serve", options::value(&flags.serve),
      "tcp://ADDRESS:PORT where consoles on other machines may connect; port 0: a free one");
  add("peer", options::value(&flags.peers),
      "NAME=HOST:PORT=KEY, a host that this one leads, or NAME=KEY of one that the registry has; may be repeated");
  add("registry", options::value(&flags.registry), "http://HOST:PORT of an etcd that says where hosts are");
  add("keys", options::value(&flags.keys),
      "the directory of the key pair and of the hosts and consoles that may connect");
  add("unsigned", options::value(&flags.unsigned_packages), "store of packages that nobody has signed, for this run");
  add("plugins", options::value(&flags.plugins), "libraries in no package that a leading host may have loaded");
  add("threads", options::value(&flags.threads)->default_value(0), "threads for instances; 0: one per core");
  add("ready-fd", options::value(&flags.ready)->default_value(-1), "descriptor that gets READY once it listens");
  add("lifeline-fd", options::value(&flags.lifeline)->default_value(-1), "descriptor whose end ends the host");
  const fiona::os::Limits limits;
  add("group-memory", options::value(&flags.group_memory)->default_value(limits.memory >> 20U),
      "MiB of memory that each group may take");
  add("group-threads", options::value(&flags.group_threads)->default_value(limits.threads),
      "threads that each group may have");
  add("group-descriptors", options::value(&flags.group_descriptors)->default_value(limits.descriptors),
      "descriptors that each group may have open");
  add("group-cpu", options::value(&flags.group_cores)->default_value(limits.cores),
      "cores that each group may take in the long run, 0.5 or so; 0: as many as there are");
  add("journal", options::value(&flags.journal), "where its changes are kept; without it: beside the socket");
  add("restore", options::bool_switch(&flags.restore),
      "begins with the system that this host's last journal ends with");
  add("supervisor-fd", options::value(&flags.supervisor)->default_value(-1),
      "descriptor of the supervisor that has started it");
  add("restarts", options::value(&flags.restarts)->default_value(0), "how often the supervisor has started it again");
  add("restart-reason", options::value(&flags.restart_reason), "how the host before it has ended");
  add("taken-back", options::bool_switch(&flags.taken_back),
      "another build was to take its place, and has not come up, or not gone on");
  add("version", options::bool_switch(&flags.version), "prints the version");
  add("help", options::bool_switch(&flags.help), "prints this");
  options::variables_map values;
  options::store(options::parse_command_line(argc, argv, description), values);
  options::notify(values);
  return flags;
}

std::filesystem::path runtime_directory() {
  const char* directory = std::getenv("XDG_RUNTIME_DIR");
  if (directory && *directory) return std::filesystem::path(directory) / "fiona";
  return "/tmp/fiona-" + std::to_string(::geteuid());
}

/// Once; false if nobody waits to hear it, or nobody does any more.
bool tell(int& descriptor, const std::string& line) {
  if (descriptor < 0) return false;
  const bool told = ::write(descriptor, line.data(), line.size()) == static_cast<ssize_t>(line.size());
  ::close(std::exchange(descriptor, -1));
  return told;
}

/// Signals that end the run, as a descriptor; blocked before any thread starts.
int signals_as_descriptor() {
  sigset_t ending;
  sigemptyset(&ending);
  sigaddset(&ending, SIGINT);
  sigaddset(&ending, SIGTERM);
  sigprocmask(SIG_BLOCK, &ending, nullptr);
  return ::signalfd(-1, &ending, SFD_CLOEXEC | SFD_NONBLOCK);
}

constexpr std::uint64_t kLeastMemory_MiB = 64;
constexpr std::uint64_t kLeastThreads = 8;
constexpr std::uint64_t kLeastDescriptors = 64;

fiona::os::Limits limits_of(const Flags& flags) {
  if (flags.group_memory < kLeastMemory_MiB || flags.group_threads < kLeastThreads ||
      flags.group_descriptors < kLeastDescriptors || !(flags.group_cores >= 0)) {
    throw fiona::Error(fiona::ErrorCode::Usage,
                       {.what = "a group cannot live with so little",
                        .expected = "--group-memory of 64 MiB or more, --group-threads of 8 or more, "
                                    "--group-descriptors of 64 or more, --group-cpu of 0 or more"});
  }
  return {flags.group_memory << 20U, flags.group_threads, flags.group_descriptors, flags.group_cores};
}

/// Where the journal is, and what keeps other hosts from it.
struct Place {
  std::filesystem::path file;
  fiona::os::Descriptor lock;
};

/// One that cannot be where it is to be is beside the socket, where no other host of this name can be.
Place place_of_journal(const Flags& flags, const std::filesystem::path& socket) {
  auto beside = socket;
  beside.replace_extension(".journal");
  if (flags.journal.empty()) return {beside, {}};
  const std::filesystem::path wanted = flags.journal;
  std::string why = "another host of this name writes that";
  try {
    fiona::os::require_private_directory(wanted.parent_path());
    if (auto lock = fiona::os::try_lock(wanted.string() + ".lock")) return {wanted, std::move(lock)};
  } catch (const fiona::Error& error) {
    why = error.text().what + ": " + error.text().found;
  }
  std::cerr << "the journal is " << beside.string() << ", and not " << wanted.string() << ": " << why << "\n";
  return {beside, {}};
}

int serve(Flags& flags) {
  fiona::host::require_descriptors_to_start();
  const int signals = signals_as_descriptor();
  const std::filesystem::path socket =
      flags.socket.empty() ? runtime_directory() / (flags.name + ".sock") : std::filesystem::path(flags.socket);
  fiona::os::require_private_directory(socket.parent_path());
  const std::filesystem::path store =
      flags.store.empty() ? fiona::marketplace::Store::default_directory() : std::filesystem::path(flags.store);
  fiona::host::HostOptions hosts{flags.keys, flags.listen, {}, flags.serve, flags.registry};
  for (const auto& peer : flags.peers) hosts.peers.push_back(fiona::host::PeerAddress::from_text(peer));
  std::unique_ptr<fiona::host::SupervisorLink> supervisor;
  if (flags.supervisor >= 0) {
    ::fcntl(flags.supervisor, F_SETFD, FD_CLOEXEC);
    supervisor =
        std::make_unique<fiona::host::SupervisorLink>(fiona::os::PacketSocket(fiona::os::Descriptor(flags.supervisor)));
    supervisor->beat();  // that it has come so far
  }
  fiona::host::System::Options options{.name = flags.name,
                                       .store = store,
                                       .unsigned_packages = flags.unsigned_packages,
                                       .directory = socket.parent_path(),
                                       .threads = flags.threads,
                                       .hosts = std::move(hosts),
                                       .plugins = flags.plugins,
                                       .group_limits = limits_of(flags),
                                       .supervisor = supervisor.get(),
                                       .restarts = flags.restarts,
                                       .restart_reason = flags.restart_reason,
                                       .taken_back = flags.taken_back};
  const Place journal = place_of_journal(flags, socket);
  const std::filesystem::path last_words = journal.file.string() + ".last-words";
  std::error_code none;
  if (!flags.restore) std::filesystem::remove(last_words, none);
  options.last_words = fiona::host::LastWords::told_in(last_words);
  fiona::host::LastWords::leave_in(last_words);
  fiona::host::ControlServer server(socket, std::move(options), flags.restore, journal.file);
  if (!server.listens().empty()) std::cerr << "listens at " << server.listens() << "\n";
  if (!server.serves().empty()) std::cerr << "serves consoles at " << server.serves() << "\n";
  if (flags.restarts == 0) server.meet_peers(flags.lifeline, signals);
  tell(flags.ready, "READY\n" + server.listens());
  const int code = server.serve(flags.lifeline, signals, [&server](int told) {
    // A thread that a component keeps is not waited for.
    fiona::os::end_within(server.has_kept_threads() ? kKeptThreads : kEndsWithin, told);
  });
  // Its groups go on without it, and the next host finds them.
  if (supervisor && !server.was_ended()) ::_exit(code);
  return code;
}

}  // namespace

int main(int argc, char** argv) {
  options::options_description description("fiona-host: holds a running system");
  Flags flags;
  fiona::open_standard_streams();
  // What a peer garbles is counted where it is refused; the library would write a line for each message.
  google::protobuf::SetLogHandler(nullptr);
  ::prctl(PR_SET_NAME, "fiona-host");  // started from a descriptor, it would have that one's number for its name
  fiona::os::leave_no_core_file();
  fiona::os::keep_freed_memory();
  fiona::os::keep_spare_descriptor();
  // Whoever reads what it says may go first. A handler, unlike SIG_IGN, is not handed down to what it starts.
  ::signal(SIGPIPE, [](int) {});
  fiona::os::wait_for_no_reader();
  try {
    flags = parse(argc, argv, description);
    if (flags.help) return std::cout << description, 0;
    if (flags.version) return std::cout << "fiona-host " << FIONA_VERSION << "\n", 0;
    return serve(flags);
  } catch (const options::error& error) {
    std::cerr << "fiona-host: " << error.what() << "\n  next: fiona-host --help\n";
    return 2;
  } catch (const fiona::Error& error) {
    if (!tell(flags.ready, std::string(error.what()) + "\n")) std::cerr << "fiona-host: " << error.what() << "\n";
    return static_cast<int>(error.code());
  } catch (const std::exception& error) {
    if (!tell(flags.ready, std::string(error.what()) + "\n")) std::cerr << "fiona-host: " << error.what() << "\n";
    return 1;
  }
}
