#include "bundle.hpp"

#include <algorithm>
#include <initializer_list>

#include "errors.hpp"
#include "json_file.hpp"

namespace duospacenet {
namespace {

namespace fs = std::filesystem;

constexpr int kOldestSchema = 2, kNewestSchema = 5;
constexpr std::uintmax_t kMaxManifestBytes = 1u << 24;
constexpr std::uintmax_t kMaxGraphBytes = (1u << 31) - 1;
constexpr std::int64_t kMaxTensorElements = 1 << 29;
constexpr const char* kCopyAgain = "The file is damaged or was edited: copy the whole folder, or export again.";

/// Checks the last field, `sha256`: it is the hash of all lines before it. The last two lines are this field and `}`.
void check_seal(const fs::path& path, std::string_view content, const std::string& seal) {
    if (content.ends_with('\n')) content.remove_suffix(1);
    const std::size_t last_line = content.rfind('\n');
    const std::size_t seal_line = last_line == 0 ? std::string_view::npos : content.rfind('\n', last_line - 1);
    const std::string_view sealed = content.substr(0, seal_line == std::string_view::npos ? 0 : seal_line + 1);
    std::string_view end = content.substr(sealed.size());
    end.remove_prefix(std::min(end.size(), end.find_first_not_of(" \t")));
    const std::string expected = sha256(sealed);
    if (seal != expected || end != "\"sha256\": \"" + seal + "\"\n}") {
        throw ArtifactError(path.string() + ": field sha256: expected " + expected.substr(0, 12) +
                            "..., the hash of the lines before it; got " + seal.substr(0, 12) + "... " + kCopyAgain);
    }
}

void check_schema(const JsonField& manifest) {
    const JsonField field = manifest["schema_version"];
    const std::int64_t version = field.integer(1, INT32_MAX);
    if (version < kOldestSchema || version > kNewestSchema) {
        field.refuse(std::to_string(kOldestSchema) + " to " + std::to_string(kNewestSchema),
                     version < kOldestSchema ? "Such a bundle has no hash: export again." : "Update this program.");
    }
}

/// Checks the rules that are written in words. A bundle with a rule that is not implemented here is refused.
/// Schemas before 5 lack some of the fields, and mean the same.
void check_words(const JsonField& record, std::initializer_list<std::pair<const char*, const char*>> words) {
    for (const auto& [key, word] : words) {
        const auto field = record.find(key);
        if (field && field->text() != word) field->refuse(std::string("'") + word + "'", "Update this program.");
    }
}

void check_rules(const JsonField& manifest) {
    check_words(manifest["preprocessing"], {{"colour_order", "bgr"},
                                            {"scaling", "cover"},
                                            {"size_rounding", "half to even"},
                                            {"resize_enlarging", "linear"},
                                            {"crop", "centre columns, bottom rows"},
                                            {"crop_rounding", "down"},
                                            {"pixel_centres", "at halves"}});
    check_words(manifest["window"], {{"slots", "newest first"},
                                     {"speed", "3D distance / time step"},
                                     {"turn", "3D rotation angle / time step"},
                                     {"above_largest", "reset"},
                                     {"new_scene", "reset"},
                                     {"time_stamp_not_later", "refuse"},
                                     {"frame_without_images", "skip"}});
    if (const auto selection = manifest.find("selection")) {
        check_words(*selection, {{"score", "sigmoid"},
                                 {"score_dtype", "float32"},
                                 {"order", "score descending"},
                                 {"ties", "query, class"},
                                 {"suppression", "none"},
                                 {"not_finite", "drop query"}});
        (*selection)["largest_count"].integer(500, 500);
    }
}

Preprocessing read_preprocessing(const JsonField& record) {
    const JsonField shrinking = record["resize_shrinking"];
    const std::string kernel = shrinking.text();
    if (kernel != "area" && kernel != "area by halvings") shrinking.refuse("'area' or 'area by halvings'");
    return {static_cast<int>(record["width_px"].integer(1, 1 << 16)),
            static_cast<int>(record["height_px"].integer(1, 1 << 16)), kernel == "area by halvings"};
}

TemporalWindow read_window(const JsonField& record) {
    return {static_cast<int>(record["num_frames"].integer(1, 256)), record["largest_time_delta_s"].positive_number(),
            record["largest_speed_m_s"].positive_number(), record["largest_turn_rad_s"].positive_number()};
}

TensorSpec read_tensor(const JsonField& record) {
    TensorSpec spec{record["name"].name(), {}, Dtype::float32};
    std::int64_t elements = 1;
    for (const JsonField& size : record["shape"].items()) {
        const std::int64_t length = size.integer(1, kMaxTensorElements);
        if ((elements *= length) > kMaxTensorElements) record["shape"].refuse("at most 2^29 elements");
        spec.shape.push_back(static_cast<std::size_t>(length));
    }
    const std::string dtype = record["dtype"].text();
    if (dtype != "float32" && dtype != "uint8" && dtype != "bool") record["dtype"].refuse("float32, uint8 or bool");
    spec.dtype = dtype == "uint8" ? Dtype::uint8 : dtype == "bool" ? Dtype::boolean : Dtype::float32;
    return spec;
}

GraphSpec read_graph_spec(const std::string& name, const JsonField& record) {
    GraphSpec spec{name, record["sha256"].text(), {}, {}};
    // Another path could name any file.
    if (record["file"].text() != name + ".onnx") record["file"].refuse(name + ".onnx", kCopyAgain);
    for (const JsonField& tensor : record["inputs"].items()) spec.inputs.push_back(read_tensor(tensor));
    for (const JsonField& tensor : record["outputs"].items()) spec.outputs.push_back(read_tensor(tensor));
    return spec;
}

std::map<std::string, GraphSpec> read_graph_specs(const JsonField& record) {
    std::map<std::string, GraphSpec> graphs;
    for (const auto& [name, field] : record.entries()) graphs.emplace(name, read_graph_spec(name, field));
    for (const auto& [name, spec] : graphs) {
        const bool is_known =
            name == "backbone" || name == "projector" || name == "lifter" || name == "decoder" || name == "segmenter";
        if (!is_known) record[name].refuse("backbone, projector, lifter, decoder or segmenter", "Update this program.");
    }
    record["backbone"], record["decoder"];
    if (graphs.contains("lifter")) record["projector"];
    if (graphs.contains("projector") || graphs.contains("segmenter")) record["lifter"];
    return graphs;
}

std::map<std::string, std::string> read_golden(const JsonField& manifest) {
    std::map<std::string, std::string> hashes;
    if (const auto golden = manifest.find("golden")) {
        for (const auto& [path, hash] : (*golden)["sha256"].entries()) hashes.emplace(path, hash.text());
    }
    return hashes;
}

void check_parity(const JsonField& manifest) {
    const JsonField report = manifest["parity"];
    if (report.is_null()) report.refuse("the report of a parity proof", "Export again.");
    if (!report["passed"].boolean()) {
        report["passed"].refuse("true", "The graphs do not compute what the model does: export again.");
    }
}

}  // namespace

Manifest read_manifest(const fs::path& bundle) {
    if (!fs::is_directory(bundle)) {
        throw ArtifactError(bundle.string() + ": expected a bundle folder; got " +
                            (fs::exists(bundle) ? "a file" : "no such folder") + ". See `duospacenet export`.");
    }
    const fs::path path = bundle / "manifest.json";
    const std::string content = read_file<ArtifactError>(path, kMaxManifestBytes);
    const JsonField manifest = JsonField::parse<ArtifactError>(path.string(), content);
    check_schema(manifest);
    check_seal(path, content, manifest["sha256"].text());
    check_parity(manifest);
    check_rules(manifest);
    const auto dcn = manifest.find("dcn"), attention = manifest.find("attention");
    return {manifest["classes"].names(),
            manifest["map_classes"].names(),
            static_cast<int>(manifest["num_cameras"].integer(1, 256)),
            read_preprocessing(manifest["preprocessing"]),
            read_window(manifest["window"]),
            manifest["memory"].names(),
            attention ? attention->text() : "grid-sample",
            dcn ? dcn->text() : "",
            read_graph_specs(manifest["graphs"]),
            read_golden(manifest)};
}

std::string read_graph(const fs::path& bundle, const GraphSpec& spec) {
    const fs::path path = bundle / (spec.name + ".onnx");
    std::string content = read_file<ArtifactError>(path, kMaxGraphBytes);
    const std::string digest = sha256(content);
    if (digest != spec.sha256) {
        throw ArtifactError(path.string() + ": expected the SHA-256 hash " + spec.sha256.substr(0, 12) +
                            "... of the manifest; got " + digest.substr(0, 12) + "... " + kCopyAgain);
    }
    return content;
}

}  // namespace duospacenet
