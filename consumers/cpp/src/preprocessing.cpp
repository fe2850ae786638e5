#include "preprocessing.hpp"

#include <algorithm>
#include <cmath>
#include <opencv2/imgproc.hpp>

#include "errors.hpp"

namespace duospacenet {
namespace {

constexpr double kMostScaledPixels = 1e8;  // of a scaled image, before the crop

/// How many halvings lead exactly from the camera's image to the scaled one; 0 if none do.
int num_halvings(const cv::Size& from, const Resize& resize) {
    for (const int halvings : {1, 2}) {
        if (from == cv::Size(resize.scaled_width << halvings, resize.scaled_height << halvings)) return halvings;
    }
    return 0;
}

/// Replaces each block of 2x2 pixels by (a + b + c + d + 2) >> 2.
cv::Mat halved(const cv::Mat& image) {
    cv::Mat half;
    cv::resize(image, half, image.size() / 2, 0, 0, cv::INTER_AREA);  // for a factor of 2, it computes exactly this
    return half;
}

cv::Mat scaled(const cv::Mat& image, const Resize& resize, bool by_halvings) {
    const cv::Size size(resize.scaled_width, resize.scaled_height);
    if (image.size() == size) return image;
    if (const int halvings = by_halvings ? num_halvings(image.size(), resize) : 0) {
        return halvings == 1 ? halved(image) : halved(halved(image));
    }
    cv::Mat result;
    cv::resize(image, result, size, 0, 0, size.width < image.cols ? cv::INTER_AREA : cv::INTER_LINEAR);
    return result;
}

cv::Matx34d image_T_ego_of(const Camera& camera, const Resize& resize) {
    return resized_T_image(camera, resize) * camera.intrinsics_px * camera.camera_T_ego.get_minor<3, 4>(0, 0);
}

}  // namespace

Resize resize_of(int width_px, int height_px, const Preprocessing& preprocessing) {
    const double scale = std::max(static_cast<double>(preprocessing.width_px) / width_px,
                                  static_cast<double>(preprocessing.height_px) / height_px);
    // In the default rounding mode, halves are rounded to the even number.
    const double width = std::nearbyint(width_px * scale), height = std::nearbyint(height_px * scale);
    if (width * height > kMostScaledPixels) {
        throw InputError("image size: expected proportions like those of the network's input; got " +
                         std::to_string(width_px) + "x" + std::to_string(height_px) + " px. Crop the image.");
    }
    const int scaled_width = static_cast<int>(width), scaled_height = static_cast<int>(height);
    return {scaled_width, scaled_height, (scaled_width - preprocessing.width_px) / 2,
            scaled_height - preprocessing.height_px};
}

cv::Matx33d resized_T_image(const Camera& camera, const Resize& resize) {
    const double x_scale = static_cast<double>(resize.scaled_width) / camera.width_px;
    const double y_scale = static_cast<double>(resize.scaled_height) / camera.height_px;
    return {x_scale, 0, -static_cast<double>(resize.left), 0, y_scale, -static_cast<double>(resize.top), 0, 0, 1};
}

NetworkInputs prepare(const Frame& frame, const Preprocessing& preprocessing, int num_cameras) {
    const auto slots = static_cast<std::size_t>(num_cameras);
    const int width = preprocessing.width_px, height = preprocessing.height_px;
    const std::size_t image_bytes = 3 * static_cast<std::size_t>(width) * static_cast<std::size_t>(height);
    NetworkInputs inputs{
        Tensor::zeros({slots, static_cast<std::size_t>(height), static_cast<std::size_t>(width), 3}, Dtype::uint8),
        Tensor::zeros({slots, 3, 4}, Dtype::float32), Tensor::zeros({slots}, Dtype::boolean)};
    for (std::size_t slot = 0; slot < frame.cameras.size(); ++slot) {
        const Camera& camera = frame.cameras[slot];
        const Resize resize = resize_of(camera.width_px, camera.height_px, preprocessing);
        const cv::Matx34d projection = image_T_ego_of(camera, resize);
        std::copy(std::begin(projection.val), std::end(projection.val), &inputs.image_T_ego.values<float>()[12 * slot]);
        if (camera.is_lost()) continue;
        cv::Mat input(height, width, CV_8UC3, &inputs.images.values<std::uint8_t>()[image_bytes * slot]);
        scaled(camera.image, resize, preprocessing.shrinks_by_halvings)({resize.left, resize.top, width, height})
            .copyTo(input);
        inputs.camera_valid.values<bool>()[slot] = true;
    }
    return inputs;
}

}  // namespace duospacenet
