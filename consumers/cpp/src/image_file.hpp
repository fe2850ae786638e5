// JPEG and PNG files.
#pragma once

#include <filesystem>
#include <opencv2/core/mat.hpp>

namespace duospacenet {

/// Reads an image as 8-bit BGR. A rotation in its EXIF data is not applied.
/// Throws InputError, naming the file, if it is missing, damaged, neither JPEG nor PNG, or has more than 8 bits per
/// channel, or another size than the calibration.
cv::Mat read_image(const std::filesystem::path& path, int width_px, int height_px);

}  // namespace duospacenet
