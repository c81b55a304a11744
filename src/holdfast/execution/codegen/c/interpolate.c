/* Values between the nodes of a grid, linear along each of HF_AXES axes (as interpolate.py of
 * holdfast has it); hf_values, hf_low, hf_steps, hf_shape and hf_periodic are the grid. */
static double hf_interpolate(const double *q) {
    double fractions[HF_AXES], total = 0.0;
    long lower[HF_AXES], upper[HF_AXES];
    for (int i = 0; i < HF_AXES; i++) {
        double x = (q[i] - hf_low[i]) / hf_steps[i];
        if (hf_periodic[i])
            x -= hf_shape[i] * floor(x / hf_shape[i]);
        else if (!(-1e-9 <= x && x <= hf_shape[i] - 1 + 1e-9))
            return NAN;
        if (!(x >= -1.0 && x <= hf_shape[i])) return NAN;
        const long last = hf_periodic[i] ? hf_shape[i] - 1 : hf_shape[i] - 2;
        long k = (long)floor(x);
        k = k < 0 ? 0 : k;
        k = k > last ? last : k;
        lower[i] = k;
        upper[i] = (k + 1) % hf_shape[i];
        fractions[i] = x - k;
    }
    for (int corner = 0; corner < 1 << HF_AXES; corner++) {
        long at = 0;
        double weight = 1.0;
        for (int i = 0; i < HF_AXES; i++) {
            const int above = corner >> i & 1;
            at = at * hf_shape[i] + (above ? upper[i] : lower[i]);
            weight *= above ? fractions[i] : 1.0 - fractions[i];
        }
        if (weight != 0.0) total += weight * hf_values[at];
    }
    return total;
}

/* 1 for a place that is not on the grid, or not a number. */
static int hf_off_grid(const double *place) {
    for (int i = 0; i < HF_AXES; i++) {
        const double x = (place[i] - hf_low[i]) / hf_steps[i];
        if (!isfinite(x)) return 1;
        if (!hf_periodic[i] && !(-1e-9 <= x && x <= hf_shape[i] - 1 + 1e-9)) return 1;
    }
    return 0;
}

/* out[0]: the value at a place, or at the nearest place of the grid; then its slopes: central
 * differences, one-sided at the ends of the grid. */
static void hf_look_up(const double *place, double *out) {
    double at[HF_AXES], beside[HF_AXES];
    for (int i = 0; i < HF_AXES; i++) {
        const double top = hf_low[i] + hf_steps[i] * (hf_shape[i] - 1);
        at[i] = place[i];
        if (!hf_periodic[i]) {
            at[i] = at[i] < hf_low[i] ? hf_low[i] : at[i];
            at[i] = at[i] > top ? top : at[i];
        }
        beside[i] = at[i];
    }
    out[0] = hf_interpolate(at);
    for (int i = 0; i < HF_AXES; i++) {
        const double top = hf_low[i] + hf_steps[i] * (hf_shape[i] - 1);
        double above = at[i] + hf_steps[i], below = at[i] - hf_steps[i];
        if (!hf_periodic[i]) {
            above = above > top ? top : above;
            below = below < hf_low[i] ? hf_low[i] : below;
        }
        beside[i] = above;
        const double upper = hf_interpolate(beside);
        beside[i] = below;
        out[i + 1] = (upper - hf_interpolate(beside)) / (above - below);
        beside[i] = at[i];
    }
}
