"""Watching a training: its log, its curves, its times, and the validation on held-out sources."""
