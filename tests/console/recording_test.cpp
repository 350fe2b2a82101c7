#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/resource.h>

#include <csignal>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iterator>

#include "fiona/probe.pb.h"
#include "fiona/security.pb.h"
#include "recording.hpp"

#include <fiona/error.hpp>

namespace fiona::console {
namespace {

using testing::HasSubstr;
using testing::Not;

class RecordingTest : public testing::Test {
 protected:
  RecordingTest() {
    std::string name = testing::TempDir() + "recording-XXXXXX";
    folder_ = ::mkdtemp(name.data());
    file_ = folder_ / "walk.mcap";
  }
  ~RecordingTest() override { std::filesystem::remove_all(folder_); }

  std::string bytes() const {
    std::ifstream file(file_, std::ios::binary);
    return {std::istreambuf_iterator<char>(file), {}};
  }
  static control::Sample sample_of(const google::protobuf::Message& object) {
    control::Sample sample;
    sample.set_type(object.GetDescriptor()->full_name());
    sample.set_object(object.SerializeAsString());
    return sample;
  }

  std::filesystem::path folder_, file_;
};

TEST_F(RecordingTest, WhatIsMarkedAsSecretIsLeftOut) {
  security::CommAuthenticationRequest login;
  login.set_username("anna");
  login.set_password("correct horse");
  Recording recording(file_);
  recording.take("page.logins", sample_of(login));
  recording.finish();
  EXPECT_THAT(bytes(), HasSubstr("anna"));
  EXPECT_THAT(bytes(), Not(HasSubstr("correct horse")));
}

TEST_F(RecordingTest, AProbeWithoutAValueIsNoMessage) {
  Recording recording(file_);
  recording.take("gauge.silent", {});
  recording.finish();
  EXPECT_EQ(recording.written().messages(), 0U);
  EXPECT_EQ(recording.ports(), 0U);
}

TEST_F(RecordingTest, AFileThatCannotGrowIsToldWithTheSystemsReason) {
  std::signal(SIGXFSZ, SIG_IGN);
  rlimit before{};
  ASSERT_EQ(::getrlimit(RLIMIT_FSIZE, &before), 0);
  probe::Text text;
  text.set_value(std::string(100'000, 'x'));
  Recording recording(file_);
  const rlimit small{500'000, before.rlim_max};
  ASSERT_EQ(::setrlimit(RLIMIT_FSIZE, &small), 0);
  std::string told;
  try {
    for (int i = 0; i < 100; ++i) recording.take("log.text", sample_of(text));
  } catch (const Error& error) {
    told = error.what();
  }
  ASSERT_EQ(::setrlimit(RLIMIT_FSIZE, &before), 0);
  EXPECT_THAT(told, HasSubstr("walk.mcap: the file cannot be written: File too large"));
  EXPECT_THAT(told, HasSubstr("next: "));
}

}  // namespace
}  // namespace fiona::console
