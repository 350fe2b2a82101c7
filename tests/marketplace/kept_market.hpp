#pragma once

#include <gtest/gtest.h>

#include <fiona/error.hpp>
#include <fiona/marketplace/install.hpp>
#include <fiona/marketplace/keeper.hpp>
#include <fiona/marketplace/open.hpp>

#include "support.hpp"

namespace fiona::marketplace {

inline tuf::Time day(int number) {
  return std::chrono::sys_days{std::chrono::year{2030} / 1 / 1} + std::chrono::days{number};
}

/// As they are told.
inline std::vector<std::string> texts(const std::vector<Refusal>& refused) {
  std::vector<std::string> texts;
  for (const auto& one : refused) texts.push_back(one.file + ": " + one.what + "\n  next: " + one.next);
  return texts;
}

class KeptMarket : public ::testing::Test {
 protected:
  // A keeper with a marketplace, a publisher "acme" with a key of his own, and a user who trusts the marketplace.
  void SetUp() override {
    root_ = init_market(market_, keeper()).root;
    author().keys.make("acme");
    trust_marketplace(root_, market_.string(), user());
  }

  KeeperOptions keeper(int on_day = 0) const { return options("keeper", on_day); }
  KeeperOptions author(int on_day = 0) const { return options("author", on_day); }
  KeeperOptions options(const std::string& who, int on_day) const {
    KeeperOptions options{.keys = tuf::SigningKeys{scratch_ / (who + "-keys")}};
    options.now = [on_day] { return day(on_day); };
    return options;
  }
  OpenOptions user(int on_day = 0) const {
    OpenOptions options{.trusted = scratch_ / "user/trusted", .copies = scratch_ / "user/copies"};
    options.now = [on_day] { return day(on_day); };
    return options;
  }

  std::filesystem::path packed(const std::string& name, const std::string& version, const std::string& body = "code") {
    const std::filesystem::path file = scratch_ / ("out/" + name + "-" + version + ".fpk");
    std::filesystem::create_directories(file.parent_path());
    std::filesystem::remove_all(scratch_ / "source");
    pack_to(file, testing::plugin_source(scratch_ / "source", name, version, body));
    return file;
  }
  Accepted hand_in(const std::filesystem::path& file) {
    sign_package(file, author());
    submit(file, market_, author());
    return accept(market_, {acme()}, keeper());
  }
  Welcome acme() const { return {publisher_, author().keys.get(publisher_).open()}; }
  std::string install_fault(const std::string& name, int on_day = 0) {
    try {
      install(name, open_marketplace(market_.string(), user(on_day)), scratch_ / "store");
      return {};
    } catch (const Error& error) {
      return error.what();
    }
  }
  std::filesystem::path target(const std::string& ending) const {
    for (const auto& entry : std::filesystem::recursive_directory_iterator(market_ / "targets")) {
      if (entry.path().string().ends_with(ending)) return entry.path();
    }
    return {};
  }

  testing::Scratch scratch_;
  const std::filesystem::path market_ = scratch_ / "market";
  const std::string publisher_ = "acme";
  std::string root_;
};

}  // namespace fiona::marketplace
