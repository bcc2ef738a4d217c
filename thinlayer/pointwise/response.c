/* Laws at points: calls the compiled function of each law, and solves the local problem of sublayers in series.
 *
 * A law is a C function of two arrays of numbers,
 *     in:  e (6), e_old (6), q, n (3), dt, theta, parameters      out: stress (6), q_new, tangent (6 x 6), energies (3)
 * in Mandel's order 11, 22, 33, 12, 13, 23. It adds to its output. A law that fails leaves a NaN in its stress. */
#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

typedef void function(double *, const double *, const double *, const double *, const int *, const uint8_t *, void *);

typedef struct {
    function *law;
    int memory, plane, n_parameters; /* plane: the strains out of the plane are unknown, the stresses there zero */
    double fraction, out_strains[3];
    double *in, *out;
    double across[6][3];       /* n . tangent, for each component of strain */
    double K[3][3], stiffness; /* n . tangent . n, and its largest entry */
    double t[3], g[3], step[3];
} sublayer;

/* A normal, and the parts across and along S of each unit strain, see `across_and_along`. */
typedef struct {
    double n[3], across[6][3], along[6][6];
} frame;

static const double root2 = 1.4142135623730951, FARTHEST = 1e3, NO_STRAIN = 1e-13, LIGHT = 1e-6;
static const double SMALLEST = 1e-32; /* of the strains before: of a return to zero the rest only gets smaller and smaller */

static void evaluate_in_space(sublayer *a)
{
    memset(a->out, 0, (45 + a->memory) * sizeof(double));
    a->law(a->out, NULL, a->in, NULL, NULL, NULL, NULL);
}

static double *tangent(const sublayer *a) { return a->out + 6 + a->memory; }
static double *energies(const sublayer *a) { return a->out + 42 + a->memory; }

/* e += sym(g (x) n) */
static void add_share(double *e, const double *g, const double *n)
{
    for (int i = 0; i < 3; i++) e[i] += g[i] * n[i];
    e[3] += (g[0] * n[1] + g[1] * n[0]) / root2;
    e[4] += (g[0] * n[2] + g[2] * n[0]) / root2;
    e[5] += (g[1] * n[2] + g[2] * n[1]) / root2;
}

/* t = s n, for components of s that lie `stride` apart */
static void traction(const double *s, int stride, const double *n, double *t)
{
    const double s3 = s[3 * stride] / root2, s4 = s[4 * stride] / root2, s5 = s[5 * stride] / root2;
    t[0] = s[0] * n[0] + s3 * n[1] + s4 * n[2];
    t[1] = s[stride] * n[1] + s3 * n[0] + s5 * n[2];
    t[2] = s[2 * stride] * n[2] + s4 * n[0] + s5 * n[1];
}

/* The vector g with e n = sym(g (x) n) n; where e is sym(g (x) n) but for rounding, what is left is none. */
static void across_and_along(const double *e, const double *n, double *g, double *along)
{
    double largest = 0, left = 0, back[3];
    traction(e, 1, n, g);
    const double normal = g[0] * n[0] + g[1] * n[1] + g[2] * n[2];
    for (int j = 0; j < 3; j++) g[j] = 2 * g[j] - normal * n[j], back[j] = -g[j];
    memcpy(along, e, 6 * sizeof(double));
    add_share(along, back, n);
    for (int k = 0; k < 6; k++) largest = fmax(largest, fabs(e[k])), left = fmax(left, fabs(along[k]));
    if (left <= NO_STRAIN * largest) memset(along, 0, 6 * sizeof(double));
}

static void turn_to(frame *S, const double *n)
{
    if (memcmp(S->n, n, sizeof S->n) == 0) return;
    memcpy(S->n, n, sizeof S->n);
    for (int k = 0; k < 6; k++) {
        double unit[6] = {0};
        unit[k] = 1;
        across_and_along(unit, n, S->across[k], S->along[k]);
    }
}

/* Solve A x = b in place for `columns` right-hand sides, rows of A and b `stride` apart; returns whether A, whose entries are
 * about 1, is regular. */
static int solve(double *A, int size, int stride, int columns)
{
    for (int k = 0; k < size; k++) {
        int pivot = k;
        for (int i = k + 1; i < size; i++)
            if (fabs(A[i * stride + k]) > fabs(A[pivot * stride + k])) pivot = i;
        if (!(fabs(A[pivot * stride + k]) > 1e-12)) return 0;
        if (pivot != k)
            for (int j = k; j < size + columns; j++) {
                const double x = A[k * stride + j];
                A[k * stride + j] = A[pivot * stride + j], A[pivot * stride + j] = x;
            }
        for (int i = k + 1; i < size; i++) {
            const double f = A[i * stride + k] / A[k * stride + k];
            if (f != 0)
                for (int j = k + 1; j < size + columns; j++) A[i * stride + j] -= f * A[k * stride + j];
        }
    }
    for (int c = size; c < size + columns; c++)
        for (int k = size - 1; k >= 0; k--) {
            double x = A[k * stride + c];
            for (int j = k + 1; j < size; j++) x -= A[k * stride + j] * A[j * stride + c];
            A[k * stride + c] = x / A[k * stride + k];
            if (!isfinite(A[k * stride + c])) return 0;
        }
    return 1;
}

#include "plane_stress.h"

static void evaluate(sublayer *a)
{
    if (a->plane)
        evaluate_in_plane(a);
    else
        evaluate_in_space(a);
}

/* Tractions of all sublayers, whose strains are along + sym(g (x) n); returns whether the laws succeeded. */
static int tractions(sublayer *layers, int count, const double *along, const double *n)
{
    int finite = 1;
    for (int i = 0; i < count; i++) {
        sublayer *a = &layers[i];
        memcpy(a->in, along, 6 * sizeof(double));
        add_share(a->in, a->g, n);
        evaluate(a);
        traction(a->out, 1, n, a->t);
        a->stiffness = 0;
        for (int k = 0; k < 6; k++) traction(tangent(a) + k, 6, n, a->across[k]);
        for (int k = 0; k < 3; k++) {
            traction(&a->across[0][k], 3, n, a->K[k]);
            for (int j = 0; j < 3; j++) a->stiffness = fmax(a->stiffness, fabs(a->K[k][j]));
        }
        for (int j = 0; j < 3; j++) finite = finite && isfinite(a->t[j]);
    }
    return finite;
}

/* Steps of the sublayers' jumps and the common traction t: K_i dg_i - t = -t_i, sum a_i dg_i = 0; with `columns` 7, the
 * slopes of both along the components of strain as well. One singular K_i (a sublayer that yields) is allowed. If
 * several are singular, their jumps are undetermined; `added`, a share of the largest entry of each K_i, is then added to its
 * diagonal. Rows are scaled by that entry, t by the smallest of them. The last rows are light, so that none of them is the
 * pivot of a jump that follows from the equations of its own sublayer. */
static int linearised(sublayer *layers, int count, const frame *S, double *A, int columns, double added)
{
    const int size = 3 * count + 3, stride = size + 7;
    double softest = INFINITY;
    memset(A, 0, size * stride * sizeof(double));
    for (int i = 0; i < count; i++)
        if (layers[i].stiffness > 0) softest = fmin(softest, layers[i].stiffness);
    if (!isfinite(softest)) softest = 1; /* nothing has a stiffness */
    for (int k = 0; k < 6 && columns > 1; k++)
        for (int j = 0; j < 3; j++) A[(3 * count + j) * stride + size + 1 + k] = LIGHT * S->across[k][j];
    for (int i = 0; i < count; i++) {
        const sublayer *a = &layers[i];
        const double largest = a->stiffness > 0 ? a->stiffness : softest;
        for (int j = 0; j < 3; j++) {
            double *row = A + (3 * i + j) * stride;
            for (int k = 0; k < 3; k++) row[3 * i + k] = a->K[j][k] / largest + (j == k ? added : 0);
            row[3 * count + j] = -softest / largest;
            A[(3 * count + j) * stride + 3 * i + j] = LIGHT * a->fraction;
            row[size] = -a->t[j] / largest;
        }
        for (int k = 0; k < 6 && columns > 1; k++)
            for (int m = 0; m < 6; m++) {
                const double x = S->along[k][m] / largest;
                if (x == 0) continue; /* most are, where n is an axis */
                for (int j = 0; j < 3; j++) A[(3 * i + j) * stride + size + 1 + k] -= a->across[m][j] * x;
            }
    }
    if (!solve(A, size, stride, columns)) return 0;
    for (int j = 0; j < 3; j++) A[(3 * count + j) * stride + size] *= softest;
    return 1;
}

/* Computes the step; returns 1, 2 if several sublayers yield, or 0 if there is no step. */
static int step_of(sublayer *layers, int count, const frame *S, double *A, int columns)
{
    if (linearised(layers, count, S, A, columns, 0)) return 1;
    return linearised(layers, count, S, A, columns, 1e-8) ? 2 : 0;
}

/* Corrects the sublayers' jumps so that they add up to that of the whole layer: the rounding error is distributed in
 * proportion to their sizes. */
static void add_up(sublayer *layers, int count, const double *whole)
{
    double missing[3], sizes = 0;
    memcpy(missing, whole, sizeof missing);
    for (int i = 0; i < count; i++) {
        const sublayer *a = &layers[i];
        sizes += a->fraction * (fabs(a->g[0]) + fabs(a->g[1]) + fabs(a->g[2]));
        for (int j = 0; j < 3; j++) missing[j] -= a->fraction * a->g[j];
    }
    for (int i = 0; i < count; i++) {
        double *g = layers[i].g;
        const double share = sizes > 0 ? (fabs(g[0]) + fabs(g[1]) + fabs(g[2])) / sizes : 1;
        for (int j = 0; j < 3; j++) g[j] += share * missing[j];
    }
}

/* Newton for the sublayers' jumps g_i per thickness: equal tractions, sum a_i g_i = g. Fills stress and tangent; begins with
 * the shares g_i - g of the beginning of the step, and leaves those of its end in g_i. Jumps, not shares, are the unknowns: the
 * strain of a stiff sublayer would be lost in their rounding.
 * A step is halved while the work of the tractions along it, which grows with its length if the laws are monotone, is more
 * than half of that at its beginning. Converged: jumps to 1e-9 and tractions to 1e-8, or nothing but rounding is left of
 * either: along null vectors of several K_i jumps stay where they are. Steps end at FARTHEST times the strains. */
static int in_series(sublayer *layers, int count, const double *e, const frame *S, double *A, double *s, double C[6][6])
{
    const double *n = S->n;
    const int size = 3 * count + 3, stride = size + 7;
    double slope = 0, length = 0, strains = 0, g[3], along[6];
    int converged = 0, iteration = 0;
    across_and_along(e, n, g, along);
    for (int i = 0; i < count; i++)
        for (int k = 0; k < 6; k++) strains = fmax(strains, fmax(fabs(e[k]), fabs(layers[i].in[6 + k])));
    for (int i = 0; i < count; i++)
        for (int j = 0; j < 3; j++) strains = fmax(strains, fabs(layers[i].g[j])), layers[i].g[j] += g[j];
    add_up(layers, count, g);
    for (; iteration < 300; iteration++) {
        if (!tractions(layers, count, along, n)) return 0;
        if (converged) break;
        if (length > 1e-9 && slope < 0) {
            double now = 0;
            for (int i = 0; i < count; i++)
                for (int j = 0; j < 3; j++) now += layers[i].fraction * layers[i].t[j] * layers[i].step[j];
            if (now > -0.5 * slope) { /* half way back */
                length /= 2;
                for (int i = 0; i < count; i++)
                    for (int j = 0; j < 3; j++) layers[i].g[j] -= length * layers[i].step[j];
                continue;
            }
        }
        const int kind = step_of(layers, count, S, A, 1);
        if (!kind) return 0;
        double whole = 0, largest = 0, force = 0, apart = 0, rounding = 0, stiffest = 0;
        for (int k = 0; k < 6; k++) whole = fmax(whole, fabs(e[k]));
        for (int i = 0; i < count; i++) {
            const sublayer *a = &layers[i];
            double strain = 0, stiff = 0;
            for (int k = 0; k < 6; k++) strain = fmax(strain, fabs(a->in[k]));
            for (int j = 0; j < 3; j++) {
                force = fmax(force, fabs(a->t[j])), whole = fmax(whole, fabs(a->g[j]));
                apart = fmax(apart, fabs(a->t[j] - A[(3 * count + j) * stride + size]));
                for (int k = 0; k < 6; k++) stiff = fmax(stiff, fabs(a->across[k][j]));
            }
            rounding = fmax(rounding, stiff * strain), stiffest = fmax(stiffest, stiff);
        }
        converged = apart <= 1e-14 * force + 1e-16 * rounding + SMALLEST * stiffest * strains;
        if (converged) break;
        for (int i = 0; i < count; i++)
            for (int j = 0; j < 3; j++) largest = fmax(largest, fabs(layers[i].step[j] = A[(3 * i + j) * stride + size]));
        slope = 0, length = 1;
        if (iteration == 0 && kind == 1) strains = fmax(strains, largest);
        const double shorter = fmin(1, FARTHEST * strains / largest);
        for (int i = 0; i < count; i++)
            for (int j = 0; j < 3; j++) {
                sublayer *a = &layers[i];
                a->step[j] *= shorter, a->g[j] += a->step[j];
                slope += a->fraction * a->t[j] * a->step[j];
                whole = fmax(whole, fabs(a->g[j]));
            }
        if (whole > 10 * FARTHEST * strains) return 0;
        add_up(layers, count, g);
        const int close = apart <= 1e-8 * force + 1e-14 * rounding;
        converged = close && largest <= 1e-9 * whole;
    }
    if (!converged || !step_of(layers, count, S, A, 7)) return 0;
    memset(s, 0, 6 * sizeof(double));
    memset(C, 0, 36 * sizeof(double));
    for (int k = 0; k < 6; k++)
        for (int i = 0; i < count; i++) {
            const sublayer *a = &layers[i];
            double change[3], strain[6];
            memcpy(strain, S->along[k], sizeof strain);
            for (int j = 0; j < 3; j++) change[j] = A[(3 * i + j) * stride + size + 1 + k];
            add_share(strain, change, n);
            s[k] += a->fraction * a->out[k];
            for (int j = 0; j < 6; j++)
                for (int m = 0; m < 6; m++) C[j][k] += a->fraction * tangent(a)[6 * j + m] * strain[m];
        }
    for (int i = 0; i < count; i++)
        for (int j = 0; j < 3; j++) layers[i].g[j] -= g[j];
    return 1;
}

/* Run a law over points; returns the number of points where it failed, or -1 without memory. A point that failed has a NaN in
 * its stress; its tangent is zero where there was no stress, else it has an entry that is not finite.
 *
 * e, e_old: (points, m), the m Mandel components `slots`, the others zero; stress: (points, 6); C: (points, m, m); n: (points, 3);
 * q, q_new: (points, width), of sublayers in series their shares (3 each), then the values of each, in plane stress followed
 * by its strains 33, 13 and 23; parameters: of all points,
 * or, with `varying`, (points, n), of each. With `fixed`, strains stay e_old, those of sublayers too: nothing is solved, there is
 * no stress, and the energies are those of e_old. */
int run(int count, const intptr_t *addresses, const int32_t *memories, const int32_t *planes,
        const int32_t *n_parameters, const double *fractions, const double *parameters, int varying, int m, const int32_t *slots, int points, int width,
        const double *e, const double *e_old, const double *q, const double *n, double dt, double theta, int fixed,
        double *stress, double *C, double *q_new, double *energy)
{
    sublayer *layers = calloc(count, sizeof(sublayer));
    int room = (3 * count + 3) * (3 * count + 10), failed = 0;
    for (int i = 0; i < count; i++) room += 62 + 2 * memories[i] + n_parameters[i];
    double *numbers = calloc(room, sizeof(double)), *next = numbers;
    if (!layers || !numbers) {
        free(layers), free(numbers);
        return -1;
    }
    for (int i = 0; i < count; i++) {
        sublayer *a = &layers[i];
        a->law = (function *)addresses[i];
        a->memory = memories[i], a->plane = planes[i], a->n_parameters = n_parameters[i];
        a->fraction = fractions[i];
        a->in = next, a->out = a->in + 17 + a->memory + a->n_parameters;
        next = a->out + 45 + a->memory;
    }
    double *system = next;
    frame S = {0};
    const double *numbers_of = parameters;
    for (int k = 0; k < points; k++, e += m, e_old += m, q += width, q_new += width, n += 3) {
        double now[6] = {0}, s[6] = {0}, D[6][6] = {{0}};
        const double *old = q + (count > 1 ? 3 * count : 0);
        for (int j = 0; j < m; j++) now[slots[j]] = e[j];
        for (int i = 0; i < count; i++) {
            sublayer *a = &layers[i];
            double *tail = a->in + 12 + a->memory;
            memset(a->in, 0, 12 * sizeof(double));
            for (int j = 0; j < m; j++) a->in[6 + slots[j]] = e_old[j];
            if (count > 1) {
                memcpy(a->g, q + 3 * i, sizeof a->g);
                add_share(a->in + 6, a->g, n);
            }
            memcpy(a->in + 12, old, a->memory * sizeof(double));
            old += a->memory;
            for (int j = 0; a->plane && j < OUT; j++) a->in[6 + out_of_plane[j]] = a->out_strains[j] = *old++;
            memcpy(tail, n, 3 * sizeof(double));
            tail[3] = dt, tail[4] = theta;
            if (varying || k == 0) memcpy(tail + 5, numbers_of, a->n_parameters * sizeof(double));
            numbers_of += a->n_parameters;
        }
        if (!varying) numbers_of = parameters;
        if (fixed) {
            for (int i = 0; i < count; i++) memcpy(layers[i].in, layers[i].in + 6, sizeof now), evaluate_in_space(&layers[i]);
        } else if (count > 1) {
            turn_to(&S, n);
            if (!in_series(layers, count, now, &S, system, s, D)) s[0] = NAN;
        } else {
            memcpy(layers->in, now, sizeof now);
            evaluate(layers);
            memcpy(s, layers->out, sizeof s);
            memcpy(D, tangent(layers), sizeof D);
        }
        double *new = q_new + (count > 1 ? 3 * count : 0);
        memset(energy + 3 * k, 0, 3 * sizeof(double));
        for (int i = 0; i < count; i++) {
            const sublayer *a = &layers[i];
            if (count > 1) memcpy(q_new + 3 * i, a->g, sizeof a->g);
            memcpy(new, a->out + 6, a->memory * sizeof(double));
            new += a->memory;
            for (int j = 0; a->plane && j < OUT; j++) *new++ = a->in[out_of_plane[j]];
            for (int j = 0; j < 3; j++) energy[3 * k + j] += a->fraction * energies(a)[j];
        }
        int known = 1, sloped = 1;
        for (int i = 0; i < 6; i++) known = known && isfinite(s[i]);
        memcpy(stress + 6 * k, s, sizeof s);
        for (int i = 0; i < m; i++)
            for (int j = 0; j < m; j++) {
                C[(k * m + i) * m + j] = D[slots[i]][slots[j]];
                sloped = sloped && isfinite(D[slots[i]][slots[j]]);
            }
        if (!known) memset(C + k * m * m, 0, m * m * sizeof(double));
        if (!known || !sloped) failed++, stress[6 * k] = NAN;
    }
    free(layers), free(numbers);
    return failed;
}
