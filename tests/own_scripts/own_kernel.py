"""A law of one's own in C: plasticity of von Mises, with a largest deviator."""

from dataclasses import dataclass
from pathlib import Path

from forms import KernelLaw
from thinlayer import drive

C = """
#include <math.h>

int kernel(double *out, const void *unused, const double *in)
{
    const double *e = in, *q = in + 12, kappa = in[23], mu = in[24], limit = in[25];
    double *stress = out, *q_new = out + 6, *tangent = out + 12, trial[6], size = 0;
    const double volume = e[0] + e[1] + e[2];
    for (int i = 0; i < 6; i++) {
        trial[i] = 2 * mu * (e[i] - (i < 3 ? volume / 3 : 0) - q[i]);
        size += trial[i] * trial[i];
    }
    size = sqrt(size);
    const double k = size <= limit ? 1 : limit / size;
    for (int i = 0; i < 6; i++) {
        stress[i] = k * trial[i] + (i < 3 ? kappa * volume : 0);
        q_new[i] = q[i] + (1 - k) * trial[i] / (2 * mu);
        for (int j = 0; j < 6; j++) {
            const double both = i < 3 && j < 3;
            tangent[6 * i + j] = kappa * both + 2 * mu * k * ((i == j) - both / 3);
            const double flows = k < 1 ? trial[i] * trial[j] / (size * size) : 0;
            tangent[6 * i + j] -= 2 * mu * k * flows;
        }
    }
    return 0;
}
"""
Path("mises.c").write_text(C)


@dataclass(frozen=True)
class Mises(KernelLaw):
    kappa: float  # bulk modulus, stress
    mu: float
    limit: float  # of the deviator's norm, stress
    powers = {"kappa": 1, "mu": 1}
    memory = 6  # plastic strain
    source = Path("mises.c")


law = Mises(kappa=80.0, mu=20.0, limit=0.6)
slipped = drive(law, [{"w_T": w, "t_N": 0.0} for w in (0.02, 0.2)])
print(slipped.tractions[:, 0])  # 0.4 and 0.424: mu w, and limit/sqrt(2) beyond
