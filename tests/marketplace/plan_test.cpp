#include <gtest/gtest.h>

#include <fiona/marketplace/compiled_protos.hpp>
#include <fiona/marketplace/index.hpp>
#include <fiona/marketplace/install.hpp>
#include <fiona/marketplace/lock.hpp>
#include <fiona/marketplace/plan.hpp>
#include <fiona/marketplace/requirement.hpp>
#include <fiona/plugin.hpp>
#include <random>

#include "../../marketplace/src/solver.hpp"
#include "support.hpp"

namespace fiona::marketplace {
namespace {

using namespace testing;
namespace filesystem = std::filesystem;

TEST(VersionRange, HasWhatIsBetweenItsBounds) {
  const VersionRange range = VersionRange::parse(" >=1.2.0 ,< 2.0.0 ", "here");
  EXPECT_EQ(range.text(), ">= 1.2.0, < 2.0.0");
  EXPECT_TRUE(range.has(*Version::parse("1.2.0")));
  EXPECT_TRUE(range.has(*Version::parse("1.99.0")));
  EXPECT_FALSE(range.has(*Version::parse("1.2.0-rc.1")));
  EXPECT_FALSE(range.has(*Version::parse("2.0.0")));
  EXPECT_TRUE(VersionRange::parse("", "here").has(*Version::parse("0.0.1")));
}

TEST(VersionRange, WhatIsNoneIsRefusedWithAnExample) {
  for (const char* text : {"1.0.0", ">= 1", ">=", ">= 1.0.0,", ">= 1.0.0 < 2.0.0", "^1.0.0", "\x1b[2J"}) {
    const Error error = error_of([&] { VersionRange::parse(text, "manifest.textproto, host"); });
    EXPECT_EQ(error.text().what, "these are not bounds of versions") << text;
    EXPECT_EQ(error.text().where, "manifest.textproto, host");
    EXPECT_EQ(error.text().expected, "such as >= 1.2.0, < 2.0.0");
    EXPECT_EQ(error.text().found.find('\x1b'), std::string::npos);
  }
}

TEST(Requirement, NamesAPackageWithItsPublisher) {
  EXPECT_EQ(Requirement::parse("acme/maps>=1.0.0", "").text(), "acme/maps >= 1.0.0");
  EXPECT_EQ(Requirement::parse("acme/maps", "").text(), "acme/maps");
  for (const char* text : {"", "maps", "acme/", "acme/Maps", "acme/maps/x", ">= 1.0.0"}) {
    EXPECT_EQ(error_of([&] { Requirement::parse(text, "here"); }).text().what, "this does not name a package") << text;
  }
}

// Debian's order of the translated versions is semver's order: its own example (rule 11), and random ones.
TEST(DebianVersion, OrdersAsSemverDoes) {
  std::vector<std::string> versions{"1.0.0-alpha",  "1.0.0-alpha.1", "1.0.0-alpha.beta", "1.0.0-beta",
                                    "1.0.0-beta.2", "1.0.0-beta.11", "1.0.0-rc.1",       "1.0.0",
                                    "1.0.0+build",  "1.0.0-rc",      "1.0.0-rc-1",       "1.0.0-alpha10",
                                    "1.0.0-alpha9", "1.0.0--",       "1.0.0-A",          "1.0.0-0"};
  std::mt19937 random(7);
  const std::string letters = "019azAZ-.";
  while (versions.size() < 300) {
    std::string text = std::to_string(random() % 3) + "." + std::to_string(random() % 12) + ".0-";
    for (unsigned i = random() % 6 + 1; i > 0; --i) text += letters[random() % letters.size()];
    if (Version::parse(text)) versions.push_back(text);
  }
  const auto satisfied = [](const std::string& bound, const std::string& offered) {
    const Platform platform{offered, "abi", "x86_64"};
    Solver solver{platform};
    Manifest manifest;
    manifest.set_publisher("acme");
    manifest.set_name("a");
    manifest.set_version("1.0.0");
    manifest.set_host(bound);
    solver.add_offered(manifest);
    return solver.solve({.exact = {&manifest}}).solved();
  };
  for (int i = 0; i < 20'000; ++i) {
    const std::string &a = versions[random() % versions.size()], &b = versions[random() % versions.size()];
    ASSERT_EQ(satisfied("< " + b, a), *Version::parse(a) < *Version::parse(b)) << a << " < " << b;
  }
}

// A small marketplace at random, and every choice of versions tried.
class Universe {
 public:
  explicit Universe(std::mt19937& random) {
    for (int name = 0; name < kNames; ++name) {
      for (int version = 1; version <= kVersions; ++version) {
        Manifest& manifest = manifests_[static_cast<std::size_t>(name * kVersions + version - 1)];
        manifest.set_publisher("acme");
        manifest.set_name(std::string(1, static_cast<char>('a' + name)));
        manifest.set_version(std::to_string(version) + ".0.0");
        for (unsigned i = random() % 4 + 1; i > 0; --i) {
          const int other = static_cast<int>(random() % kNames);
          if (other == name) continue;
          const char* comparisons[] = {" >= ", " < ", " = ", " <= "};
          const std::string text = "acme/" + std::string(1, static_cast<char>('a' + other)) +
                                   comparisons[random() % 4] + std::to_string(random() % kVersions + 1) + ".0.0";
          random() % 4 == 0 ? manifest.add_conflicts(text) : manifest.add_requirements(text);
        }
      }
    }
  }

  // Whether these versions (0: none) go together.
  bool goes(const std::vector<int>& versions) const {
    const auto meets = [&](const std::string& text) {
      const Requirement requirement = Requirement::parse(text, "");
      const int version = versions[static_cast<std::size_t>(requirement.package.back() - 'a')];
      return version > 0 && requirement.versions.has(*Version::parse(std::to_string(version) + ".0.0"));
    };
    for (int name = 0; name < kNames; ++name) {
      if (versions[static_cast<std::size_t>(name)] == 0) continue;
      const Manifest& manifest = at(name, versions[static_cast<std::size_t>(name)]);
      if (!std::ranges::all_of(manifest.requirements(), meets) || std::ranges::any_of(manifest.conflicts(), meets))
        return false;
    }
    return true;
  }

  // Whether `a` and `b` can be there together.
  bool can_have_both() const {
    std::vector<int> versions(kNames, 0);
    for (int code = 0; code < 256; ++code) {  // kVersions + 1 to the power of kNames
      for (int name = 0, rest = code; name < kNames; ++name, rest /= kVersions + 1)
        versions[static_cast<std::size_t>(name)] = rest % (kVersions + 1);
      if (versions[0] > 0 && versions[1] > 0 && goes(versions)) return true;
    }
    return false;
  }

  const Manifest& at(int name, int version) const {
    return manifests_[static_cast<std::size_t>(name * kVersions + version - 1)];
  }
  const std::vector<Manifest>& all() const { return manifests_; }

  static constexpr int kNames = 4, kVersions = 3;

 private:
  std::vector<Manifest> manifests_{kNames * kVersions};
};

TEST(Solver, FindsAChoiceExactlyWhereThereIsOne) {
  std::mt19937 random(11);
  const Platform platform{"1.0.0", "abi", "x86_64"};
  int found = 0;
  for (int round = 0; round < 3000; ++round) {
    const Universe universe(random);
    Solver solver{platform};
    for (const auto& manifest : universe.all()) solver.add_offered(manifest);
    const auto outcome = solver.solve({.install = {{"acme/a", {}}, {"acme/b", {}}}});
    ASSERT_EQ(outcome.solved(), universe.can_have_both()) << "round " << round;
    if (!outcome.solved()) continue;
    ++found;
    std::vector<int> versions(Universe::kNames, 0);
    for (const auto* manifest : outcome.packages)
      versions[static_cast<std::size_t>(manifest->name()[0] - 'a')] = manifest->version()[0] - '0';
    ASSERT_TRUE(universe.goes(versions) && versions[0] > 0 && versions[1] > 0) << "round " << round;
  }
  EXPECT_GT(found, 500);
  EXPECT_LT(found, 2900);
}

class PlanTest : public ::testing::Test {
 protected:
  void publish_one(const std::string& name, const std::string& version, const std::string& more = {}) {
    publish_plugin(scratch_.path(), market_, name, version, version, more);
  }
  Plan plan(const std::vector<std::string>& requests) {
    return plan_install(requests, Marketplace{market_}, Store{store_}, platform_);
  }
  void install_one(const std::string& request) { install(request, Marketplace{market_}, store_); }
  void perform(const Plan& plan) {
    const Marketplace market{market_};
    ASSERT_TRUE(apply(plan, {&market}, store_));
  }

  Plan locked(const Lock& lock) {
    const Marketplace market{market_};
    return plan_locked(lock, {&market}, Store{scratch_ / "other"});
  }

  static std::string text(const Plan& plan) {
    std::string text;
    for (const auto& step : plan.steps) {
      const char* kinds[] = {"+", "^", "v", "=", "!", "-"};
      text += kinds[static_cast<int>(step.kind)] + step.package.substr(5) + "@" + step.version +
              (step.because.empty() ? "" : " (" + step.because + ")") + " ";
    }
    return text;
  }

  Scratch scratch_;
  filesystem::path market_ = scratch_ / "market", store_ = scratch_ / "store";
  Platform platform_ = Platform::here();
};

TEST_F(PlanTest, WhatIsRequiredComesAlongInTheNewestVersionThatFits) {
  publish_one("maps", "1.0.0");
  publish_one("maps", "1.5.0");
  publish_one("maps", "2.0.0");
  publish_one("nav", "1.0.0", "requirements: 'acme/maps >= 1.0.0, < 2.0.0'");
  const Plan found = plan({"nav"});
  EXPECT_EQ(text(found), "+maps@1.5.0 (acme/nav requires it) +nav@1.0.0 ");
  EXPECT_TRUE(found.needs_consent());
}

TEST_F(PlanTest, WhatWasTypedAndNoMoreNeedsNoConsent) {
  auto source = plugin_source(scratch_.path(), "steps", "1.0.0");
  source.manifest.replace(source.manifest.find("acme"), 4, "fiona");
  pack_to(scratch_ / "first.fpk", source);
  publish(scratch_ / "first.fpk", market_);
  EXPECT_FALSE(plan({"steps"}).needs_consent());
}

TEST_F(PlanTest, ANewPublisherAndNewRightsNeedConsent) {
  publish_one("steps", "1.0.0");
  const Plan first = plan({"steps"});
  EXPECT_TRUE(first.steps[0].new_publisher);
  EXPECT_TRUE(first.needs_consent());
  perform(first);
  publish_one("steps", "1.1.0");
  EXPECT_FALSE(plan({"steps"}).needs_consent());
  publish_one("steps", "1.2.0", "rights: ['network', 'device:bluetooth']");
  const Plan more = plan({"steps"});
  EXPECT_TRUE(more.needs_consent());
  EXPECT_EQ(more.steps[0].new_rights, (std::vector<std::string>{"network", "device:bluetooth"}));
  perform(more);
  publish_one("steps", "1.3.0", "rights: ['network', 'master']");
  EXPECT_EQ(plan({"steps"}).steps[0].new_rights, std::vector<std::string>{"master"});
}

TEST_F(PlanTest, TwoThatRequireDifferentVersionsAreExplained) {
  publish_one("maps", "1.0.0");
  publish_one("maps", "2.0.0");
  publish_one("nav", "1.0.0", "requirements: 'acme/maps >= 2.0.0'");
  publish_one("track", "1.0.0", "requirements: 'acme/maps < 2.0.0'");
  const Error together = error_of([&] { plan({"nav", "track"}); });
  EXPECT_EQ(together.code(), ErrorCode::DependencyConflict);
  EXPECT_EQ(together.text().what,
            "acme/nav and acme/track cannot be installed together: acme/nav 1.0.0 requires acme/maps >= 2.0.0, and "
            "acme/track 1.0.0 requires acme/maps < 2.0.0");
  install_one("track");
  const Error after = error_of([&] { plan({"nav"}); });
  EXPECT_EQ(after.text().what,
            "acme/nav cannot be installed: acme/nav 1.0.0 requires acme/maps >= 2.0.0, and acme/track 1.0.0, which is "
            "installed, requires acme/maps < 2.0.0");
  EXPECT_EQ(after.text().next, "market remove acme/track, or choose another version");
}

TEST_F(PlanTest, ADeclaredConflictIsExplained) {
  publish_one("maps", "1.0.0");
  publish_one("nav", "1.0.0", "conflicts: 'acme/maps < 2.0.0'");
  install_one("maps");
  EXPECT_EQ(error_of([&] { plan({"nav"}); }).text().what,
            "acme/nav cannot be installed: acme/nav 1.0.0 does not go together with acme/maps < 2.0.0");
  publish_one("maps", "2.0.0");
  EXPECT_EQ(text(plan({"nav"})), "^maps@2.0.0 +nav@1.0.0 ");
}

TEST_F(PlanTest, ARequirementThatNobodyOffersIsNamed) {
  publish_one("nav", "1.0.0", "requirements: 'acme/maps >= 2.0.0'");
  EXPECT_EQ(
      error_of([&] { plan({"nav"}); }).text().what,
      "acme/nav cannot be installed: acme/nav 1.0.0 requires acme/maps >= 2.0.0, which the marketplace does not have");
  publish_one("maps", "1.0.0");
  EXPECT_EQ(error_of([&] { plan({"nav"}); }).text().what,
            "acme/nav cannot be installed: acme/nav 1.0.0 requires acme/maps >= 2.0.0, and there is only 1.0.0");
}

TEST_F(PlanTest, ThePlatformDecidesAndWhatWouldFitIsSaid) {
  publish_one("nav", "1.0.0");
  publish_one("nav", "2.0.0", "host: '>= 9.0.0'");
  const Plan older = plan({"nav"});
  EXPECT_EQ(text(older), "+nav@1.0.0 ");
  ASSERT_EQ(older.notes.size(), 1u);
  EXPECT_EQ(older.notes[0],
            "acme/nav 2.0.0 is not taken: acme/nav 2.0.0 works with FIONA >= 9.0.0, and this is " + platform_.version);
  const Error exact = error_of([&] { plan({"nav@2.0.0"}); });
  EXPECT_EQ(
      exact.text().what,
      "acme/nav 2.0.0 cannot be installed: acme/nav 2.0.0 works with FIONA >= 9.0.0, and this is " + platform_.version);
  EXPECT_EQ(exact.text().next, "market install acme/nav@1.0.0, which fits");
  platform_.abi = "another";
  EXPECT_EQ(error_of([&] { plan({"nav@1.0.0"}); }).text().what,
            "acme/nav 1.0.0 cannot be installed: acme/nav 1.0.0 is built for the ABI " + std::string(kAbiTag) +
                ", and this FIONA has another");
}

TEST_F(PlanTest, PreReleasesAreTakenOnlyWhereTheyAreAskedForOrThereIsNothingElse) {
  publish_one("nav", "1.0.0");
  publish_one("nav", "2.0.0-rc.1");
  publish_one("beta", "0.1.0-alpha");
  EXPECT_EQ(text(plan({"nav", "beta"})), "+beta@0.1.0-alpha +nav@1.0.0 ");
  EXPECT_EQ(text(plan({"nav@2.0.0-rc.1"})), "+nav@2.0.0-rc.1 ");
  install_one("nav@2.0.0-rc.1");
  publish_one("nav", "2.0.0-rc.2");
  EXPECT_EQ(text(plan({"nav"})), "^nav@2.0.0-rc.2 ");
  EXPECT_EQ(text(plan({"nav@1.0.0"})), "vnav@1.0.0 ");
}

TEST_F(PlanTest, AnUpdateKeepsWhatOthersRequireAndSaysSo) {
  publish_one("maps", "1.0.0");
  publish_one("nav", "1.0.0", "requirements: 'acme/maps < 2.0.0'");
  install_one("nav");
  publish_one("maps", "1.1.0");
  publish_one("maps", "2.0.0");
  const Plan update = plan_update({}, Marketplace{market_}, Store{store_});
  EXPECT_EQ(text(update), "^maps@1.1.0 ");
  ASSERT_EQ(update.notes.size(), 1u);
  EXPECT_EQ(update.notes[0],
            "acme/maps 2.0.0 is not taken: acme/nav 1.0.0, which is installed, requires acme/maps < 2.0.0");
  EXPECT_EQ(text(plan_update({"maps"}, Marketplace{market_}, Store{store_})), "^maps@1.1.0 ");
  EXPECT_EQ(text(plan_update({"nav"}, Marketplace{market_}, Store{store_})), "");
}

TEST_F(PlanTest, WhatOthersRequireIsNotRemovedAndTheyAreNamed) {
  publish_one("maps", "1.0.0");
  publish_one("nav", "1.0.0", "requirements: 'acme/maps'");
  install_one("nav");
  const Error error = error_of([&] { plan_remove({"maps"}, Store{store_}); });
  EXPECT_EQ(error.code(), ErrorCode::DependencyConflict);
  EXPECT_EQ(error.text().what, "acme/maps cannot be removed: acme/nav 1.0.0 requires it");
  EXPECT_EQ(error.text().next, "market remove acme/maps acme/nav removes both");
}

TEST_F(PlanTest, WhatCameAsARequirementGoesWithTheLastThatRequiresIt) {
  publish_one("maps", "1.0.0");
  publish_one("nav", "1.0.0", "requirements: 'acme/maps'");
  publish_one("track", "1.0.0", "requirements: 'acme/maps'");
  install_one("nav");
  install_one("track");
  EXPECT_EQ(text(plan_remove({"nav"}, Store{store_})), "-nav@1.0.0 ");
  EXPECT_EQ(text(plan_remove({"nav", "track"}, Store{store_})),
            "-maps@1.0.0 (nothing requires it any more) -nav@1.0.0 -track@1.0.0 ");
  install_one("maps");  // now somebody has asked for it
  EXPECT_EQ(text(plan_remove({"nav", "track"}, Store{store_})), "-nav@1.0.0 -track@1.0.0 ");
}

TEST_F(PlanTest, ARequirementThatAnUpdateDropsIsNamedAndGoesWithTheNextRemoval) {
  publish_one("maps", "1.0.0");
  publish_one("track", "1.0.0");
  publish_one("nav", "1.0.0", "requirements: 'acme/maps'");
  install_one("nav");
  install_one("track");
  publish_one("nav", "1.1.0");
  const Marketplace market{market_};
  const Plan update = plan_update({}, market, Store{store_});
  EXPECT_EQ(text(update), "^nav@1.1.0 ");
  EXPECT_EQ(update.notes, std::vector<std::string>{"nothing requires acme/maps any more: market remove acme/maps"});
  perform(update);
  EXPECT_TRUE(plan_update({}, market, Store{store_}).notes.empty()) << "it is told once";
  EXPECT_EQ(text(plan_remove({"track"}, Store{store_})), "-maps@1.0.0 (nothing requires it any more) -track@1.0.0 ");
}

TEST_F(PlanTest, OtherContentOfAVersionComesWithWhatItRequiresOrNotAtAll) {
  publish_one("nav", "1.0.0");
  install_one("nav");
  filesystem::remove_all(market_);
  publish_one("nav", "1.0.0", "requirements: 'acme/maps'");
  const Plan kept = plan({"nav"});
  EXPECT_EQ(text(kept), "");
  ASSERT_EQ(kept.notes.size(), 1u);
  EXPECT_EQ(
      kept.notes[0],
      "other content of acme/nav 1.0.0 is not taken: acme/nav 1.0.0 requires acme/maps, which the marketplace does "
      "not have");
  publish_one("maps", "1.0.0");
  EXPECT_EQ(text(plan({"nav"})), "+maps@1.0.0 (acme/nav requires it) =nav@1.0.0 ");
  EXPECT_EQ(text(plan_update({"nav"}, Marketplace{market_}, Store{store_})),
            "+maps@1.0.0 (acme/nav requires it) =nav@1.0.0 ");
  EXPECT_EQ(text(plan_update({}, Marketplace{market_}, Store{store_})),
            "+maps@1.0.0 (acme/nav requires it) =nav@1.0.0 ");
}

TEST_F(PlanTest, OtherContentOfAVersionComesFromWhereThePackageCameFromAlone) {
  publish_one("nav", "1.0.0");
  publish_plugin(scratch_.path(), scratch_ / "second", "nav", "1.0.0", "summary: 'another'");
  const Marketplace first{market_}, second{scratch_ / "second"};
  install("nav", second, store_);
  const Store store{store_};
  EXPECT_EQ(text(plan_update({}, first, store)), "");
  EXPECT_EQ(text(plan_update({"nav"}, first, store)), "");
  EXPECT_EQ(text(plan_update({}, second, store)), "");
  EXPECT_EQ(text(plan_locked(make_lock(store, {}), {&first, &second}, store)), "");
  EXPECT_EQ(text(plan_install({"nav"}, first, store)), "=nav@1.0.0 ") << "who names it has it from there";
}

TEST_F(PlanTest, ALockOfSeveralMarketplacesIsInstalledWholeOrNotAtAll) {
  publish_one("nav", "1.0.0");
  publish_plugin(scratch_.path(), scratch_ / "second", "maps", "1.0.0");
  const Marketplace first{market_}, second{scratch_ / "second"};
  install("nav", first, store_);
  install("maps", second, store_);
  const Lock lock = make_lock(Store{store_}, {});
  const Store other{scratch_ / "other"};
  const Plan plan = plan_locked(lock, {&first, &second}, other);
  EXPECT_EQ(text(plan), "+maps@1.0.0 +nav@1.0.0 ");
  const filesystem::path file = scratch_ / "second" / second.info("maps")[0].file();
  filesystem::rename(file, scratch_ / "away");
  error_of([&] { apply(plan, {&first, &second}, other.directory()); });
  EXPECT_TRUE(other.installed().empty());
  filesystem::rename(scratch_ / "away", file);
  EXPECT_TRUE(apply(plan, {&first, &second}, other.directory()));
  EXPECT_EQ(other.find("maps").source, second.source());
  EXPECT_EQ(other.find("nav").source, first.source());
}

TEST_F(PlanTest, APlanForAnotherStateOfTheStoreIsNotCarriedOut) {
  publish_one("maps", "1.0.0");
  publish_one("nav", "1.0.0");
  const Plan stale = plan({"nav"});
  install_one("maps");
  const Marketplace market{market_};
  EXPECT_FALSE(apply(stale, {&market}, store_));
  EXPECT_EQ(Store{store_}.installed().size(), 1u);
}

TEST_F(PlanTest, RequiredServicesThatNobodyProvidesAreNamedWithProviders) {
  auto source = plugin_source(scratch_.path(), "nav", "1.0.0");
  source.interface = "abi: '" + std::string(kAbiTag) +
                     "' components { name: 'nav' ports { name: 'steps' direction: REQUIRES service: "
                     "'fiona.localisation.StepProvider' } ports { name: 'imu' direction: REQUIRES service: 'a.B' } "
                     "ports { name: 'more' direction: REQUIRES service: 'a.C' optional: true } }";
  pack_to(scratch_ / "nav.fpk", source);
  publish(scratch_ / "nav.fpk", market_);
  publish_one("steps", "1.0.0");
  const Plan found = plan({"nav"});
  ASSERT_EQ(found.missing.size(), 2u);
  EXPECT_EQ(found.missing[0].port, "acme/nav: nav.steps");
  EXPECT_EQ(found.missing[0].providers, std::vector<std::string>{"acme/steps"});
  EXPECT_TRUE(found.missing[1].providers.empty());
  EXPECT_EQ(plan({"nav", "steps"}).missing.size(), 1u);
}

TEST_F(PlanTest, ALockBringsTheSameBytesElsewhere) {
  publish_one("maps", "1.0.0");
  publish_one("nav", "1.0.0", "requirements: 'acme/maps'");
  install_one("nav");
  const Lock lock = make_lock(Store{store_}, std::vector<std::string>{"acme/nav"});
  ASSERT_EQ(lock.packages_size(), 2);
  write_lock(scratch_ / "fiona.lock", lock);
  publish_one("maps", "1.1.0");
  const Store other{scratch_ / "other"};
  const Marketplace market{market_};
  const Plan plan = plan_locked(read_lock(scratch_ / "fiona.lock"), {&market}, other);
  EXPECT_EQ(text(plan), "+maps@1.0.0 +nav@1.0.0 ");
  EXPECT_TRUE(apply(plan, {&market}, other.directory()));
  EXPECT_EQ(other.find("maps").directory.filename(), Store{store_}.find("maps").directory.filename());
  EXPECT_TRUE(other.find("maps").as_requirement);
  EXPECT_EQ(text(plan_locked(lock, {&market}, other)), "");
}

TEST_F(PlanTest, ALockOfOtherContentIsASignatureError) {
  publish_one("maps", "1.0.0");
  install_one("maps");
  Lock lock = make_lock(Store{store_}, {});
  lock.mutable_packages(0)->set_blake2b(std::string(64, 'a'));
  const Error error = error_of([&] { locked(lock); });
  EXPECT_EQ(error.code(), ErrorCode::BadSignature);
  EXPECT_EQ(error.text().what, "the marketplace has acme/maps 1.0.0 with other content than the lock says");
  lock.mutable_packages(0)->set_version("3.0.0");
  EXPECT_EQ(error_of([&] { locked(lock); }).text().what,
            "the marketplace does not have acme/maps 3.0.0, which the lock names");
}

TEST_F(PlanTest, ALockThatIsNotWholeIsRefused) {
  write_file(scratch_ / "fiona.lock", "packages { package: 'acme/maps' version: '1.0.0' }");
  EXPECT_EQ(error_of([&] { read_lock(scratch_ / "fiona.lock"); }).text().what, "the lock of acme/maps is not whole");
  write_file(scratch_ / "fiona.lock", "packages {");
  EXPECT_EQ(error_of([&] { read_lock(scratch_ / "fiona.lock"); }).text().what.find("this is not a Lock"), 0u);
  EXPECT_EQ(error_of([&] { read_lock(scratch_ / "none"); }).code(), ErrorCode::NotFound);
}

TEST_F(PlanTest, ASystemPackageIsItsFileAndWhatItNeeds) {
  publish_one("steps", "1.0.0");
  write_file(scratch_ / "share/museum.fiona", "load acme/steps as steps\n");
  PackageSource source;
  source.manifest =
      "publisher: 'acme' name: 'museum' version: '1.0.0' kind: SYSTEM summary: 'A museum' license: 'Apache-2.0' "
      "requirements: 'acme/steps'";
  source.readme = "# museum\n";
  EXPECT_EQ(error_of([&] { pack(source); }).text().what, "a package of kind SYSTEM needs its system file");
  source.share = scratch_ / "share";
  pack_to(scratch_ / "museum.fpk", source);
  publish(scratch_ / "museum.fpk", market_);
  EXPECT_EQ(text(plan({"museum"})), "+museum@1.0.0 +steps@1.0.0 (acme/museum requires it) ");
}

// A package of messages, and one that was compiled with them; `form` is what the objects look like.
class MessagesPlanTest : public PlanTest {
 protected:
  static std::string interface_of(const std::string& form, const std::string& more) {
    return "abi: '" + std::string(kAbiTag) + "' descriptors { file { name: 'acme/rooms.proto' package: 'acme." + form +
           "' } } " + more;
  }
  PackageSource messages(const std::string& version, const std::string& form, const std::string& publisher = "acme") {
    PackageSource source = plugin_source(scratch_.path(), "rooms", version, form, "kind: MESSAGES");
    source.manifest.replace(source.manifest.find("acme"), 4, publisher);
    source.interface = interface_of(form, "");
    return source;
  }
  PackageSource user(const std::string& version, const std::string& form,
                     const std::string& more = "requirements: 'acme/rooms'") {
    PackageSource source = plugin_source(scratch_.path(), "finder", version, form, more);
    source.interface = interface_of(form, "shared: 'acme/rooms.proto'");
    return source;
  }
  void publish_it(const PackageSource& source) {
    pack_to(scratch_ / "one.fpk", source);
    publish(scratch_ / "one.fpk", market_);
  }
};

TEST_F(MessagesPlanTest, ComeAlongInTheFormThatAPluginWasCompiledWith) {
  publish_it(messages("1.0.0", "a"));
  publish_it(messages("1.1.0", "b"));
  publish_it(user("1.0.0", "a"));
  EXPECT_EQ(text(plan({"finder"})), "+finder@1.0.0 +rooms@1.0.0 (acme/finder requires it) ");
}

TEST_F(MessagesPlanTest, AreNotUpdatedBelowAPluginThatKnowsAnotherForm) {
  publish_it(messages("1.0.0", "a"));
  publish_it(user("1.0.0", "a"));
  install_one("finder");
  publish_it(messages("1.1.0", "b"));
  const Plan kept = plan_update({}, Marketplace(market_), Store(store_), Platform::here());
  EXPECT_EQ(text(kept), "");
  ASSERT_EQ(kept.notes.size(), 1U);
  EXPECT_EQ(kept.notes.front(),
            "acme/rooms 1.1.0 is not taken: acme/finder 1.0.0, which is installed, was compiled with another form of "
            "acme/rooms.proto");
  publish_it(user("1.0.1", "b"));
  EXPECT_EQ(text(plan_update({}, Marketplace(market_), Store(store_), Platform::here())),
            "^finder@1.0.1 ^rooms@1.1.0 ");
}

TEST_F(MessagesPlanTest, InAFormThatNobodyOffersKeepAPluginAway) {
  publish_it(messages("1.1.0", "b"));
  publish_it(user("1.0.0", "a"));
  EXPECT_EQ(error_of([&] { plan({"finder"}); }).text().what,
            "acme/finder cannot be installed: acme/finder 1.0.0 was compiled with another form of acme/rooms.proto");
}

TEST_F(MessagesPlanTest, OfAnotherPublishersNameAreNotPacked) {
  const Error error = error_of([&] { pack(messages("1.0.0", "a", "globex")); });
  EXPECT_EQ(error.text().what, "the proto file \"acme/rooms.proto\" is not under its publisher's name");
  EXPECT_EQ(error.text().expected, "globex/…");
}

TEST_F(MessagesPlanTest, AreRequiredInSoManyWords) {
  const Error error = error_of([&] { pack(user("1.0.0", "a", "")); });
  EXPECT_EQ(error.text().what, "it was compiled with acme/rooms.proto, and requires no package of acme");
  EXPECT_EQ(error.text().expected, "requirements: \"acme/NAME\", the package that offers it");
}

TEST(CompiledProtos, OfPackagesThatSayThatEachNeedsTheOtherAreRefused) {
  const auto package = [](const std::string& publisher, const std::string& needed) {
    InstalledPackage one;
    one.manifest.set_publisher(publisher);
    one.manifest.set_name("rooms");
    one.manifest.add_offered()->set_name(publisher + "/rooms.proto");
    one.manifest.add_shared()->set_name(needed + "/rooms.proto");
    return one;
  };
  const std::vector packages{package("acme", "globex"), package("globex", "acme"), package("hooli", "hooli")};
  EXPECT_EQ(error_of([&] { messages_of(packages[0].manifest, "acme/rooms", packages); }).text().what,
            "'globex/rooms' says that it was compiled with objects of 'acme/rooms', which cannot be opened before "
            "'globex/rooms'");
  EXPECT_EQ(error_of([&] { messages_of(packages[2].manifest, "hooli/rooms", packages); }).text().next,
            "market remove hooli/rooms, and tell its publisher");
}

TEST_F(PlanTest, ManifestsThatRequireNonsenseAreRefused) {
  const auto what = [&](const std::string& more) {
    return error_of([&] { pack(plugin_source(scratch_.path(), "nav", "1.0.0", "code", more)); }).text().what;
  };
  EXPECT_EQ(what("requirements: 'maps'"), "this does not name a package");
  EXPECT_EQ(what("requirements: 'acme/nav >= 1.0.0'"), "the package requires itself");
  EXPECT_EQ(what("conflicts: 'acme/maps >= 1.0.0, < 2.0.0'"), "this cannot be a conflict");
  EXPECT_EQ(what("host: '1.0'"), "these are not bounds of versions");
  std::string many;
  for (int i = 0; i < 257; ++i) many += "requirements: 'acme/a" + std::to_string(i) + "' ";
  EXPECT_EQ(what(many), "the package has too many requirements and conflicts");
}

}  // namespace
}  // namespace fiona::marketplace
