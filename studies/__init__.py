"""Studies: figures of the paper, sweeps in the layer's thickness, limits, estimates. data/studies.toml lists them."""

from pathlib import Path

__path__.append(str(Path(__file__).parents[1] / ".ci/benchmarks"))  # modules that compare times; only in a clone
