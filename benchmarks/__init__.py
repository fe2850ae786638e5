"""Scripts that measure. Each is run as `python -m benchmarks.NAME`; the Makefile has a target for most."""
