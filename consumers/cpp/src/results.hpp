// A line of `results.jsonl`, as `duospacenet run` writes it. See docs/run.md.
#pragma once

#include <string>

#include "bundle.hpp"
#include "detections.hpp"
#include "frame.hpp"

namespace duospacenet {

/// The result of a frame as one line of JSON, without the line end.
std::string result_line(const Frame& frame, const Detections& detections, const Manifest& manifest);

}  // namespace duospacenet
