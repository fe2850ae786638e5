"""The summary of a batch as text and a table."""

from typing import TYPE_CHECKING

from rich.table import Table

from .console import print_result

if TYPE_CHECKING:
    from ..jobs.batch.batch_summary import BatchSummary

MAX_ROWS = 32  # workers; the summary.json of a cluster has all of them


def print_batch(summary: "BatchSummary") -> None:
    """Print the throughput of each worker, and the counts of a batch."""
    workers = summary.workers
    if workers:  # none if a resumed batch had no scene left
        table = Table("worker", "scenes", "frames", "frames/s")
        for row in workers[:MAX_ROWS]:
            table.add_row(row.worker, str(row.scenes), str(row.frames), f"{row.frames_per_s:.2f}")
        print_result(table)
        if len(workers) > MAX_ROWS:
            print_result(f"and {len(workers) - MAX_ROWS} workers more")
    done, failed = len(summary.outcomes) - len(summary.failed), len(summary.failed)
    counts = f"{done} scenes done, {failed} failed" if failed else f"{done} scenes done"
    lost = f", {summary.lost_workers} workers lost" if summary.lost_workers else ""
    frames = f"{summary.count('frames')} frames, {summary.count('boxes')} boxes"
    seconds, new = summary.seconds, summary.new_frames
    speed = f"{new} frames in {seconds:.1f} s, {new / seconds:.2f} frames/s"
    print_result(f"{counts}{lost}; {frames}; this call: {speed}; results in {summary.out}", markup=False)
