"""The synthetic world as a nuScenes root: tables, images and maps in the layout of the dataset."""

from .root_writer import write_nuscenes_root as write_nuscenes_root
