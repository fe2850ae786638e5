#include <doctest/doctest.h>

#include "errors.hpp"
#include "preprocessing.hpp"

using namespace duospacenet;

namespace {

Camera camera_of(int width_px, int height_px, const cv::Mat& image = {}) {
    const cv::Matx44d looking_forward{0, -1, 0, 0, 0, 0, -1, 1.5, 1, 0, 0, 0, 0, 0, 0, 1};
    return {"FRONT", width_px, height_px, {10, 0, 8, 0, 10, 4, 0, 0, 1}, looking_forward, image};
}

/// An image in which each pixel tells its row, its column and a constant.
cv::Mat numbered_image(int width_px, int height_px) {
    cv::Mat image(height_px, width_px, CV_8UC3);
    for (int row = 0; row < height_px; ++row) {
        for (int column = 0; column < width_px; ++column) {
            image.at<cv::Vec3b>(row, column) = {static_cast<uchar>(row), static_cast<uchar>(column), 77};
        }
    }
    return image;
}

}  // namespace

TEST_CASE("the scaled image covers the input, sizes round halves to even, and the cut rounds down") {
    const Preprocessing input{160, 64, true};
    CHECK(resize_of(1600, 900, input) == Resize{160, 90, 0, 26});
    CHECK(resize_of(321, 128, input) == Resize{160, 64, 0, 0});  // 160.5
    CHECK(resize_of(323, 128, input) == Resize{162, 64, 1, 0});  // 161.5
    CHECK(resize_of(326, 128, input) == Resize{163, 64, 1, 0});  // 3 columns too many: 1 on the left
    CHECK(resize_of(80, 64, input) == Resize{160, 128, 0, 64});
}

TEST_CASE("an image of extreme proportions is refused before any memory is allocated") {
    CHECK_THROWS_AS(resize_of(1, 60000, {160, 64, true}), InputError);
}

TEST_CASE("the map to input pixels scales each axis by its own factor, and subtracts the cut") {
    const cv::Matx33d map = resized_T_image(camera_of(323, 128), {162, 64, 1, 0});
    CHECK(map == cv::Matx33d{162.0 / 323, 0, -1, 0, 0.5, 0, 0, 0, 1});
}

TEST_CASE("an image of the input's width keeps its channels, and loses rows at the top") {
    Frame frame;
    frame.cameras = {camera_of(16, 10, numbered_image(16, 10))};
    const NetworkInputs inputs = prepare(frame, {16, 8, true}, 2);
    const auto pixels = inputs.images.values<std::uint8_t>();
    CHECK(inputs.images.shape() == Shape{2, 8, 16, 3});
    for (std::size_t row = 0; row < 8; ++row) {
        for (std::size_t column = 0; column < 16; ++column) {
            const std::size_t first = 3 * (16 * row + column);
            CHECK(pixels[first] == row + 2);
            CHECK(pixels[first + 1] == column);
            CHECK(pixels[first + 2] == 77);
        }
    }
}

TEST_CASE("halving gives the mean of four pixels with halves rounded up, twice for a quarter") {
    cv::Mat image = cv::Mat::zeros(2, 4, CV_8UC3);
    image.at<cv::Vec3b>(0, 0) = {1, 2, 3};
    image.at<cv::Vec3b>(1, 1) = {1, 3, 3};
    Frame frame;
    frame.cameras = {camera_of(4, 2, image)};
    const NetworkInputs inputs = prepare(frame, {2, 1, true}, 1);
    const auto pixels = inputs.images.values<std::uint8_t>();
    CHECK(pixels[0] == 1);  // 0.5
    CHECK(pixels[1] == 1);  // 1.25
    CHECK(pixels[2] == 2);  // 1.5
    CHECK(pixels[3] == 0);

    // One pixel of 8 in a block of 4x4: halvings give 2, then 1. The exact mean is 0.5, too.
    cv::Mat quarter = cv::Mat::zeros(4, 4, CV_8UC3);
    quarter.at<cv::Vec3b>(0, 0) = {6, 8, 9};
    frame.cameras = {camera_of(4, 4, quarter)};
    const NetworkInputs twice = prepare(frame, {1, 1, true}, 1);
    CHECK(twice.images.values<std::uint8_t>()[0] == 1);  // 1.5 becomes 2, then 0.5 becomes 1; the mean is 0.375
    CHECK(prepare(frame, {1, 1, false}, 1).images.values<std::uint8_t>()[0] == 0);
}

TEST_CASE("a lost camera keeps its projection, and an absent one has zeros") {
    Frame frame;
    frame.cameras = {camera_of(16, 8), camera_of(16, 8, numbered_image(16, 8))};
    const NetworkInputs inputs = prepare(frame, {16, 8, true}, 3);
    const auto valid = inputs.camera_valid.values<bool>();
    CHECK(!valid[0]);
    CHECK(valid[1]);
    CHECK(!valid[2]);
    // K [R | t] by hand: u = 10 * -y + 8 * x, v = 10 * (1.5 - z) + 4 * x, depth = x.
    const float expected[] = {8, -10, 0, 0, 4, 0, -10, 15, 1, 0, 0, 0};
    const auto projections = inputs.image_T_ego.values<float>();
    for (std::size_t index = 0; index < 12; ++index) {
        CHECK(projections[index] == expected[index]);
        CHECK(projections[12 + index] == expected[index]);
        CHECK(projections[24 + index] == 0);
    }
    CHECK(inputs.images.values<std::uint8_t>()[0] == 0);
}
