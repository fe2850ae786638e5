"""Seeded faults, each with the place where it is put, and what tells whether a check has seen it."""

import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from duospacenet.export import Bisection, ParityResult, bisect_parity, check_parity
from duospacenet.export.bisection.search import Trace
from duospacenet.export.parity import check as parity
from duospacenet.export.parity.stress_sequence import stress_sequence
from duospacenet.model import PRESETS, DuoSpaceNet, randomise
from duospacenet.runtime import Frame
from duospacenet.runtime.bundle.manifest import GRAPH_NAMES, read_manifest

from . import bundle_faults as bundle
from . import shared_faults as shared
from . import stream_faults as stream
from .bench import Bench
from .bundle_faults import in_graph
from .golden import GOLDEN_CASES
from .shared_faults import in_boxes, in_preparation
from .stream_faults import fed, in_window, prepared

# Pictures of twice the network's width, so that they are scaled and cut.
DRIVE = tuple(stress_sequence(320, 180))
ONE_FRAME = DRIVE[:1]
LATE_FRAMES = DRIVE[4:8]  # a frame dropped, the rig turned, a camera lost; the window of the last is full
SCENE_CUT = DRIVE[8:10]
CLOSE_FRAMES = DRIVE[9:]  # every camera has something within 1 m of it


@dataclass(frozen=True)
class Fault:
    """where: in a graph of the bundle, in the feed, the state or the answers of the stream, in the model, or in what
    both sides share. bisected: the place that a bisection must name, where it has been worked out.
    """

    name: str
    where: str
    inject: Callable[[Bench], None]
    frames: Sequence[Frame] = ONE_FRAME
    bisected: str = ""

    @property
    def is_shared(self) -> bool:
        """Whether it is out of parity's sight."""
        return self.where == "shared"


FAULTS = (
    Fault("RGB for BGR in the graph", "backbone", in_graph("backbone", bundle.rgb_for_bgr), bisected="backbone.flip"),
    Fault("mean not subtracted", "backbone", in_graph("backbone", bundle.mean_not_subtracted), bisected="backbone.sub"),
    Fault(
        "one weight changed by 30 %",
        "backbone",
        in_graph("backbone", bundle.one_weight_changed),
        bisected="backbone.getitem_12",
    ),
    Fault("a layer's weights rounded to half", "backbone", in_graph("backbone", bundle.weights_of_half_precision)),
    Fault("BatchNorm folded with epsilon 1e-3", "backbone", bundle.batch_norm_epsilon(1e-3)),
    Fault("a pyramid level enlarged linearly", "backbone", in_graph("backbone", bundle.linear_pyramid)),
    Fault("two cameras' features exchanged", "lifter", in_graph("lifter", bundle.a_level_read_twice)),
    Fault("voxels summed, not averaged", "lifter", in_graph("lifter", bundle.voxels_not_averaged)),
    Fault("align_corners flipped", "lifter", in_graph("lifter", bundle.align_corners_flipped)),
    Fault("a projector's camera mask inverted", "projector", in_graph("projector", bundle.camera_mask_inverted)),
    Fault(
        "a projector's voxels half a pixel off",
        "projector",
        in_graph("projector", bundle.half_a_pixel_off),
        bisected="projector.div",
    ),
    Fault(
        "voxels seen from 2 m on, not 0.1 m",
        "projector",
        in_graph("projector", bundle.seen_from_farther_off(2.0)),
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
    Fault("padding by the border", "decoder", in_graph("decoder", bundle.border_instead_of_zeros)),
    Fault("nearest instead of bilinear", "decoder", in_graph("decoder", bundle.nearest_instead_of_bilinear)),
    Fault("x and y of the BEV grid exchanged", "decoder", in_graph("decoder", bundle.x_and_y_swapped_in_bev)),
    Fault("two attention heads exchanged", "decoder", in_graph("decoder", bundle.attention_heads_exchanged)),
    Fault(
        "velocity not rotated in the first layer",
        "decoder",
        in_graph("decoder", bundle.velocity_not_rotated),
        DRIVE[:3],
        bisected="decoder.matmul_2",
    ),
    Fault("sine and cosine exchanged", "decoder", in_graph("decoder", bundle.sine_for_cosine)),
    Fault(
        "sine and cosine exchanged on the way into the past",
        "decoder",
        in_graph("decoder", bundle.headings_exchanged),
        bisected="decoder.cat_2",
    ),
    Fault(
        "queries seen from 1 m on, not 0.1 m",
        "decoder",
        in_graph("decoder", bundle.seen_from_farther_off(1.0)),
        CLOSE_FRAMES,
        bisected="decoder.gt",
    ),
    Fault("yaw turned round", "decoder", in_graph("decoder", bundle.yaw_turned_round), bisected="decoder.boxes"),
    Fault("boxes of other queries", "decoder", in_graph("decoder", bundle.boxes_of_other_queries)),
    Fault("two columns of classes exchanged", "decoder", in_graph("decoder", bundle.classes_of_other_columns)),
    Fault("frame mask inverted", "decoder", in_graph("decoder", bundle.frame_mask_inverted)),
    Fault("camera mask inverted", "decoder", in_graph("decoder", bundle.camera_mask_inverted)),
    Fault("time folded to the traced example", "decoder", in_graph("decoder", bundle.time_folded), LATE_FRAMES),
    Fault("ego motion folded to a standstill", "decoder", in_graph("decoder", bundle.motion_folded), DRIVE[:2]),
    Fault("one slot read in another's place", "decoder", in_graph("decoder", bundle.a_slot_read_twice), DRIVE[:3]),
    Fault("NaN in a weight", "segmenter", in_graph("segmenter", bundle.nan_in_a_weight)),
    Fault("a map transposed", "segmenter", in_graph("segmenter", bundle.maps_transposed)),
    Fault("the maps exchanged", "segmenter", in_graph("segmenter", bundle.maps_exchanged)),
    Fault("another seed's weights", "model", lambda bench: bench.edit_model(lambda model: randomise(model, seed=1))),
    Fault("pictures of two cameras exchanged", "feed", fed(stream.pictures_exchanged)),
    Fault("calibrations of the cameras mirrored", "feed", fed(stream.calibrations_mirrored)),
    Fault("RGB for BGR", "feed", fed(stream.rgb_for_bgr), bisected="backbone.images[camera 0 CAM_FRONT]"),
    Fault("pictures off by one frame", "feed", stream.pictures_of_the_frame_before, DRIVE[:2]),
    Fault("extrinsics transposed", "feed", fed(stream.extrinsic_transposed)),
    Fault("extrinsics inverted", "feed", fed(stream.extrinsic_inverted)),
    Fault("ego poses inverted", "feed", fed(stream.pose_inverted), DRIVE[:2]),
    Fault("a lost camera's picture black but valid", "feed", fed(stream.lost_camera_black), DRIVE[7:8]),
    Fault("intrinsics of the uncut image", "feed", prepared(stream.intrinsics_of_the_uncut_image)),
    Fault("intrinsics of the unscaled image", "feed", prepared(stream.intrinsics_of_the_unscaled_image)),
    Fault("another resize kernel", "feed", prepared(stream.another_resize_kernel)),
    Fault("lost cameras taken for valid", "feed", prepared(stream.lost_cameras_valid), DRIVE[7:8]),
    Fault("sign of the time turned", "state", in_window(time_delta_s=lambda times: -times), DRIVE[:2]),
    Fault("times off by one slot", "state", in_window(time_delta_s=stream.one_slot_late), DRIVE[:3]),
    Fault(
        "past_T_now inverted",
        "state",
        in_window(past_T_now=stream.inverted),
        DRIVE[:2],
        bisected="decoder.past_T_now[slot 1]",
    ),
    Fault("past_T_now transposed", "state", in_window(past_T_now=stream.transposed), DRIVE[:2]),
    Fault("current pose not the identity", "state", in_window(past_T_now=stream.now_moved)),
    Fault("all slots taken for valid", "state", in_window(frame_valid=lambda valid: valid | True)),
    Fault(
        "camera masks ignored",
        "state",
        in_window(camera_valid=lambda valid: valid | True),
        DRIVE[7:8],
        bisected="decoder.camera_valid[slot 0, camera 0 CAM_FRONT]",
    ),
    Fault(
        "calibration of now for all slots",
        "state",
        in_window(image_T_ego=stream.calibration_of_now_for_all),
        LATE_FRAMES,
    ),
    Fault("a slot stale", "state", stream.a_stale_slot, DRIVE[:3]),
    Fault("memories of two slots exchanged", "state", stream.memory_of_the_wrong_slot, DRIVE[:3]),
    Fault("history kept over a scene change", "state", stream.history_never_ends, SCENE_CUT),
    Fault("history dropped at every frame", "state", stream.history_ends_at_once, DRIVE[:2]),
    Fault("lifting tables never renewed", "state", stream.tables_never_renewed, LATE_FRAMES),
    Fault("names shifted by one class", "answers", stream.names_shifted),
    Fault("the best boxes left out", "answers", stream.best_boxes_left_out),
    Fault("classes listed in another order", "shared", shared.other_class_order),
    Fault("width and length exchanged", "shared", in_boxes([0, 1, 2, 4, 3, 5, 6, 7, 8])),
    Fault("yaw turned round", "shared", in_boxes([*range(9)], [1, 1, 1, 1, 1, 1, -1, 1, 1])),
    Fault("velocity axes exchanged", "shared", in_boxes([0, 1, 2, 3, 4, 5, 6, 8, 7])),
    Fault("RGB for BGR", "shared", shared.rgb_for_bgr),
    Fault("mean not subtracted", "shared", shared.mean_not_subtracted),
    Fault("RGB for BGR in pre-processing", "shared", in_preparation(stream.colours_turned_round)),
    Fault("intrinsics of the uncut image", "shared", in_preparation(stream.intrinsics_of_the_uncut_image)),
    Fault("extrinsics transposed", "shared", shared.extrinsics_transposed),
    Fault("lost cameras taken for valid", "shared", in_preparation(stream.lost_cameras_valid), DRIVE[7:8]),
    Fault("another resize kernel", "shared", shared.kernel_of_another_kind),
    Fault("voxels transposed", "shared", shared.voxels_transposed),
    Fault("BEV queries transposed", "shared", shared.bev_queries_transposed),
    Fault("time runs backwards", "shared", shared.time_runs_backwards, DRIVE[:2]),
    Fault("velocity not rotated", "shared", shared.velocity_not_rotated, DRIVE[:3]),
    Fault("ego motion turned round", "shared", shared.ego_motion_turned_round, DRIVE[:2]),
    Fault("scores of another slope", "shared", shared.scores_of_another_slope),
    Fault("the worst boxes first", "shared", shared.worst_boxes_first),
    Fault("corners with width for length", "shared", shared.corners_of_a_box_turned),
    Fault("quaternion with w last", "shared", shared.quaternion_with_w_last),
    Fault("masks written transposed", "shared", shared.masks_transposed),
)

HEALTHY = Fault("(none)", "nowhere", lambda bench: bench.graphs_changed.update(GRAPH_NAMES), DRIVE[:2])


@dataclass(frozen=True)
class Trial:
    """What came of one fault. golden: the cases that failed. bisection: where parity failed and traces were at hand."""

    fault: Fault
    report: ParityResult
    is_refused_as_found: bool
    golden: tuple[str, ...]
    bisection: Bisection | None

    @property
    def caught_by(self) -> tuple[str, ...]:
        """The checks that saw the fault. That of the files' hashes is no proof: it was led past on purpose."""
        seen = {
            "graphs": self.report.failing_outputs,
            "stream": self.report.failing_frames,
            "liveness": self.report.dead_inputs,
            "golden": self.golden,
        }
        return tuple(name for name, found in seen.items() if found)

    @property
    def is_caught(self) -> bool:
        """By what is responsible: parity, or for what both sides share the golden cases, where parity is blind."""
        return self.caught_by == ("golden",) if self.fault.is_shared else bool({*self.caught_by} - {"golden"})


def try_fault(fault: Fault, tiny_bundle: Path, model: DuoSpaceNet, traces: Mapping[str, Trace] | None = None) -> Trial:
    """Put one fault into a copy of `tiny_bundle`, or into what works with it, and ask every check.

    traces: of `model`, by graph; without them nothing is bisected.
    """
    with tempfile.TemporaryDirectory() as folder, Bench(tiny_bundle, model, Path(folder)) as bench:
        fault.inject(bench)
        bench.patch("dead_inputs", _in_graphs_changed(bench), parity)
        report = check_parity(bench.bundle, bench.model, fault.frames)
        bisect = traces is not None and not report.passed and bench.model is model
        cases = () if fault.where == "feed" else GOLDEN_CASES  # these bring frames of their own
        return Trial(
            fault,
            report,
            bench.refused_as_found,
            tuple(case.__name__ for case in cases if _fails(case, bench.bundle)),
            bisect_parity(bench.bundle, model, fault.frames, report, traces=traces) if bisect else None,
        )


def _in_graphs_changed(bench: Bench) -> Callable[..., list[str]]:
    """The check of liveness, but for graphs that nobody has touched: their inputs are as alive as in the control."""
    dead_inputs = parity.dead_inputs
    graphs = read_manifest(bench.bundle).graphs
    changed = [{tensor.name for tensor in graphs[name].inputs} for name in bench.graphs_changed]
    return lambda session, inputs, names: dead_inputs(session, inputs, names) if inputs.keys() in changed else []


def tiny_model() -> DuoSpaceNet:
    return randomise(DuoSpaceNet(PRESETS["tiny"])).eval()


def _fails(case: Callable[[Path], None], bundle_folder: Path) -> bool:
    try:
        case(bundle_folder)
    except AssertionError:
        return True
    return False
