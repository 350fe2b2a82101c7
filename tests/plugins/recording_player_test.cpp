// What a recording holds is put again: as the console writes it, and as other tools do.
#include <archive.h>
#include <archive_entry.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/stat.h>
#include <zlib.h>

#include <algorithm>
#include <fstream>
#include <iterator>
#include <set>

#include "../error_of.hpp"
#include "../temporary_directory.hpp"
#include "fiona/options.pb.h"
#include "fiona/testing/bench.hpp"
#include "mcap_writer.hpp"
#include "recording_player.hpp"
#include "schema.hpp"

#include "fiona/hmi.fiona.hpp"
#include "fiona/localisation.fiona.hpp"
#include "fiona/navigation.fiona.hpp"
#include "fiona/perception.fiona.hpp"
#include "fiona/security.pb.h"
#include "fiona/sensors.fiona.hpp"

namespace fiona::recording_player {
namespace {

using tests::error_of;

namespace pb = google::protobuf;
using console::McapWriter;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using namespace std::chrono_literals;
using Player = testing::Bench<RecordingPlayer>;

constexpr std::uint64_t kBegin_ns = 1'790'000'000'000'000'000;  // of the recording: in September 2026
constexpr std::uint64_t kSecond_ns = 1'000'000'000;

pb::FileDescriptorSet files_of(const pb::FileDescriptor& file) {
  pb::FileDescriptorSet all;
  std::set<std::string> seen;
  const std::function<void(const pb::FileDescriptor&)> add = [&](const pb::FileDescriptor& one) {
    if (!seen.insert(one.name()).second) return;
    for (int i = 0; i < one.dependency_count(); ++i) add(*one.dependency(i));
    one.CopyTo(all.add_file());
  };
  add(file);
  return all;
}

localisation::CommStep step(double length_m) {
  localisation::CommStep made;
  made.set_length(length_m);
  made.set_t_end(static_cast<std::int64_t>(kBegin_ns / 1'000'000));
  made.set_is_valid(true);
  return made;
}

/// Records as the specification has them, for what our own writer never writes.
struct Records {
  template <class T>
  static std::string number(T value) {
    std::string bytes;
    for (std::size_t i = 0; i < sizeof(T); ++i) bytes.push_back(static_cast<char>(value >> (8 * i)));
    return bytes;
  }
  static std::string text(std::string_view value) {
    return number(static_cast<std::uint32_t>(value.size())) + std::string(value);
  }
  static std::string record(std::uint8_t op, const std::string& content) {
    return number(op) + number(std::uint64_t{content.size()}) + content;
  }
  static std::string begin() { return std::string("\x89MCAP0\r\n", 8) + record(0x01, text("") + text("other")); }
  static std::string end() {
    return record(0x0F, number(0U)) + record(0x02, std::string(20, '\0')) + begin().substr(0, 8);
  }
  static std::string schema(std::uint16_t id, const std::string& type, const std::string& encoding,
                            const std::string& data) {
    return record(0x03, number(id) + text(type) + text(encoding) + text(data));
  }
  static std::string channel(std::uint16_t id, std::uint16_t schema, const std::string& topic,
                             const std::string& encoding) {
    return record(0x04, number(id) + number(schema) + text(topic) + text(encoding) + number(0U));
  }
  static std::string message(std::uint16_t channel, std::uint64_t at_ns, const std::string& data) {
    return record(0x05, number(channel) + number(0U) + number(kBegin_ns + at_ns) + number(kBegin_ns + at_ns) + data);
  }
  static std::string chunk(std::uint64_t first_ns, std::uint64_t last_ns, const std::string& records,
                           const std::string& compression = "") {
    const std::string packed = compression.empty() ? records : compressed(records, compression);
    const auto check = static_cast<std::uint32_t>(
        ::crc32(0, reinterpret_cast<const Bytef*>(records.data()), static_cast<uInt>(records.size())));
    return record(0x06, number(kBegin_ns + first_ns) + number(kBegin_ns + last_ns) +
                            number(std::uint64_t{records.size()}) + number(check) + text(compression) +
                            number(std::uint64_t{packed.size()}) + packed);
  }
  static std::string compressed(const std::string& bytes, const std::string& how) {
    std::string out(bytes.size() + 64 * 1024, '\0');
    std::size_t used = 0;
    archive* writer = archive_write_new();
    archive_write_set_format_raw(writer);
    how == "zstd" ? archive_write_add_filter_zstd(writer) : archive_write_add_filter_lz4(writer);
    archive_write_set_bytes_per_block(writer, 0);
    archive_write_open_memory(writer, out.data(), out.size(), &used);
    archive_entry* entry = archive_entry_new();
    archive_entry_set_filetype(entry, AE_IFREG);
    archive_write_header(writer, entry);
    archive_write_data(writer, bytes.data(), bytes.size());
    archive_entry_free(entry);
    archive_write_close(writer);
    archive_write_free(writer);
    out.resize(used);
    return out;
  }
  /// A schema and the channel `walk.steps` of it.
  static std::string steps_channel(std::uint16_t id = 1) {
    return schema(1, "fiona.localisation.CommStep", "protobuf",
                  files_of(*localisation::CommStep::descriptor()->file()).SerializeAsString()) +
           channel(id, 1, "walk.steps", "protobuf");
  }
  static std::string step_at(double length_m, std::uint64_t at_ns) {
    return message(1, at_ns, step(length_m).SerializeAsString());
  }
};

class RecordingPlayerTest : public ::testing::Test {
 private:
  tests::TemporaryDirectory directory_;

 protected:
  const std::filesystem::path file_ = directory_.path / "walk.mcap";

  std::string path() const { return file_.string(); }
  void write(const std::string& bytes) { std::ofstream(file_, std::ios::binary) << bytes; }
  std::string bytes() const {
    std::ifstream file(file_, std::ios::binary);
    return {std::istreambuf_iterator<char>(file), {}};
  }
  /// A step of 0.5, 0.6, … m every 100 ms, each 20 ms old when it came; `count` of them.
  void write_steps(int count) {
    McapWriter writer(file_);
    const auto channel = writer.add_channel("walk.steps", "fiona.localisation.CommStep",
                                            files_of(*localisation::CommStep::descriptor()->file()));
    for (int i = 0; i < count; ++i)
      put(writer, channel, 100'000'000ULL * static_cast<unsigned>(i), step(0.5 + 0.1 * i));
    writer.finish();
  }
  static void put(McapWriter& writer, McapWriter::Channel channel, std::uint64_t at_ns, const pb::Message& object,
                  std::chrono::nanoseconds age = 20ms) {
    const std::string data = object.SerializeAsString();
    writer.write({.channel = channel,
                  .logged_ns = kBegin_ns + at_ns,
                  .published_ns = kBegin_ns + at_ns - static_cast<std::uint64_t>(age.count()),
                  .data = data});
  }
  std::unique_ptr<Player> player(const std::string& channels = "") {
    auto made = std::make_unique<Player>("walk");
    made->set("file", path());
    made->set("channels", channels);
    return made;
  }
  /// The lengths of all steps that the file has, in the order in which they are put.
  std::vector<double> lengths() {
    const auto bench = player();
    bench->start();
    bench->advance(100s);
    return lengths_of(*bench);
  }
  static std::vector<double> lengths_of(Player& bench) {
    std::vector<double> all;
    for (const auto& one : bench.take<localisation::StepProvider>("steps")) all.push_back(one->length());
    return all;
  }
};

TEST_F(RecordingPlayerTest, PutsEachMessageAtItsOwnTimeAndEndsTheRun) {
  write_steps(5);
  const auto bench = player();
  bench->advance(10s);
  const TimePoint begun = bench->now();
  bench->start();
  bench->advance(250ms);
  const auto steps = bench->take<localisation::StepProvider>("steps");
  ASSERT_EQ(steps.size(), 3U);
  EXPECT_DOUBLE_EQ(steps[1]->length(), 0.6);
  EXPECT_EQ(steps[1].origin, begun + 80ms) << "20 ms before it had come";
  EXPECT_EQ(steps[1]->t_end(), to_milliseconds(begun)) << "moves with the whole";
  EXPECT_FALSE(bench->run_end());
  EXPECT_NEAR(*bench->probe<double>("position"), 0.2, 1e-9);
  bench->advance(150ms);
  ASSERT_TRUE(bench->run_end());
  EXPECT_EQ(bench->run_end()->first, 0);
  EXPECT_EQ(bench->run_end()->second, "end of recording " + path());
  EXPECT_EQ(bench->take<localisation::StepProvider>("steps").size(), 2U);
}

TEST_F(RecordingPlayerTest, KeepsAnOriginThatIsAheadOfTheClock) {
  McapWriter writer(file_);
  const auto channel = writer.add_channel("walk.steps", "fiona.localisation.CommStep",
                                          files_of(*localisation::CommStep::descriptor()->file()));
  put(writer, channel, 0, step(0.5));
  put(writer, channel, 100'000'000, step(0.6), -7ms);
  writer.finish();
  const auto bench = player();
  bench->advance(10s);
  const TimePoint begun = bench->now();
  bench->start();
  bench->advance(100ms);
  const auto steps = bench->take<localisation::StepProvider>("steps");
  ASSERT_EQ(steps.size(), 2U);
  EXPECT_EQ(steps[1].origin, begun + 107ms);
}

TEST_F(RecordingPlayerTest, HoldsWhereItIsToldTo) {
  write_steps(2);
  const auto bench = player();
  bench->set("at_end", "HOLD");
  bench->start();
  bench->advance(10s);
  EXPECT_FALSE(bench->run_end());
}

TEST_F(RecordingPlayerTest, PausesOutsideOfActive) {
  write_steps(5);
  const auto bench = player();
  bench->start();
  bench->advance(150ms);
  EXPECT_EQ(lengths_of(*bench).size(), 2U);
  bench->start(kModeNeutral);
  bench->advance(10s);
  EXPECT_THAT(lengths_of(*bench), IsEmpty());
  bench->start();
  bench->advance(40ms);
  EXPECT_THAT(lengths_of(*bench), IsEmpty()) << "50 ms are left until the next one";
  bench->advance(10ms);
  EXPECT_EQ(lengths_of(*bench).size(), 1U);
}

TEST_F(RecordingPlayerTest, BeginsWhereItIsToldTo) {
  write_steps(5);
  const auto bench = player();
  bench->set("from_s", 0.25);
  bench->start();
  bench->advance(49ms);
  EXPECT_THAT(lengths_of(*bench), IsEmpty());
  bench->advance(1ms);
  EXPECT_EQ(lengths_of(*bench), std::vector<double>{step(0.8).length()});
  EXPECT_NEAR(*bench->probe<double>("position"), 0.3, 1e-9);

  const auto late = player();
  late->set("from_s", 1.0);
  EXPECT_THAT(error_of([&] { late->start(); }), HasSubstr("the recording is over after 0.4 s"));
}

TEST_F(RecordingPlayerTest, AllOfItsParametersButOneAreFixed) {
  write_steps(5);
  const auto bench = player();
  bench->start();
  bench->set("at_end", "HOLD");
  EXPECT_THAT(error_of([&] { bench->set("from_s", 1.0); }), HasSubstr("only at_end can still be changed"));
}

TEST_F(RecordingPlayerTest, OfTwoChannelsOfOneTypeOneIsChosen) {
  McapWriter writer(file_);
  const auto files = files_of(*localisation::CommStep::descriptor()->file());
  const auto one = writer.add_channel("one.steps", "fiona.localisation.CommStep", files);
  const auto two = writer.add_channel("two.steps", "fiona.localisation.CommStep", files);
  put(writer, one, 0, step(0.5));
  put(writer, two, 1, step(0.7));
  writer.finish();
  EXPECT_THAT(
      error_of([&] { player()->start(); }),
      HasSubstr(
          "'one.steps' and 'two.steps' have one type, fiona.localisation.CommStep, and there is one port for it"));
  EXPECT_THAT(error_of([&] { player("two.steps,one.steps")->start(); }), HasSubstr("there is one port for it"));
  const auto bench = player(" two.steps ");
  bench->start();
  bench->advance(1s);
  EXPECT_EQ(lengths_of(*bench), std::vector<double>{0.7});
  const std::string error = error_of([&] { player("two.step")->start(); });
  EXPECT_THAT(error, HasSubstr("the recording has no channel 'two.step'"));
  EXPECT_THAT(error, HasSubstr("did you mean: two.steps"));
}

TEST_F(RecordingPlayerTest, WhatNoPortHasTheTypeOfIsLeftOutAndTold) {
  write(Records::begin() + Records::steps_channel() + Records::schema(2, "acme.Stairs", "protobuf", "") +
        Records::channel(2, 2, "a.stairs", "protobuf") + Records::channel(3, 0, "a.text", "json") +
        Records::step_at(0.5, 0) + Records::message(2, 1, "") + Records::end());
  const auto bench = player();
  bench->start();
  EXPECT_THAT(
      bench->log(),
      ::testing::Contains(HasSubstr("left out: a.stairs (no port has its type acme.Stairs); a.text (it has no type)")));
  bench->advance(1s);
  EXPECT_EQ(lengths_of(*bench), std::vector<double>{0.5});
  EXPECT_THAT(
      error_of([&] { player("walk.steps, a.stairs")->start(); }),
      ::testing::AllOf(HasSubstr("what is asked for cannot be played: a.stairs (no port has its type acme.Stairs)"),
                       HasSubstr("market info recording-player shows its ports")));
}

TEST_F(RecordingPlayerTest, ATypeThatIsDescribedOtherwiseIsRefusedByTheFieldThatDiffers) {
  auto files = files_of(*localisation::CommStep::descriptor()->file());
  for (auto& file : *files.mutable_file()) {
    if (file.name() != localisation::CommStep::descriptor()->file()->name()) continue;
    for (auto& type : *file.mutable_message_type()) {
      if (type.name() != "CommStep") continue;
      for (auto& field : *type.mutable_field()) {
        if (field.name() == "length") field.mutable_options()->SetExtension(fiona::unit, "mm");
      }
    }
  }
  McapWriter writer(file_);
  put(writer, writer.add_channel("walk.steps", "fiona.localisation.CommStep", files), 0, step(0.5));
  writer.finish();
  EXPECT_THAT(error_of([&] { player()->start(); }),
              HasSubstr("walk.steps (field fiona.localisation.CommStep.length has unit 'm' required, 'mm' provided)"));
}

TEST_F(RecordingPlayerTest, DescriptionsThatDoNotFitTogetherAreRefused) {
  const auto refused = [&](const std::string& encoding, const std::string& schema_encoding, const std::string& schema) {
    write(Records::begin() + Records::schema(1, "fiona.localisation.CommStep", schema_encoding, schema) +
          Records::channel(1, 1, "walk.steps", encoding) + Records::step_at(0.5, 0) + Records::end());
    return error_of([&] { player()->start(); });
  };
  EXPECT_THAT(refused("cdr", "ros2msg", ""), HasSubstr("its messages are encoded as 'cdr', not as 'protobuf'"));
  EXPECT_THAT(refused("protobuf", "ros2msg", ""), HasSubstr("its type is described as 'ros2msg'"));
  EXPECT_THAT(refused("protobuf", "protobuf", "\xff\xff"), HasSubstr("the description of its type is garbled"));
  EXPECT_THAT(refused("protobuf", "protobuf", ""), HasSubstr("the description of its type does not have it"));
  pb::FileDescriptorSet circle;
  auto& file = *circle.add_file();
  file.set_name("a.proto");
  file.set_package("fiona.localisation");
  file.add_dependency("a.proto");
  file.add_message_type()->set_name("CommStep");
  EXPECT_THAT(refused("protobuf", "protobuf", circle.SerializeAsString()), HasSubstr("does not fit together: "));
}

TEST_F(RecordingPlayerTest, ReadsWhatOtherToolsWrite) {
  const std::vector<double> all{0.5, 0.6, 0.7};
  const std::string definitions = Records::steps_channel();
  const std::string messages =
      Records::step_at(0.5, 0) + Records::step_at(0.6, kSecond_ns) + Records::step_at(0.7, 2 * kSecond_ns);

  write(Records::begin() + definitions + messages + Records::end());
  EXPECT_EQ(lengths(), all) << "without chunks";
  for (const char* compression : {"", "zstd", "lz4"}) {
    write(Records::begin() + Records::chunk(0, 2 * kSecond_ns, definitions + messages, compression) + Records::end());
    EXPECT_EQ(lengths(), all) << "compression '" << compression << "', defined in the chunk only";
  }
  write(Records::begin() + definitions +
        Records::chunk(0, kSecond_ns, Records::step_at(0.5, 0) + Records::step_at(0.7, 2 * kSecond_ns)) +
        Records::record(0x7f, "of a later version") +
        Records::chunk(kSecond_ns, kSecond_ns, Records::step_at(0.6, kSecond_ns), "zstd") + Records::end());
  EXPECT_EQ(lengths(), all) << "chunks of one time";
  write(Records::begin() + definitions + Records::step_at(0.7, 2 * kSecond_ns) + Records::step_at(0.5, 0) +
        Records::step_at(0.6, kSecond_ns) + Records::end());
  EXPECT_EQ(lengths(), all) << "out of order";
}

TEST_F(RecordingPlayerTest, WhatIsCutOffAnywhereIsReadAsFarAsItIsWhole) {
  const std::string data =
      Records::begin() + Records::schema(1, "a.Type", "protobuf", "") + Records::channel(1, 1, "a", "protobuf") +
      Records::message(1, 0, "first") +
      Records::chunk(1, 2, Records::message(1, 1, "second") + Records::message(1, 2, "third"), "lz4");
  const std::string whole = data + Records::end();
  std::size_t most = 0;
  for (std::size_t size = 0; size < whole.size(); ++size) {
    write(whole.substr(0, size));
    if (size < 8) {
      EXPECT_THAT(error_of([&] { McapReader reader(file_); }), HasSubstr("this is no recording"));
      continue;
    }
    McapReader reader(file_);
    EXPECT_EQ(reader.is_cut(), size < whole.size() - 8) << size;
    std::size_t messages = 0;
    McapReader::Message message;
    for (auto next = McapReader::Next::Later; next != McapReader::Next::End; next = reader.next(message))
      messages += next == McapReader::Next::Message ? 1 : 0;
    EXPECT_GE(messages, most);
    most = messages;
    EXPECT_EQ(messages == 3, size >= data.size()) << size;
  }
  EXPECT_EQ(most, 3U);
}

TEST_F(RecordingPlayerTest, ATailOfZerosIsCutOff) {
  write(Records::begin() + Records::steps_channel() + Records::chunk(0, 0, Records::step_at(0.5, 0)) +
        std::string(1000, '\0'));
  EXPECT_EQ(lengths(), std::vector<double>{0.5});
}

TEST_F(RecordingPlayerTest, AChunkWithoutMessagesHasNoTime) {
  write(Records::begin() + Records::steps_channel() + Records::step_at(0.5, 0) +
        Records::record(0x06, std::string(28, '\0') + Records::text("") + Records::number(std::uint64_t{0})) +
        Records::record(0x06, std::string(28, '\0') + Records::text("zstd") + Records::number(std::uint64_t{0})) +
        Records::step_at(0.6, kSecond_ns) + Records::end());
  EXPECT_EQ(lengths(), (std::vector<double>{0.5, 0.6}));
}

TEST_F(RecordingPlayerTest, ATimeThatCannotBeOfTheSameRecordingIsRefused) {
  write(Records::begin() + Records::steps_channel() + Records::step_at(0.5, 0) + Records::step_at(0.6, 0 - kBegin_ns) +
        Records::end());
  EXPECT_THAT(error_of([&] { player()->start(); }),
              HasSubstr("between its first and last message there are 20718 days: one of the times is wrong"));
}

TEST_F(RecordingPlayerTest, ChannelsAreFoundWhereverTheyAreDescribed) {
  const std::string steps = Records::steps_channel();
  write(Records::begin() + Records::chunk(kSecond_ns, kSecond_ns, steps + Records::step_at(0.6, kSecond_ns)) +
        Records::chunk(
            0, 0,
            Records::channel(2, 1, "walk.steps", "protobuf") + Records::message(2, 0, step(0.5).SerializeAsString())) +
        Records::end());
  EXPECT_EQ(lengths(), (std::vector<double>{0.5, 0.6})) << "against the order of times";
  write(Records::begin() + Records::channel(7, 0, "a.text", "json") +
        Records::chunk(0, 0, steps + Records::step_at(0.5, 0)) + Records::end());
  EXPECT_EQ(lengths(), std::vector<double>{0.5}) << "some outside of chunks, some inside";
  std::string damaged = Records::chunk(0, 0, Records::step_at(0.5, 0));
  damaged.back() = static_cast<char>(damaged.back() ^ 1);
  write(Records::begin() + Records::chunk(0, 0, steps + Records::step_at(0.5, 0)) + damaged + Records::end());
  EXPECT_EQ(lengths(), std::vector<double>{0.5}) << "beside a chunk that is damaged";
}

TEST_F(RecordingPlayerTest, ChunksThatHaveNoneOfItsChannelsAreNotRead) {
  const auto index = [](std::uint16_t channel) {
    return Records::record(0x07, Records::number(channel) + Records::number(0U));
  };
  std::string damaged = Records::chunk(0, 0, Records::message(2, 0, "other"));
  damaged.back() = static_cast<char>(damaged.back() ^ 1);
  write(Records::begin() + Records::steps_channel() + Records::channel(2, 0, "b.other", "json") + damaged + index(2) +
        Records::chunk(0, 0, Records::step_at(0.5, 0)) + index(2) + index(1) + Records::end());
  const auto bench = player("walk.steps");
  bench->start();
  bench->advance(1s);
  EXPECT_EQ(lengths_of(*bench), std::vector<double>{0.5});
  EXPECT_EQ(bench->probe<std::uint64_t>("damaged"), 0U);
}

TEST_F(RecordingPlayerTest, OneOfWhichNothingWasPlayedIsNoSuccess) {
  std::string damaged = Records::chunk(0, kSecond_ns, Records::step_at(0.5, 0));
  damaged.back() = static_cast<char>(damaged.back() ^ 1);
  write(Records::begin() + Records::steps_channel() + damaged + Records::end());
  const auto bench = player();
  bench->start();
  bench->advance(2s);
  ASSERT_TRUE(bench->run_end());
  EXPECT_EQ(bench->run_end()->first, 1);
  EXPECT_THAT(bench->run_end()->second, HasSubstr("nothing of it was played"));
}

TEST_F(RecordingPlayerTest, RecordsThatAreTooShortAreLeftOutAndCounted) {
  write(Records::begin() + Records::steps_channel() + Records::record(0x03, "x") + Records::record(0x04, "x") +
        Records::record(0x05, "x") + Records::record(0x06, "x") + Records::step_at(0.5, 0) + Records::end());
  const auto bench = player();
  bench->start();
  EXPECT_THAT(bench->log(), ::testing::Contains(HasSubstr("4 of its records are garbled and left out")));
  bench->advance(1s);
  EXPECT_EQ(lengths_of(*bench), std::vector<double>{0.5});
}

TEST_F(RecordingPlayerTest, WhoGoesOnAfterTheEndHearsOfItOnce) {
  write_steps(2);
  const auto bench = player();
  bench->set("at_end", "HOLD");
  bench->start();
  bench->advance(1s);
  bench->start(kModeNeutral);
  bench->start();
  bench->advance(1s);
  EXPECT_EQ(std::count_if(bench->log().begin(), bench->log().end(),
                          [](const auto& line) { return line.find("end of recording") != std::string::npos; }),
            1);
}

TEST_F(RecordingPlayerTest, ThatOneIsCutOffIsTold) {
  write_steps(3);
  std::filesystem::resize_file(file_, std::filesystem::file_size(file_) - 100);
  const auto bench = player();
  bench->start();
  EXPECT_THAT(bench->log(), ::testing::Contains(HasSubstr("the recording is cut off: what is whole of it is played")));
  bench->advance(1s);
  EXPECT_EQ(lengths_of(*bench).size(), 3U);
}

TEST_F(RecordingPlayerTest, ADamagedChunkIsLeftOutToldAndCounted) {
  const std::string good = Records::chunk(2 * kSecond_ns, 2 * kSecond_ns, Records::step_at(0.7, 2 * kSecond_ns));
  const auto damaged_is_left_out = [&](const std::string& damaged, const std::string& why) {
    write(Records::begin() + Records::steps_channel() + damaged + good + Records::end());
    const auto bench = player();
    bench->start();
    bench->advance(10s);
    EXPECT_EQ(lengths_of(*bench), std::vector<double>{0.7});
    EXPECT_EQ(bench->probe<std::uint64_t>("damaged"), 1U);
    EXPECT_THAT(bench->log(), ::testing::Contains(HasSubstr(why)));
  };
  std::string flipped = Records::chunk(0, 0, Records::step_at(0.5, 0));
  flipped.back() = static_cast<char>(flipped.back() ^ 1);
  damaged_is_left_out(flipped, "a chunk is damaged: its checksum is another one");
  std::string packed = Records::chunk(0, 0, Records::step_at(0.5, 0), "zstd");
  packed.resize(packed.size() - 3);
  packed.replace(1, 8, Records::number(std::uint64_t{packed.size() - 9}));
  packed.replace(9 + 28 + 8, 8, Records::number(std::uint64_t{packed.size() - 9 - 28 - 8 - 8}));
  damaged_is_left_out(packed, "a chunk is damaged: ");
  std::string unknown = Records::chunk(0, 0, Records::step_at(0.5, 0));
  unknown = Records::record(0x06, unknown.substr(9, 28) + Records::text("rar") + unknown.substr(9 + 28 + 4));
  damaged_is_left_out(unknown, "a chunk is compressed in a way that is not known here: rar");
  damaged_is_left_out(Records::chunk(0, 0, Records::step_at(0.5, 0).substr(0, 20)), "one of its records is not whole");
  damaged_is_left_out(Records::chunk(0, 0, Records::message(1, 0, "\xff")), "a message of 'walk.steps' is garbled");
}

TEST_F(RecordingPlayerTest, NoneOfItsFilesIsRefusedByName) {
  EXPECT_THAT(error_of([] { Player("walk").start(); }), HasSubstr("load recording-player as walk file=FILE.mcap"));
  const std::string missing = error_of([&] { player()->start(); });
  EXPECT_THAT(missing, HasSubstr("cannot read the recording: No such file or directory"));
  EXPECT_THAT(missing, HasSubstr(path()));
  ASSERT_EQ(::mkfifo(path().c_str(), 0600), 0);
  EXPECT_THAT(error_of([&] { player()->start(); }), HasSubstr("this is no file"));
  std::filesystem::remove(file_);
  write("no recording at all");
  EXPECT_THAT(error_of([&] { player()->start(); }),
              HasSubstr("walk.mcap, byte 0: 'walk' failed: this is no recording"));
  write(Records::begin() + Records::end());
  EXPECT_THAT(error_of([&] { player()->start(); }), HasSubstr("there is nothing to be played"));
}

/// Each push service of the catalogue has its port.
TEST(RecordingPlayerPorts, AreThePushServicesOfTheCatalogue) {
  std::set<std::string> catalogue;
  for (const auto* file : {sensors::GetIMU::descriptor()->file(), perception::CommObstacle::descriptor()->file(),
                           localisation::CommLocation::descriptor()->file(), navigation::CommPath::descriptor()->file(),
                           security::CommSession::descriptor()->file(), hmi::NextTurn::descriptor()->file()}) {
    for (int i = 0; i < file->service_count(); ++i) {
      const auto pattern = file->service(i)->options().GetExtension(contract).pattern();
      if (pattern == PUSH_NEWEST || pattern == PUSH_TIMED) catalogue.insert(file->service(i)->full_name());
    }
  }
  std::set<std::string> ports;
  Player bench("walk");
  for (const Port* port : bench.hull().ports()) ports.insert(std::string(port->service().name()));
  EXPECT_EQ(ports, catalogue);
}

TEST(ShiftedTimes, AreThoseOfAllObjectsInside) {
  sensors::CommiBeaconList list;
  list.add_beacon_list()->set_t(1000);
  list.add_beacon_list()->set_t(std::numeric_limits<std::int64_t>::max());
  list.add_beacon_list()->set_rssi(-60);
  list.add_beacon_list()->set_t(100);
  ASSERT_TRUE(has_times(*list.GetDescriptor()));
  EXPECT_FALSE(has_times(*sensors::GetIMU::descriptor()));
  shift_times(list, 500);
  EXPECT_EQ(list.beacon_list(0).t(), 1500);
  EXPECT_EQ(list.beacon_list(1).t(), std::numeric_limits<std::int64_t>::max()) << "a time that cannot be one stays";
  EXPECT_FALSE(list.beacon_list(2).has_t());
  shift_times(list, -1000);
  EXPECT_EQ(list.beacon_list(0).t(), 500);
  EXPECT_EQ(list.beacon_list(3).t(), 0) << "before the clock began";
}

}  // namespace
}  // namespace fiona::recording_player
