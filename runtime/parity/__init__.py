"""Comparison of tensors and of streamed frames with a reference, without PyTorch."""
