"""UFL: kinematics, laws, and the work line that carries a law into a body, a meshed layer or a surface S."""

from forms.laws import *  # noqa: F403
from forms.laws import __all__ as __all__
