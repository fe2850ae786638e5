"""One manifest of each schema version. Every later version of the toolkit must be able to read them."""

from tests.helpers.bundles import GRAPHS

SCHEMA_1 = {
    "schema_version": 1,
    "versions": {"duospacenet": "0.1.0", "torch": "2.13.0", "onnx": "1.20.0", "onnxscript": "0.7.0"},
    "preset": "tiny",
    "config": {"preset": "tiny", "num_queries": 32},
    "classes": ["car", "pedestrian"],
    "map_classes": ["drivable_area"],
    "num_cameras": 6,
    "preprocessing": {
        "width_px": 160,
        "height_px": 64,
        "colour_order": "bgr",
        "resize_shrinking": "area",
        "resize_enlarging": "linear",
        "crop": "centre columns, bottom rows",
        "normalisation_in_graph": {"colour_order": "rgb", "mean": [123.675, 116.28, 103.53], "std": [58.4, 57.1, 57.4]},
    },
    "window": {
        "num_frames": 4,
        "nominal_time_delta_s": 0.5,
        "largest_time_delta_s": 2.0,
        "largest_speed_m_s": 70.0,
    },
    "perception": {"size": [16, 16, 4], "lower_m": [-51.2, -51.2, -3.0], "upper_m": [51.2, 51.2, 5.0]},
    "frames_of_reference": {"ego": "x forward, y left, z up"},
    "tensors": {"class_logits": "a score is 1 / (1 + exp(-logit))"},
    "memory": ["bev_value_0"],
    "precision": "float32",
    "weights": {"source": "random, seed 0", "sha256": "0" * 64, "file_sha256": None, "trained": False},
    "graphs": {
        name: {
            "file": f"{name}.onnx",
            "sha256": "0" * 64,
            "inputs": [{"name": "images", "shape": [6, 64, 160, 3], "dtype": "uint8"}],
            "outputs": [{"name": "bev", "shape": [1, 32, 16, 16], "dtype": "float32"}],
        }
        for name in GRAPHS
    },
    "parity": {
        "passed": True,
        "failures": [],
        "tolerances": {"graph": 1e-4, "box": 1e-3, "score": 1e-3},
        "source": "scripted drive",
        "frames": 1,
        "graphs": {"decoder": {"boxes": {"absolute": 1e-6, "relative": 1e-7, "cosine": 1.0, "frame": 0}}},
        "stream": [
            {"window": 1, "boxes": 3, "unmatched": 0, "box": 1e-6, "score": 1e-7, "map": None, "history": 0},
        ],
        "dead_inputs": [],
    },
}

# Schema 2 adds the largest turn, the assignment of the checkpoint's tensors, the operator sets, and the seal.
SCHEMA_2 = SCHEMA_1 | {
    "schema_version": 2,
    "window": SCHEMA_1["window"] | {"largest_turn_rad_s": 3.1416},
    "weights": {
        "source": "epoch_24.pth",
        "sha256": "0" * 64,
        "file_sha256": "1" * 64,
        "trained": False,
        "checkpoint": {
            "layout": "mmdetection3d",
            "wrappers": ["state_dict"],
            "matched": 82,
            "missing": {"queries.pose": "queries.*"},
            "seed": 0,
            "left_aside": ["pts_bbox_head.anchor"],
            "notes": ["the neck has no ReLU there"],
        },
        "anchors": {"file": "anchors.json", "sha256": "2" * 64},
    },
    "graphs": {name: graph | {"opsets": {"": 20}} for name, graph in SCHEMA_1["graphs"].items()},
    "sha256": "0" * 64,
}

# Schema 3 adds coverage, random_inputs, elements, wrong_elements, weights and retrace to the parity report, and ignored
# and weights_key to the checkpoint's record. `parity.dead_inputs` is no longer used.
SCHEMA_3 = SCHEMA_2 | {
    "schema_version": 3,
    "dcn": None,
    "weights": SCHEMA_2["weights"]
    | {
        "checkpoint": SCHEMA_2["weights"]["checkpoint"]
        | {"ignored": {"img_neck.lateral.0.weight": "img_neck.*"}, "weights_key": "ema"}
    },
    "parity": SCHEMA_1["parity"]
    | {
        "tolerances": {"graph": 1e-4, "box": 1e-3, "score": 1e-3, "random": 3e-4},
        "graphs": {
            "decoder": {"boxes": {"absolute": 1e-6, "relative": 1e-7, "cosine": 1.0, "frame": None, "seed": 3}},
        },
        "coverage": {
            "frames": 14,
            "skipped": 1,
            "windows": {"1": 5, "2": 2, "3": 1, "4": 5},
            "lost_cameras": [6, 6, 6, 6],
            "motion": {"pitch_deg": 6.3, "roll_deg": 4.9, "yaw_deg": 18.5, "height_m": 0.9, "distance_m": 11.0},
            "calibrations": 3,
            "resets": {"new scene": 1, "gap": 1, "ego jump": 1, "ego turn": 1},
            "dropped_frames": 1,
        },
        "random_inputs": {"backbone": 2, "decoder": 12},
        "elements": {"backbone": 18, "decoder": 554},
        "wrong_elements": [],
        "weights": {"parameters": 291, "matched": 291, "values": 287704, "matched_values": 287704},
    },
}

# Schema 4 adds the form of attention, and precision int8 with its record.
SCHEMA_4 = SCHEMA_3 | {
    "schema_version": 4,
    "preprocessing": SCHEMA_1["preprocessing"] | {"resize_shrinking": "area by halvings"},
    "attention": "compact",
    "precision": "int8",
    "quantization": {
        "float_manifest_sha256": "3" * 64,
        "recipe": {
            "form": "QDQ",
            "activations": "uint8",
            "weights": "int8 per channel",
            "operators": ["Conv", "Add", "MaxPool", "Relu"],
            "calibration": "min-max",
            "onnxruntime": "1.31.1",
        },
        "calibration": {"sources": ["synthetic:1:8"], "frames": 8},
        "judging": {"sources": ["synthetic:2:60"], "frames": 60},
        "quantized_blocks": ["image_encoder.backbone.layer1"],
        "float_blocks": ["image_encoder.neck"],
        "metrics": {
            "float32": {"mAP": 0.5765, "NDS": 0.6477, "map_iou": {"drivable_area": 0.9}},
            "simulated": {"mAP": 0.5746, "NDS": 0.6458, "map_iou": {"drivable_area": 0.9}},
            "engine": {"mAP": 0.5746, "NDS": 0.6458, "map_iou": {"drivable_area": 0.9}},
        },
        "agreement": {
            "simulated": {"boxes": 900, "matched": 0.97, "score": 0.01, "position_m": 0.1},
            "engine": {"boxes": 900, "matched": 0.97, "score": 0.01, "position_m": 0.1},
        },
    },
}

# Schema 5 has every field. It adds the rules of preprocessing, window, selection, boxes and maps, and checks `config`.
SCHEMA_5 = SCHEMA_4 | {
    "schema_version": 5,
    "config": {
        "preset": "tiny",
        "image": {
            "width_px": 160,
            "height_px": 64,
            "colour_order": "rgb",
            "mean": [123.675, 116.28, 103.53],
            "std": [58.4, 57.1, 57.4],
        },
        "backbone": {
            "block": "basic",
            "depths": [1, 1, 1, 1],
            "width": 8,
            "caffe_style": False,
            "batch_norm_eps": 1e-5,
            "deformable_stages": [],
        },
        "voxels": {"size": [16, 16, 4], "lower_m": [-51.2, -51.2, -3.0], "upper_m": [51.2, 51.2, 5.0]},
        "num_layers": 2,
        "num_queries": 32,
        "num_frames": 4,
        "num_cameras": 6,
        "channels": 32,
        "voxel_channels": 16,
        "segmentation_channels": 16,
        "feedforward_channels": 64,
        "num_heads": 4,
        "pv_points": 4,
        "bev_points": 8,
        "queries": "duo",
        "bev_temporal": "queries",
        "divergence_enhancement": True,
        "classes": ["car", "pedestrian"],
        "map_classes": ["drivable_area"],
    },
    "preprocessing": {
        "width_px": 160,
        "height_px": 64,
        "colour_order": "bgr",
        "scaling": "cover",
        "size_rounding": "half to even",
        "resize_shrinking": "area by halvings",
        "resize_enlarging": "linear",
        "crop": "centre columns, bottom rows",
        "crop_rounding": "down",
        "pixel_centres": "at halves",
        "normalisation_in_graph": {"colour_order": "rgb", "mean": [123.675, 116.28, 103.53], "std": [58.4, 57.1, 57.4]},
    },
    "window": {
        "num_frames": 4,
        "slots": "newest first",
        "nominal_time_delta_s": 0.5,
        "largest_time_delta_s": 2.0,
        "largest_speed_m_s": 70.0,
        "largest_turn_rad_s": 3.1416,
        "speed": "3D distance / time step",
        "turn": "3D rotation angle / time step",
        "above_largest": "reset",
        "new_scene": "reset",
        "time_stamp_not_later": "refuse",
        "frame_without_images": "skip",
    },
    "golden": {
        "scene": "golden/scene",
        "expected": "golden/expected.json",
        "results": "golden/results.jsonl",
        "sha256": {
            "golden/expected.json": "4" * 64,
            "golden/results.jsonl": "5" * 64,
            "golden/scene/scene.json": "6" * 64,
        },
    },
    "axes": {"ego": ["forward", "left", "up"], "camera": ["right", "down", "forward"], "image": ["right", "down"]},
    "selection": {
        "score": "sigmoid",
        "score_dtype": "float32",
        "order": "score descending",
        "ties": "query, class",
        "largest_count": 500,
        "smallest_score": None,
        "suppression": "none",
        "not_finite": "drop query",
    },
    "boxes": {
        "columns": ["x_m", "y_m", "z_m", "w_m", "l_m", "h_m", "yaw_rad", "vx_m_s", "vy_m_s"],
        "frame": "ego",
        "position": "centre",
        "length": "along heading",
        "yaw": "from x, counter-clockwise about z",
        "velocity": "over ground",
    },
    "maps": {
        "axes": ["x", "y"],
        "cell_centre": "lower + (index + 0.5) * (upper - lower) / size",
        "probability": "sigmoid",
        "not_finite": 0,
    },
    "parity": {
        "reference": "the float32 bundle",
        "passed": True,
        "failures": [],
        "tolerances": {
            "graph": 1e-4,
            "box": 1e-3,
            "score": 1e-3,
            "random": 3e-4,
            "quantized": {"graph": 0.3, "dequantized": 0.01, "position_m": 0.5, "score": 0.1, "map": 0.02},
        },
        "source": "scripted drive",
        "frames": 1,
        "graphs": {
            "decoder": {
                "boxes": {
                    "absolute": 1e-6,
                    "relative": 1e-7,
                    "cosine": 1.0,
                    "frame": None,
                    "seed": 3,
                    "rms": 1e-7,
                    "quantized": False,
                }
            },
        },
        "stream": [
            {
                "window": 1,
                "boxes": 3,
                "unmatched": 0,
                "box": 1e-6,
                "score": 1e-7,
                "map": None,
                "history": 0,
                "mean_position_m": 1e-7,
                "mean_score": 1e-8,
                "mean_map": None,
            },
        ],
        "coverage": SCHEMA_3["parity"]["coverage"],
        "random_inputs": {"backbone": 2, "decoder": 12},
        "elements": {"backbone": 18, "decoder": 554},
        "wrong_elements": [],
        "weights": {"parameters": 291, "matched": 291, "values": 287704, "matched_values": 287704},
        "retrace": {"graphs": ["decoder"], "skipped": None},
        "dead_inputs": [],
    },
}
