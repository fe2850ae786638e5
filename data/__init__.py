"""Where frames come from and where results go: sources, images, result files."""
