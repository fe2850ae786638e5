"""Where a bundle deviates from its model."""
