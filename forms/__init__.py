"""UFL: kinematics, laws, and the work line that carries a law into a body, a meshed layer or a surface S."""

from forms.elastic import Anisotropic, LinearElastic, Stack
from forms.law import Law, LawError, Step

__all__ = ["Anisotropic", "Law", "LawError", "LinearElastic", "Stack", "Step"]
