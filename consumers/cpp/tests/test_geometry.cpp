#include <doctest/doctest.h>

#include <numbers>
#include <opencv2/core.hpp>

#include "geometry.hpp"

using namespace duospacenet;

TEST_CASE("the inverse of a quarter turn left and 2 m forward is a quarter turn right and 2 m to the left") {
    const cv::Matx44d a_T_b{0, -1, 0, 2, 1, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1};
    CHECK(inverse(a_T_b) == cv::Matx44d{0, 1, 0, 0, -1, 0, 0, 2, 0, 0, 1, 0, 0, 0, 0, 1});
}

TEST_CASE("a rotation that is scaled by rounding becomes orthonormal, and its position stays") {
    const cv::Matx44d rounded{1.001, 0, 0, 4e6, 0, 1.001, 0, 5e6, 0, 0, 1.001, 7, 0, 0, 0, 1};
    const cv::Matx44d rigid = nearest_rigid(rounded);
    CHECK(cv::norm(rotation_of(rigid) - cv::Matx33d::eye()) < 1e-15);
    CHECK(translation_of(rigid) == cv::Vec3d(4e6, 5e6, 7));
}

TEST_CASE("the angle of a rotation is from 0 to pi, also where rounding leaves the range of the cosine") {
    CHECK(rotation_angle(cv::Matx33d::eye() * 1.0000001) == 0);
    CHECK(rotation_angle({-1, 0, 0, 0, -1, 0, 0, 0, 1}) == doctest::Approx(std::numbers::pi));
    CHECK(rotation_angle({0, -1, 0, 1, 0, 0, 0, 0, 1}) == doctest::Approx(std::numbers::pi / 2));
}
