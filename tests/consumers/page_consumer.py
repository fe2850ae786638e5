"""A consumer of bundles, written from docs/bundle-format.md, docs/frame-steps.md and docs/scene-folder.md alone.

It uses numpy, OpenCV and onnxruntime, and nothing of this toolkit. It has none of the checks of "Bundles from others".
"""

import hashlib
import json
import re

import cv2
import numpy as np

DTYPES = {"float32": np.float32, "uint8": np.uint8, "bool": np.bool_}


class Consumer:
    """A loaded bundle with the history of one vehicle."""

    def __init__(self, bundle, open_session):
        """open_session: from the bytes of a graph to a session with `run(None, inputs)`."""
        self.manifest = json.loads(read_sealed(bundle / "manifest.json"))
        assert self.manifest["schema_version"] <= 5
        assert self.manifest["parity"]["passed"]
        self.graphs, self.sessions = self.manifest["graphs"], {}
        for name, graph in self.graphs.items():
            content = (bundle / graph["file"]).read_bytes()
            assert graph["file"] == f"{name}.onnx"
            assert hashlib.sha256(content).hexdigest() == graph["sha256"]
            self.sessions[name] = open_session(content)
        self.past = []  # newest first
        self.last = None
        self.projected = None

    def run(self, name, tensors):
        """Run a graph with those tensors that it takes. Returns its outputs by name."""
        inputs = {spec["name"]: tensors[spec["name"]] for spec in self.graphs[name]["inputs"]}
        names = [spec["name"] for spec in self.graphs[name]["outputs"]]
        return dict(zip(names, self.sessions[name].run(names, inputs), strict=True))

    def step(self, frame):
        """Process one frame. Returns None if it is skipped, or boxes, scores and class indices, and the window size."""
        window = self.manifest["window"]
        frame = frame | {"global_T_ego": made_rigid(np.array(frame["global_T_ego"], np.float64))}
        reset = self.last is not None and must_reset(self.last, frame, window)
        if all(image is None for _, image in frame["cameras"]):
            return None
        past = [] if reset else self.past
        tensors = self.prepare(frame)
        cached = self.encode(tensors)
        now = frame | tensors | {name: cached[name] for name in self.manifest["memory"]}
        outputs = self.run("decoder", self.decoder_inputs([now, *past]))
        self.past, self.last = [now, *past][: window["num_frames"] - 1], frame
        return *select(outputs["class_logits"], outputs["boxes"]), 1 + len(past), reset

    def prepare(self, frame):
        preprocessing, num_cameras = self.manifest["preprocessing"], self.manifest["num_cameras"]
        width, height = preprocessing["width_px"], preprocessing["height_px"]
        images = np.zeros((num_cameras, height, width, 3), np.uint8)
        image_T_ego, valid = np.zeros((num_cameras, 3, 4), np.float32), np.zeros(num_cameras, bool)
        for slot, (camera, image) in enumerate(frame["cameras"]):
            native = camera["width_px"], camera["height_px"]
            scale = max(width / native[0], height / native[1])
            scaled = round(native[0] * scale), round(native[1] * scale)
            left, top = (scaled[0] - width) // 2, scaled[1] - height
            resized_T_image = [[scaled[0] / native[0], 0, -left], [0, scaled[1] / native[1], -top], [0, 0, 1]]
            intrinsics_px, camera_T_ego = (
                np.array(camera[key], np.float64) for key in ("intrinsics_px", "camera_T_ego")
            )
            image_T_ego[slot] = (np.array(resized_T_image) @ intrinsics_px) @ camera_T_ego[:3]
            if image is not None:
                resized = resize(image, scaled, preprocessing["resize_shrinking"])
                images[slot], valid[slot] = resized[top : top + height, left : left + width], True
        return {"images": images, "image_T_ego": image_T_ego, "camera_valid": valid}

    def encode(self, tensors):
        images, outputs = tensors["images"], []
        (per_run, *_), num_cameras = self.graphs["backbone"]["inputs"][0]["shape"], len(images)
        for first in range(0, num_cameras, per_run):
            outputs.append(self.run("backbone", {"images": images[first : first + per_run]}))
        features = {name: np.concatenate([output[name] for output in outputs]) for name in outputs[0]}
        if "lifter" not in self.graphs:
            return features
        inputs = tensors["image_T_ego"], tensors["camera_valid"]
        if self.projected is None or not all(map(np.array_equal, inputs, self.projected[0])):
            self.projected = inputs, self.run("projector", tensors)
        return features | self.run("lifter", features | self.projected[1])

    def decoder_inputs(self, slots):
        shapes = {spec["name"]: (spec["shape"], DTYPES[spec["dtype"]]) for spec in self.graphs["decoder"]["inputs"]}
        tensors = {name: np.zeros(*shape) for name, shape in shapes.items()}
        tensors["past_T_now"][:] = np.eye(4)
        for t, frame in enumerate(slots):
            tensors["frame_valid"][t] = True
            for name in {"image_T_ego", "camera_valid"} & set(tensors):
                tensors[name][t] = frame[name]
            if t > 0:
                tensors["past_T_now"][t] = inverse(frame["global_T_ego"]) @ slots[0]["global_T_ego"]
                tensors["time_delta_s"][t] = slots[0]["timestamp_s"] - frame["timestamp_s"]
            for name in self.manifest["memory"]:
                tensors[f"slot{t}.{name}"] = frame[name]
        return tensors


def read_sealed(path):
    """The text of a manifest, whose last field is the hash of the lines before it."""
    text = path.read_text()
    *lines, seal, _ = text.splitlines(keepends=True)
    assert re.search(r"[0-9a-f]{64}", seal)[0] == hashlib.sha256("".join(lines).encode()).hexdigest()
    return text


def must_reset(last, frame, window):
    if frame["scene"] != last["scene"]:
        return True
    step_s = frame["timestamp_s"] - last["timestamp_s"]
    if step_s <= 0:
        raise ValueError("the time stamp is not later")
    old, new = last["global_T_ego"], frame["global_T_ego"]
    distance_m = np.linalg.norm(new[:3, 3] - old[:3, 3])
    angle_rad = np.arccos(np.clip((np.trace(old[:3, :3].T @ new[:3, :3]) - 1) / 2, -1, 1))
    return bool(
        step_s > window["largest_time_delta_s"]
        or distance_m > window["largest_speed_m_s"] * step_s
        or angle_rad > window["largest_turn_rad_s"] * step_s
    )


def resize(image, scaled, shrinking):
    size = image.shape[1], image.shape[0]
    if scaled == size:
        return image
    for factor in (2, 4):
        if shrinking == "area by halvings" and size == (factor * scaled[0], factor * scaled[1]):
            return halved(image) if factor == 2 else halved(halved(image))
    return cv2.resize(image, scaled, interpolation=cv2.INTER_AREA if scaled[0] < size[0] else cv2.INTER_LINEAR)


def halved(image):
    blocks = image.astype(np.uint16)
    return ((blocks[::2, ::2] + blocks[::2, 1::2] + blocks[1::2, ::2] + blocks[1::2, 1::2] + 2) >> 2).astype(np.uint8)


def made_rigid(pose):
    u, _, vh = np.linalg.svd(pose[:3, :3])
    return np.block([[u @ vh, pose[:3, 3:]], [np.array([[0.0, 0.0, 0.0, 1.0]])]])


def inverse(pose):
    rotation = pose[:3, :3].T
    return np.block([[rotation, -rotation @ pose[:3, 3:]], [np.array([[0.0, 0.0, 0.0, 1.0]])]])


def select(logits, boxes, largest_count=500):
    finite = np.isfinite(logits).all(axis=1) & np.isfinite(boxes).all(axis=1)
    power = np.exp(-np.abs(logits))
    scores = np.where(logits >= 0, np.float32(1), power) / (1 + power)
    queries, classes = np.nonzero(np.broadcast_to(finite[:, None], logits.shape))
    order = np.argsort(-scores[queries, classes], kind="stable")[:largest_count]
    queries, classes = queries[order], classes[order]
    return boxes[queries], scores[queries, classes], classes


def read_scene(folder):
    """Yield the frames of a scene folder, with the calibration and the image of each camera."""
    scene = json.loads((folder / "scene.json").read_text())
    shared = scene.get("cameras", {})
    for frame in scene["frames"]:
        own = frame["cameras"]
        cameras = [(shared.get(name, {}) | own.get(name, {"image": None})) for name in {**shared, **own}]
        images = [camera["image"] and cv2.imread(str(folder / camera["image"])) for camera in cameras]
        fields = {"scene": frame.get("scene", scene["scene"]), "cameras": list(zip(cameras, images, strict=True))}
        yield fields | {name: frame[name] for name in ("timestamp_s", "global_T_ego")}
