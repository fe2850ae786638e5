// Detections: the decoder's outputs as a list of boxes, highest score first.
#pragma once

#include <array>
#include <optional>
#include <string>
#include <vector>

#include "tensor.hpp"

namespace duospacenet {

/// One object in the ego frame: x y z of the centre [m], w l h [m], yaw [rad], vx vy over ground [m/s].
struct Detection {
    std::size_t class_index;  // into the manifest's `classes`
    float score;              // 0 to 1
    std::array<float, 9> box;
};

/// The result of one frame.
struct Detections {
    std::vector<Detection> boxes;             // at most 500
    Tensors maps;                             // (X, Y) float32 probabilities by map class, if they were asked for
    std::vector<double> ages_s;               // of the past frames that the decoder used, newest first
    std::optional<std::string> reset_reason;  // why the history before this frame was dropped
    std::optional<std::string> skipped;       // why the frame was not processed
    int dropped_queries = 0;                  // removed because a number was not finite
    int dropped_map_cells = 0;                // set to 0 because the logit was not finite
};

/// Selects the (query, class) pairs with the highest scores.
/// class_logits: (Q, classes). boxes: (Q, 9). dropped_queries: gets the number of queries that were removed.
std::vector<Detection> select_detections(const Tensor& class_logits, const Tensor& boxes, int& dropped_queries);

/// The probabilities (X, Y) of a mask (1, 1, X, Y) of logits. dropped_cells: is increased by the cells set to 0.
Tensor probabilities(const Tensor& mask, int& dropped_cells);

}  // namespace duospacenet
