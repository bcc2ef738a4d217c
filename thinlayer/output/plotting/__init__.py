"""Pictures: rates and curves from tables, deformed structures, contact on S, layers by status, densities on S."""

from thinlayer.output.plotting.contacts import contact
from thinlayer.output.plotting.curves import COLOURS, ERRORS, curves, panels, rates
from thinlayer.output.plotting.densities import density
from thinlayer.output.plotting.layers import layers
from thinlayer.output.plotting.lines import along
from thinlayer.output.plotting.maps import maps
from thinlayer.output.plotting.movies import movie
from thinlayer.output.plotting.picture import Picture
from thinlayer.output.plotting.scene import VIEWS
from thinlayer.output.plotting.structures import deformed
from thinlayer.output.plotting.zoomed import zoomed

__all__ = [
    "COLOURS",
    "ERRORS",
    "VIEWS",
    "Picture",
    "along",
    "contact",
    "curves",
    "deformed",
    "density",
    "layers",
    "maps",
    "movie",
    "panels",
    "rates",
    "zoomed",
]
