// A scene folder: `scene.json` beside image files. See docs/scene-folder.md.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "frame.hpp"

namespace duospacenet {

class SceneFolder {
  public:
    /// Reads and checks all of `scene.json`: fields, times, poses, calibrations, and that the image files exist.
    /// folder: or the path of the file. Throws InputError, naming the file and the field.
    explicit SceneFolder(const std::filesystem::path& folder);

    std::size_t size() const { return frames_.size(); }

    /// Checks that no frame has more cameras than the bundle accepts. Throws InputError.
    void check_rigs(int num_cameras) const;

    /// Reads a frame with its images. Throws InputError, naming the image file.
    Frame frame(std::size_t index) const;

    /// A frame as `scene.json` describes it.
    struct FrameRecord {
        Frame frame;                                     // without images
        std::vector<std::filesystem::path> image_paths;  // by camera; empty for a lost one
    };

  private:
    std::vector<FrameRecord> frames_;
};

}  // namespace duospacenet
