// One frame of a camera rig.
#pragma once

#include <opencv2/core/mat.hpp>
#include <opencv2/core/matx.hpp>
#include <string>
#include <vector>

namespace duospacenet {

/// `a_T_b` maps points of frame b to frame a [m]. Ego frame: x forward, y left, z up. Camera frame: z forward, x right,
/// y down. The centre of the first pixel is at (0.5, 0.5).
struct Camera {
    std::string name;
    int width_px = 0;  // of the camera's image
    int height_px = 0;
    cv::Matx33d intrinsics_px{};  // in pixels of the camera's image
    cv::Matx44d camera_T_ego{};   // at the time stamp of the frame
    cv::Mat image{};              // 8-bit BGR; empty for a lost camera

    bool is_lost() const { return image.empty(); }
};

struct Frame {
    std::vector<Camera> cameras;  // in any order
    cv::Matx44d global_T_ego{};   // the ego pose, in any fixed global frame
    double timestamp_s = 0;       // only differences matter
    std::string scene;            // frames of different scenes share no history
    std::string token;            // a name of the frame, copied to the results
};

}  // namespace duospacenet
