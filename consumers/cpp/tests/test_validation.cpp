#include <doctest/doctest.h>

#include <functional>
#include <limits>

#include "errors.hpp"
#include "validation.hpp"

using namespace duospacenet;

namespace {

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();

Frame good_frame() {
    const cv::Matx44d looking_forward{0, -1, 0, 0, 0, 0, -1, 1.5, 1, 0, 0, 0, 0, 0, 0, 1};
    Camera camera{"FRONT", 16, 8, {10, 0, 8, 0, 10, 4, 0, 0, 1}, looking_forward, cv::Mat::zeros(8, 16, CV_8UC3)};
    return {{camera}, cv::Matx44d::eye(), 10.0, "yard", ""};
}

}  // namespace

TEST_CASE("a good frame is accepted, also at the limits") {
    Frame frame = good_frame();
    CHECK_NOTHROW(check_frame(frame, 1));
    frame.timestamp_s = -1e11;
    frame.global_T_ego(0, 3) = 1e9;
    frame.global_T_ego(0, 0) = 1.0009;          // its square is off by 0.0018
    frame.cameras[0].intrinsics_px(0, 2) = 40;  // two image sizes from the centre
    frame.cameras[0].intrinsics_px(1, 1) = 0.8;
    CHECK_NOTHROW(check_frame(frame, 1));
}

TEST_CASE("every bad number of a frame is refused") {
    using Damage = std::function<void(Frame&)>;
    const std::pair<const char*, Damage> damages[] = {
        {"NaN in the time", [](Frame& f) { f.timestamp_s = kNan; }},
        {"milliseconds", [](Frame& f) { f.timestamp_s = 1.6e12; }},
        {"NaN in the pose", [](Frame& f) { f.global_T_ego(1, 3) = kNan; }},
        {"far pose", [](Frame& f) { f.global_T_ego(1, 3) = 2e9; }},
        {"scaled pose", [](Frame& f) { f.global_T_ego(0, 0) = 1.0012; }},
        {"mirrored pose", [](Frame& f) { f.global_T_ego(0, 0) = -1; }},
        {"transposed pose", [](Frame& f) { f.global_T_ego(3, 0) = 5; }},
        {"NaN in the extrinsics", [](Frame& f) { f.cameras[0].camera_T_ego(2, 2) = kNan; }},
        {"infinite extrinsics",
         [](Frame& f) { f.cameras[0].camera_T_ego(0, 3) = std::numeric_limits<double>::infinity(); }},
        {"NaN in the intrinsics", [](Frame& f) { f.cameras[0].intrinsics_px(0, 0) = kNan; }},
        {"NaN in the skew", [](Frame& f) { f.cameras[0].intrinsics_px(0, 1) = kNan; }},
        {"negative focal length", [](Frame& f) { f.cameras[0].intrinsics_px(1, 1) = -10; }},
        {"short focal length", [](Frame& f) { f.cameras[0].intrinsics_px(0, 0) = 1.5; }},
        {"long focal length", [](Frame& f) { f.cameras[0].intrinsics_px(0, 0) = 961; }},
        {"far centre", [](Frame& f) { f.cameras[0].intrinsics_px(1, 2) = 20.1; }},
        {"transposed intrinsics", [](Frame& f) { f.cameras[0].intrinsics_px(2, 0) = 8; }},
        {"scaled intrinsics", [](Frame& f) { f.cameras[0].intrinsics_px(2, 2) = 2; }},
        {"no cameras", [](Frame& f) { f.cameras.clear(); }},
        {"too many cameras",
         [](Frame& f) {
             f.cameras.push_back({"LEFT", 16, 8, f.cameras[0].intrinsics_px, f.cameras[0].camera_T_ego, {}});
         }},
        {"no size", [](Frame& f) { f.cameras[0].width_px = 0; }},
        {"image of another size", [](Frame& f) { f.cameras[0].image = cv::Mat::zeros(16, 8, CV_8UC3); }},
        {"grey image", [](Frame& f) { f.cameras[0].image = cv::Mat::zeros(8, 16, CV_8UC1); }},
        {"image of 16 bits", [](Frame& f) { f.cameras[0].image = cv::Mat::zeros(8, 16, CV_16UC3); }},
    };
    for (const auto& [name, damage] : damages) {
        CAPTURE(name);
        Frame frame = good_frame();
        damage(frame);
        CHECK_THROWS_AS(check_frame(frame, 1), InputError);
    }
}

TEST_CASE("two cameras of one name are refused") {
    Frame frame = good_frame();
    frame.cameras.push_back(frame.cameras[0]);
    CHECK_THROWS_AS(check_frame(frame, 2), InputError);
}
