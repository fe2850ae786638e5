"""Losses of one frame: of the decoder and of the maps (`frame_losses.py`), and of the supervision heads."""
