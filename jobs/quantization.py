"""The quantization of a float32 bundle to int8: calibration, sensitivity, comparison, and the new bundle."""

import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..runtime import Pipeline
from ..runtime.bundle.manifest import MANIFEST_NAME, Manifest, read_manifest, sha256, write_manifest
from ..runtime.bundle.parity_report import ParityReport
from ..runtime.bundle.quantization_record import AgreementByVariant, FramesRecord, MetricsByVariant, QuantizationRecord
from ..runtime.errors import ArtifactError, CheckError, UsageError
from ..runtime.extras import needs_extra
from ..runtime.progress import Progress, no_progress
from .ground_truth_check import check_benchmark_classes, check_true_boxes
from .input_warnings import InputWarnings
from .models import bundle_config
from .notify import Notify, ignore
from .quantization_frames import Clip, shortened, split_frames
from .quantization_gate import violations
from .quantization_judge import Judgement, judge
from .source_check import check_source
from .sources import map_grid, open_source

if TYPE_CHECKING:
    from ..export.quantization.candidate import Block, Candidates, GraphFiles
    from ..export.quantization.sensitivity import Sensitivity

SENSITIVITY_FRAMES = 6  # per block; enough for a full window
CALIBRATION_FRAMES = 32


@dataclass(frozen=True)
class QuantizedBundle:
    """A new int8 bundle.

    report: its parity with the float32 bundle. warnings: what is unusual about the sources.
    """

    bundle: Path
    record: QuantizationRecord
    report: ParityReport
    warnings: tuple[str, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """The fields as JSON values."""
        return {
            "bundle": str(self.bundle),
            "quantization": self.record.model_dump(mode="json"),
            "parity": self.report.model_dump(mode="json"),
            "warnings": list(self.warnings),
        }


def quantize_bundle(
    bundle: str | Path,
    sources: str | Path | Sequence[str | Path],
    out: str | Path,
    *,
    eval_sources: Sequence[str | Path] = (),
    metrics: bool = True,
    limit: int | None = None,
    calibration_frames: int = CALIBRATION_FRAMES,
    threads: int | None = None,
    check: bool = True,
    progress: Progress = no_progress,
    notify: Notify = ignore,
) -> QuantizedBundle:
    """Quantize a float32 bundle to a new bundle at `out`, if its metrics hold.

    sources: frames for the calibration. Without `eval_sources`, their second half is compared instead.
    eval_sources: frames on which the int8 bundle is compared with the float32 bundle.
    metrics: compare the nuScenes metrics, which need ground truth. Otherwise only the agreement is recorded.
    limit: only use the first frames of each source.
    calibration_frames: number of frames for the calibration, at most.
    threads: None uses the cores that are available to this process.
    check: refuse calibrations that `check-rig` calls broken. Otherwise they are only warned about.
    notify: gets each warning once, and each block that stays in float32.
    Raises CheckError if the metrics or the parity do not hold. Raises OutputError if `out` exists, ArtifactError for a
    bundle that cannot be quantized, InputError for a source without ground truth, and UsageError. Nothing is written
    then.
    """
    bundle, out = Path(bundle), Path(out)
    for option, number in (("limit", limit), ("calibration-frames", calibration_frames)):
        if number is not None and number < 1:
            raise UsageError(f"--{option}: expected at least 1; got {number}.")
    manifest = _read_float_manifest(bundle)
    with needs_extra("export"):
        from ..export.bundle import check_output_is_new, make_staging_dir
    check_output_is_new(out)
    names = [sources] if isinstance(sources, str | Path) else sources
    warnings = InputWarnings(notify)
    opened, eval_opened = (
        [_open(name, manifest, warnings, limit, check, progress) for name in each] for each in (names, eval_sources)
    )
    calibration, judging = split_frames(opened, eval_opened)
    if metrics:
        check_benchmark_classes(bundle, manifest, "Add --no-metrics.")
        advice = "Name a source with boxes as --eval-source, or add --no-metrics."
        for clip in judging:
            check_true_boxes(clip.source, clip.name, range(clip.start, clip.stop), advice)
    staging_dir = make_staging_dir(out)
    try:
        job = _Quantization(bundle, manifest, staging_dir, threads, progress, notify)
        result = job.run(shortened(calibration, calibration_frames), judging, metrics)
        staging_dir.chmod(0o755)
        staging_dir.rename(out)
    finally:
        shutil.rmtree(staging_dir, ignore_errors=True)
    return QuantizedBundle(out, *result, tuple(warnings.texts))


class _Quantization:
    """One job, which writes the new bundle to a staging directory."""

    def __init__(
        self,
        bundle: Path,
        manifest: Manifest,
        staging_dir: Path,
        threads: int | None,
        progress: Progress,
        notify: Notify,
    ) -> None:
        from ..export.parity.bundle_reference import BundleReference

        self._bundle, self._manifest, self._staging_dir = bundle, manifest, staging_dir
        self._threads, self._progress, self._notify = threads, progress, notify
        self._pipeline = Pipeline.load(bundle, threads)
        self._config = bundle_config(bundle, manifest)
        self._reference = BundleReference(bundle, self._pipeline, self._config)

    def run(
        self, calibration: Sequence[Clip], judging: Sequence[Clip], metrics: bool
    ) -> tuple[QuantizationRecord, ParityReport]:
        """Write the int8 bundle to the staging directory."""
        from ..export.quantization.candidate import blocks_in
        from ..export.quantization.golden_copy import copy_golden_example
        from ..export.quantization.quantized_graph import recipe
        from ..export.quantization.sensitivity import write_sensitivity
        from .quantization_calibration import calibrate, measure_sensitivities

        blocks = blocks_in(self._bundle, self._manifest)
        if not blocks:
            raise ArtifactError(f"{self._bundle}: expected a bundle with convolutions to quantize; got none.")
        candidates = calibrate(self._bundle, self._pipeline, calibration, self._staging_dir, self._progress)
        frames = shortened(calibration[:1], SENSITIVITY_FRAMES)
        sensitivities = measure_sensitivities(self._pipeline, candidates, blocks, frames, self._progress)
        float32 = judge(self._pipeline, judging, metrics, self._progress, "float32")
        quantized, graphs, engine = self._choose_blocks(candidates, sensitivities, judging, float32)
        simulation = candidates.simulated_pipeline(graphs)
        simulated = judge(simulation, judging, metrics, self._progress, "int8, simulated")
        record = QuantizationRecord(
            float_manifest_sha256=sha256(self._bundle / MANIFEST_NAME),
            recipe=recipe(),
            calibration=_frames_record(calibration),
            judging=_frames_record(judging),
            quantized_blocks=tuple(block.name for block in blocks if block in quantized),
            float_blocks=tuple(block.name for block in blocks if block not in quantized),
            metrics=_metrics_record(float32, simulated, engine),
            agreement=AgreementByVariant(simulated=simulated.agreement(float32), engine=engine.agreement(float32)),
        )
        # The configuration in a bundle of an older schema may lack fields that the current schema has.
        changes = {"precision": "int8", "quantization": record, "config": self._config.to_dict()}
        changes["golden"] = copy_golden_example(self._bundle, self._manifest, graphs.keys(), self._staging_dir)
        manifest = candidates.write(self._staging_dir, graphs).model_copy(update=changes)
        write_manifest(self._staging_dir, manifest)
        write_sensitivity(self._staging_dir, sensitivities, quantized)
        report = self._check_parity()
        write_manifest(self._staging_dir, manifest.model_copy(update={"parity": report}))
        return record, report

    def _choose_blocks(
        self,
        candidates: "Candidates",
        sensitivities: Sequence["Sensitivity"],
        clips: Sequence[Clip],
        float32: Judgement,
    ) -> tuple[list["Block"], "GraphFiles", Judgement]:
        """Quantize all blocks. While the metrics do not hold, leave the most sensitive block in float32.

        If only the IoU of maps is too low, that is the block with the largest error of maps.

        Returns the quantized blocks, the graphs, and their judgement. Raises CheckError if no block is left.
        """
        rows = list(sensitivities)
        while True:
            blocks = [row.block for row in rows]
            graphs = candidates.quantize(blocks)
            pipeline, with_metrics = candidates.engine_pipeline(graphs), float32.metrics is not None
            int8 = judge(pipeline, clips, with_metrics, self._progress, f"int8, {len(blocks)} blocks")
            failures = violations(float32.metrics, int8.metrics) if float32.metrics and int8.metrics else {}
            if not failures:
                return blocks, graphs, int8
            if len(rows) == 1:
                raise CheckError(
                    "the int8 bundle loses too much with every choice of blocks; no bundle was written. The last one: "
                    f"{'; '.join(failures.values())}. Calibrate with more frames, or keep the float32 bundle."
                )
            only_maps = not failures.keys() & {"mAP", "NDS"}
            worst = max(rows, key=lambda row: row.map_error if only_maps else row.error)
            self._notify(f"{next(iter(failures.values()))}; {worst.block.name} stays in float32")
            rows.remove(worst)

    def _check_parity(self) -> ParityReport:
        """Compare the bundle in the staging directory with the float32 bundle. Raises CheckError."""
        from ..export.parity.quantized_check import check_quantized

        # The bundle gets its parity report from this check, so it has none yet.
        pipeline = Pipeline.load(self._staging_dir, self._threads, require_parity=False)
        name = f"the float32 bundle with {MANIFEST_NAME} {sha256(self._bundle / MANIFEST_NAME)[:12]}"
        result = check_quantized(self._staging_dir, pipeline, self._reference, name, self._progress)
        if not result.passed:
            lines = "\n".join(f"  {line}" for line in result.failures)
            raise CheckError(f"the int8 graphs differ from the float32 graphs; no bundle was written:\n{lines}")
        return result.to_report()


def _read_float_manifest(bundle: Path) -> Manifest:
    manifest = read_manifest(bundle)
    if manifest.precision != "float32":
        raise ArtifactError(
            f"{bundle / MANIFEST_NAME}: field precision: expected a float32 bundle; got {manifest.precision}. "
            "Quantize the float32 bundle that it was made from."
        )
    return manifest


def _open(
    name: str | Path, manifest: Manifest, warnings: InputWarnings, limit: int | None, check: bool, progress: Progress
) -> Clip:
    """Open and check the frames of a source. The maps of a synthetic scene are rendered on the bundle's grid."""
    source = open_source(name, map_grid(manifest.perception, manifest.map_classes), progress)
    check_source(source, manifest, warnings, name=str(name), num_frames=limit, refuse_broken=check, progress=progress)
    return Clip(source, 0, len(source) if limit is None else min(len(source), limit), str(name))


def _metrics_record(float32: Judgement, simulated: Judgement, engine: Judgement) -> MetricsByVariant | None:
    """The metrics of the three variants; None if they were not computed."""
    if float32.metrics is None or simulated.metrics is None or engine.metrics is None:
        return None
    return MetricsByVariant(float32=float32.metrics, simulated=simulated.metrics, engine=engine.metrics)


def _frames_record(clips: Sequence[Clip]) -> FramesRecord:
    return FramesRecord(sources=tuple(clip.source.identity for clip in clips), frames=sum(map(len, clips)))
