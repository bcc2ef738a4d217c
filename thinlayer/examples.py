"""Mesh files that come with thinlayer, for first scripts in any folder."""

from pathlib import Path

DATA_FOLDER = Path(__file__).parents[1] / "studies/data"


def lap() -> Path:
    """Return the path of a mesh file of two plates that overlap, in mm.

    The file names the bodies "LOWER PLATE" and "UPPER PLATE", the facets "GLUE" on which the plates meet, 25 mm long,
    and the end facets "LEFT" of the lower and "RIGHT" of the upper plate.

    Example:
        >>> from geometry import read
        >>> from thinlayer import examples
        >>> plates = read(examples.lap(), S="GLUE", upper="UPPER PLATE")
        >>> print(plates.regions)
        ('LOWER PLATE', 'UPPER PLATE')
    """
    return DATA_FOLDER / "lap.msh"


def arch() -> Path:
    """Return the path of a mesh file of a masonry arch of five stones with four joints, in m. Cells are curved.

    The file names the bodies "ODD STONES" and "EVEN STONES", the facets "JOINTS" between them, and the facets
    "INTRADOS", "EXTRADOS" and "SPRINGINGS", the lower, upper and end sides of the arch.

    Example:
        >>> from geometry import read
        >>> from thinlayer import examples
        >>> stones = read(examples.arch(), S="JOINTS", upper="EVEN STONES")
        >>> print(stones.regions)
        ('EVEN STONES', 'ODD STONES')
    """
    return DATA_FOLDER / "arch.msh"
