// The manifest and the graph files of a bundle.
#pragma once

#include <filesystem>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "tensor.hpp"

namespace duospacenet {

/// One graph of the bundle. Its file is `NAME.onnx`.
struct GraphSpec {
    std::string name;
    std::string sha256;  // of the file
    std::vector<TensorSpec> inputs, outputs;
};

/// How a camera image becomes an input image of the backbone. The rules without numbers are in preprocessing.cpp.
struct Preprocessing {
    int width_px, height_px;
    bool shrinks_by_halvings;  // to a half or a quarter of the size
};

/// The number of frames that the decoder uses, and the limits beyond which the history is reset.
struct TemporalWindow {
    int num_frames;  // including the current frame
    double largest_time_delta_s, largest_speed_m_s, largest_turn_rad_s;
};

/// The part of `manifest.json` that is needed to run the graphs.
struct Manifest {
    std::vector<std::string> classes;
    std::vector<std::string> map_classes;
    int num_cameras;  // camera slots N; a rig has 1 to N cameras
    Preprocessing preprocessing;
    TemporalWindow window;
    std::vector<std::string> memory;  // names of the cached values
    std::string attention;            // form of PV attention and lifting: compact or grid-sample
    std::string dcn;                  // form of deformable convolutions: native or grid-sample; empty without them
    std::map<std::string, GraphSpec> graphs;
    std::map<std::string, std::string> golden_sha256;  // hash of each file of the golden example; empty without one

    bool has_graph(const std::string& name) const { return graphs.contains(name); }
};

/// Reads and checks the manifest in a bundle's folder: its hash, its schema version, and that its parity proof passed.
/// Throws ArtifactError.
Manifest read_manifest(const std::filesystem::path& bundle);

/// Reads a graph file, and compares its hash. The engine gets these bytes. Throws ArtifactError.
std::string read_graph(const std::filesystem::path& bundle, const GraphSpec& spec);

}  // namespace duospacenet
