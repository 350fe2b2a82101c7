#include "staging.hpp"

namespace fiona::marketplace {

StagingSink::StagingSink(const DurableDirectory& store, const std::string& name)
    : staging_((store.make_directory(name, 0700), store.existing_child(name))) {}

void StagingSink::begin(const PackageFile& file) {
  path_ = file.path();
  make_parents(path_);
  file_ = staging_.create(path_, file.executable() ? 0755 : 0644);
}

void StagingSink::write(std::string_view bytes) { staging_.write(file_, bytes, path_); }

void StagingSink::end() {
  staging_.sync(file_, path_);
  file_ = FileDescriptor{};
}

// The directory is new and ours alone, and path_fault has refused "..": no element of the path can be a link.
void StagingSink::make_parents(const std::string& path) {
  for (std::size_t slash = path.find('/'); slash != std::string::npos; slash = path.find('/', slash + 1)) {
    const std::string parent = path.substr(0, slash);
    if (directories_.insert(parent).second) staging_.make_directory(parent, 0755);
  }
}

void StagingSink::finish() {
  // Reversed: what is inside comes before what holds it.
  for (auto directory = directories_.rbegin(); directory != directories_.rend(); ++directory) {
    staging_.existing_child(*directory).sync();
  }
  staging_.sync();
}

}  // namespace fiona::marketplace
