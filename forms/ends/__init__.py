"""Free ends of layers: constants of the layer's own problem near an end."""

from forms.ends.constants import FreeEnd as FreeEnd
from forms.ends.constants import free_end as free_end
