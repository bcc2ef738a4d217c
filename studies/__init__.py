"""One script per figure of the paper, sweeps in the layer's thickness, limits."""
