#include "golden_example.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <optional>
#include <set>
#include <sstream>

#include "errors.hpp"
#include "json_file.hpp"
#include "scene_folder.hpp"

namespace duospacenet {
namespace {

namespace fs = std::filesystem;

constexpr std::uintmax_t kMaxFileBytes = 1u << 27;
constexpr const char* kExpected = "golden/expected.json";
constexpr const char* kResults = "golden/results.jsonl";
constexpr std::size_t kYaw = 6;  // the column of a box

template <typename... Parts>
[[noreturn]] void differ(const Parts&... parts) {
    std::ostringstream message;
    message.precision(9);
    (message << ... << parts);
    throw CheckError(message.str() + ". This program or its engine does not compute what the bundle says.");
}

/// Checks the hash of each file of the example.
void check_hashes(const fs::path& bundle, const Manifest& manifest) {
    if (!manifest.golden_sha256.contains(kExpected) || !manifest.golden_sha256.contains(kResults)) {
        throw ArtifactError((bundle / "manifest.json").string() +
                            ": field golden: expected a golden example; got none. Export again with a newer toolkit.");
    }
    for (const auto& [name, hash] : manifest.golden_sha256) {
        const fs::path path = fs::path(name).lexically_normal();
        if (path.empty() || *path.begin() != "golden") {
            throw ArtifactError((bundle / "manifest.json").string() + ": field golden.sha256: expected files below " +
                                "golden/; got " + name + ". The file was edited: copy the whole folder.");
        }
        if (sha256(read_file<ArtifactError>(bundle / path, kMaxFileBytes)) != hash) {
            throw ArtifactError((bundle / path).string() + ": expected the hash in the manifest; got another one. " +
                                "The file is damaged: copy the whole folder, or export again.");
        }
    }
}

SceneFolder read_scene(const fs::path& bundle) {
    try {
        return SceneFolder(bundle / "golden" / "scene");
    } catch (const InputError& error) {  // the scene is a part of the bundle
        throw ArtifactError(error.what());
    }
}

double element(const Tensor& tensor, std::size_t index) {
    if (tensor.dtype() == Dtype::float32) return tensor.values<float>()[index];
    return static_cast<double>(tensor.bytes()[index]);  // a bool is 0 or 1
}

std::string index_text(std::size_t flat, const Shape& shape) {
    std::string text;
    for (auto size = shape.rbegin(); size != shape.rend(); ++size) {
        text = std::to_string(flat % *size) + (text.empty() ? "" : ", ") + text;
        flat /= *size;
    }
    return "[" + text + "]";
}

double difference_of_angles(double one, double other) { return std::remainder(one - other, 2 * std::numbers::pi); }

/// One element of a tensor that the example has a value for.
struct SampledValue {
    std::size_t index;  // row-major
    double expected, found;
    bool is_yaw;

    double difference() const { return is_yaw ? difference_of_angles(found, expected) : found - expected; }
};

/// Compares the tensors of one frame while a stream computes them.
class FrameComparison {
  public:
    explicit FrameComparison(const JsonField& frame) : token_(frame["token"].text()), expected_(frame["tensors"]) {}

    void compare(const std::string& name, const Tensor& found) {
        const auto expected = expected_.find(name);
        if (!expected) return;
        compared_.insert(name);
        check_shape(name, (*expected)["shape"], found);
        const JsonField rule = (*expected)["compare"];
        const std::string compare = rule.text();
        if (compare != "each" && compare != "rms") rule.refuse("'each' or 'rms'", "Update this program.");
        const std::vector<SampledValue> values = sampled_values(name, *expected, found);
        const double tolerance = (*expected)["tolerance"].number();
        compare == "each" ? compare_each(name, values, found, tolerance) : compare_rms(name, values, tolerance);
        num_values_ += values.size();
    }

    /// Checks that every expected tensor was computed. Returns the number of compared values.
    std::size_t finish() const {
        for (const auto& [name, tensor] : expected_.entries()) {
            if (!compared_.contains(name)) differ("frame ", token_, ": expected the tensor ", name, "; found none");
        }
        return num_values_;
    }

  private:
    void check_shape(const std::string& name, const JsonField& expected, const Tensor& found) const {
        Shape shape;
        for (const JsonField& size : expected.items()) {
            shape.push_back(static_cast<std::size_t>(size.integer(1, INT32_MAX)));
        }
        if (shape != found.shape()) {
            differ("frame ", token_, ": ", name, ": expected the shape ", describe(shape, found.dtype()), "; found ",
                   describe(found.shape(), found.dtype()));
        }
    }

    std::vector<SampledValue> sampled_values(const std::string& name, const JsonField& expected, const Tensor& found) {
        std::vector<SampledValue> values;
        const auto step = static_cast<std::size_t>(expected["step"].integer(1, INT32_MAX));
        std::size_t index = 0;
        for (const JsonField& value : expected["values"].items()) {
            if (index >= found.size()) value.refuse("no value beyond the tensor");
            const bool is_yaw = name == "decoder.boxes" && index % 9 == kYaw;
            // null: a consumer may compute anything there.
            if (!value.is_null()) values.push_back({index, value.number(), element(found, index), is_yaw});
            index += step;
        }
        return values;
    }

    void compare_each(const std::string& name, const std::vector<SampledValue>& values, const Tensor& found,
                      double tolerance) const {
        for (const SampledValue& value : values) {
            if (std::abs(value.difference()) <= tolerance) continue;  // NaN fails the comparison, so it differs
            differ("frame ", token_, ": ", name, index_text(value.index, found.shape()), ": expected ", value.expected,
                   " within ", tolerance, "; found ", value.found);
        }
    }

    void compare_rms(const std::string& name, const std::vector<SampledValue>& values, double tolerance) const {
        double sum = 0;
        for (const SampledValue& value : values) sum += value.difference() * value.difference();
        const double rms = values.empty() ? 0 : std::sqrt(sum / static_cast<double>(values.size()));
        if (rms <= tolerance) return;
        differ("frame ", token_, ": ", name, ": expected values with an RMS error of at most ", tolerance, "; found ",
               rms);
    }

    std::string token_;
    JsonField expected_;
    std::set<std::string> compared_;
    std::size_t num_values_ = 0;
};

/// Whether a detection has the class and the numbers of an expected box, within the tolerances.
bool is_close(const Detection& found, const JsonField& expected, const JsonField& tolerance, const Manifest& manifest) {
    if (manifest.classes[found.class_index] != expected["class"].text()) return false;
    if (!(std::abs(found.score - expected["score"].number()) <= tolerance["score"].number())) return false;
    const double largest = tolerance["box"].number();
    const auto are_close = [&](const char* key, std::size_t first, std::size_t count) {
        const std::vector<JsonField> values = expected[key].items();
        if (values.size() != count) expected[key].refuse("an array of " + std::to_string(count));
        for (std::size_t index = 0; index < count; ++index) {
            if (!(std::abs(found.box[first + index] - values[index].number()) <= largest)) return false;
        }
        return true;
    };
    return are_close("center_m", 0, 3) && are_close("size_wlh_m", 3, 3) && are_close("velocity_m_s", 7, 2) &&
           std::abs(difference_of_angles(found.box[kYaw], expected["yaw_rad"].number())) <= largest;
}

/// Compares the boxes of a frame with a line of results. Boxes of nearly equal scores may be in another order, and the
/// last boxes of a full list may be others.
void compare_boxes(const Detections& found, const JsonField& line, const JsonField& tolerance,
                   const Manifest& manifest) {
    const std::vector<JsonField> expected = line["boxes"].items();
    const std::string frame = "frame " + line["token"].text() + ": ";
    const auto frames = static_cast<std::size_t>(line["history"]["frames"].integer(0, 256));
    if (found.skipped || 1 + found.ages_s.size() != frames) {
        differ(frame, "expected ", frames, " frames in the window; found ",
               found.skipped ? 0 : 1 + found.ages_s.size());
    }
    if (found.boxes.size() != expected.size()) {
        differ(frame, "expected ", expected.size(), " boxes; found ", found.boxes.size());
    }
    if (expected.empty() || !tolerance.find("box")) return;  // int8 engines round differently: boxes are not compared
    const double uncertain_score = expected.back()["score"].number() + tolerance["score"].number();
    std::vector<Detection> left = found.boxes;
    for (std::size_t index = 0; index < expected.size(); ++index) {
        const auto match = std::find_if(left.begin(), left.end(), [&](const Detection& detection) {
            return is_close(detection, expected[index], tolerance, manifest);
        });
        if (match != left.end()) {
            left.erase(match);
        } else if (expected[index]["score"].number() > uncertain_score) {
            differ(frame, "box ", index, ": expected a ", expected[index]["class"].text(), " with the score ",
                   expected[index]["score"].number(), "; found none with its numbers");
        }
    }
}

std::vector<JsonField> read_lines(const fs::path& path) {
    std::istringstream lines(read_file<ArtifactError>(path, kMaxFileBytes));
    std::vector<JsonField> fields;
    for (std::string line; std::getline(lines, line);) {
        fields.push_back(JsonField::parse<ArtifactError>(path.string(), line));
    }
    return fields;
}

}  // namespace

std::size_t verify(const fs::path& bundle, Pipeline& pipeline) {
    check_hashes(bundle, pipeline.manifest());
    const SceneFolder scene = read_scene(bundle);
    const JsonField expected = read_json<ArtifactError>(bundle / kExpected, kMaxFileBytes);
    expected["schema_version"].integer(1, 1);
    const std::vector<JsonField> frames = expected["frames"].items(), lines = read_lines(bundle / kResults);
    if (frames.size() != scene.size() || lines.size() != scene.size()) {
        expected["frames"].refuse("one entry and one line of results per frame of the scene");
    }
    std::optional<FrameComparison> comparison;
    const Observer observer = [&](const std::string& name, const Tensor& tensor) { comparison->compare(name, tensor); };
    Stream stream(pipeline, {.maps = true, .observer = observer});
    std::size_t num_values = 0;
    for (std::size_t index = 0; index < scene.size(); ++index) {
        comparison.emplace(frames[index]);
        const Detections detections = stream.step(scene.frame(index));
        num_values += comparison->finish();
        compare_boxes(detections, lines[index], expected["tolerance"], pipeline.manifest());
    }
    return num_values;
}

}  // namespace duospacenet
