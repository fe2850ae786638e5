"""Frame sources, result files and anchors files.

Frames: `source.py` (the protocol of every source), `scene_folder.py`, `scene_schema.py` and `scene_writer.py` (scene
folders: `scene.json` beside images), `images.py` (image files).
Results: `results.py` (JSON Lines), `nuscenes_submission.py` (the submission file of nuScenes).
Anchors: `anchor_clustering.py` (K-means of ground-truth boxes), `anchors_file.py` (their file).
"""
