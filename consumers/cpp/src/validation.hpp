// Validation of frames. The graphs cannot detect bad numbers, and may turn them into plausible boxes.
#pragma once

#include "frame.hpp"

namespace duospacenet {

/// Checks the time, pose, calibrations and images of a frame, as "Validation" in docs/frame-steps.md says.
/// num_cameras: the largest number of cameras that the bundle accepts. Throws InputError.
void check_frame(const Frame& frame, int num_cameras);

/// The same without the images and the number of cameras.
void check_numbers(const Frame& frame);

}  // namespace duospacenet
