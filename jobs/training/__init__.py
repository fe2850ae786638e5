"""Training: a model is trained in a folder. Its parts: data, initial weights, folder, and what is shown of it."""
