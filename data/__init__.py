"""Frame sources, result files and anchors files.

Frames: `source.py` (the protocol of every source), `scene_folder.py` and `scene_writer.py` (scene folders: `scene.json`
beside images), `nuscenes/` (nuScenes roots), `joined_source.py` (several sources as one).
`scene.json`: `scene_schema.py` (its fields, and the errors about them), `scene_file.py` (reading), `scene_index.py`,
`scene_records.py` and `scene_fast_check.py` (reading fast).
Image files: `images.py`, with a reader for each format in `jpeg_file.py` and `png_file.py`; `camera_image.py` (at the
size that a bundle needs).
Ground truth: `class_names.py` (which names stand for which class), `box_selection.py` (which boxes are used).
Results: `results.py` (JSON Lines).
Submissions to nuScenes: `submitted_boxes.py` (boxes in the global frame), `nuscenes_submission.py` (writing),
`submission_file.py`, `submission_schema.py` and `json_stream.py` (reading files of any size), `global_boxes.py` (true
boxes to compare with).
Anchors: `anchor_clustering.py` (K-means of ground-truth boxes), `anchors_file.py` (their file).
"""
