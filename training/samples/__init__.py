"""Samples: the frames that a model is trained on, from a source or from the synthetic world.

`clips.py` is what both have in common. `clip_loader.py` turns clips into tensors, and `augmentation.py` changes them.
"""
