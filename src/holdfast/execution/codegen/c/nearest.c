/* The admissible input nearest to a wanted one, exactly (as nearest.py of holdfast has it):
 *
 *     minimise  sum_i ((u_i - wanted_i) / scale_i)^2   subject to   normals u <= offsets
 *
 * Constraints are met one after the other (R. Seidel, Discrete Comput. Geom. 6, 1991); where the
 * best point so far violates one, the best point lies on its plane: a problem of one dimension
 * less, solved one storey below. HF_M inputs, at most HF_ROWS constraints; all arrays are on the
 * stack.
 */
#define HF_CLOSE 1e-10    /* what counts as on a plane, relative to its distance */
#define HF_PARALLEL 1e-9  /* the sine of the angle below which two planes are parallel */
#define HF_APART 1e-8     /* the gap above which two such planes exclude each other */
#define HF_PULL (-1e6)    /* where the slack is wanted, in its own unit: as small as it can be */
#define HF_FAINT 1e-6     /* the size of a normal below which it does not set that unit */
#define HF_WIDE (HF_M + 2) /* the entries of a row: a normal of HF_M + 1 entries, and its offset */

/* The lowest and the highest s with rows[j] . (base + s along) <= offset of j, in m dimensions. */
static void hf_interval(double rows[][HF_WIDE], int count, int m, const double *base,
                        const double *along, double *lowest, double *highest) {
    double low = -INFINITY, high = INFINITY;
    for (int j = 0; j < count; j++) {
        double slope = 0.0, offset = rows[j][m];
        for (int i = 0; i < m; i++) {
            slope += rows[j][i] * along[i];
            offset -= rows[j][i] * base[i];
        }
        if (fabs(slope) <= HF_PARALLEL) {
            if (offset < -HF_APART * (1.0 + fabs(rows[j][m]))) {
                *lowest = INFINITY;
                *highest = -INFINITY;
                return;
            }
        } else if (slope > 0.0) {
            if (offset / slope < high) high = offset / slope;
        } else if (offset / slope > low) {
            low = offset / slope;
        }
    }
    if (high < low && low <= high + HF_CLOSE * (1.0 + fabs(low))) low = high;
    *lowest = low;
    *highest = high;
}

static double hf_between(double x, double low, double high) {
    double y = x < low ? low : x;
    return y > high ? high : y;
}

static int hf_nearest_in_plane(double rows[][HF_WIDE], int count, int m, double *x) {
    const double origin[2] = {0.0, 0.0}, axis[2] = {1.0, 0.0};
    double low, high;
    if (m == 1) {
        hf_interval(rows, count, 1, origin, axis, &low, &high);
        x[0] = hf_between(x[0], low, high);
        return low <= high;
    }
    const double given[2] = {x[0], x[1]};
    for (int j = 0; j < count; j++) {
        const double n0 = rows[j][0], n1 = rows[j][1], offset = rows[j][2];
        if (n0 * x[0] + n1 * x[1] - offset <= HF_CLOSE * (1.0 + fabs(offset))) continue;
        const double base[2] = {offset * n0, offset * n1}, along[2] = {-n1, n0};
        hf_interval(rows, j, 2, base, along, &low, &high);
        if (low > high) return 0;
        const double s = hf_between(n0 * given[1] - n1 * given[0], low, high);
        x[0] = base[0] - s * n1;
        x[1] = base[1] + s * n0;
    }
    return 1;
}

#if HF_M > 1
static double hf_dot(const double *a, const double *b, int m) {
    double total = 0.0;
    for (int i = 0; i < m; i++) total += a[i] * b[i];
    return total;
}

/* The rows of `plane` become an orthonormal basis of the plane normal to a unit vector. */
static void hf_span(const double *normal, double plane[][HF_M + 1], int m) {
    int pivot = 0;
    for (int i = 0; i < m; i++)
        if (fabs(normal[i]) > fabs(normal[pivot])) pivot = i;
    const double side = normal[pivot] >= 0.0 ? 1.0 : -1.0;
    const double size = 2.0 * (1.0 + fabs(normal[pivot]));
    for (int c = 0; c < m - 1; c++) {
        const int k = c < pivot ? c : c + 1;
        for (int i = 0; i < m; i++) {
            const double w = normal[i] + (i == pivot ? side : 0.0);
            plane[c][i] = (i == k ? 1.0 : 0.0) - 2.0 * normal[k] * w / size;
        }
    }
}

/* The constraints on the plane of `normal`, in its own coordinates; -1 where one excludes it. */
static int hf_restrict(double rows[][HF_WIDE], int count, int m, const double *normal,
                       double offset, double *base, double plane[][HF_M + 1],
                       double inner[][HF_WIDE]) {
    int kept = 0;
    for (int i = 0; i < m; i++) base[i] = offset * normal[i];
    hf_span(normal, plane, m);
    for (int j = 0; j < count; j++) {
        double size = 0.0;
        for (int c = 0; c < m - 1; c++) {
            inner[kept][c] = hf_dot(rows[j], plane[c], m);
            size += inner[kept][c] * inner[kept][c];
        }
        size = sqrt(size);
        const double rest = rows[j][m] - hf_dot(rows[j], base, m);
        if (size <= HF_PARALLEL) {
            if (rest < -HF_APART * (1.0 + fabs(rows[j][m]))) return -1;
            continue;
        }
        for (int c = 0; c < m - 1; c++) inner[kept][c] /= size;
        inner[kept][m - 1] = rest / size;
        kept++;
    }
    return kept;
}
#endif

/* Moves x in R^m to the nearest point within the rows, of unit normals; 0 where there is none. */
static int hf_nearest(double rows[][HF_WIDE], int count, int m, double *x) {
    if (m <= 2) return hf_nearest_in_plane(rows, count, m, x);
#if HF_M > 1
    double tables[HF_M + 2][HF_ROWS + 1][HF_WIDE]; /* the constraints of each storey */
    double points[HF_M + 2][HF_M + 1], given[HF_M + 2][HF_M + 1], bases[HF_M + 2][HF_M + 1];
    double planes[HF_M + 2][HF_M + 1][HF_M + 1];
    int counts[HF_M + 2] = {0}, met[HF_M + 2] = {0};
    for (int j = 0; j < count; j++)
        for (int i = 0; i <= m; i++) tables[m][j][i] = rows[j][i];
    for (int i = 0; i < m; i++) points[m][i] = given[m][i] = x[i];
    counts[m] = count;
    int storey = m;
    for (;;) {
        double *point = points[storey];
        if (storey == 2) {
            if (!hf_nearest_in_plane(tables[2], counts[2], 2, point)) return 0;
        } else {
            int j = met[storey];
            while (j < counts[storey]) {
                const double offset = tables[storey][j][storey];
                if (hf_dot(tables[storey][j], point, storey) - offset >
                    HF_CLOSE * (1.0 + fabs(offset)))
                    break;
                j++;
            }
            met[storey] = j + 1;
            if (j < counts[storey]) {
                const int below = storey - 1;
                const double *normal = tables[storey][j];
                const int kept = hf_restrict(tables[storey], j, storey, normal, normal[storey],
                                             bases[storey], planes[storey], tables[below]);
                if (kept < 0) return 0;
                for (int i = 0; i < below; i++)
                    given[below][i] = points[below][i] =
                        hf_dot(given[storey], planes[storey][i], storey);
                counts[below] = kept;
                met[below] = 0;
                storey = below;
                continue;
            }
        }
        if (storey == m) {
            for (int i = 0; i < m; i++) x[i] = point[i];
            return 1;
        }
        storey++;
        for (int i = 0; i < storey; i++) {
            double total = 0.0;
            for (int c = 0; c < storey - 1; c++) total += planes[storey][c][i] * point[c];
            points[storey][i] = bases[storey][i] + total;
        }
    }
#else
    return 0;
#endif
}

/* Constraints in units of the scales, with unit normals; how many, or -1 where one without
 * inputs cannot be met. With `relaxed` the slack is one more coordinate. */
static int hf_fill(double rows[][HF_WIDE], const double *constraints, const double *scales,
                   int most, int hard, int relaxed) {
    double unit = 0.0;
    int count = 0;
    if (relaxed) {
        double least = INFINITY, largest = 0.0;
        for (int j = hard; j < most; j++) {
            double size = 0.0;
            for (int i = 0; i < HF_M; i++) {
                const double entry = constraints[j * (HF_M + 1) + i] * scales[i];
                size += entry * entry;
            }
            if (size > 0.0) {
                if (size < least) least = size;
                if (size > largest) largest = size;
            }
        }
        unit = 1.0;
        if (largest > 0.0) {
            unit = sqrt(least);
            if (HF_FAINT * sqrt(largest) > unit) unit = HF_FAINT * sqrt(largest);
        }
        for (int i = 0; i < HF_WIDE; i++) rows[0][i] = i == HF_M ? -1.0 : 0.0;
        count = 1; /* the slack is 0 or more */
    }
    for (int j = 0; j < most; j++) {
        const double *constraint = constraints + j * (HF_M + 1), offset = constraint[HF_M];
        double size = 0.0;
        int last = HF_M;
        for (int i = 0; i < HF_M; i++) {
            rows[count][i] = constraint[i] * scales[i];
            size += rows[count][i] * rows[count][i];
        }
        if (relaxed) {
            rows[count][HF_M] = j < hard ? 0.0 : -unit;
            size += rows[count][HF_M] * rows[count][HF_M];
            last = HF_M + 1;
        }
        size = sqrt(size);
        if (!(size > 1e-300)) {
            if (offset < 0.0) return -1;
            continue;
        }
        for (int i = 0; i < last; i++) rows[count][i] /= size;
        rows[count][last] = offset / size;
        count++;
    }
    return count;
}

/* The input where the wanted one violates a constraint; returns the slack. */
static double hf_solve(const double *wanted, const double *scales, const double *constraints,
                       int most, int hard, double *result) {
    double rows[HF_ROWS + 1][HF_WIDE], y[HF_M + 1], reach = 1.0, slack = 0.0;
    for (int i = 0; i < HF_M; i++) {
        y[i] = wanted[i] / scales[i];
        result[i] = wanted[i];
    }
    int count = hf_fill(rows, constraints, scales, most, hard, 0);
    if (count >= 0 && hf_nearest(rows, count, HF_M, y)) {
        for (int i = 0; i < HF_M; i++) result[i] = y[i] * scales[i];
        return 0.0;
    }
    count = hf_fill(rows, constraints, scales, most, hard, 1);
    for (int i = 0; i < HF_M; i++) {
        y[i] = wanted[i] / scales[i];
        if (fabs(y[i]) > reach) reach = fabs(y[i]);
    }
    y[HF_M] = HF_PULL * reach;
    if (count < 0 || !hf_nearest(rows, count, HF_M + 1, y)) return INFINITY;
    for (int i = 0; i < HF_M; i++) result[i] = y[i] * scales[i];
    for (int j = hard; j < most; j++) {
        const double *constraint = constraints + j * (HF_M + 1), offset = constraint[HF_M];
        double level = -offset, size = 0.0;
        for (int i = 0; i < HF_M; i++) {
            const double entry = constraint[i] * scales[i];
            level += constraint[i] * result[i];
            size += entry * entry;
        }
        if (level > HF_CLOSE * (sqrt(size) + fabs(offset)) && level > slack) slack = level;
    }
    return slack;
}

/* Fills `result` and returns the slack: 0 where all constraints are met. Where they exclude each
 * other, those after the first `hard` are relaxed by the same least slack; it is infinite where
 * the hard ones exclude each other. What is not a number gives what is not a number. */
static double hf_keep_within(const double *wanted, const double *scales,
                             const double *constraints, int most, int hard, double *result) {
    int good = 1, number = 1;
    for (int j = 0; j < most; j++) {
        double level = -constraints[j * (HF_M + 1) + HF_M];
        for (int i = 0; i < HF_M; i++) level += constraints[j * (HF_M + 1) + i] * wanted[i];
        good = good && level <= 0.0;
        number = number && level < INFINITY;
    }
    if (number && !good) return hf_solve(wanted, scales, constraints, most, hard, result);
    for (int i = 0; i < HF_M; i++) result[i] = number ? wanted[i] : NAN;
    return number ? 0.0 : NAN;
}
