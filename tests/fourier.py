"""Two unlike blocks under a flux cos(K x), with what is between them: their closed compliance."""

import math

import numpy as np
import ufl

from forms import Conduction
from geometry import sandwich
from thinlayer import Structure

LOWER, UPPER, K_LOWER, K_UPPER, K = 0.4, 0.7, 2.0, 0.5, math.pi  # heights and conductivities of blocks, 1 wide


def blocks(h=1 / 8, **data):
    joint = sandwich(1, LOWER, UPPER, h=h, cell="quadrilateral")
    fluxes = {"TOP": lambda x, t: ufl.cos(K * x[0])}
    body = dict(zip(joint.bodies, (Conduction(K_LOWER), Conduction(K_UPPER)), strict=True))
    return Structure(joint, **({"body": body, "supports": {"BOTTOM": 0.0}, "fluxes": fluxes} | data))


def transfer(k, H):
    """The matrix from the value and flux below a sheet of conductivity k and height H to those above."""
    return np.array([[math.cosh(K * H), math.sinh(K * H) / (k * K)], [k * K * math.sinh(K * H), math.cosh(K * H)]])


def compliance(*between):
    """That of the blocks with these transfers between them, from the lower to the upper one."""
    M = transfer(K_LOWER, LOWER)
    for matrix in (*between, transfer(K_UPPER, UPPER)):
        M = matrix @ M
    return M[0, 1] / M[1, 1] / 2  # the integral of cos^2 is 1/2
