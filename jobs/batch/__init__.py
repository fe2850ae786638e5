"""Batch: a bundle runs over many scenes, in processes of this machine or on a Ray cluster. One scene is one job."""
