"""Free ends of layers: constants of the stresses and displacements of a layer near its end."""

from forms.ends.constants import FreeEnd as FreeEnd
from forms.ends.constants import free_end as free_end
