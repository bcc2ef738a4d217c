/* Mohr-Coulomb at one point, in three dimensions: return to faces, edges and apex of the yield surface.
 *
 * Tensors are in Mandel's order 11, 22, 33, sqrt2 12, sqrt2 13, sqrt2 23. Principal stresses descend, s_1 >= s_2 >= s_3. The
 * planes (i, j) of the yield surface are n.s <= 2 c cos(Omega) with n_i = 1 + sin(Omega), n_j = -(1 - sin(Omega)); flow along
 * them is m, the same with psi. In principal stresses every return is linear in its flow, along a plane or along both planes of
 * an edge together. The cohesion is c = C + H p + Q p/(p_0 + p), where the strain p grows by 2 cos(Omega) times this flow. */
#include <math.h>
#include <string.h>

static const double root2 = 1.4142135623730951, degree = 0.017453292519943295;

typedef struct {
    double lmbda, mu;
    double cohesion, linear, saturation, strain; /* C, H, Q, p_0 */
    double friction, dilatancy;                  /* sines */
    double shear, cotangent;                     /* 2 cos(Omega), cot(Omega) */
    double old;                                  /* p at the beginning of the step */
} material;

static double cohesion(const material *k, double p)
{
    return k->cohesion + k->linear * p + (k->saturation > 0 ? k->saturation * p / (k->strain + p) : 0);
}

static double cohesion_slope(const material *k, double p)
{
    const double d = k->strain + p;
    return k->linear + (k->saturation > 0 ? k->saturation * k->strain / (d * d) : 0);
}

/* The flow x > 0 with excess = a x + w (c(p + 2 cos(Omega) x) - c(p)), a quadratic equation, and its slope by the excess. */
static double flow_of(const material *k, double excess, double a, double w, double *slope)
{
    const int saturates = k->saturation > 0;
    const double d = saturates ? k->strain + k->old : 1, c = k->shear, A = a + w * c * k->linear;
    const double B = saturates ? w * c * k->saturation * k->strain / d : 0, b = A * d + B - c * excess;
    const double root = sqrt(b * b + 4 * A * c * excess * d), x = b > 0 ? 2 * excess * d / (b + root) : (root - b) / (2 * A * c);
    *slope = 1 / (A + B * d / ((d + c * x) * (d + c * x)));
    return x;
}

static void elastic(const material *k, const double *e, double *s)
{
    const double volume = k->lmbda * (e[0] + e[1] + e[2]);
    for (int i = 0; i < 6; i++) s[i] = 2 * k->mu * e[i] + (i < 3 ? volume : 0);
}

static double dot(const double *a, const double *b)
{
    double sum = 0;
    for (int i = 0; i < 6; i++) sum += a[i] * b[i];
    return sum;
}

static double energy(const material *k, const double *e)
{
    double s[6];
    elastic(k, e, s);
    return dot(s, e) / 2;
}

/* Eigenvalues of A (destroyed) and, in the columns of V, eigenvectors: Jacobi's rotations, descending order. */
static void principal(double A[3][3], double *value, double V[3][3])
{
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) V[i][j] = i == j;
    for (int sweep = 0; sweep < 50; sweep++) {
        const double off = fabs(A[0][1]) + fabs(A[0][2]) + fabs(A[1][2]);
        const double size = fabs(A[0][0]) + fabs(A[1][1]) + fabs(A[2][2]) + off;
        if (!(off > 1e-18 * size)) break;
        for (int p = 0; p < 2; p++)
            for (int q = p + 1; q < 3; q++) {
                if (A[p][q] == 0) continue;
                const double ratio = (A[q][q] - A[p][p]) / (2 * A[p][q]);
                const double t = (ratio < 0 ? -1 : 1) / (fabs(ratio) + sqrt(ratio * ratio + 1));
                const double c = 1 / sqrt(t * t + 1), s = t * c, change = t * A[p][q];
                const int r = 3 - p - q;
                const double rp = A[r][p], rq = A[r][q];
                A[p][p] -= change, A[q][q] += change, A[p][q] = A[q][p] = 0;
                A[r][p] = A[p][r] = c * rp - s * rq;
                A[r][q] = A[q][r] = s * rp + c * rq;
                for (int i = 0; i < 3; i++) {
                    const double vp = V[i][p], vq = V[i][q];
                    V[i][p] = c * vp - s * vq, V[i][q] = s * vp + c * vq;
                }
            }
    }
    int order[3] = {0, 1, 2};
    for (int i = 0; i < 2; i++)
        for (int j = 0; j < 2 - i; j++)
            if (A[order[j]][order[j]] < A[order[j + 1]][order[j + 1]]) {
                const int swapped = order[j];
                order[j] = order[j + 1], order[j + 1] = swapped;
            }
    double sorted[3][3];
    for (int a = 0; a < 3; a++) {
        value[a] = A[order[a]][order[a]];
        for (int i = 0; i < 3; i++) sorted[i][a] = V[i][order[a]];
    }
    memcpy(V, sorted, sizeof sorted);
}

/* A plane of the yield surface: its normal and the fall of stress along its flow. */
static void plane(const material *k, int i, int j, double *n, double *d)
{
    for (int a = 0; a < 3; a++) n[a] = 0, d[a] = 2 * k->lmbda * k->dilatancy;
    n[i] = 1 + k->friction, n[j] = -(1 - k->friction);
    d[i] += 2 * k->mu * (1 + k->dilatancy), d[j] -= 2 * k->mu * (1 - k->dilatancy);
}

static double dot3(const double *a, const double *b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

static int ordered(const double *s, double tolerance) { return s[0] >= s[1] - tolerance && s[1] >= s[2] - tolerance; }

/* The apex, mean stress c cot(Omega): without dilatancy no flow changes the mean stress, and what is beyond is cut off; the
 * flow is that which takes away the deviator. */
static int to_apex(const material *k, double *s, double T[3][3], double *flow)
{
    const double mean = (s[0] + s[1] + s[2]) / 3, bulk = k->lmbda + 2 * k->mu / 3;
    double apex, slopes[3];
    if (k->dilatancy > 0) {
        double slope;
        const double fall = 2 * bulk * k->dilatancy;
        *flow = flow_of(k, mean - k->cotangent * cohesion(k, k->old), fall, k->cotangent, &slope);
        apex = mean - fall * *flow;
        for (int b = 0; b < 3; b++) slopes[b] = (1 - fall * slope) / 3;
    } else {
        const int upper = s[0] - mean > mean - s[2];
        *flow = (upper ? s[0] - mean : mean - s[2]) / (2 * k->mu);
        const double p = k->old + k->shear * *flow;
        apex = k->cotangent * cohesion(k, p);
        const double by_flow = k->cotangent * cohesion_slope(k, p) * k->shear / (2 * k->mu);
        for (int b = 0; b < 3; b++) slopes[b] = by_flow * (upper ? (b == 0) - 1.0 / 3 : 1.0 / 3 - (b == 2));
    }
    for (int a = 0; a < 3; a++) {
        s[a] = apex;
        for (int b = 0; b < 3; b++) T[a][b] = slopes[b];
    }
    return 1;
}

/* Whether, without dilatancy, the mean stress is beyond that of the apex. */
static int is_torn(const material *k, const double *s)
{
    const double mean = (s[0] + s[1] + s[2]) / 3, flow = fmax(s[0] - mean, mean - s[2]) / (2 * k->mu);
    return k->dilatancy == 0 && k->friction > 0 && mean >= k->cotangent * cohesion(k, k->old + k->shear * flow);
}

/* The edge where the two lower stresses are equal (minor), or the two higher ones: their mean x and the other stress y flow
 * along the sum of two planes. Planes that are next to parallel, as near 90 degrees, do not matter so. */
static int to_edge(const material *k, double *s, double T[3][3], int minor, double tolerance, double *flow)
{
    const int a = minor ? 1 : 0, b = a + 1, c = minor ? 0 : 2;
    const double n_x = minor ? -(1 - k->friction) : 1 + k->friction, n_y = minor ? 1 + k->friction : -(1 - k->friction);
    const double m_x = minor ? -(1 - k->dilatancy) : 1 + k->dilatancy, m_y = minor ? 1 + k->dilatancy : -(1 - k->dilatancy);
    const double volume = 2 * k->lmbda * k->dilatancy;
    const double d_x = k->mu * m_x + volume, d_y = 2 * k->mu * m_y + volume, slope = n_x * d_x + n_y * d_y;
    double by;
    const double x = (s[a] + s[b]) / 2, strength = k->shear * cohesion(k, k->old);
    *flow = flow_of(k, n_x * x + n_y * s[c] - strength, slope, k->shear, &by);
    const double on_x = x - *flow * d_x, on_y = s[c] - *flow * d_y;
    const double apart = s[a] - s[b] - 2 * k->mu * fabs(m_x) * *flow; /* > 0: one of the planes would have to flow back */
    if (!(apart <= tolerance) || !((minor ? on_y - on_x : on_x - on_y) >= -tolerance)) return 0;
    s[a] = s[b] = on_x, s[c] = on_y;
    T[a][a] = T[a][b] = T[b][a] = T[b][b] = (1 - d_x * n_x * by) / 2;
    T[a][c] = T[b][c] = -d_x * n_y * by, T[c][a] = T[c][b] = -d_y * n_x * by / 2;
    T[c][c] = 1 - d_y * n_y * by;
    return 1;
}

/* Return principal stresses s to the yield surface, T their slopes by the trial ones; whether anything flows, and how much. */
static int yield(const material *k, double *s, double T[3][3], double *flow)
{
    double n1[3], d1[3], trial[3], found[3];
    memcpy(trial, s, sizeof trial);
    for (int a = 0; a < 3; a++)
        for (int b = 0; b < 3; b++) T[a][b] = a == b;
    plane(k, 0, 2, n1, d1);
    const double strength = k->shear * cohesion(k, k->old), f1 = dot3(n1, s) - strength;
    if (f1 <= 1e-14 * (fabs(s[0]) + fabs(s[2]) + strength)) return 0;
    if (is_torn(k, s)) return to_apex(k, s, T, flow);

    double by;
    const double tolerance = 1e-11 * (s[0] - s[2] + fabs(s[0]) + fabs(s[2]));
    *flow = flow_of(k, f1, dot3(n1, d1), k->shear, &by);
    for (int a = 0; a < 3; a++) found[a] = trial[a] - *flow * d1[a];
    if (ordered(found, tolerance)) {
        for (int a = 0; a < 3; a++) {
            s[a] = found[a];
            for (int b = 0; b < 3; b++) T[a][b] -= d1[a] * n1[b] * by;
        }
        return 1;
    }
    const int minor = found[1] < found[2]; /* the middle stress meets the lowest one, or the highest */
    return to_edge(k, s, T, minor, tolerance, flow) || to_edge(k, s, T, !minor, tolerance, flow) || to_apex(k, s, T, flow);
}

/* Tangent of a stress that is coaxial with the trial strain, from its slopes T in principal stresses. */
static void consistent(const material *k, const double *trial, const double *s, double T[3][3], double V[3][3], double *D)
{
    double N[3][6], slopes[3][3];
    for (int a = 0; a < 3; a++) {
        const double *v[3] = {&V[0][a], &V[1][a], &V[2][a]};
        N[a][0] = *v[0] * *v[0], N[a][1] = *v[1] * *v[1], N[a][2] = *v[2] * *v[2];
        N[a][3] = root2 * *v[0] * *v[1], N[a][4] = root2 * *v[0] * *v[2], N[a][5] = root2 * *v[1] * *v[2];
        for (int b = 0; b < 3; b++) slopes[a][b] = 2 * k->mu * T[a][b] + k->lmbda * (T[a][0] + T[a][1] + T[a][2]);
    }
    for (int a = 0; a < 3; a++) {
        double row[6] = {0};
        for (int b = 0; b < 3; b++)
            for (int j = 0; j < 6; j++) row[j] += slopes[a][b] * N[b][j];
        for (int i = 0; i < 6; i++)
            for (int j = 0; j < 6; j++) D[6 * i + j] += N[a][i] * row[j];
    }
    const double size = fabs(trial[0]) + fabs(trial[2]);
    for (int a = 0; a < 2; a++)
        for (int b = a + 1; b < 3; b++) { /* turning the principal axes */
            const double apart = trial[a] - trial[b];
            const double G = apart > 1e-8 * size ? 2 * k->mu * (s[a] - s[b]) / apart : slopes[a][a] - slopes[a][b];
            const double u[3] = {V[0][a], V[1][a], V[2][a]}, v[3] = {V[0][b], V[1][b], V[2][b]};
            const double M[6] = {root2 * u[0] * v[0],       root2 * u[1] * v[1],       root2 * u[2] * v[2],
                                 u[0] * v[1] + u[1] * v[0], u[0] * v[2] + u[2] * v[0], u[1] * v[2] + u[2] * v[1]};
            for (int i = 0; i < 6; i++)
                for (int j = 0; j < 6; j++) D[6 * i + j] += G * M[i] * M[j];
        }
}

static void add_elastic(const material *k, double share, double *D)
{
    for (int i = 0; i < 6; i++) {
        D[7 * i] += 2 * k->mu * share;
        for (int j = 0; i < 3 && j < 3; j++) D[6 * i + j] += k->lmbda * share;
    }
}

int kernel(double *out, const void *unused, const double *in)
{
    const double *e = in, *e_old = in + 6, *q = in + 12, theta = in[23], *parameters = in + 24;
    double *stress = out, *q_new = out + 6, *D = out + 13, *energies = out + 49, size = 0;
    const double h = parameters[4], angle = parameters[3] * degree;
    material k = {parameters[0], parameters[1], parameters[2], parameters[5], parameters[6], parameters[7],
                  sin(angle),    sin(parameters[8] * degree), 2 * cos(angle), 0, q[6]};
    if (k.friction > 0) k.cotangent = cos(angle) / k.friction;

    double mid[6], strain[6], s[6], beside[6], value[3], V[3][3], T[3][3];
    for (int i = 0; i < 6; i++) mid[i] = theta * e[i] + (1 - theta) * e_old[i], strain[i] = mid[i] - q[i];
    elastic(&k, mid, beside);
    elastic(&k, strain, s);
    double A[3][3] = {{s[0], s[3] / root2, s[4] / root2}, {s[3] / root2, s[1], s[5] / root2}, {s[4] / root2, s[5] / root2, s[2]}};
    principal(A, value, V);
    double trial[3] = {value[0], value[1], value[2]}, flow[6] = {0};
    if (yield(&k, value, T, &size)) {
        double fall[6];
        for (int i = 0; i < 6; i++) {
            static const int row[6] = {0, 1, 2, 0, 0, 1}, column[6] = {0, 1, 2, 1, 2, 2};
            double returned = 0;
            for (int a = 0; a < 3; a++) returned += value[a] * V[row[i]][a] * V[column[i]][a] * (i < 3 ? 1 : root2);
            fall[i] = s[i] - returned, s[i] = returned;
        }
        const double volume = k.lmbda / (3 * k.lmbda + 2 * k.mu) * (fall[0] + fall[1] + fall[2]);
        for (int i = 0; i < 6; i++) flow[i] = (fall[i] - (i < 3 ? volume : 0)) / (2 * k.mu);
        consistent(&k, trial, value, T, V, D);
        for (int i = 0; i < 36; i++) D[i] *= (1 - h) * theta;
        add_elastic(&k, h * theta, D);
    } else {
        add_elastic(&k, theta, D);
    }
    double change[6], elastic_change[6], end[6];
    for (int i = 0; i < 6; i++) {
        stress[i] = (1 - h) * s[i] + h * beside[i];
        q_new[i] = q[i] + flow[i] / theta;
        change[i] = e[i] - e_old[i];
        elastic_change[i] = change[i] - flow[i] / theta;
        end[i] = e[i] - q_new[i];
    }
    q_new[6] = q[6] + k.shear * size / theta;
    energies[0] = (1 - h) * energy(&k, end) + h * energy(&k, e);
    energies[1] = (1 - h) * dot(s, flow) / theta;
    energies[2] = (2 * theta - 1) * ((1 - h) * energy(&k, elastic_change) + h * energy(&k, change));
    return 0;
}
