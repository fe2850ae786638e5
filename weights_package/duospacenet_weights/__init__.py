"""Trained weights of DuoSpaceNet, one safetensors file per preset. The toolkit only looks for the files."""
