#include "scene_folder.hpp"

#include <algorithm>

#include "errors.hpp"
#include "image_file.hpp"
#include "json_file.hpp"
#include "validation.hpp"

namespace duospacenet {
namespace {

namespace fs = std::filesystem;

constexpr std::uintmax_t kMaxSceneBytes = 1'000'000'000;
using FrameRecord = SceneFolder::FrameRecord;

/// What frames have unless they say otherwise.
struct Defaults {
    std::string scene;
    std::vector<Camera> cameras;
    fs::path folder;
};

constexpr std::int64_t kLargestSize = 1'000'000'000;

/// The calibration fields that a camera record has. Those of a frame override those of the scene.
void read_calibration(const JsonField& record, Camera& camera) {
    if (const auto field = record.find("width_px")) camera.width_px = static_cast<int>(field->integer(1, kLargestSize));
    if (const auto field = record.find("height_px"))
        camera.height_px = static_cast<int>(field->integer(1, kLargestSize));
    if (const auto field = record.find("intrinsics_px")) camera.intrinsics_px = field->matrix<3, 3>();
    if (const auto field = record.find("camera_T_ego")) camera.camera_T_ego = field->matrix<4, 4>();
}

void require_calibration(const JsonField& record) {
    for (const char* key : {"width_px", "height_px", "intrinsics_px", "camera_T_ego"}) record[key];
}

Camera read_scene_camera(const std::string& name, const JsonField& record) {
    record.allow_only({"width_px", "height_px", "intrinsics_px", "camera_T_ego"});
    require_calibration(record);
    Camera camera{.name = name};
    read_calibration(record, camera);
    return camera;
}

std::vector<Camera> read_scene_cameras(const JsonField& scene) {
    std::vector<Camera> cameras;
    if (const auto records = scene.find("cameras")) {
        for (const auto& [name, record] : records->entries()) cameras.push_back(read_scene_camera(name, record));
    }
    return cameras;
}

/// The path of an image. It must stay inside the folder by its text; symbolic links are followed.
fs::path read_image_path(const JsonField& field, const fs::path& folder) {
    const fs::path path = fs::path(field.name()).lexically_normal();
    if (path.empty() || path.is_absolute() || *path.begin() == "..") {
        field.refuse("a path inside the scene folder", "Copy or link the file into the folder.");
    }
    if (!fs::is_regular_file(folder / path)) {
        field.refuse("an image file", "There is no such file. For a lost camera, set the image to null.");
    }
    return folder / path;
}

/// The camera of a frame, which a frame adds if the scene does not have it.
std::size_t find_or_add_camera(FrameRecord& frame, const std::string& name, const JsonField& record) {
    auto& cameras = frame.frame.cameras;
    const auto is_named = [&name](const Camera& camera) { return camera.name == name; };
    const auto found = std::find_if(cameras.begin(), cameras.end(), is_named);
    if (found != cameras.end()) return static_cast<std::size_t>(found - cameras.begin());
    require_calibration(record);
    cameras.push_back(Camera{.name = name});
    frame.image_paths.emplace_back();
    return cameras.size() - 1;
}

FrameRecord read_frame(const JsonField& record, const Defaults& defaults) {
    record.allow_only({"timestamp_s", "token", "scene", "global_T_ego", "cameras", "boxes", "maps"});
    const auto token = record.find("token"), scene = record.find("scene");
    FrameRecord result{{defaults.cameras, record["global_T_ego"].matrix<4, 4>(), record["timestamp_s"].number(),
                        scene ? scene->name() : defaults.scene, token ? token->name() : ""},
                       std::vector<fs::path>(defaults.cameras.size())};
    for (const auto& [name, camera] : record["cameras"].entries()) {
        camera.allow_only({"image", "width_px", "height_px", "intrinsics_px", "camera_T_ego"});
        const std::size_t index = find_or_add_camera(result, name, camera);
        read_calibration(camera, result.frame.cameras[index]);
        const JsonField image = camera["image"];
        if (!image.is_null()) result.image_paths[index] = read_image_path(image, defaults.folder);
    }
    return result;
}

}  // namespace

SceneFolder::SceneFolder(const fs::path& folder) {
    const fs::path path = fs::is_directory(folder) ? folder / "scene.json" : folder;
    const JsonField scene = read_json<InputError>(path, kMaxSceneBytes);
    scene.allow_only({"schema_version", "scene", "cameras", "frames", "class_mapping"});
    scene["schema_version"].integer(1, 1);
    const Defaults defaults{scene["scene"].name(), read_scene_cameras(scene), path.parent_path()};
    for (const JsonField& record : scene["frames"].items()) {
        FrameRecord frame = read_frame(record, defaults);
        try {
            check_numbers(frame.frame);
        } catch (const InputError& error) {
            throw InputError(path.string() + ": field frames." + std::to_string(frames_.size()) + ": " + error.what());
        }
        const bool follows = !frames_.empty() && frames_.back().frame.scene == frame.frame.scene;
        if (follows && frame.frame.timestamp_s <= frames_.back().frame.timestamp_s) {
            record["timestamp_s"].refuse("later than that of the frame before", "Sort the frames.");
        }
        frames_.push_back(std::move(frame));
    }
    if (frames_.empty()) scene["frames"].refuse("at least one frame");
}

void SceneFolder::check_rigs(int num_cameras) const {
    for (std::size_t index = 0; index < frames_.size(); ++index) {
        const std::size_t found = frames_[index].frame.cameras.size();
        if (found <= static_cast<std::size_t>(num_cameras)) continue;
        throw InputError("frame " + std::to_string(index) + ": expected at most " + std::to_string(num_cameras) +
                         " cameras, as the bundle was exported; got " + std::to_string(found) +
                         ". Leave some out, or export again with more.");
    }
}

Frame SceneFolder::frame(std::size_t index) const {
    const FrameRecord& record = frames_.at(index);
    Frame frame = record.frame;
    for (std::size_t slot = 0; slot < frame.cameras.size(); ++slot) {
        Camera& camera = frame.cameras[slot];
        if (!record.image_paths[slot].empty()) {
            camera.image = read_image(record.image_paths[slot], camera.width_px, camera.height_px);
        }
    }
    return frame;
}

}  // namespace duospacenet
