/* Gauss-Seidel sweeps for normal compliance and Coulomb friction at nodes.
 *
 * Jumps w and tractions have d = 2 or 3 components, d - 1 tangential ones and the normal one, positive where S opens. The
 * law is p = K_N max(-w_N, 0), t_N = -p, t_T = K_T (w_T - slip) shortened to the threshold of p. */
#include <float.h>
#include <math.h>
#include <stddef.h>
#include <stdint.h>

typedef struct {
    double K_N, K_T, friction, cohesion;
} law_numbers;

/* The law of a node, with the threshold of the law or with a given one. */
static law_numbers law_of(const double *numbers, const double *threshold, int i)
{
    law_numbers law = {numbers[0], numbers[1], numbers[2], numbers[3]};
    if (threshold) law.friction = 0, law.cohesion = threshold[i];
    return law;
}

static double largest(const law_numbers *law, double p) { return law->cohesion + law->friction * p; }

/* D w + b t(w) = q of one node, in the axes of S; y = w_T - slip. */
typedef struct {
    int m; /* tangential components */
    double T[2][2], TN[2], NT[2], N; /* blocks of D */
    double c[2], c_N; /* q without what D does with the slip */
    double b;
    law_numbers law;
    double y[2], w_N; /* the state that `excess` leaves */
} node;

/* State with the tangential traction b t_T = k y; returns by how much that is above the threshold.
 *
 * For each k >= 0 there is one state: without the tangential unknowns, the normal one is that of a spring that acts in one
 * direction. Where the traction is shortened, k is between 0 and b K_T, and the excess there is zero. */
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

/* Solve a node: leaves y and w_N, returns whether it succeeded (it does when D is positive definite and all is finite).
 *
 * Of several solutions, which strong friction allows, one without tangential traction goes before one that sticks, and
 * that before one that slides. There the excess is zero, between its signs at k = 0 and at k = b K_T. As a function of
 * f = s / (s + k), where s is the tangential stiffness of the node, it is piecewise linear in two dimensions and nearly
 * so in three: regula falsi (Anderson and Bjorck's) takes a few steps; every fourth step is a bisection. */
static int solve_node(node *a)
{
    const double most = a->b * a->law.K_T, normal = a->N + a->b * a->law.K_N;
    double s = 0, below = excess(a, 0);
    if (!(below < 0)) return isfinite(below) && isfinite(a->w_N);
    double above = excess(a, most);
    if (!(above > 0)) return isfinite(above) && isfinite(a->w_N);
    for (int i = 0; i < a->m; i++) s += 1 / (a->T[i][i] - a->TN[i] * a->NT[i] / normal);
    s = a->m / s; /* of the softer component, if one is held by an endless stiffness */
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

/* Sweep over nodes; returns the largest change of a component in the last sweep, NaN when a node could not be solved.
 *
 * The matrix has n x n blocks of d x d: rows of all numbers, or, when indptr is given, rows of blocks. u, base, g: (n, d);
 * frames: (n, d, d); slip: (n, d - 1) or NULL; threshold: (n,) or NULL; moves: (n,). */
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

/* b_i - sum a_ij u_j over all j but i, whose a_ii is put in `own`. */
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

/* Relaxation, unknown by unknown, over all dofs; stops when the change, a Euclidean norm, is at most tolerance times that
 * of u, or when it is not finite. Returns the number of sweeps; their changes and the norms of u are left in two arrays.
 *
 * steps: what a sweep does one after the other: a dof, or, of contact node i, -1 - 2 i for its normal component and
 * -2 - 2 i for its tangential ones, together. contact: (n, d) dofs of the nodes, the normal one last; slip: (n, d - 1) or
 * NULL; threshold: (n,) or NULL. */
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
            node a = {.m = m, .N = 1, .b = weights[i], .law = law}; /* its normal component plays no part */
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
