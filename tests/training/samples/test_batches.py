"""Tests of batches: every process gets its part of each batch, and the lengths of all clips."""

from duospacenet.training.samples.batches import make_batches
from duospacenet.training.samples.clip_loader import clips_of_process
from tests.helpers.trainings import FixedClips, settings_with, synthetic_frames


def test_each_process_gets_its_clips_and_the_lengths_of_all_clips():
    """Clips of 1 and 3 frames alternate. Batches 1 and 2 of four clips, in two processes."""
    frames = synthetic_frames(1, 3)
    clips, settings = FixedClips((frames[:1], frames)), settings_with(batch_size=4)
    numbers = range(4, 12)
    for rank, expected in enumerate(([[4, 5], [8, 9]], [[6, 7], [10, 11]])):
        own = iter(clips_of_process(numbers, settings, rank, 2))
        batches = list(make_batches(own, clips, numbers, settings, 2))  # numbers instead of loaded clips
        assert [batch.clips for batch in batches] == expected
        assert [batch.num_steps for batch in batches] == [[1, 3, 1, 3]] * 2
