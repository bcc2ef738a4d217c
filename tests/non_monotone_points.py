"""Non-monotone laws, strains whose drives are spread about the threshold, and paths, for tests at points."""

from __future__ import annotations

import numpy as np

from forms import LinearElastic, NonMonotone, NonMonotoneUnrelaxed, Tabulated
from tests.at_points import E2, at_rest, respond, tensor, vector

LMBDA, MU, ALPHA, C = 60.0, 40.0, 1.2, 0.02
ACROSS, ALONG = np.diag([0.0, 1.0]), np.array([[0.0, 0.5], [0.5, 0.0]])  # n (x) n, sym(tangent (x) n)
CHI2 = np.array([[-0.3, 0.5], [0.5, 0.9]])
CHI3 = np.array([[0.3, 0.5, -0.2], [0.5, 0.9, 0.4], [-0.2, 0.4, -0.6]])
CHIS = {"2D": CHI2, "3D": CHI3, "n (x) n": ACROSS, "sym(tangent (x) n)": ALONG}
RELAXED = {name: NonMonotone(LMBDA, MU, ALPHA, C, chi) for name, chi in CHIS.items()}
PURE = {name: NonMonotoneUnrelaxed(LMBDA, MU, ALPHA, C, chi) for name, chi in CHIS.items()}
STEEP = NonMonotone(LMBDA, MU, ALPHA, C, CHI2, mixing=0.4)
LAWS = {f"relaxed {name}": law for name, law in RELAXED.items()} | {"steep": STEEP}
LAWS |= {"pure": PURE["2D"], "pure 3D": PURE["3D"]}
THETAS = [1.0, 0.7, 0.5]
EPS = 0.05  # a thickness


def lifted(a):
    """(..., 2, 2) tensors or (..., 2) vectors with zeros added; three-dimensional ones unchanged."""
    missing = 3 - a.shape[-1]
    ends = 2 if a.ndim > 1 and a.shape[-1] == a.shape[-2] else 1
    return np.pad(a, [(0, 0)] * (a.ndim - ends) + [(0, missing)] * ends)


def random_strains(law, points, seed=4, spread=2.5):
    """Mandel strains (points, 6), in the plane for two dimensions, whose drives m are spread C to both sides."""
    random, d = np.random.default_rng(seed), len(law.chi)
    a = 0.006 * random.normal(size=(points, d, d))
    e = lifted((a + np.swapaxes(a, 1, 2)) / 2)
    wanted = np.linspace(-spread, spread, points) * law.transformation_energy / law.alpha
    chi = lifted(law.chi)
    return vector(e + ((wanted - np.sum(e * chi, axis=(1, 2))) / np.sum(chi * chi))[:, None, None] * chi)


def drives(law, e):
    """alpha chi:e, for n = e_2."""
    return law.alpha * np.sum(tensor(e) * lifted(law.chi), axis=(1, 2))


def at(law, e, e_old=None, theta=1.0, n=E2, phase=None):
    """Answer of a law to strains after e_old, with phases held if they are given."""
    q = at_rest(law, len(e))
    if phase is not None:
        q[:, 0] = phase
    return respond(law, e, 0 * e if e_old is None else e_old, q, np.broadcast_to(n, (len(e), 3)), 1.0, theta)


def density(e, z, chi, C=C):
    """Energy of the phase z at strains (..., 3, 3), Eq. (39)."""
    elastic = LMBDA / 2 * np.trace(e, axis1=-2, axis2=-1) ** 2 + MU * np.sum(e * e, axis=(-2, -1))
    return elastic - z * ALPHA * np.sum(lifted(chi) * e, axis=(-2, -1)) + C * np.abs(z)


def jumps_and_normals(law, count, seed=1):
    """Jumps and normals (count, 3) in the plane for a law of two dimensions, drives within a few C."""
    random, d = np.random.default_rng(seed), len(law.chi)
    w, n = (lifted(random.normal(size=(count, d))) for _ in range(2))
    return 0.015 * w, n / np.linalg.norm(n, axis=1)[:, None]


def branch(law, answer):
    """-2, 2 pure phases, -1, 1 mixtures, 0."""
    phase = answer.q[:, 0]
    return np.sign(phase) * (1 + (np.abs(phase) == 1))


AXES = {2: ("T", "N"), 3: ("T1", "T2", "N")}


def pulled(kind, values):
    """Steps of a path, jumps ("w") or tractions ("t") in the order of `PointHistory`."""
    return [{f"{kind}_{c}": x for c, x in zip(AXES[len(v)], v, strict=True)} for v in values]


def in_layer_axes(values):
    """From T, N or T1, T2, N to the layer's axes, whose second is N."""
    return values[..., [[0, 1], [0, 2, 1]][values.shape[-1] - 2]]


from_layer_axes = in_layer_axes


PATHS = {  # in thousandths
    2: [(4, 2), (10, 8), (30, 50), (60, 0), (-2, 10), (-30, 0), (-40, -10), (-20, 10)],
    3: [(0, 2, -0.3), (10, 10, 4), (50, 0, 40), (0, 40, -30), (-40, -20, -20)],
}
PATHS = {d: [tuple(w / 1e3 for w in jump) for jump in path] for d, path in PATHS.items()}


TABLE = Tabulated([(0.0, 2.0), (10.0, 1.0), (40.0, 4.0)])


STIFF = LinearElastic(20.0, 90.0)
