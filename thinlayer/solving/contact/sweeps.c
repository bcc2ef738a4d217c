/* Gauss-Seidel sweeps over nodes in contact, and the relaxation of the paper, for normal compliance and Coulomb friction.
 *
 * A pair joins an upper node with a lower one, or with a rigid base. Its jump w has d = 2 or 3 components: d - 1 tangential
 * ones, less the slip, then the normal one, which is positive where the pair is open. */
#include <math.h>
#include <stddef.h>
#include <stdint.h>

#define STEPS 24 /* most Newton steps at a node */
#define TRIALS 12 /* most trials of a step's length */
#define LEAST 1e-3 /* least share of springs of a node that is eased, but for none */
#define LESS 0.5 /* each share over the one before */
#define FLAT 0.1 /* work along a step at its end, relative to that at its beginning, that ends the search of its length */
#define SMALL 1e-13 /* residual of a node, relative to its forces, that counts as zero */
#define ROUNDING 1e-15 /* rounding of a jump, relative to the displacements in it */

enum { K_N, K_T, FRICTION, COHESION, SHARE, NUMBERS }; /* a pair's law: SHARE is that of springs that neither open nor slide */

/* The threshold: the largest tangential traction at a normal jump. */
static double threshold(const double *law, double w_N)
{
    return law[COHESION] + law[FRICTION] * law[K_N] * fmax(-w_N, 0);
}

/* Traction t on the lower side and its derivative D at the jump w.
 *
 * p = K_N max(-w_N, 0), t_N = -p, and t_T = K_T w_T, shortened to the threshold where it is longer. */
static void traction(int d, const double *law, const double *w, double *t, double D[3][3])
{
    const int m = d - 1;
    const double bound = threshold(law, w[m]), own = 1 - law[SHARE], normal = law[SHARE] * law[K_N];
    double size = 0, K = law[SHARE] * law[K_T];
    for (int k = 0; k < m; k++) size += w[k] * w[k];
    size = law[K_T] * sqrt(size);
    const int slides = size > bound;
    K += own * law[K_T] * (slides ? bound / size : 1);
    for (int k = 0; k < d; k++)
        for (int l = 0; l < d; l++) D[k][l] = 0;
    t[m] = (normal + (w[m] < 0 ? own * law[K_N] : 0)) * w[m];
    D[m][m] = normal + (w[m] < 0 ? own * law[K_N] : 0);
    for (int k = 0; k < m; k++) {
        t[k] = K * w[k];
        D[k][k] = K;
        if (!slides) continue;
        const double along = law[K_T] * w[k] / size;
        for (int l = 0; l < m; l++) D[k][l] -= own * law[K_T] * bound / size * along * law[K_T] * w[l] / size;
        if (w[m] < 0) D[k][m] = -own * along * law[FRICTION] * law[K_N];
    }
}

/* Solves A x = b of size d <= 3 by elimination with pivots; b becomes x. Returns 0 if A is singular. */
static int solve(int d, double A[3][3], double *b)
{
    for (int k = 0; k < d; k++) {
        int at = k;
        for (int i = k + 1; i < d; i++)
            if (fabs(A[i][k]) > fabs(A[at][k])) at = i;
        if (!(fabs(A[at][k]) > 0)) return 0;
        for (int l = 0; l < d; l++) {
            const double kept = A[k][l];
            A[k][l] = A[at][l], A[at][l] = kept;
        }
        const double kept = b[k];
        b[k] = b[at], b[at] = kept;
        for (int i = k + 1; i < d; i++) {
            const double f = A[i][k] / A[k][k];
            for (int l = k; l < d; l++) A[i][l] -= f * A[k][l];
            b[i] -= f * b[k];
        }
    }
    for (int k = d - 1; k >= 0; k--) {
        for (int l = k + 1; l < d; l++) b[k] -= A[k][l] * b[l];
        b[k] /= A[k][k];
    }
    return isfinite(b[0] + b[d - 1]);
}

/* A node: A x + forces of its pairs = r. Its pairs have the numbers `pair`; sign is 1 if it is the upper node of a pair, -1
 * if it is the lower one; other is the other node, -1 where there is none that moves. Jumps are those of u, plus offsets.
 * Components that are not free rest. */
typedef struct {
    int d, count;
    double A[3][3], r[3];
    const int32_t *pair, *other, *sign;
    const double *u, *frames, *weights, *laws, *offsets;
    const uint8_t *free;
    double eased; /* least share of springs that neither open nor slide */
} node;

/* Residual F and its derivative T at the displacement x of the node; returns the norm of F, and in `zero` what counts as
 * zero. */
static double residual(const node *a, const double *x, double *F, double T[3][3], double *zero)
{
    const int d = a->d;
    double norm = 0, terms = 0, rounding = 0;
    for (int k = 0; k < d; k++) {
        F[k] = -a->r[k], terms += fabs(a->r[k]);
        for (int l = 0; l < d; l++) F[k] += a->A[k][l] * x[l], T[k][l] = a->A[k][l];
    }
    for (int q = 0; q < a->count; q++) {
        const int i = a->pair[q], sign = a->sign[q];
        const double *frame = a->frames + (size_t)i * d * d, base[3] = {0};
        const double *there = a->other[q] < 0 ? base : a->u + (size_t)a->other[q] * d;
        double w[3], t[3], D[3][3], law[NUMBERS];
        for (int k = 0; k < d; k++) {
            w[k] = a->offsets[(size_t)i * d + k];
            rounding += a->weights[i] * a->laws[(size_t)i * NUMBERS + K_N] * (fabs(w[k]) + fabs(x[k]));
            for (int l = 0; l < d; l++) w[k] += frame[k * d + l] * sign * (x[l] - there[l]);
        }
        for (int k = 0; k < NUMBERS; k++) law[k] = a->laws[(size_t)i * NUMBERS + k];
        law[SHARE] = fmax(law[SHARE], a->eased);
        traction(d, law, w, t, D);
        for (int k = 0; k < d; k++) {
            double force = 0;
            for (int l = 0; l < d; l++) force += frame[l * d + k] * t[l];
            F[k] += sign * a->weights[i] * force, terms += a->weights[i] * fabs(force);
            for (int l = 0; l < d; l++)
                for (int e = 0; e < d; e++)
                    for (int f = 0; f < d; f++) T[k][l] += a->weights[i] * frame[e * d + k] * D[e][f] * frame[f * d + l];
        }
    }
    for (int k = 0; k < d; k++) {
        if (!a->free[k]) {
            for (int l = 0; l < d; l++) T[k][l] = T[l][k] = 0;
            F[k] = 0, T[k][k] = 1;
        }
        norm += F[k] * F[k];
    }
    *zero = SMALL * terms + ROUNDING * rounding;
    return sqrt(norm);
}

/* Work of the forces at x - length step along the step, less that which balances. */
static double work(const node *a, const double *x, const double *step, double length)
{
    double at[3] = {0}, F[3], T[3][3], zero, sum = 0;
    for (int k = 0; k < a->d; k++) at[k] = x[k] - length * step[k];
    residual(a, at, F, T, &zero);
    for (int k = 0; k < a->d; k++) sum -= step[k] * F[k];
    return sum;
}

/* Newton's method for the displacement x of a node; returns whether it is solved.
 *
 * The length of a step is at most 1, and such that the forces do no more work along it; it is found by regula falsi. */
static int newton(const node *a, double *x)
{
    double F[3], T[3][3], zero;
    for (int step = 0; step < STEPS; step++) {
        double length = 1, low = 0, high = 1;
        if (residual(a, x, F, T, &zero) <= zero) return 1;
        if (!solve(a->d, T, F)) return 0;
        double first = work(a, x, F, 0), below = first, above = work(a, x, F, 1);
        for (int trial = 0; trial < TRIALS && first < 0 && above > FLAT * -first; trial++) {
            length = trial % 3 == 2 ? (low + high) / 2 : low - below * (high - low) / (above - below);
            const double now = work(a, x, F, length);
            if (fabs(now) <= FLAT * -first) break;
            if (now < 0)
                low = length, below = now;
            else
                high = length, above = now;
        }
        for (int k = 0; k < a->d; k++) x[k] -= length * F[k];
    }
    return 0;
}

/* Finds the displacement x of a node from x or, if this fails, from springs that neither open nor slide, which are made
 * less and less. Returns whether it is found; otherwise x stays. */
static int solve_node(node *a, double *x)
{
    double at[3];
    for (int way = 0; way < 2; way++) {
        for (int k = 0; k < a->d; k++) at[k] = x[k];
        for (a->eased = way; a->eased > LEAST; a->eased *= LESS) newton(a, at);
        a->eased = 0;
        if (!newton(a, at)) continue;
        for (int k = 0; k < a->d; k++) x[k] = at[k];
        return 1;
    }
    return 0;
}

/* Sweeps over n nodes, in place: each finds its balance while the others rest. Returns how often one was not solved.
 *
 * The matrix has blocks of d x d, row by row (indptr, indices, blocks). g, u: (n, d) forces and displacements. Node i is in
 * the pairs begins[i] to begins[i + 1] of pair, other and sign. frames: (pairs, d, d) axes as rows; weights: (pairs,) areas;
 * laws: (pairs, NUMBERS); offsets: (pairs, d). free: (n, d) components that move. */
int sweep_pairs(int n, int d, const int32_t *indptr, const int32_t *indices, const double *blocks, const double *g,
                double *u, const int32_t *begins, const int32_t *pair, const int32_t *other, const int32_t *sign,
                const double *frames, const double *weights, const double *laws, const double *offsets,
                const uint8_t *free, int sweeps)
{
    int failed = 0;
    for (int sweep = 0; sweep < sweeps; sweep++)
        for (int i = 0; i < n; i++) {
            const int first = begins[i];
            node a = {.d = d, .count = begins[i + 1] - first, .pair = pair + first, .other = other + first,
                      .sign = sign + first, .u = u, .frames = frames, .weights = weights, .laws = laws, .offsets = offsets,
                      .free = free + (size_t)i * d};
            double r[3] = {0}, x[3];
            for (int k = 0; k < d; k++) x[k] = u[(size_t)i * d + k];
            for (int p = indptr[i]; p < indptr[i + 1]; p++) {
                const double *block = blocks + (size_t)p * d * d, *uj = u + (size_t)indices[p] * d;
                if (indices[p] == i) {
                    for (int k = 0; k < d; k++)
                        for (int l = 0; l < d; l++) a.A[k][l] = block[k * d + l];
                    continue;
                }
                for (int k = 0; k < d; k++)
                    for (int l = 0; l < d; l++) r[k] += block[k * d + l] * uj[l];
            }
            for (int k = 0; k < d; k++) a.r[k] = g[(size_t)i * d + k] - r[k];
            failed += !solve_node(&a, x);
            for (int k = 0; k < d; k++) u[(size_t)i * d + k] = x[k];
        }
    return failed;
}

/* Returns b_i - sum a_ij u_j over all j other than i, and puts a_ii in `own`. */
static double remainder_of_row(int i, const int32_t *indptr, const int32_t *indices, const double *data, const double *b,
                               const double *u, double *own)
{
    double r = b[i], a = 0;
    for (int p = indptr[i]; p < indptr[i + 1]; p++) {
        if (indices[p] == i)
            a += data[p];
        else
            r -= data[p] * u[indices[p]];
    }
    *own = a;
    return r;
}

static void move(double *u, double target, double omega, double *squares)
{
    const double step = omega * (target - *u);
    *u += step, *squares += step * step;
}

/* Relaxation over all degrees of freedom, one after the other, in place. Ends when the Euclidean norm of the change of u in
 * a sweep is at most `tolerance` times that of u, or is not finite. Returns the number of sweeps; `changes` and `norms` have
 * the norms of the change and of u after each of them.
 *
 * steps: the order within a sweep. An entry >= 0 is a degree of freedom; -1 - 2 i is the normal component of contact node
 * i, and -2 - 2 i are its tangential components, which are solved together. contact: (n, d) degrees of freedom of the
 * nodes, the normal one last; slip: (n, d - 1); omega: relaxation factors of degrees of freedom off S, and of those of
 * contact nodes. */
int relax_sweeps(int count, const int32_t *steps, int dofs, const int32_t *indptr, const int32_t *indices,
                 const double *data, const double *b, double *u, int d, const int32_t *contact, const double *weights,
                 const double *law, const double *slip, const double *omega, int sweeps, double tolerance, double *changes,
                 double *norms)
{
    const int m = d - 1;
    const int32_t first = 0, none = -1, upper = 1;
    const uint8_t free[3] = {1, m == 2, 0};
    double own;
    int sweep = 0;
    while (sweep < sweeps) {
        double squares = 0, norm = 0;
        for (int step = 0; step < count; step++) {
            if (steps[step] >= 0) {
                const int j = steps[step];
                const double r = remainder_of_row(j, indptr, indices, data, b, u, &own);
                move(u + j, r / own, omega[0], &squares);
                continue;
            }
            const int i = (-1 - steps[step]) / 2;
            const int32_t *here = contact + (size_t)i * d, normal = here[m];
            if (steps[step] % 2) {
                const double r = remainder_of_row(normal, indptr, indices, data, b, u, &own);
                move(u + normal, r / (r < 0 ? own + weights[i] * law[K_N] : own), omega[1], &squares);
                continue;
            }
            /* the tangential components under the pressure of now, as a node whose normal component rests */
            const double of_now[NUMBERS] = {0, law[K_T], 0, threshold(law, u[normal]), 0};
            double frame[9] = {0}, offset[3] = {0}, x[3] = {0};
            node a = {.d = d, .count = 1, .pair = &first, .other = &none, .sign = &upper, .u = u, .frames = frame,
                      .weights = weights + i, .laws = of_now, .offsets = offset, .free = free};
            for (int k = 0; k < d; k++) frame[k * d + k] = 1;
            for (int k = 0; k < m; k++) {
                a.r[k] = remainder_of_row(here[k], indptr, indices, data, b, u, &a.A[k][k]);
                for (int p = indptr[here[k]]; m == 2 && p < indptr[here[k] + 1]; p++)
                    if (indices[p] == here[1 - k]) a.A[k][1 - k] += data[p], a.r[k] += data[p] * u[here[1 - k]];
                x[k] = u[here[k]], offset[k] = -slip[(size_t)i * m + k];
            }
            const int solved = solve_node(&a, x);
            for (int k = 0; k < m; k++) move(u + here[k], solved ? x[k] : NAN, omega[1], &squares);
        }
        for (int j = 0; j < dofs; j++) norm += u[j] * u[j];
        changes[sweep] = sqrt(squares), norms[sweep] = sqrt(norm);
        sweep++;
        if (!isfinite(squares) || changes[sweep - 1] <= tolerance * norms[sweep - 1]) break;
    }
    return sweep;
}
