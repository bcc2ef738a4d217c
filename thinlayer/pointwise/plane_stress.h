/* Plane stress at a point: the strains out of the plane, 33, 13 and 23, at which the stresses there are zero. */

enum { OUT = 3, IN = 3, MOST_TRIALS = 200 };
static const int out_of_plane[OUT] = {2, 4, 5}, in_plane[IN] = {0, 1, 3};
static const double LOOSE = 1e-9; /* stresses out of the plane, over the largest one, that are left where no step helps */

/* Solve K x = b for `columns` right-hand sides, K the rows and columns of the tangent out of the plane; b and x: (3, columns).
 * Shears that are apart from the strain 33 may have no stiffness. Returns whether there is a solution. */
static int solve_out_of_plane(const double *C, double size, int columns, double *b)
{
    double A[OUT * (OUT + IN)];
    const int stride = OUT + columns;
    int apart = 1;
    for (int j = 0; j < OUT; j++) {
        for (int k = 0; k < OUT; k++) A[j * stride + k] = C[6 * out_of_plane[j] + out_of_plane[k]] / size;
        for (int k = 0; k < columns; k++) A[j * stride + OUT + k] = b[j * columns + k] / size;
        if (j > 0) {
            apart = apart && A[j * stride] == 0 && A[j] == 0;
            for (int k = 0; k < columns; k++) apart = apart && b[j * columns + k] == 0;
        }
    }
    if (apart) {
        if (!(fabs(A[0]) > 1e-12)) return 0;
        for (int k = 0; k < columns; k++) b[k] = A[OUT + k] / A[0];
        return 1;
    }
    if (!solve(A, OUT, stride, columns)) return 0;
    for (int j = 0; j < OUT; j++)
        for (int k = 0; k < columns; k++) b[j * columns + k] = A[j * stride + OUT + k];
    return 1;
}

/* Replaces stress and tangent by those in the plane. Sublayers in series need a stiffness against shear out of the plane,
 * which vanishes; where the tangent out of the plane is singular, a small share of the largest entry is added to it. */
static int condense(sublayer *a, double size)
{
    double *C = tangent(a), x[OUT * IN], copy[36];
    memcpy(copy, C, sizeof copy);
    for (int trial = 0; trial < 2; trial++) {
        for (int j = 0; j < OUT; j++)
            for (int k = 0; k < IN; k++) x[j * IN + k] = C[6 * out_of_plane[j] + in_plane[k]];
        if (trial == 1)
            for (int j = 0; j < OUT; j++) copy[7 * out_of_plane[j]] += 1e-8 * size;
        if (size == 0 || solve_out_of_plane(copy, size, IN, x)) break;
        if (trial == 1) return 0;
    }
    for (int i = 0; i < IN; i++)
        for (int k = 0; k < IN && size > 0; k++)
            for (int j = 0; j < OUT; j++) C[6 * in_plane[i] + in_plane[k]] -= C[6 * in_plane[i] + out_of_plane[j]] * x[j * IN + k];
    for (int i = 0; i < IN; i++)
        for (int k = 0; k < i; k++) { /* far beyond yield only rounding of the large entries is left of the small ones */
            double *one = &C[6 * in_plane[i] + in_plane[k]], *other = &C[6 * in_plane[k] + in_plane[i]];
            if (fabs(*one - *other) <= 1e-14 * size) *one = *other = (*one + *other) / 2;
        }
    for (int j = 0; j < OUT; j++) {
        a->out[out_of_plane[j]] = 0;
        for (int k = 0; k < 6; k++) C[6 * out_of_plane[j] + k] = C[6 * k + out_of_plane[j]] = 0;
        C[7 * out_of_plane[j]] = size;
    }
    return 1;
}

/* Newton's method from the strains out of the plane found last; leaves a NaN in the stress where there are none. Steps are
 * halved as in `in_series`. Where the tangent is singular the strains go against the stresses, farther each time. */
static void evaluate_in_plane(sublayer *a)
{
    double r[OUT], step[OUT] = {0}, length = 0, slope = 0, farther = 1, stiffest = 0;
    for (int trial = 0; trial < MOST_TRIALS; trial++) {
        for (int j = 0; j < OUT; j++) a->in[out_of_plane[j]] = a->out_strains[j];
        evaluate_in_space(a);
        const double *C = tangent(a);
        double force = 0, strain = 0, size = 0, left = 0, now = 0, largest = 0;
        int finite = 1;
        for (int k = 0; k < 6; k++) force = fmax(force, fabs(a->out[k])), strain = fmax(strain, fabs(a->in[k]));
        for (int k = 0; k < 6; k++) finite = finite && isfinite(a->out[k]);
        for (int k = 0; k < 36; k++) size = fmax(size, fabs(C[k])), finite = finite && isfinite(C[k]);
        for (int j = 0; j < OUT; j++) r[j] = a->out[out_of_plane[j]], left = fmax(left, fabs(r[j])), now += r[j] * step[j];
        if (finite) stiffest = fmax(stiffest, size);
        if (finite && left <= 1e-14 * force + 4e-16 * size * strain) {
            if (!condense(a, size)) a->out[0] = NAN;
            return;
        }
        const int shortest = length < 1e-9;
        if (length > 0 && !shortest && (!finite || (slope < 0 && now > -0.5 * slope))) { /* half way back */
            length /= 2;
            for (int j = 0; j < OUT; j++) a->out_strains[j] -= length * step[j];
            continue;
        }
        if (!finite) break;
        for (int j = 0; j < OUT; j++) step[j] = -r[j];
        if (size > 0 && solve_out_of_plane(C, size, 1, step)) {
            farther = 1;
        } else {
            const double stiffness = stiffest > 0 ? stiffest : 10 * force / strain;
            for (int j = 0; j < OUT; j++) step[j] = -farther * r[j] / stiffness;
            farther *= 2;
        }
        slope = 0, length = 1;
        for (int j = 0; j < OUT; j++) slope += r[j] * step[j], largest = fmax(largest, fabs(step[j]));
        const int stuck = largest <= 1e-15 * strain || (shortest && trial > 0);
        if (stuck && left <= LOOSE * (force + size * strain)) {
            if (!condense(a, size)) a->out[0] = NAN;
            return;
        }
        if (!(largest > 0) || stuck) break;
        for (int j = 0; j < OUT; j++) a->out_strains[j] += step[j];
    }
    a->out[0] = NAN;
}
