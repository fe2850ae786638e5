// From the images and calibrations of a frame to the tensors that the graphs take.
#pragma once

#include "bundle.hpp"
#include "frame.hpp"
#include "tensor.hpp"

namespace duospacenet {

/// How a camera's image is scaled, and then cropped to the size of the network's input [px].
struct Resize {
    int scaled_width, scaled_height;
    int left, top;  // columns and rows that are removed

    bool operator==(const Resize&) const = default;
};

/// The smallest scaled image that covers the network's input. The crop is equal on the left and right, and at the top.
Resize resize_of(int width_px, int height_px, const Preprocessing& preprocessing);

/// The affine map from pixels of the camera's image to pixels of the network's input.
cv::Matx33d resized_T_image(const Camera& camera, const Resize& resize);

/// The tensors of one frame for N camera slots. Cameras keep their order; slots without a camera are zeros.
struct NetworkInputs {
    Tensor images;        // (N, H, W, 3) uint8 BGR
    Tensor image_T_ego;   // (N, 3, 4) float32
    Tensor camera_valid;  // (N) bool
};

/// Prepares a valid frame.
NetworkInputs prepare(const Frame& frame, const Preprocessing& preprocessing, int num_cameras);

}  // namespace duospacenet
