/* Von Mises' plasticity at one point, in three dimensions: radial return with isotropic and kinematic hardening.
 *
 * Tensors are in Mandel's order 11, 22, 33, sqrt2 12, sqrt2 13, sqrt2 23. With the backstress 2/3 K e^p, the equivalent stress
 * q = sqrt(3/2) |dev stress - backstress| of the trial and the accumulated plastic strain p, the return is
 * q - (3 mu + K) x = Y + H (p + x) + Q (1 - exp(-(p + x)/p_0)) for its increase x. */
#include <math.h>
#include <string.h>

typedef struct {
    double lmbda, mu, strength, linear, kinematic, saturation, strain; /* Y, H, K, Q, p_0 */
} material;

static double dot(const double *a, const double *b)
{
    double sum = 0;
    for (int i = 0; i < 6; i++) sum += a[i] * b[i];
    return sum;
}

/* Energy of an elastic strain and a plastic one. */
static double energy(const material *k, const double *elastic, const double *plastic)
{
    const double volume = elastic[0] + elastic[1] + elastic[2];
    return k->lmbda * volume * volume / 2 + k->mu * dot(elastic, elastic) + k->kinematic * dot(plastic, plastic) / 3;
}

/* Yield stress at the accumulated plastic strain p, and its slope. */
static double yield_stress(const material *k, double p, double *slope)
{
    const double left = k->saturation > 0 ? exp(-p / k->strain) : 0;
    *slope = k->linear + (k->saturation > 0 ? k->saturation * left / k->strain : 0);
    return k->strength + k->linear * p + k->saturation * (1 - left);
}

/* Increase of p for an equivalent trial stress beyond the yield stress; NaN if it is not found. The rest is a convex function
 * that falls, so that Newton's method from 0 never goes too far. */
static double increase(const material *k, double trial, double p, double *slope)
{
    double x = 0;
    for (int i = 0; i < 200; i++) {
        const double rest = trial - (3 * k->mu + k->kinematic) * x - yield_stress(k, p + x, slope);
        const double step = rest / (3 * k->mu + k->kinematic + *slope);
        x += step;
        if (fabs(step) <= 1e-15 * fabs(x) || fabs(rest) <= 1e-15 * trial) {
            yield_stress(k, p + x, slope);
            return x;
        }
    }
    return NAN;
}

int kernel(double *out, const void *unused, const double *in)
{
    const double *e = in, *e_old = in + 6, *plastic = in + 12, p = in[18], theta = in[23], *parameters = in + 24;
    double *stress = out, *q_new = out + 6, *D = out + 13, *energies = out + 49;
    const material k = {parameters[0], parameters[1], parameters[2], parameters[3],
                        parameters[4], parameters[5], parameters[6]};
    double mid[6], beyond[6], deviator[6], flow[6] = {0}, x = 0, shrunk = 0, along = 0;
    for (int i = 0; i < 6; i++) mid[i] = theta * e[i] + (1 - theta) * e_old[i];
    const double volume = mid[0] + mid[1] + mid[2], bulk = k.lmbda + 2 * k.mu / 3;
    for (int i = 0; i < 6; i++) {
        deviator[i] = 2 * k.mu * (mid[i] - (i < 3 ? volume / 3 : 0) - plastic[i]);
        beyond[i] = deviator[i] - 2 * k.kinematic / 3 * plastic[i];
    }
    double slope;
    const double size = sqrt(dot(beyond, beyond)), trial = sqrt(1.5) * size;
    if (trial > yield_stress(&k, p, &slope)) {
        x = increase(&k, trial, p, &slope);
        shrunk = 3 * k.mu * x / trial;
        along = shrunk - 3 * k.mu / (3 * k.mu + k.kinematic + slope);
        for (int i = 0; i < 6; i++) flow[i] = 1.5 * x * beyond[i] / trial;
    }
    double change[6], of_plastic[6], end[6];
    for (int i = 0; i < 6; i++) {
        stress[i] = deviator[i] - 2 * k.mu * flow[i] + (i < 3 ? bulk * volume : 0);
        of_plastic[i] = flow[i] / theta;
        q_new[i] = plastic[i] + of_plastic[i];
        change[i] = e[i] - e_old[i] - of_plastic[i];
        end[i] = e[i] - q_new[i];
        for (int j = 0; j < 6; j++) {
            double slope_ij = i < 3 && j < 3 ? bulk - 2 * k.mu * (1 - shrunk) / 3 : 0;
            if (i == j) slope_ij += 2 * k.mu * (1 - shrunk);
            if (x > 0) slope_ij += 2 * k.mu * along * beyond[i] * beyond[j] / (size * size);
            D[6 * i + j] = theta * slope_ij;
        }
    }
    q_new[6] = p + x / theta;
    energies[0] = energy(&k, end, q_new);
    energies[1] = yield_stress(&k, p + x, &slope) * x / theta;
    energies[2] = (2 * theta - 1) * energy(&k, change, of_plastic);
    return 0;
}
