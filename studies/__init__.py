"""One script per figure of the paper, sweeps in the layer's thickness, limits; data/studies.toml has each of them once."""

from pathlib import Path

__path__.append(str(Path(__file__).parents[1] / ".ci/benchmarks"))  # modules of a clone alone, which compare times
