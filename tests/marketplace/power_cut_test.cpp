#include <gtest/gtest.h>
#include <unistd.h>

#include <algorithm>
#include <fiona/marketplace/index.hpp>
#include <fiona/marketplace/install.hpp>
#include <map>
#include <memory>

#include "support.hpp"

namespace fiona::marketplace {
namespace {

using namespace testing;
namespace filesystem = std::filesystem;

// A file or directory as a disk with a cache knows it: what programs see, and what a power cut leaves.
struct Node {
  bool directory = false;
  std::string data, durable_data;
  std::map<std::string, std::shared_ptr<Node>> entries, durable_entries;
};

// Which of the two extremes the disk chose: nothing that was not synced, or all names and no data that was
// not synced (a file system that writes its journal early and file contents late).
enum class Loss { EverythingUnsynced, DataUnsynced };

// The directory that the test's store is in, followed call by call.
class ModelDisk {
 public:
  explicit ModelDisk(filesystem::path root) : root_(std::move(root)), top_(load(root_)) {}

  // The real calls, each also done to the model; `synced` says whether the n-th fsync reaches the disk.
  // `after` is called when each is done.
  OsCalls calls(std::function<bool(int)> synced, std::function<void()> after) {
    const OsCalls real = system_calls();
    const auto done = [after](auto result) { return after(), result; };
    OsCalls os = real;
    os.create = [=, this](int directory, const char* name, mode_t mode) {
      parent_of(where(directory) / name).entries[filesystem::path(name).filename()] = std::make_shared<Node>();
      return done(real.create(directory, name, mode));
    };
    os.mkdir = [=, this](int directory, const char* name, mode_t mode) {
      const auto node = std::make_shared<Node>();
      node->directory = true;
      parent_of(where(directory) / name).entries[filesystem::path(name).filename()] = node;
      return done(real.mkdir(directory, name, mode));
    };
    os.write = [=, this](int file, const void* bytes, std::size_t size) {
      at(where(file)).data.append(static_cast<const char*>(bytes), size);
      return done(real.write(file, bytes, size));
    };
    os.fsync = [=, this](int file) {
      if (synced(++syncs_)) {
        Node& node = at(where(file));
        node.durable_data = node.data;
        node.durable_entries = node.entries;
      }
      return done(real.fsync(file));
    };
    os.rename = [=, this](int from_directory, const char* from, int to_directory, const char* to) {
      auto moved = at(where(from_directory)).entries.extract(from);
      at(where(to_directory)).entries[to] = moved.mapped();
      return done(real.rename(from_directory, from, to_directory, to));
    };
    os.unlink = [=, this](int directory, const char* name, int flags) {
      at(where(directory)).entries.erase(name);
      return done(real.unlink(directory, name, flags));
    };
    return os;
  }

  // Writes what a power cut now would leave.
  void leave(const filesystem::path& to, Loss loss) const {
    filesystem::remove_all(to);
    leave(*top_, to, loss);
  }

  int syncs() const { return syncs_; }

 private:
  // What is there at the beginning is on the disk.
  static std::shared_ptr<Node> load(const filesystem::path& path) {
    const auto node = std::make_shared<Node>();
    node->directory = filesystem::is_directory(path);
    if (!node->directory)
      node->data = node->durable_data = file_content(path);
    else
      for (const auto& entry : filesystem::directory_iterator(path)) {
        node->entries[entry.path().filename()] = load(entry.path());
      }
    node->durable_entries = node->entries;
    return node;
  }

  static void leave(const Node& node, const filesystem::path& to, Loss loss) {
    if (!node.directory) return write_file(to, node.durable_data);
    filesystem::create_directories(to);
    const auto& entries = loss == Loss::DataUnsynced ? node.entries : node.durable_entries;
    for (const auto& [name, child] : entries) leave(*child, to / name, loss);
  }

  filesystem::path where(int descriptor) const {
    return filesystem::read_symlink("/proc/self/fd/" + std::to_string(descriptor)).lexically_relative(root_);
  }

  Node& at(const filesystem::path& path) {
    Node* node = top_.get();
    for (const auto& element : path) {
      if (element != ".") node = node->entries.at(element).get();
    }
    return *node;
  }

  Node& parent_of(const filesystem::path& path) { return at(path.parent_path().empty() ? "." : path.parent_path()); }

  filesystem::path root_;
  std::shared_ptr<Node> top_;
  int syncs_ = 0;
};

class PowerCut : public ::testing::Test {
 protected:
  PowerCut() {
    publish_plugin(scratch_.path(), market_, "steps", "1.0.0", "old");
    install("steps", Marketplace{market_}, store_);
    publish_plugin(scratch_.path(), market_, "steps", "2.0.0", "new");
  }

  // The installed version in a store that a power cut left, or what is wrong with it.
  static std::string state(const filesystem::path& store) {
    try {
      std::string versions;
      for (const auto& package : Store{store}.installed()) {
        Store{store}.verify(package);
        versions += package.manifest.version();
      }
      // What a rollback would go back to has to be as safe.
      const auto history = Store{store}.history();
      for (const auto& generation : history) {
        if (!generation.fault.empty()) return generation.fault;
        if (generation.packages != 1) return "generation " + std::to_string(generation.number) + " is not whole";
      }
      if (!history.empty() && history.size() < history.front().number) return "a generation is missing";
      return versions;
    } catch (const Error& error) {
      return error.text().what;
    }
  }

  struct Outcome {
    std::vector<std::string> states;  // after a cut behind each call, both losses
    std::string last;                 // after a cut behind the last, with everything unsynced lost
    int syncs = 0;
  };

  // Upgrades a store that sits in a model disk whose n-th fsync is lost, and cuts the power behind each call.
  Outcome upgrade(int lost_sync) {
    const filesystem::path disk = scratch_ / "copy";
    filesystem::remove_all(disk);
    filesystem::copy(scratch_ / "disk", disk, filesystem::copy_options::recursive);
    ModelDisk model{disk};
    Outcome outcome;
    const auto cut = [&] {
      for (const Loss loss : {Loss::EverythingUnsynced, Loss::DataUnsynced}) {
        model.leave(scratch_ / "left", loss);
        outcome.states.push_back(state(scratch_ / "left/store"));
        if (loss == Loss::EverythingUnsynced) outcome.last = outcome.states.back();
      }
    };
    InstallOptions options;
    options.os = model.calls([&](int sync) { return sync != lost_sync; }, cut);
    install("steps", Marketplace{market_}, disk / "store", options);
    outcome.syncs = model.syncs();
    return outcome;
  }

  Scratch scratch_;
  filesystem::path market_ = scratch_ / "market";
  filesystem::path store_ = scratch_ / "disk/store";
};

TEST_F(PowerCut, BehindAnyCallTheStoreIsOldOrNewAndAtTheEndNew) {
  const Outcome outcome = upgrade(0);
  ASSERT_GT(outcome.states.size(), 20u);
  for (std::size_t i = 0; i < outcome.states.size(); ++i) {
    EXPECT_TRUE(outcome.states[i] == "1.0.0" || outcome.states[i] == "2.0.0") << outcome.states[i] << " at cut " << i;
  }
  EXPECT_EQ(outcome.last, "2.0.0");
}

TEST_F(PowerCut, ALostSyncOfAnyFileOrDirectoryThatMattersIsNoticed) {
  const int syncs = upgrade(0).syncs;
  std::vector<int> unnoticed;
  for (int lost = 1; lost <= syncs; ++lost) {
    const Outcome outcome = upgrade(lost);
    const bool whole =
        std::ranges::all_of(outcome.states, [](const auto& state) { return state == "1.0.0" || state == "2.0.0"; });
    if (whole && outcome.last == "2.0.0") unnoticed.push_back(lost);
  }
  EXPECT_EQ(unnoticed, std::vector<int>{}) << "of " << syncs;
}

TEST_F(PowerCut, TheFirstInstallationOfAllIsDurableToo) {
  const filesystem::path disk = scratch_ / "empty";
  filesystem::create_directory(disk);
  ModelDisk model{disk};
  InstallOptions options;
  std::vector<std::string> states;
  const auto cut = [&] {
    model.leave(scratch_ / "left", Loss::EverythingUnsynced);
    states.push_back(state(scratch_ / "left/fiona/store"));
  };
  options.os = model.calls([](int) { return true; }, cut);
  install("steps", Marketplace{market_}, disk / "fiona/store", options);
  for (const auto& found : states) EXPECT_TRUE(found.empty() || found == "2.0.0") << found;
  EXPECT_EQ(states.back(), "2.0.0");
}

}  // namespace
}  // namespace fiona::marketplace
