#include "detections.hpp"

#include <algorithm>
#include <cmath>

namespace duospacenet {
namespace {

constexpr std::size_t kMaxDetections = 500;

/// 1 / (1 + exp(-x)) in float32, without overflow.
float sigmoid(float x) {
    const float e = std::exp(-std::abs(x));
    return (x >= 0 ? 1.0f : e) / (1.0f + e);
}

bool are_finite(std::span<const float> values) {
    return std::all_of(values.begin(), values.end(), [](float value) { return std::isfinite(value); });
}

}  // namespace

std::vector<Detection> select_detections(const Tensor& class_logits, const Tensor& boxes, int& dropped_queries) {
    const std::size_t num_queries = class_logits.shape()[0], num_classes = class_logits.shape()[1];
    std::vector<Detection> detections;
    detections.reserve(num_queries * num_classes);
    for (std::size_t query = 0; query < num_queries; ++query) {
        const auto logits = class_logits.values<float>().subspan(query * num_classes, num_classes);
        const auto box = boxes.values<float>().subspan(9 * query, 9);
        if (!are_finite(logits) || !are_finite(box)) {
            ++dropped_queries;
            continue;
        }
        for (std::size_t index = 0; index < num_classes; ++index) {
            Detection& detection = detections.emplace_back(Detection{index, sigmoid(logits[index]), {}});
            std::copy(box.begin(), box.end(), detection.box.begin());
        }
    }
    // Equal scores keep the order of queries and classes.
    const auto is_higher = [](const Detection& one, const Detection& other) { return one.score > other.score; };
    std::stable_sort(detections.begin(), detections.end(), is_higher);
    detections.resize(std::min(detections.size(), kMaxDetections));
    return detections;
}

Tensor probabilities(const Tensor& mask, int& dropped_cells) {
    const Tensor result({mask.shape()[2], mask.shape()[3]}, Dtype::float32);
    const auto logits = mask.values<float>();
    std::transform(logits.begin(), logits.end(), result.values<float>().begin(), [&](float logit) {
        if (std::isfinite(logit)) return sigmoid(logit);
        ++dropped_cells;
        return 0.0f;
    });
    return result;
}

}  // namespace duospacenet
