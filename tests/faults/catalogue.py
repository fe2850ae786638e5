"""The catalogue of seeded faults, and a trial that shows which checks catch a fault."""

import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from duospacenet.export import Bisection, ParityResult, bisect_parity, check_parity
from duospacenet.export.bisection.search import Trace
from duospacenet.export.parity import comparison
from duospacenet.export.parity.liveness import Liveness
from duospacenet.export.parity.stress_sequence import stress_sequence
from duospacenet.model import PRESETS, DuoSpaceNet, randomise
from duospacenet.runtime import Frame
from duospacenet.runtime.bundle.manifest import GRAPH_NAMES

from . import bundle_faults as bundle
from . import shared_faults as shared
from . import stream_faults as stream
from .bench import Bench
from .bundle_faults import in_graph, in_manifest
from .golden import GOLDEN_CASES
from .shared_faults import in_boxes, in_shared_preparation
from .stream_faults import in_frames, in_stream_preparation, in_window

# The images are twice as wide as the network's input, so that they are resized and cropped.
SEQUENCE = tuple(stress_sequence(PRESETS["tiny"], (320, 180)))
ONE_FRAME = SEQUENCE[:1]
LOST_CAMERAS = SEQUENCE[1:2]  # CAM_FRONT and another camera are lost
LATE_FRAMES = SEQUENCE[3:8]  # lost cameras, a skipped frame and a new calibration; the last frame has a full window
SCENE_CUT = SEQUENCE[8:10]
CLOSE_FRAMES = SEQUENCE[9:]  # every camera has queries within 1 m

RANDOM_INPUTS = 4  # of a graph


@dataclass(frozen=True)
class Fault:
    """A seeded fault.

    where: a graph of the bundle, "manifest", "input", "history" or "result" of the stream, "model", or "shared" for
        code that both sides of the parity check use.
    inject: puts the fault into a bench.
    frames: frames on which the fault has an effect.
    bisected: the place that a bisection must report; empty if it is not checked.
    """

    name: str
    where: str
    inject: Callable[[Bench], None]
    frames: Sequence[Frame] = ONE_FRAME
    bisected: str = ""

    @property
    def is_shared(self) -> bool:
        """Whether parity cannot detect the fault."""
        return self.where == "shared"


FAULTS = (
    Fault(
        "RGB for BGR in the graph", "backbone", in_graph("backbone", bundle.rgb_for_bgr), bisected="backbone.permute"
    ),
    Fault("mean not subtracted", "backbone", in_graph("backbone", bundle.mean_not_subtracted), bisected="backbone.sub"),
    Fault(
        "one weight changed by 30 %",
        "backbone",
        in_graph("backbone", bundle.one_weight_changed),
        bisected="backbone.getitem_12",
    ),
    Fault("a layer's weights in half precision", "backbone", in_graph("backbone", bundle.weights_of_half_precision)),
    Fault("BatchNorm folded with epsilon 1e-3", "backbone", bundle.batch_norm_epsilon(1e-3)),
    Fault("a pyramid level resized linearly", "backbone", in_graph("backbone", bundle.linear_pyramid)),
    Fault("two cameras' features exchanged", "lifter", in_graph("lifter", bundle.camera_features_exchanged)),
    Fault("voxels summed instead of averaged", "lifter", in_graph("lifter", bundle.voxels_summed)),
    Fault("align_corners flipped", "lifter", in_graph("lifter", bundle.align_corners_flipped)),
    Fault("one camera per voxel", "lifter", in_graph("lifter", bundle.one_camera_per_location)),
    Fault("the projector's camera mask inverted", "projector", in_graph("projector", bundle.camera_mask_inverted)),
    Fault(
        "the projector's pixels shifted by half a pixel",
        "projector",
        in_graph("projector", bundle.half_a_pixel_off),
        bisected="projector.div",
    ),
    Fault(
        "voxels visible from 2 m instead of 0.1 m",
        "projector",
        in_graph("projector", bundle.larger_visible_depth(2.0)),
        CLOSE_FRAMES,
        bisected="projector.gt",
    ),
    Fault("LayerNorm with epsilon 1e-3", "decoder", bundle.layer_norm_epsilon(1e-3), bisected="decoder.layer_norm_2"),
    Fault(
        "softmax over the queries",
        "decoder",
        in_graph("decoder", bundle.softmax_over_the_queries),
        bisected="decoder.softmax",
    ),
    Fault("border padding instead of zeros", "decoder", in_graph("decoder", bundle.border_instead_of_zeros)),
    Fault("one camera per query", "decoder", in_graph("decoder", bundle.one_camera_per_location)),
    Fault("nearest instead of bilinear", "decoder", in_graph("decoder", bundle.nearest_instead_of_bilinear)),
    Fault("x and y of the BEV grid exchanged", "decoder", in_graph("decoder", bundle.x_and_y_swapped_in_bev)),
    Fault("two attention heads exchanged", "decoder", in_graph("decoder", bundle.attention_heads_exchanged)),
    Fault(
        "velocity not rotated in the first layer",
        "decoder",
        in_graph("decoder", bundle.velocity_not_rotated),
        SEQUENCE[:3],
        bisected="decoder.matmul_2",
    ),
    Fault("sine and cosine exchanged", "decoder", in_graph("decoder", bundle.sine_for_cosine)),
    Fault(
        "sine and cosine exchanged in past poses",
        "decoder",
        in_graph("decoder", bundle.headings_exchanged),
        bisected="decoder.cat_2",
    ),
    Fault(
        "queries visible from 1 m instead of 0.1 m",
        "decoder",
        in_graph("decoder", bundle.larger_visible_depth(1.0)),
        CLOSE_FRAMES,
        bisected="decoder.gt",
    ),
    Fault("yaw negated", "decoder", in_graph("decoder", bundle.yaw_negated), bisected="decoder.boxes"),
    Fault("boxes in reversed query order", "decoder", in_graph("decoder", bundle.boxes_in_reversed_query_order)),
    Fault("two class columns exchanged", "decoder", in_graph("decoder", bundle.class_columns_exchanged)),
    Fault("frame mask inverted", "decoder", in_graph("decoder", bundle.frame_mask_inverted)),
    Fault("camera mask inverted", "decoder", in_graph("decoder", bundle.camera_mask_inverted)),
    Fault("times replaced by a constant", "decoder", in_graph("decoder", bundle.time_made_constant), LATE_FRAMES),
    Fault(
        "ego motion replaced by the identity", "decoder", in_graph("decoder", bundle.motion_made_constant), SEQUENCE[:2]
    ),
    Fault("slot 1 read instead of slot 2", "decoder", in_graph("decoder", bundle.slot_read_twice), SEQUENCE[:3]),
    Fault("NaN in a weight", "segmenter", in_graph("segmenter", bundle.nan_in_a_weight)),
    Fault("a map transposed", "segmenter", in_graph("segmenter", bundle.maps_transposed)),
    Fault("the maps exchanged", "segmenter", in_graph("segmenter", bundle.maps_exchanged)),
    Fault("weights of another seed", "model", lambda bench: bench.edit_model(lambda model: randomise(model, seed=1))),
    Fault("images of two cameras exchanged", "input", in_frames(stream.images_exchanged)),
    Fault("calibrations in reversed camera order", "input", in_frames(stream.calibrations_mirrored)),
    Fault("RGB for BGR", "input", in_frames(stream.rgb_for_bgr), bisected="backbone.images[camera 0 CAM_FRONT]"),
    Fault("images one frame late", "input", stream.images_one_frame_late, SEQUENCE[:2]),
    Fault("extrinsics transposed", "input", in_frames(stream.extrinsic_transposed)),
    Fault("extrinsics inverted", "input", in_frames(stream.extrinsic_inverted)),
    Fault("ego poses inverted", "input", in_frames(stream.pose_inverted), SEQUENCE[:2]),
    Fault("black image for a lost camera", "input", in_frames(stream.lost_camera_as_black_image), LOST_CAMERAS),
    Fault("intrinsics without the crop", "input", in_stream_preparation(stream.intrinsics_without_crop)),
    Fault("intrinsics without the resize", "input", in_stream_preparation(stream.intrinsics_without_resize)),
    Fault("another resize kernel", "input", in_stream_preparation(stream.another_resize_kernel)),
    Fault("lost cameras marked valid", "input", in_stream_preparation(stream.lost_cameras_marked_valid), LOST_CAMERAS),
    Fault("times negated", "history", in_window(time_delta_s=lambda times: -times), SEQUENCE[:2]),
    Fault("times one slot late", "history", in_window(time_delta_s=stream.times_one_slot_late), SEQUENCE[:3]),
    Fault(
        "past_T_now inverted",
        "history",
        in_window(past_T_now=stream.inverted),
        SEQUENCE[:2],
        bisected="decoder.past_T_now[slot 1]",
    ),
    Fault("past_T_now transposed", "history", in_window(past_T_now=stream.transposed), SEQUENCE[:2]),
    Fault("current pose moved by 30 cm", "history", in_window(past_T_now=stream.current_pose_moved)),
    Fault("empty slots marked valid", "history", in_window(frame_valid=lambda valid: valid | True)),
    Fault(
        "camera masks ignored",
        "history",
        in_window(camera_valid=lambda valid: valid | True),
        LOST_CAMERAS,
        bisected="decoder.camera_valid[slot 0, camera 0 CAM_FRONT]",
    ),
    Fault(
        "current calibration in all slots",
        "history",
        in_window(image_T_ego=stream.current_calibration_for_all),
        LATE_FRAMES,
    ),
    Fault("history never updated", "history", stream.history_not_updated, SEQUENCE[:3]),
    Fault("cached values of two slots exchanged", "history", stream.cached_values_of_the_wrong_slot, SEQUENCE[:3]),
    Fault("history kept over a scene change", "history", stream.history_never_reset, SCENE_CUT),
    Fault("history reset at every frame", "history", stream.history_always_reset, SEQUENCE[:2]),
    Fault("lifting tables never recomputed", "history", stream.tables_never_recomputed, LATE_FRAMES),
    Fault("class names shifted by one", "result", stream.class_names_shifted),
    Fault("the five best boxes missing", "result", stream.best_boxes_missing),
    Fault("classes in another order", "manifest", bundle.classes_in_another_order),
    Fault("class names reversed", "manifest", in_manifest("classes", lambda names: names[::-1])),
    Fault("largest speed 0.01 m/s", "manifest", in_manifest("window", lambda it: it | {"largest_speed_m_s": 0.01})),
    Fault("largest gap 0.6 s", "manifest", in_manifest("window", lambda it: it | {"largest_time_delta_s": 0.6})),
    Fault(
        "perception range of 5 m",
        "manifest",
        in_manifest("perception", lambda it: it | {"lower_m": [-5, -5, -3], "upper_m": [5, 5, 5]}),
    ),
    Fault("width and length exchanged", "shared", in_boxes([0, 1, 2, 4, 3, 5, 6, 7, 8])),
    Fault("yaw negated", "shared", in_boxes([*range(9)], [1, 1, 1, 1, 1, 1, -1, 1, 1])),
    Fault("velocity axes exchanged", "shared", in_boxes([0, 1, 2, 3, 4, 5, 6, 8, 7])),
    Fault("RGB for BGR", "shared", shared.rgb_for_bgr),
    Fault("mean not subtracted", "shared", shared.mean_not_subtracted),
    Fault("RGB for BGR in preprocessing", "shared", in_shared_preparation(stream.colours_reversed)),
    Fault("intrinsics without the crop", "shared", in_shared_preparation(stream.intrinsics_without_crop)),
    Fault("extrinsics transposed", "shared", shared.extrinsics_transposed),
    Fault("lost cameras marked valid", "shared", in_shared_preparation(stream.lost_cameras_marked_valid), LOST_CAMERAS),
    Fault("another resize kernel", "shared", shared.nearest_resize_kernel),
    Fault("voxels transposed", "shared", shared.voxels_transposed),
    Fault("BEV queries transposed", "shared", shared.bev_queries_transposed),
    Fault("times negated", "shared", shared.time_negated, SEQUENCE[:2]),
    Fault("velocity not rotated", "shared", shared.velocity_not_rotated, SEQUENCE[:3]),
    Fault("ego motion inverted", "shared", shared.ego_motion_inverted, SEQUENCE[:2]),
    Fault("scores from half the logits", "shared", shared.scores_of_half_the_logits),
    Fault("boxes in ascending order of score", "shared", shared.ascending_scores),
    Fault("box corners with width and length exchanged", "shared", shared.box_corners_exchanged),
    Fault("quaternion with w last", "shared", shared.quaternion_with_w_last),
    Fault("masks written transposed", "shared", shared.masks_transposed),
)

NO_FAULT = Fault("(none)", "nowhere", lambda bench: bench.changed_graphs.update(GRAPH_NAMES), SEQUENCE[:2])


@dataclass(frozen=True)
class Trial:
    """The result of one seeded fault.

    report: the parity result.
    refused_before_rehash: whether the hash check refused the edited file.
    golden: names of the golden cases that failed.
    bisection: the bisection, if parity failed and traces were given.
    """

    fault: Fault
    report: ParityResult
    refused_before_rehash: bool
    golden: tuple[str, ...]
    bisection: Bisection | None

    @property
    def caught_by(self) -> tuple[str, ...]:
        """The checks that caught the fault. The hash check does not count, because every fault updates the hash."""
        violations = {
            "graphs": self.report.failing_outputs,
            "stream": self.report.failing_frames,
            "elements": self.report.wrong_elements,
            "weights": self.report.weights.failures,
            "manifest": self.report.manifest,
            "golden": self.golden,
        }
        return tuple(name for name, found in violations.items() if found)

    @property
    def is_caught(self) -> bool:
        """Whether the right check caught the fault: only a golden case for shared code, and parity otherwise."""
        return self.caught_by == ("golden",) if self.fault.is_shared else bool({*self.caught_by} - {"golden"})


def try_fault(fault: Fault, tiny_bundle: Path, model: DuoSpaceNet, traces: Mapping[str, Trace] | None = None) -> Trial:
    """Put one fault into a copy of `tiny_bundle`, or into the code that runs it, and run every check.

    To save time, parity runs on the frames of the fault and few random inputs, instead of the whole stress sequence.
    traces: the traces of `model` by graph. Without them there is no bisection.
    """
    with tempfile.TemporaryDirectory() as folder, Bench(tiny_bundle, model, Path(folder)) as bench:
        fault.inject(bench)
        bench.patch("check_liveness", _liveness_of_changed_graphs(bench), comparison)
        report = check_parity(bench.bundle, bench.model, random_inputs=RANDOM_INPUTS, stress_frames=fault.frames)
        bisect = traces is not None and not report.passed and bench.model is model
        # Golden cases have their own frames, so a wrong input of the stream does not reach them.
        cases = () if fault.where == "input" else GOLDEN_CASES
        return Trial(
            fault,
            report,
            bench.refused_before_rehash,
            tuple(case.__name__ for case in cases if _fails(case, bench.bundle)),
            bisect_parity(bench.bundle, model, result=report, traces=traces, stress_frames=fault.frames)
            if bisect
            else None,
        )


def _liveness_of_changed_graphs(bench: Bench) -> Callable[..., Liveness]:
    """`check_liveness` for the edited graphs only. This saves time: the control shows that the others are right."""
    check_liveness = comparison.check_liveness
    return lambda graph, *rest: check_liveness(graph, *rest) if graph.name in bench.changed_graphs else Liveness(0)


def build_tiny_model() -> DuoSpaceNet:
    return randomise(DuoSpaceNet(PRESETS["tiny"])).eval()


def _fails(case: Callable[[Path], None], bundle_folder: Path) -> bool:
    try:
        case(bundle_folder)
    except AssertionError:
        return True
    return False
