"""A synthetic world with exact ground truth: roads, vehicles and people, rendered into the cameras of a rig."""
