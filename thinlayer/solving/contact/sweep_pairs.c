/* Gauss-Seidel sweeps over nodes in contact with several others, for normal compliance and Coulomb friction.
 *
 * A pair joins an upper node with a lower one; its jump w has d - 1 tangential components, then the normal one, which is
 * positive where it opens, the initial gap included. Its traction on the lower node is (1 - share) t + share K (w - slip): p = K_N max(-w_N, 0),
 * t_N = -p, and t_T = K_T (w_T - slip), shortened to the length cohesion + friction p where it is longer. */
#include <math.h>
#include <stddef.h>
#include <stdint.h>

#define STEPS 16 /* most Newton steps at a node */
#define HALVINGS 8 /* most halvings of a step */
#define SMALL 1e-13 /* residual of a node, relative to its largest force, that counts as zero */

/* Adds traction t and tangent D (d x d) of a pair at the jump w. */
static void law(int d, const double *numbers, const double *slip, const double *w, double *t, double D[3][3])
{
    const int m = d - 1;
    const double K_N = numbers[0], K_T = numbers[1], friction = numbers[2], cohesion = numbers[3], share = numbers[4];
    const double p = K_N * fmax(-w[m], 0), bound = cohesion + friction * p, own = 1 - share;
    double e[2] = {0, 0}, size = 0;
    for (int k = 0; k < m; k++) e[k] = K_T * (w[k] - slip[k]), size += e[k] * e[k];
    size = sqrt(size);
    for (int k = 0; k < d; k++)
        for (int l = 0; l < d; l++) D[k][l] = 0;
    t[m] = -own * p + share * K_N * w[m];
    D[m][m] = own * (p > 0 ? K_N : 0) + share * K_N;
    for (int k = 0; k < m; k++) {
        const double a = size > bound ? e[k] / size : 0;
        t[k] = own * (size > bound ? bound * a : e[k]) + share * e[k];
        D[k][k] = own * (size > bound ? K_T * bound / size : K_T) + share * K_T;
        if (size > bound) {
            for (int l = 0; l < m; l++) D[k][l] -= own * K_T * bound / size * a * e[l] / size;
            if (p > 0) D[k][m] = -own * a * friction * K_N;
        }
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

/* The pairs of one node, and the stiffness A of the node itself. */
typedef struct {
    int d, count;
    double A[3][3], r[3]; /* A x + forces of the pairs = r */
    const int32_t *pair, *other, *sign;
    const double *u, *frames, *weights, *numbers, *slip;
} node;

/* Residual F and tangent T at the displacement x of the node; returns the norm of F, and in `size` that of its terms. */
static double residual(const node *a, const double *x, double *F, double T[3][3], double *size)
{
    const int d = a->d;
    double norm = 0, terms = 0;
    for (int k = 0; k < d; k++) {
        F[k] = -a->r[k], terms += fabs(a->r[k]);
        for (int l = 0; l < d; l++) F[k] += a->A[k][l] * x[l], T[k][l] = a->A[k][l];
    }
    for (int q = 0; q < a->count; q++) {
        const int i = a->pair[q], sign = a->sign[q];
        const double *frame = a->frames + (size_t)i * d * d, zero[3] = {0};
        const double *there = a->other[q] < 0 ? zero : a->u + (size_t)a->other[q] * d;
        double w[3], t[3], D[3][3];
        for (int k = 0; k < d; k++) {
            w[k] = 0;
            for (int l = 0; l < d; l++) w[k] += frame[k * d + l] * sign * (x[l] - there[l]);
        }
        w[d - 1] += a->numbers[(size_t)i * 6 + 5];
        law(d, a->numbers + (size_t)i * 6, a->slip + (size_t)i * (d - 1), w, t, D);
        for (int k = 0; k < d; k++) {
            double force = 0;
            for (int l = 0; l < d; l++) force += frame[l * d + k] * t[l];
            F[k] += sign * a->weights[i] * force, terms += a->weights[i] * fabs(force);
            for (int l = 0; l < d; l++)
                for (int e = 0; e < d; e++)
                    for (int f = 0; f < d; f++)
                        T[k][l] += a->weights[i] * frame[e * d + k] * D[e][f] * frame[f * d + l];
        }
    }
    for (int k = 0; k < d; k++) norm += F[k] * F[k];
    *size = terms;
    return sqrt(norm);
}

/* Newton's method with shortened steps for the displacement x of a node; returns whether it is solved. The best x stays. */
static int solve_node(const node *a, double *x)
{
    double F[3], T[3][3], size;
    double now = residual(a, x, F, T, &size);
    for (int step = 0; step < STEPS && now > SMALL * size; step++) {
        double best = now;
        if (!solve(a->d, T, F)) return 0;
        for (int half = 0; half <= HALVINGS; half++) {
            double trial[3], G[3], share = ldexp(1, -half);
            for (int k = 0; k < a->d; k++) trial[k] = x[k] - share * F[k];
            best = residual(a, trial, G, T, &size);
            if (best < now) {
                for (int k = 0; k < a->d; k++) x[k] = trial[k], F[k] = G[k];
                break;
            }
        }
        if (!(best < now)) return 0;
        now = best;
    }
    return now <= SMALL * size;
}

/* Sweeps over n nodes with blocks of d x d, row by row (indptr, indices, blocks), in place; returns how often a node was
 * solved.
 *
 * g, u: (n, d) forces and displacements. Node i is in the pairs begins[i] to begins[i + 1] of pair, other (node, -1: rigid
 * base) and sign (1: i is the upper node, -1: the lower one). frames: (pairs, d, d); weights: (pairs,); numbers: (pairs, 6)
 * K_N, K_T, friction, cohesion, share, gap; slip: (pairs, d - 1). moves: (n,) whether a node is solved. */
int sweep_pairs(int n, int d, const int32_t *indptr, const int32_t *indices, const double *blocks, const double *g,
                 double *u, const int32_t *begins, const int32_t *pair, const int32_t *other, const int32_t *sign,
                 const double *frames, const double *weights, const double *numbers, const double *slip,
                 const uint8_t *moves, int sweeps)
{
    int solved = 0;
    for (int sweep = 0; sweep < sweeps; sweep++)
        for (int i = 0; i < n; i++) {
            if (!moves[i]) continue;
            const int first = begins[i];
            node a = {.d = d, .count = begins[i + 1] - first, .pair = pair + first, .other = other + first,
                      .sign = sign + first, .u = u, .frames = frames, .weights = weights, .numbers = numbers, .slip = slip};
            for (int k = 0; k < d; k++) a.r[k] = g[(size_t)i * d + k];
            for (int p = indptr[i]; p < indptr[i + 1]; p++) {
                const double *block = blocks + (size_t)p * d * d, *uj = u + (size_t)indices[p] * d;
                for (int k = 0; k < d; k++)
                    for (int l = 0; l < d; l++) {
                        if (indices[p] == i)
                            a.A[k][l] = block[k * d + l];
                        else
                            a.r[k] -= block[k * d + l] * uj[l];
                    }
            }
            double x[3];
            for (int k = 0; k < d; k++) x[k] = u[(size_t)i * d + k];
            solved += solve_node(&a, x);
            for (int k = 0; k < d; k++) u[(size_t)i * d + k] = x[k];
        }
    return solved;
}
