"""Pictures: errors and curves from tables, deformed structures and movies, fields on S and along it, zooms."""

# ruff: noqa: F401
from thinlayer.output.plotting.along import along
from thinlayer.output.plotting.cells import cells
from thinlayer.output.plotting.curves import curves, load_displacement, rates, response
from thinlayer.output.plotting.movies import movie
from thinlayer.output.plotting.scene import View
from thinlayer.output.plotting.structures import deformed, field, on_surface
from thinlayer.output.plotting.zoomed import zoomed
