"""A nuScenes root as a source, read directly from its JSON tables.

Source: `nuscenes_source.py`, with `root_name.py` (the name of a source) and `splits.py` (which scenes it has).
Index: `index_file.py` (where it is kept, when it is rebuilt), `index_builder.py`, `index_records.py` (its content).
Tables: `table.py` (one JSON file, row by row), `table_set.py`, `table_records.py` (the fields), and what they hold:
`frame_tables.py`, `image_tables.py`, `annotation_tables.py`, `annotated_boxes.py`, `poses.py`.
Maps: `map_expansion.py` (masks of a frame), `map_rasterisation.py`, `map_geometry.py`, and `map_file.py`, which reads
the JSON files of the map expansion.
Both: `cache_folder.py`, where the index and the geometry of the maps are kept.
"""
