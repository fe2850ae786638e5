#include <doctest/doctest.h>

#include "errors.hpp"
#include "geometry.hpp"
#include "history.hpp"

using namespace duospacenet;

namespace {

Manifest manifest_of(int num_frames) {
    Manifest manifest{};
    manifest.num_cameras = 1;
    manifest.window = {num_frames, 2.0, 70.0, 3.1416};
    manifest.memory = {"bev_value_0"};
    return manifest;
}

cv::Matx44d pose_at(double x_m, double angle_rad = 0) {
    const double cos = std::cos(angle_rad), sin = std::sin(angle_rad);
    return rigid_transform({cos, -sin, 0, sin, cos, 0, 0, 0, 1}, {x_m, 0, 0});
}

Frame frame_at(double timestamp_s, double x_m = 0, double angle_rad = 0, const std::string& scene = "yard") {
    return {{}, pose_at(x_m, angle_rad), timestamp_s, scene, ""};
}

/// A processed frame whose tensors all have one value.
PastFrame past_frame(double timestamp_s, double x_m, float value) {
    PastFrame frame{"yard", timestamp_s, pose_at(x_m), Tensor({1, 3, 4}, Dtype::float32), Tensor({1}, Dtype::boolean),
                    {}};
    for (float& element : frame.image_T_ego.values<float>()) element = value;
    frame.camera_valid.values<bool>()[0] = true;
    Tensor memory({1, 2}, Dtype::float32);
    for (float& element : memory.values<float>()) element = value;
    frame.memory.emplace("bev_value_0", memory);
    return frame;
}

float first(const Tensors& tensors, const std::string& name) { return tensors.at(name).values<float>()[0]; }

}  // namespace

TEST_CASE("slot 1 has the newest past frame, and empty slots have zeros and the identity") {
    const Manifest manifest = manifest_of(4);
    History history(manifest);
    history.add(past_frame(10.0, 0, 1));
    history.add(past_frame(10.5, 3, 2));
    const Tensors inputs = history.decoder_inputs(past_frame(11.25, 7, 3));
    CHECK(first(inputs, "slot0.bev_value_0") == 3);
    CHECK(first(inputs, "slot1.bev_value_0") == 2);
    CHECK(first(inputs, "slot2.bev_value_0") == 1);
    CHECK(first(inputs, "slot3.bev_value_0") == 0);
    const auto valid = inputs.at("frame_valid").values<bool>();
    CHECK((valid[0] && valid[1] && valid[2] && !valid[3]));
    const auto deltas_s = inputs.at("time_delta_s").values<float>();
    CHECK(deltas_s[0] == 0.0f);
    CHECK(deltas_s[1] == 0.75f);
    CHECK(deltas_s[2] == 1.25f);
    CHECK(deltas_s[3] == 0.0f);
    // Row 0, column 3 is x: the point below the ego is 4 m ahead of the ego of slot 1, and 7 m of that of slot 2.
    const auto transforms = inputs.at("past_T_now").values<float>();
    CHECK(transforms[3] == 0);
    CHECK(transforms[16 + 3] == 4);
    CHECK(transforms[32 + 3] == 7);
    CHECK(transforms[48] == 1);
    const auto projections = inputs.at("image_T_ego").values<float>();
    CHECK(projections[0] == 3);
    CHECK(projections[12] == 2);
    CHECK(projections[36] == 0);
    CHECK(!inputs.at("camera_valid").values<bool>()[3]);
}

TEST_CASE("past_T_now has the row-major layout: a quarter turn between two frames at the same place") {
    const Manifest manifest = manifest_of(2);
    History history(manifest);
    history.add(past_frame(10.0, 0, 1));
    PastFrame now = past_frame(10.5, 0, 2);
    now.global_T_ego = pose_at(0, CV_PI / 2);
    const Tensors inputs = history.decoder_inputs(now);
    const auto transform = inputs.at("past_T_now").values<float>().subspan(16, 16);
    CHECK(transform[1] == doctest::Approx(-1));  // what is left of the ego now was behind it
    CHECK(transform[4] == doctest::Approx(1));
}

TEST_CASE("the window drops its oldest frame, and a window of one frame still knows the last one") {
    const Manifest manifest = manifest_of(2);
    History history(manifest);
    for (int index = 0; index < 3; ++index) history.add(past_frame(10 + index, 0, static_cast<float>(index)));
    CHECK(history.ages_s(12.5) == std::vector<double>{0.5});
    const Manifest single = manifest_of(1);
    History last(single);
    last.add(past_frame(10.0, 0, 1));
    CHECK(last.ages_s(10.5).empty());
    CHECK_THROWS_AS(last.reset_reason(frame_at(10.0)), InputError);
    CHECK(last.decoder_inputs(past_frame(10.5, 0, 2)).size() == 6);
}

TEST_CASE("the reset rules apply in their order, and a limit itself is allowed") {
    const Manifest manifest = manifest_of(4);
    History history(manifest);
    CHECK(!history.reset_reason(frame_at(-5)));
    history.add(past_frame(10.0, 0, 1));
    CHECK(!history.reset_reason(frame_at(10.5)));
    CHECK(!history.reset_reason(frame_at(12.0)));
    CHECK(history.reset_reason(frame_at(12.25)) == "gap of 2.25 s, above 2 s");
    CHECK(!history.reset_reason(frame_at(10.5, 35)));
    CHECK(history.reset_reason(frame_at(10.5, -36)) == "ego jump of 36.0 m in 0.50 s");
    CHECK(!history.reset_reason(frame_at(10.5, 0, 1.57)));
    CHECK(history.reset_reason(frame_at(10.5, 0, -1.58)) == "ego turn of 91 degrees in 0.50 s");
    CHECK(history.reset_reason(frame_at(9.0, 0, 0, "street")) == "new scene 'street' after 'yard'");
    CHECK_THROWS_AS(history.reset_reason(frame_at(10.0)), InputError);
    CHECK_THROWS_AS(history.reset_reason(frame_at(9.0, 500)), InputError);
}
