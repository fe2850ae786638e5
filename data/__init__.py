"""Frame sources, result files and anchors files.

Frames: `source.py` (the protocol of every source), `scene_folder.py`, `scene_schema.py` and `scene_writer.py` (scene
folders: `scene.json` beside images).
Image files: `images.py`, with a reader for each format in `jpeg_file.py` and `png_file.py`.
Ground truth: `class_names.py` (which names stand for which class), `box_selection.py` (which boxes are used).
Results: `results.py` (JSON Lines), `nuscenes_submission.py` (the submission file of nuScenes).
Anchors: `anchor_clustering.py` (K-means of ground-truth boxes), `anchors_file.py` (their file).
"""
