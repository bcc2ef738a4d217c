"""One script per figure of the paper, sweeps in the layer's thickness, limits; data/studies.toml has each of them once."""
