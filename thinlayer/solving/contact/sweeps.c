/* Gauss-Seidel sweeps over the nodes of S, for normal compliance and Coulomb friction.
 *
 * Jumps w and tractions t have d = 2 or 3 components: d - 1 tangential ones, then the normal one, which is positive where S
 * opens. The law is p = K_N max(-w_N, 0), t_N = -p, t_T = K_T (w_T - slip). If t_T is longer than the threshold, cohesion +
 * friction p, it is shortened to it. */
#include <float.h>
#include <math.h>
#include <stddef.h>
#include <stdint.h>

typedef struct {
    double K_N, K_T, friction, cohesion;
} law_numbers;

/* The law of node i. A given threshold replaces that of the law. */
static law_numbers law_of(const double *numbers, const double *threshold, int i)
{
    law_numbers law = {numbers[0], numbers[1], numbers[2], numbers[3]};
    if (threshold) law.friction = 0, law.cohesion = threshold[i];
    return law;
}

/* The threshold: the largest tangential traction at a pressure p. */
static double largest(const law_numbers *law, double p) { return law->cohesion + law->friction * p; }

/* The equation D w + b t(w) = q of one node, in the axes of S, where b is the node's area. The unknowns are y = w_T - slip
 * and w_N. */
typedef struct {
    int m; /* number of tangential components, d - 1 */
    double T[2][2], TN[2], NT[2], N; /* tangential, mixed and normal blocks of D */
    double c[2], c_N; /* q less the forces of D on the slip */
    double b;
    law_numbers law;
    double y[2], w_N; /* the unknowns that `excess` was called for last */
} node;

/* Solves the node for a tangential force b t_T = k y; returns by how much this force exceeds the threshold times b.
 *
 * For each k >= 0 there is one solution: with y eliminated, w_N is that of a spring that resists closing alone. If the
 * traction is shortened, the solution of the node has a k between 0 and b K_T, at which the excess is zero. */
static double excess(node *a, double k)
{
    double z[2], x[2]; /* (T + k)^-1 applied to c and to TN */
    if (a->m == 1) {
        z[0] = a->c[0] / (a->T[0][0] + k);
        x[0] = a->TN[0] / (a->T[0][0] + k);
    } else {
        const double A = a->T[0][0] + k, B = a->T[0][1], C = a->T[1][0], D = a->T[1][1] + k, det = A * D - B * C;
        z[0] = (D * a->c[0] - B * a->c[1]) / det, z[1] = (A * a->c[1] - C * a->c[0]) / det;
        x[0] = (D * a->TN[0] - B * a->TN[1]) / det, x[1] = (A * a->TN[1] - C * a->TN[0]) / det;
    }
    double pull = a->c_N, stiffness = a->N, size = 0;
    for (int i = 0; i < a->m; i++) pull -= a->NT[i] * z[i], stiffness -= a->NT[i] * x[i];
    a->w_N = pull / (pull < 0 ? stiffness + a->b * a->law.K_N : stiffness);
    for (int i = 0; i < a->m; i++) a->y[i] = z[i] - x[i] * a->w_N, size += a->y[i] * a->y[i];
    return k * sqrt(size) - a->b * largest(&a->law, a->law.K_N * fmax(-a->w_N, 0));
}

/* Solves a node: leaves y and w_N in it, and returns whether this succeeded. It does if D is positive definite and all
 * numbers are finite.
 *
 * Strong friction allows several solutions. One without tangential traction is preferred to one that sticks, and that to
 * one that slides. For a node that slides the excess is negative at k = 0, positive at k = b K_T, and its zero between them
 * is found. As a function of f = s / (s + k), where s is the tangential stiffness of the node, it is piecewise linear in
 * two dimensions and nearly so in three. So regula falsi (in Anderson and Bjorck's form) takes a few steps; every fourth
 * step is a bisection, which bounds their number. */
static int solve_node(node *a)
{
    const double most = a->b * a->law.K_T, normal = a->N + a->b * a->law.K_N;
    double s = 0, below = excess(a, 0);
    if (!(below < 0)) return isfinite(below) && isfinite(a->w_N);
    double above = excess(a, most);
    if (!(above > 0)) return isfinite(above) && isfinite(a->w_N);
    for (int i = 0; i < a->m; i++) s += 1 / (a->T[i][i] - a->TN[i] * a->NT[i] / normal);
    s = a->m / s; /* harmonic mean: that of the other component, if the stiffness of one is infinite */
    double old = s / (s + most), old_excess = above, last = 1, last_excess = below;
    for (int step = 1; step < 300; step++) {
        double f = last - last_excess * (last - old) / (last_excess - old_excess);
        if (step % 4 == 0 || !((f - old) * (last - f) > 0)) f = (old + last) / 2;
        const double now = excess(a, s * (1 - f) / f), pressing = a->b * a->law.K_N * fmax(-a->w_N, 0);
        const double pulling = now + a->b * largest(&a->law, pressing / a->b);
        if (!isfinite(now)) return 0;
        if (fabs(now) <= 2 * DBL_EPSILON * (pressing + pulling) || fabs(f - last) <= DBL_EPSILON * f) break;
        if ((now > 0) != (last_excess > 0)) {
            old = last, old_excess = last_excess;
        } else {
            const double less = 1 - now / last_excess;
            old_excess *= less > 0 ? less : 0.5;
        }
        last = f, last_excess = now;
    }
    return 1;
}

static double dot(const double *a, const double *x, int n)
{
    double s0 = 0, s1 = 0, s2 = 0, s3 = 0; /* independent sums, added in parallel */
    int j = 0;
    for (; j + 3 < n; j += 4)
        s0 += a[j] * x[j], s1 += a[j + 1] * x[j + 1], s2 += a[j + 2] * x[j + 2], s3 += a[j + 3] * x[j + 3];
    for (; j < n; j++) s0 += a[j] * x[j];
    return (s0 + s1) + (s2 + s3);
}

/* Sweeps over the nodes; returns the largest change of a component of u in the last sweep, NaN if a node was not solved.
 *
 * The matrix has n x n blocks of d x d. It is dense, row by row, or, if indptr is given, sparse in blocks.
 * g: (n, d) forces; u: (n, d) displacements; base: (n, d) displacements of the other side, so that u - base is the jump;
 * frames: (n, d, d) axes of S as rows; weights: (n,) areas; numbers: K_N, K_T, friction, cohesion; slip: (n, d - 1) or
 * NULL; threshold: (n,) or NULL; moves: (n,) whether a node is solved. */
double sweep_nodes(int n, int d, const double *matrix, const int32_t *indptr, const int32_t *indices, const double *g,
                   double *u, const double *base, const double *frames, const double *weights, const double *numbers,
                   const double *slip, const double *threshold, const uint8_t *moves, int sweeps)
{
    const int m = d - 1;
    double change = 0;
    for (int sweep = 0; sweep < sweeps; sweep++) {
        change = 0;
        for (int i = 0; i < n; i++) {
            if (!moves[i]) continue;
            const double *F = frames + (size_t)i * d * d, *x = base + (size_t)i * d;
            double A[3][3] = {{0}}, r[3], D[3][3], q[3] = {0}, w[3], *ui = u + (size_t)i * d;
            for (int k = 0; k < d; k++) r[k] = g[(size_t)i * d + k];
            if (indptr) {
                for (int p = indptr[i]; p < indptr[i + 1]; p++) {
                    const double *block = matrix + (size_t)p * d * d, *uj = u + (size_t)indices[p] * d;
                    for (int k = 0; k < d; k++)
                        for (int l = 0; l < d; l++) {
                            if (indices[p] == i)
                                A[k][l] += block[k * d + l];
                            else
                                r[k] -= block[k * d + l] * uj[l];
                        }
                }
            } else {
                for (int k = 0; k < d; k++) {
                    const double *row = matrix + ((size_t)i * d + k) * n * d, *after = row + (size_t)(i + 1) * d;
                    r[k] -= dot(row, u, i * d) + dot(after, u + (size_t)(i + 1) * d, (n - 1 - i) * d);
                    for (int l = 0; l < d; l++) A[k][l] = row[(size_t)i * d + l];
                }
            }
            for (int k = 0; k < d; k++)
                for (int l = 0; l < d; l++) r[k] -= A[k][l] * x[l];
            for (int k = 0; k < d; k++)
                for (int l = 0; l < d; l++) {
                    q[k] += F[k * d + l] * r[l];
                    D[k][l] = 0;
                    for (int e = 0; e < d; e++)
                        for (int f = 0; f < d; f++) D[k][l] += F[k * d + e] * A[e][f] * F[l * d + f];
                }
            node a = {.m = m, .N = D[m][m], .c_N = q[m], .b = weights[i], .law = law_of(numbers, threshold, i)};
            for (int k = 0; k < m; k++) {
                a.c[k] = q[k], a.TN[k] = D[k][m], a.NT[k] = D[m][k];
                for (int l = 0; l < m; l++) a.T[k][l] = D[k][l];
            }
            for (int l = 0; slip && l < m; l++) {
                const double s = slip[(size_t)i * m + l];
                for (int k = 0; k < m; k++) a.c[k] -= D[k][l] * s;
                a.c_N -= D[m][l] * s;
            }
            if (!solve_node(&a)) {
                change = NAN;
                continue;
            }
            for (int k = 0; k < m; k++) w[k] = a.y[k] + (slip ? slip[(size_t)i * m + k] : 0);
            w[m] = a.w_N;
            for (int k = 0; k < d; k++) {
                double now = x[k];
                for (int l = 0; l < d; l++) now += F[l * d + k] * w[l];
                if (fabs(now - ui[k]) > change) change = fabs(now - ui[k]);
                ui[k] = now;
            }
        }
    }
    return change;
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

/* Relaxation over all degrees of freedom, one after the other. Ends when the Euclidean norm of the change of u in a sweep
 * is at most `tolerance` times that of u, or is not finite. Returns the number of sweeps; `changes` and `norms` have the
 * norms of the change and of u after each of them.
 *
 * steps: the order within a sweep. An entry >= 0 is a degree of freedom; -1 - 2 i is the normal component of contact node
 * i, and -2 - 2 i are its tangential components, which are solved together. contact: (n, d) degrees of freedom of the
 * nodes, the normal one last; slip: (n, d - 1) or NULL; threshold: (n,) or NULL; omega: relaxation factor of degrees of
 * freedom off S, omega_contact: of those of contact nodes. */
int relax_sweeps(int count, const int32_t *steps, int dofs, const int32_t *indptr, const int32_t *indices,
                 const double *data, const double *b, double *u, int d, const int32_t *contact, const double *weights,
                 const double *numbers, const double *slip, const double *threshold, double omega, double omega_contact,
                 int sweeps, double tolerance, double *changes, double *norms)
{
    const int m = d - 1;
    double own;
    int sweep = 0;
    while (sweep < sweeps) {
        double squares = 0, norm = 0;
        for (int step = 0; step < count; step++) {
            if (steps[step] >= 0) {
                const int j = steps[step];
                const double r = remainder_of_row(j, indptr, indices, data, b, u, &own);
                move(u + j, r / own, omega, &squares);
                continue;
            }
            const int i = (-1 - steps[step]) / 2;
            const int32_t *here = contact + (size_t)i * d, normal = here[m];
            law_numbers law = law_of(numbers, threshold, i);
            if (steps[step] % 2) {
                const double r = remainder_of_row(normal, indptr, indices, data, b, u, &own);
                move(u + normal, r / (r < 0 ? own + weights[i] * law.K_N : own), omega_contact, &squares);
                continue;
            }
            law.cohesion = largest(&law, law.K_N * fmax(-u[normal], 0)), law.friction = 0;
            node a = {.m = m, .N = 1, .b = weights[i], .law = law}; /* the normal block has no effect */
            for (int k = 0; k < m; k++) {
                a.c[k] = remainder_of_row(here[k], indptr, indices, data, b, u, &a.T[k][k]);
                for (int p = indptr[here[k]]; m == 2 && p < indptr[here[k] + 1]; p++)
                    if (indices[p] == here[1 - k]) a.T[k][1 - k] += data[p], a.c[k] += data[p] * u[here[1 - k]];
                for (int l = 0; slip && l < m; l++) a.c[k] -= a.T[k][l] * slip[(size_t)i * m + l];
            }
            const int solved = solve_node(&a);
            for (int k = 0; k < m; k++) {
                const double target = a.y[k] + (slip ? slip[(size_t)i * m + k] : 0);
                move(u + here[k], solved ? target : NAN, omega_contact, &squares);
            }
        }
        for (int j = 0; j < dofs; j++) norm += u[j] * u[j];
        changes[sweep] = sqrt(squares), norms[sweep] = sqrt(norm);
        sweep++;
        if (!isfinite(squares) || changes[sweep - 1] <= tolerance * norms[sweep - 1]) break;
    }
    return sweep;
}
