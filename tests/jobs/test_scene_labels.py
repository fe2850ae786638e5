"""Labels of frames for the progress of a job."""

from dataclasses import replace

from duospacenet.jobs.scene_labels import SceneLabels
from tests.helpers.trainings import FixedSource, synthetic_frames


def test_the_scenes_are_counted_where_the_name_changes():
    (frame,) = synthetic_frames(1, 1)
    label = SceneLabels(FixedSource([replace(frame, scene=name) for name in ("a", "a", "b", "a")]))
    assert [label(index) for index in range(4)] == [
        "scene 1 of 3, a",
        "scene 1 of 3, a",
        "scene 2 of 3, b",
        "scene 3 of 3, a",
    ]
