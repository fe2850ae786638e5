"""Whole jobs as functions: what a command does, without its options and messages."""
