#include <fiona/plugin.hpp>

#include POSE_HEADER

namespace fiona::zoo {

/// Its parameters are a message of another library.
class PoseReader final : public Component {
 public:
  using Component::Component;

 private:
  Params<Pose> start_{*this};
};

}  // namespace fiona::zoo

FIONA_PLUGIN(plugin) { plugin.add<fiona::zoo::PoseReader>("pose-reader"); }
