#include <fiona/walk/dataset.hpp>

#include <algorithm>
#include <charconv>

#include <fiona/error.hpp>

#include "archive_reader.hpp"
#include "trace_parser.hpp"

namespace fiona::walk {
namespace {

namespace fs = std::filesystem;

constexpr const char* kSurveyFile = "train.tar.xz";
constexpr const char* kTestFile = "test.tar.xz";
constexpr const char* kLayouts = "FLOOR/train.tar.xz for floors like B1, F1, F2, or one train.tar.xz";

[[noreturn]] void not_a_dataset(const fs::path& folder, const std::string& found) {
  throw Error(ErrorCode::NotFound, {.what = "this folder holds no recorded walks",
                                    .where = folder.string(),
                                    .expected = kLayouts,
                                    .found = found,
                                    .next = "name the folder that holds the archives"});
}

Walk parse_current(ArchiveReader& reader, std::optional<int> level, const Limits& limits) {
  TraceParser parser(reader.where(), level, limits.walk_events);
  reader.for_each_line([&](std::string_view line) { parser.line(line); });
  return parser.finish();
}

/// False when the visitor asked to stop.
bool visit_archive(const fs::path& file, std::optional<int> level, const Limits& limits, const WalkVisitor& visit) {
  ArchiveReader reader(file, limits);
  while (reader.next()) {
    if (!visit(parse_current(reader, level, limits))) return false;
  }
  return true;
}

}  // namespace

std::optional<int> level_of_floor_name(const std::string& name) {
  if (name.size() < 2) return std::nullopt;
  const bool letter_first = name.front() == 'B' || name.front() == 'F';
  if (!letter_first && name.back() != 'F') return std::nullopt;
  const char* begin = name.data() + (letter_first ? 1 : 0);
  const char* end = name.data() + name.size() - (letter_first ? 0 : 1);
  int number = 0;
  const auto [stop, error] = std::from_chars(begin, end, number);
  if (error != std::errc() || stop != end || number < 1 || number > 200) return std::nullopt;
  return name.front() == 'B' ? -number : number - 1;
}

Dataset Dataset::open(const fs::path& folder, const Limits& limits) {
  if (!fs::is_directory(folder)) not_a_dataset(folder, "no such folder");
  Dataset dataset(folder, limits);
  if (fs::exists(folder / kSurveyFile)) {
    dataset.survey_.push_back({folder / kSurveyFile, std::nullopt});
  } else {
    for (const auto& entry : fs::directory_iterator(folder)) {
      if (!entry.is_directory() || !fs::exists(entry.path() / kSurveyFile)) continue;
      const auto level = level_of_floor_name(entry.path().filename().string());
      if (!level) not_a_dataset(entry.path(), "a floor called " + entry.path().filename().string());
      dataset.survey_.push_back({entry.path() / kSurveyFile, level});
    }
    std::sort(dataset.survey_.begin(), dataset.survey_.end(),
              [](const Archive& a, const Archive& b) { return a.level < b.level; });
  }
  if (fs::exists(folder / kTestFile)) dataset.test_ = Archive{folder / kTestFile, std::nullopt};
  if (dataset.survey_.empty() && !dataset.test_) not_a_dataset(folder, "none of them");
  return dataset;
}

void Dataset::for_each_survey_walk(const WalkVisitor& visit) const {
  for (const Archive& archive : survey_) {
    if (!visit_archive(archive.file, archive.level, limits_, visit)) return;
  }
}

void Dataset::for_each_test_walk(const WalkVisitor& visit) const {
  if (test_) visit_archive(test_->file, test_->level, limits_, visit);
}

std::vector<std::string> Dataset::walk_names() const {
  std::vector<std::string> names;
  if (!test_) return names;
  ArchiveReader reader(test_->file, limits_);
  while (reader.next()) names.push_back(parse_current(reader, test_->level, limits_).name);
  return names;
}

Walk Dataset::walk(const std::string& name) const {
  std::vector<std::string> names;
  std::optional<Walk> found;
  const WalkVisitor match = [&](const Walk& walk) {
    names.push_back(walk.name);
    if (walk.name == name) found = walk;
    return !found;
  };
  for_each_test_walk(match);
  if (!found) for_each_survey_walk(match);
  if (found) return std::move(*found);
  throw Error(ErrorCode::NotFound, {.what = "no recorded walk is called " + name,
                                    .where = folder_.string(),
                                    .expected = "one of its " + std::to_string(names.size()) + " walks",
                                    .found = name,
                                    .next = "choose a name from the archives' lists (`tar tJf`)",
                                    .near = nearest_names(name, names)});
}

std::string Dataset::name() const {
  const fs::path clean = fs::absolute(folder_).lexically_normal();
  return (clean.has_filename() ? clean : clean.parent_path()).filename().string();
}

}  // namespace fiona::walk
