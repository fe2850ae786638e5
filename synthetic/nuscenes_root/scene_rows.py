"""Adds one scene to a root, frame by frame."""

from datetime import UTC, datetime
from pathlib import Path

from .root_scene import RootScene, SceneFrame
from .root_tables import RootTables, make_token
from .sensor_rows import SensorRows
from .tracks import Tracks


class SceneRows:
    """Adds the rows and the files of one scene."""

    def __init__(self, tables: RootTables, folder: Path, name: str, scene: RootScene, location: str) -> None:
        """folder: of the root.
        name, location: of the scene.
        """
        self.name = name
        self.scene = scene
        self._location = location
        self._tables = tables
        self._sensors = SensorRows(tables, folder, name, scene)
        self._tracks = Tracks(scene.seed, name)
        self._samples = [make_token("sample", name, index) for index in range(len(scene))]

    def add_frame(self, index: int, frame: SceneFrame) -> None:
        """Add a key frame. Frames are added in order."""
        self._tables.add(
            "sample",
            token=self._samples[index],
            timestamp=self.scene.times.key_frames_us[index],
            prev=self._samples[index - 1] if index else "",
            next=self._samples[index + 1] if index + 1 < len(self._samples) else "",
            scene_token=make_token("scene", self.name),
        )
        self._sensors.add_frame(index, self._samples[index], frame)
        self._tracks.add_frame(index, frame.objects)

    def finish(self, has_annotations: bool) -> None:
        """Add the rows of the whole scene, after its last frame."""
        log_token = make_token("log", self.name)
        start_s = self.scene.times.key_frames_us[0] * 1e-6
        self._tables.add(
            "log",
            token=log_token,
            logfile=f"synthetic-{self.scene.seed}",
            vehicle="synthetic",
            date_captured=datetime.fromtimestamp(start_s, UTC).date().isoformat(),
            location=self._location,
        )
        self._tables.add(
            "scene",
            token=make_token("scene", self.name),
            log_token=log_token,
            nbr_samples=len(self._samples),
            first_sample_token=self._samples[0],
            last_sample_token=self._samples[-1],
            name=self.name,
            description=f"Synthetic drive, seed {self.scene.seed}",
        )
        if has_annotations:
            self._tracks.add_rows(self._tables, self._samples)
