"""Quantization of a bundle's graphs to int8: blocks, calibration, and the rewriting of a graph.

Start reading in `quantized_graph.py`.
"""
