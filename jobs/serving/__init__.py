"""Many vehicles on one server: a model repository for Triton, and the model that Triton's Python backend runs in it."""
