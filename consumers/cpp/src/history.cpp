#include "history.hpp"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <opencv2/core.hpp>

#include "errors.hpp"
#include "geometry.hpp"

namespace duospacenet {
namespace {

template <typename... Numbers>
std::string format(const char* pattern, Numbers... numbers) {
    char text[160];
    std::snprintf(text, sizeof text, pattern, numbers...);
    return text;
}

/// Copies `from` to position `slot` of the first axis of `to`.
template <typename T>
void set_slot(const Tensor& to, std::size_t slot, const Tensor& from) {
    const auto values = from.values<T>();
    std::copy(values.begin(), values.end(), to.values<T>().begin() + static_cast<std::ptrdiff_t>(slot * from.size()));
}

/// Sets a matrix of `past_T_now`. The values are computed in float64, and converted to float32 here.
void set_transform(const Tensor& past_T_now, std::size_t slot, const cv::Matx44d& transform) {
    std::copy(std::begin(transform.val), std::end(transform.val), &past_T_now.values<float>()[16 * slot]);
}

}  // namespace

std::optional<std::string> History::reset_reason(const Frame& frame) const {
    if (past_.empty()) return std::nullopt;
    const PastFrame& last = past_.front();
    const TemporalWindow& limits = manifest_->window;
    if (frame.scene != last.scene) return "new scene '" + frame.scene + "' after '" + last.scene + "'";
    const double step_s = frame.timestamp_s - last.timestamp_s;
    if (step_s <= 0) {
        throw InputError(
            format("timestamp_s: expected later than %.17g of the frame before; got %.17g. "
                   "Leave the frame out, or reset the stream.",
                   last.timestamp_s, frame.timestamp_s));
    }
    if (step_s > limits.largest_time_delta_s) {
        return format("gap of %.2f s, above %g s", step_s, limits.largest_time_delta_s);
    }
    const double distance_m = cv::norm(translation_of(frame.global_T_ego) - translation_of(last.global_T_ego));
    if (distance_m > limits.largest_speed_m_s * step_s)
        return format("ego jump of %.1f m in %.2f s", distance_m, step_s);
    // The last pose is exactly rigid. Rounding errors of the new one would enlarge the angle.
    const cv::Matx33d rotation = rotation_of(nearest_rigid(frame.global_T_ego));
    const double turn_rad = rotation_angle(rotation_of(last.global_T_ego).t() * rotation);
    if (turn_rad > limits.largest_turn_rad_s * step_s) {
        return format("ego turn of %.0f degrees in %.2f s", turn_rad * 180 / CV_PI, step_s);
    }
    return std::nullopt;
}

Tensors History::decoder_inputs(const PastFrame& now) const {
    const auto num_slots = static_cast<std::size_t>(manifest_->window.num_frames);
    const auto num_cameras = static_cast<std::size_t>(manifest_->num_cameras);
    const Tensor image_T_ego = Tensor::zeros({num_slots, num_cameras, 3, 4}, Dtype::float32);
    const Tensor past_T_now = Tensor::zeros({num_slots, 4, 4}, Dtype::float32);
    const Tensor time_delta_s = Tensor::zeros({num_slots}, Dtype::float32);
    const Tensor frame_valid = Tensor::zeros({num_slots}, Dtype::boolean);
    const Tensor camera_valid = Tensor::zeros({num_slots, num_cameras}, Dtype::boolean);

    for (std::size_t slot = 0; slot < num_slots; ++slot) {
        set_transform(past_T_now, slot, cv::Matx44d::eye());
        if (slot > past_.size()) continue;
        const PastFrame& frame = slot == 0 ? now : past_[slot - 1];
        set_slot<float>(image_T_ego, slot, frame.image_T_ego);
        set_slot<bool>(camera_valid, slot, frame.camera_valid);
        frame_valid.values<bool>()[slot] = true;
        if (slot == 0) continue;  // the current frame keeps the exact identity
        set_transform(past_T_now, slot, inverse(frame.global_T_ego) * now.global_T_ego);
        time_delta_s.values<float>()[slot] = static_cast<float>(now.timestamp_s - frame.timestamp_s);
    }
    Tensors inputs = cached_values(now);
    inputs.insert({{"image_T_ego", image_T_ego},
                   {"past_T_now", past_T_now},
                   {"time_delta_s", time_delta_s},
                   {"frame_valid", frame_valid},
                   {"camera_valid", camera_valid}});
    return inputs;
}

std::vector<double> History::ages_s(double timestamp_s) const {
    std::vector<double> ages;
    const auto num_past = static_cast<std::size_t>(manifest_->window.num_frames - 1);
    for (std::size_t index = 0; index < std::min(past_.size(), num_past); ++index) {
        ages.push_back(timestamp_s - past_[index].timestamp_s);
    }
    return ages;
}

void History::add(PastFrame now) {
    past_.push_front(std::move(now));
    // The newest frame is always needed, for the rules of a reset.
    const int num_needed = std::max(1, manifest_->window.num_frames - 1);
    if (past_.size() > static_cast<std::size_t>(num_needed)) past_.pop_back();
}

/// The cached values of all slots, under the names of the decoder's inputs. Empty slots share one tensor of zeros.
Tensors History::cached_values(const PastFrame& now) const {
    Tensors values;
    for (const std::string& name : manifest_->memory) {
        const Tensor& current = now.memory.at(name);
        std::optional<Tensor> zeros;
        for (std::size_t slot = 0; slot < static_cast<std::size_t>(manifest_->window.num_frames); ++slot) {
            const std::string slot_name = "slot" + std::to_string(slot) + "." + name;
            if (slot == 0) {
                values.emplace(slot_name, current);
            } else if (slot <= past_.size()) {
                values.emplace(slot_name, past_[slot - 1].memory.at(name));
            } else {
                if (!zeros) zeros = Tensor::zeros(current.shape(), current.dtype());
                values.emplace(slot_name, *zeros);
            }
        }
    }
    return values;
}

}  // namespace duospacenet
