"""Two blocks with a viscous layer on a surface between them, pulled: the model of most tests of marches."""

from __future__ import annotations

from forms import KelvinVoigt, LinearElastic, Maxwell
from geometry import sandwich
from thinlayer import Structure, Surface, ThinLayer

BODY = LinearElastic.young(100.0, 0.3)
SLOW = KelvinVoigt(60.0, 40.0, theta_lmbda=0.3, theta_mu=0.5)
SUDDEN = Maxwell(60.0, 40.0, t1=0.7)
JOINT = sandwich(1.0, 0.5, 0.5, 0.5)


SETUP = {"body": BODY, "supports": {"BOTTOM": 0.0, "LEFT": {"x": 0.0}, "RIGHT": {"x": 0.0}}}
PULL = {"TOP": (0.0, 1.0)}
K_N, G_N = 140.0, 60.0 * 0.3 + 80.0 * 0.5


def interface(law=SLOW, tractions=PULL, supports=None):
    setup = SETUP | ({"supports": SETUP["supports"] | supports} if supports else {})
    return Structure(JOINT, tractions=tractions, **setup).interface(ThinLayer(law, 0.1, at=1.0))


def opening(model):
    surface = Surface(model)
    return {"opening": lambda state: surface.integral(surface.jump(state)[1])}
