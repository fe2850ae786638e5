#include "results.hpp"

#include <cmath>
#include <map>
#include <nlohmann/json.hpp>

namespace duospacenet {
namespace {

using Json = nlohmann::ordered_json;

constexpr double kMoving_m_s = 0.2;  // a faster object counts as moving

double rounded(double value, int decimals) {
    const double factor = decimals == 4 ? 1e4 : 1e6;
    return std::nearbyint(value * factor) / factor;
}

Json numbers(const std::array<float, 9>& box, std::size_t first, std::size_t count) {
    Json values = Json::array();
    for (std::size_t index = first; index < first + count; ++index) values.push_back(rounded(box[index], 4));
    return values;
}

/// The most likely attribute of nuScenes, by class and speed. Empty for barriers, traffic cones and other classes.
std::string attribute_of(const std::string& name, double speed_m_s) {
    struct Attributes {
        std::string standing, moving;
    };
    static const Attributes vehicle{"vehicle.parked", "vehicle.moving"};
    static const Attributes cycle{"cycle.without_rider", "cycle.with_rider"};
    static const std::map<std::string, Attributes> attributes{
        {"car", vehicle},
        {"truck", vehicle},
        {"trailer", vehicle},
        {"construction_vehicle", vehicle},
        {"bus", {"vehicle.stopped", "vehicle.moving"}},
        {"motorcycle", cycle},
        {"bicycle", cycle},
        {"pedestrian", {"pedestrian.standing", "pedestrian.moving"}},
    };
    const auto found = attributes.find(name);
    if (found == attributes.end()) return "";
    return speed_m_s > kMoving_m_s ? found->second.moving : found->second.standing;
}

Json box_result(const Detection& detection, const std::string& name) {
    const auto& box = detection.box;
    return {{"class", name},
            {"score", rounded(detection.score, 6)},
            {"center_m", numbers(box, 0, 3)},
            {"size_wlh_m", numbers(box, 3, 3)},
            {"yaw_rad", rounded(box[6], 6)},
            {"velocity_m_s", numbers(box, 7, 2)},
            {"attribute", attribute_of(name, std::hypot(static_cast<double>(box[7]), static_cast<double>(box[8])))}};
}

Json rows(const cv::Matx44d& matrix) {
    Json result = Json::array();
    for (int row = 0; row < 4; ++row)
        result.push_back({matrix(row, 0), matrix(row, 1), matrix(row, 2), matrix(row, 3)});
    return result;
}

Json text_or_null(const std::optional<std::string>& text) { return text ? Json(*text) : Json(nullptr); }

}  // namespace

std::string result_line(const Frame& frame, const Detections& detections, const Manifest& manifest) {
    Json ages = Json::array(), boxes = Json::array();
    for (const double age_s : detections.ages_s) ages.push_back(rounded(age_s, 6));
    for (const Detection& detection : detections.boxes) {
        boxes.push_back(box_result(detection, manifest.classes[detection.class_index]));
    }
    const std::size_t num_frames = detections.skipped ? 0 : 1 + detections.ages_s.size();
    const Json result{
        {"scene", frame.scene},
        {"token", frame.token},
        {"timestamp_s", frame.timestamp_s},
        {"global_T_ego", rows(frame.global_T_ego)},
        {"history",
         {{"frames", num_frames}, {"reset_reason", text_or_null(detections.reset_reason)}, {"ages_s", ages}}},
        {"skipped", text_or_null(detections.skipped)},
        {"degraded", detections.dropped_queries > 0 || detections.dropped_map_cells > 0},
        {"dropped", {{"queries", detections.dropped_queries}, {"map_cells", detections.dropped_map_cells}}},
        {"boxes", boxes},
        {"maps", Json::object()},
    };
    return result.dump();
}

}  // namespace duospacenet
