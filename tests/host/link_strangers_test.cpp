// What a peer may not do to the process that it has links with.
#include <gtest/gtest.h>

#include <unistd.h>

#include <cstddef>
#include <cstdint>
#include <future>
#include <memory>
#include <string>

#include "links_fixture.hpp"
#include "os/limits.hpp"

namespace fiona::host {
namespace {

TEST_F(LinksOfAProcess, APeerHasOneUnfinishedObjectForEachOfItsWiresWhateverItCallsThem) {
  links.provide(1, kLinksToken, "peer", ends->told, 1, "client");
  RawPeer peer(context, at("links"), "peer");
  peer.prove(kLinksKey);
  open_by_hand(peer, 1);
  for (std::uint64_t i = 0; i < 100; ++i) {
    wire::Frame first = frame_for(1000 + i);
    first.add_also(1);
    first.set_size(2 * kLocalChunkBytes);
    first.mutable_object()->set_sequence(1);
    peer.send(first, "x");
  }
  EXPECT_TRUE(becomes_true([&] { return links.status().garbled() == 50; })) << "each that meets an unfinished one";
}

TEST_F(LinksOfAProcess, APeersSentencesAreCutToWhatASentenceMayHave) {
  ProviderByHand other(at("other"));
  require(1, ends->noticed);
  wire::Frame silent = frame_for(1);
  silent.mutable_lease()->set_reason(std::string(kMostFrame - 100, 'x'));
  other.send(silent);
  EXPECT_TRUE(becomes_true([&] { return ends->noticed.connection() == Connection::Lost; }));
  EXPECT_LT(ends->noticed.connection_reason().size(), 5'000U);
  links.release(hull, "the test is over");
}

TEST_F(LinksOfAProcess, AProviderThatComesAndGoesFasterThanItsClientWorksFillsNothing) {
  ProviderByHand other(at("other"));
  require(1, ends->noticed);
  std::promise<void> works, goes_on;
  hull.strand().post([&] {
    works.set_value();
    goes_on.get_future().wait();
  });
  works.get_future().wait();
  const std::size_t before = hull.strand().waiting_jobs();
  for (int i = 0; i < 200; ++i) {
    wire::Frame lease = frame_for(1);
    lease.mutable_lease()->set_held(i % 2 == 1);
    other.send(lease);
    const auto told = i % 2 == 1 ? Connection::Connected : Connection::Lost;
    ASSERT_TRUE(becomes_true([&] { return ends->noticed.connection() == told; }));
  }
  EXPECT_LE(hull.strand().waiting_jobs(), before + 16);
  goes_on.set_value();
  other.send(frame_for(1), std::make_shared<localisation::CommLocation>());
  EXPECT_TRUE(becomes_true([&] { return ends->noticed_so_far == 1; }));
  links.release(hull, "the test is over");
}

TEST_F(LinksOfAProcess, AClientCannotSayThatMoreWasLostThanWasPut) {
  links.provide(1, kLinksToken, "peer", ends->told, 1, "client");
  RawPeer peer(context, at("links"), "peer");
  peer.prove(kLinksKey);
  open_by_hand(peer, 1);
  EXPECT_TRUE(hull.strand().call([&] { ends->told.put(localisation::CommLocation()); }, 20s));
  for (const std::uint64_t messages : {1ULL, ~0ULL, 5ULL}) {
    wire::Frame frame = frame_for(1);
    frame.mutable_lost()->set_messages(messages);
    peer.send(frame);
  }
  const auto before = links.status().not_granted();
  peer.send(frame_for(7));
  EXPECT_TRUE(becomes_true([&] { return links.status().not_granted() > before; }));
  EXPECT_EQ(ends->told.counters().dropped, 1U);
}

TEST_F(LinksOfAProcess, WhoAsksWithoutReadingTheAnswersTakesNoMemory) {
  constexpr std::size_t kMessages = 2000;
  constexpr std::size_t kTogether = 500;
  RawPeer peer(context, at("links"), "peer", "peer", 1);
  peer.prove(kLinksKey);
  wire::Frame open = frame_for(7);
  open.mutable_open()->set_version(wire::VERSION_1);
  const Block record = make_record(open, nullptr, 0);
  std::string message;
  for (std::size_t i = 0; i < kTogether; ++i)
    message.append(reinterpret_cast<const char*>(record.data()), record.size());
  const auto resident_bytes = [] { return os::usage_of(::getpid())->memory; };
  const std::uint64_t before = resident_bytes();
  for (std::size_t i = 0; i < kMessages; ++i) peer.send(RawPeer::Message{message});
  EXPECT_TRUE(becomes_true([&] { return links.status().received_messages() >= kMessages; }));
  EXPECT_EQ(links.status().overrun(), 1U);
  EXPECT_EQ(links.status().peers(), 0U);
  if (FIONA_SANITIZED) return;  // which keep what was freed
  EXPECT_LT(resident_bytes(), before + 64 * 1024 * 1024);
}

}  // namespace
}  // namespace fiona::host
