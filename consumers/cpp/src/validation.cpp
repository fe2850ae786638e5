#include "validation.hpp"

#include <algorithm>
#include <cmath>
#include <opencv2/core.hpp>
#include <sstream>

#include "errors.hpp"
#include "geometry.hpp"

namespace duospacenet {
namespace {

constexpr double kLargest = 1e9;  // px or m
constexpr double kLatest_s = 1e11;
constexpr double kOrthonormalTolerance = 2e-3;              // accepts rotations written with three decimals
constexpr double kShortestFocal = 0.1, kLongestFocal = 60;  // in image sizes
constexpr double kFarthestCentre = 2;                       // in image sizes from the image centre

template <typename... Parts>
[[noreturn]] void refuse(const std::string& field, const Parts&... parts) {
    std::ostringstream message;
    message << field << ": ";
    (message << ... << parts);
    throw InputError(message.str());
}

template <int rows, int columns>
void check_elements(const std::string& field, const cv::Matx<double, rows, columns>& matrix) {
    for (const double value : matrix.val) {
        // NaN fails the comparison, so it is refused here.
        if (!(std::abs(value) <= kLargest)) {
            refuse(field, "expected finite numbers of at most ", kLargest, "; got ", value, ". Correct the matrix.");
        }
    }
}

void check_rigid(const std::string& field, const cv::Matx44d& a_T_b) {
    check_elements(field, a_T_b);
    const cv::Matx33d rotation = rotation_of(a_T_b);
    const cv::Matx33d product = rotation * rotation.t() - cv::Matx33d::eye();
    const double deviation = cv::norm(product, cv::NORM_INF);
    const double determinant = cv::determinant(rotation);
    if (deviation > kOrthonormalTolerance || !(determinant > 0)) {
        refuse(field, "expected a rotation, orthonormal to ", kOrthonormalTolerance,
               " and with determinant 1; got one ", "that is off by ", deviation, ", with determinant ", determinant,
               ". Is it scaled or mirrored?");
    }
    if (a_T_b.row(3) != cv::Matx14d(0, 0, 0, 1)) {
        refuse(field, "expected the last row 0 0 0 1; got ", a_T_b.row(3), ". Is the matrix transposed?");
    }
}

void check_proportion(const std::string& field, char axis, double focal_px, double centre_px, int size_px) {
    const double focal = focal_px / size_px, centre = centre_px / size_px;
    if (!(focal >= kShortestFocal && focal <= kLongestFocal && std::abs(centre - 0.5) <= kFarthestCentre)) {
        refuse(field, "expected a focal length f", axis, " of ", kShortestFocal, " to ", kLongestFocal, " times the ",
               size_px, " px of the image, and a principal point c", axis, " at most ", kFarthestCentre,
               " image sizes from its centre; got ", focal_px, " and ", centre_px,
               ". Are they in pixels of this image?");
    }
}

void check_intrinsics(const std::string& field, const Camera& camera) {
    const cv::Matx33d& k = camera.intrinsics_px;
    check_elements(field, k);
    if (k(1, 0) != 0 || k(2, 0) != 0 || k(2, 1) != 0 || k(2, 2) != 1) {
        refuse(field, "expected [[fx, s, cx], [0, fy, cy], [0, 0, 1]]; got ", k, ". Is the matrix transposed?");
    }
    check_proportion(field, 'x', k(0, 0), k(0, 2), camera.width_px);
    check_proportion(field, 'y', k(1, 1), k(1, 2), camera.height_px);
}

void check_camera(const Camera& camera) {
    const std::string field = "camera " + camera.name + ": ";
    if (camera.width_px < 1 || camera.height_px < 1) {
        refuse(field + "size", "expected at least 1x1 px; got ", camera.width_px, "x", camera.height_px, ".");
    }
    check_intrinsics(field + "intrinsics_px", camera);
    check_rigid(field + "camera_T_ego", camera.camera_T_ego);
}

void check_image(const Camera& camera) {
    const cv::Mat& image = camera.image;
    if (image.type() != CV_8UC3 || image.cols != camera.width_px || image.rows != camera.height_px) {
        refuse("camera " + camera.name, "expected an image of 8-bit BGR and ", camera.width_px, "x", camera.height_px,
               " px, as its calibration says; got ", cv::typeToString(image.type()), " and ", image.cols, "x",
               image.rows, " px. Correct the calibration, or use the original image.");
    }
}

}  // namespace

void check_frame(const Frame& frame, int num_cameras) {
    if (frame.cameras.size() > static_cast<std::size_t>(num_cameras)) {
        refuse("cameras", "expected at most ", num_cameras, ", as the bundle was exported; got ", frame.cameras.size(),
               ". Leave some out, or export again with more.");
    }
    check_numbers(frame);
    for (const Camera& camera : frame.cameras) {
        if (!camera.is_lost()) check_image(camera);
    }
}

void check_numbers(const Frame& frame) {
    if (frame.cameras.empty()) refuse("cameras", "expected at least 1; got none. Add the calibrations of the rig.");
    if (!(std::abs(frame.timestamp_s) <= kLatest_s)) {
        refuse("timestamp_s", "expected seconds, at most ", kLatest_s, "; got ", frame.timestamp_s,
               ". If the times are in milliseconds or microseconds, convert them.");
    }
    check_rigid("global_T_ego", frame.global_T_ego);
    for (auto camera = frame.cameras.begin(); camera != frame.cameras.end(); ++camera) {
        check_camera(*camera);
        const auto same = [&](const Camera& other) { return other.name == camera->name; };
        if (std::any_of(frame.cameras.begin(), camera, same)) {
            refuse("camera " + camera->name, "expected each camera once; got it twice. Remove one.");
        }
    }
}

}  // namespace duospacenet
