/* A stage of a step over the nodes of a grid, by blocks of threads.
 *
 * The text before this one defines what belongs to one program: hf_real, HF_AXES, HF_GHOSTS,
 * HF_ONE_SLOPE, HF_LOWER and HF_UPPER (whether there are such bounds), HF_ROW (how many numbers depend
 * on a row of the last axis), HF_MOST_ROWS, hf_along, hf_row, hf_upper and hf_lower (slopes of an
 * interval at its ends), hf_node.
 *
 * A unit is some whole rows of the last axis, or a stretch of one. It is computed where something
 * that it depends on has changed, by one block.
 */
enum { HF_EXTRAPOLATED, HF_PERIODIC, HF_LIMITED };

/* The value `distance` nodes beyond an edge, as in `stencils.py`. */
HF_FUNCTION hf_real hf_beyond(hf_real edge, hf_real inner, hf_real distance, hf_real fall,
                              hf_real lowest)
{
    const hf_real slope = fabs(edge - inner);
    hf_real steep = edge - lowest;
    steep = steep > 0 ? steep : 0;
    steep = fall < steep ? fall : steep;
    steep = slope > steep ? slope : steep;
    return fma(distance, edge > (hf_real)1e-6 * slope ? slope : -steep, edge);
}

/* The value at the place `there` along an axis, from the node at `place`, which is at `here`. */
HF_FUNCTION hf_real hf_at(const hf_real *values, hf_int here, hf_int place, hf_int there,
                          hf_int nodes, hf_int stride, hf_int kind, const double *falls)
{
    if (kind == HF_PERIODIC) there = (there + nodes) % nodes;
    if (kind == HF_LIMITED) there = there < 0 ? 0 : there >= nodes ? nodes - 1 : there;
    if (0 <= there && there < nodes) return values[here + (there - place) * stride];
    const hf_int edge = there < 0 ? 0 : nodes - 1, inner = there < 0 ? 1 : nodes - 2;
    return hf_beyond(values[here + (edge - place) * stride], values[here + (inner - place) * stride],
                     (hf_real)(there < edge ? edge - there : there - edge),
                     (hf_real)falls[there < 0 ? 0 : HF_AXES],
                     (hf_real)falls[there < 0 ? 2 * HF_AXES : 3 * HF_AXES]);
}

/* The slopes on both sides of a node along an axis, in cells, and its plain differences for a
   filter. */
HF_FUNCTION void hf_sides(const hf_real *values, hf_int here, hf_int place, hf_int nodes,
                          hf_int stride, hf_int kind, const double *falls, hf_real *below, hf_real *above, hf_real *plain_below,
                          hf_real *plain_above)
{
    hf_real n[2 * HF_GHOSTS + 1];
    if (place >= HF_GHOSTS && place + HF_GHOSTS < nodes) {
        for (int k = 0; k <= 2 * HF_GHOSTS; k++) n[k] = values[here + (k - HF_GHOSTS) * stride];
    } else {
        for (int k = 0; k <= 2 * HF_GHOSTS; k++)
            n[k] = hf_at(values, here, place, place + k - HF_GHOSTS, nodes, stride, kind, falls);
    }
#if HF_ONE_SLOPE
    *below = n[0];
    *above = n[2];
#else
    *below = hf_upper(n);
    *above = hf_lower(n + 1);
#endif
#if HF_FILTERED
    *plain_below = n[HF_GHOSTS] - n[HF_GHOSTS - 1];
    *plain_above = n[HF_GHOSTS + 1] - n[HF_GHOSTS];
#else
    *plain_below = *plain_above = 0;
#endif
}

/* What depends on the last axis alone. */
HF_KERNEL hf_last_axis(const double *axis, hf_int nodes, const double *u, hf_real *table)
{
    HF_EACH(t)
        for (hf_int k = HF_BLOCK * HF_THREADS + t; k < nodes; k += HF_BLOCKS * HF_THREADS)
            hf_along(axis + k, u, table + k, nodes);
}

HF_FUNCTION void hf_mark(uint8_t *marks, hf_int unit, hf_int place, hf_int there, hf_int nodes,
                         hf_int units, hf_int kind)
{
    if (kind == HF_PERIODIC) there = (there + nodes) % nodes;
    if (0 <= there && there < nodes) marks[unit + (there - place) * units] = 1;
}

/* grid: of every axis its nodes, the nodes and the units of a place, its kind of ends; the rows of
 * a unit, the groups of rows, the stretches of a row, the nodes of a stretch. counts: units
 * computed, nodes that are not finite, the largest move as the bits of a double. */
HF_FUNCTION void hf_stage_of(
    bool measures, const hf_int *grid, hf_int units, const double *axes, hf_int pitch,
    const double *u, const double *numbers, const hf_real *along, const hf_real *values,
    const hf_real *base, const hf_real *before, const hf_real *lower, const hf_real *upper,
    hf_real *out, uint8_t *active, uint8_t *marks, uint8_t *own, hf_int own_count,
    hf_bits64 *counts)
{
    HF_SHARED double of_row[HF_MOST_ROWS * (HF_ROW + 1)];
    HF_SHARED int changed;
    const hf_int *shape = grid, *stride = grid + HF_AXES, *within = grid + 2 * HF_AXES;
    const hf_int *kinds = grid + 3 * HF_AXES, *cut = grid + 4 * HF_AXES;
    const hf_int many = cut[0], groups = cut[1], stretches = cut[2], longest = cut[3];
    const hf_int nodes = shape[HF_AXES - 1], rows = HF_AXES > 1 ? shape[HF_AXES - 2 + (HF_AXES == 1)] : 1;
    const hf_int local = groups * stretches;
    for (hf_int unit = HF_BLOCK; unit < units; unit += HF_BLOCKS) {
        if (!active[unit]) continue;
        hf_int index[HF_AXES];
        const hf_int block = unit / local, part = unit % local;
        hf_int left = block;
        for (int i = HF_AXES - 3; i >= 0; i--) {
            index[i] = left % shape[i];
            left /= shape[i];
        }
        const hf_int row = part / stretches * many, begin = part % stretches * longest;
        const hf_int tall = rows - row < many ? rows - row : many;
        const hf_int wide = nodes - begin < longest ? nodes - begin : longest;
        const hf_int first = (block * rows + row) * nodes + begin;
        HF_WAIT;
        HF_EACH(t) {
            if (t == 0) {
                changed = 0;
                active[unit] = 0;
                hf_add(counts, 1);
            }
            for (hf_int r = t; r < tall; r += HF_THREADS) {
                double w[HF_AXES];
                for (int i = 0; i < HF_AXES - 2; i++) w[i] = axes[i * pitch + index[i]];
                if (HF_AXES > 1) w[HF_AXES - 2 + (HF_AXES == 1)] = axes[(HF_AXES - 2) * pitch + row + r];
                hf_row(w, u, of_row + r);
            }
        }
        HF_WAIT;
        HF_EACH(t) {
            for (hf_int j = t; j < tall * wide; j += HF_THREADS) {
                const hf_int r = j / wide, k = begin + j % wide, here = first + j;
                hf_real below[HF_AXES], above[HF_AXES], plain_below[HF_AXES], plain_above[HF_AXES];
                for (int i = 0; i < HF_AXES; i++) {
                    const hf_int place = i < HF_AXES - 2 ? index[i] : i < HF_AXES - 1 ? row + r : k;
                    hf_sides(values, here, place, shape[i], stride[i], kinds[i],
                             numbers + HF_FALLS + i, below + i, above + i, plain_below + i, plain_above + i);
                }
                hf_real new_value, move = 0;
                int differs, odd;
                hf_node(numbers, along + k, nodes, of_row + r, below, above, plain_below, plain_above,
                        values[here], base[here], before[here], HF_LOWER ? lower[here] : (hf_real)0,
                        HF_UPPER ? upper[here] : (hf_real)0, &new_value, &differs, &odd, &move);
                out[here] = new_value;
                if (differs) changed = 1;
                if (odd) hf_add(counts + 1, 1);
                if (measures && move > (hf_real)0) hf_most(counts + 2, hf_bits((double)move));
            }
        }
        HF_WAIT;
        if (!changed) continue;
        HF_EACH(t) {
            for (hf_int s = t; s < own_count; s += HF_THREADS) own[s * units + unit] = 1;
            for (int m = t; m < HF_AXES * (2 * HF_GHOSTS + 1); m += HF_THREADS) {
                const int i = m / (2 * HF_GHOSTS + 1);
                const hf_int k = m % (2 * HF_GHOSTS + 1) - HF_GHOSTS;
                if (i < HF_AXES - 2) {
                    hf_mark(marks, unit, index[i], index[i] + k, shape[i], within[i], kinds[i]);
                } else if (i == HF_AXES - 1) {
                    const hf_int of = part % stretches;
                    hf_mark(marks, unit, of, of + k, stretches, 1, kinds[i]);
                }
            }
            if (HF_AXES > 1)
                for (hf_int k = row - HF_GHOSTS + t; k < row + tall + HF_GHOSTS; k += HF_THREADS) {
                    const hf_int i = HF_AXES - 2;
                    const hf_int there = kinds[i] == HF_PERIODIC ? (k + rows) % rows : k;
                    if (0 <= there && there < rows)
                        marks[unit + (there / many - row / many) * stretches] = 1;
                }
        }
    }
}

#define HF_STAGE(name, measures)                                                                    \
    HF_KERNEL name(const hf_int *grid, hf_int units, const double *axes, hf_int pitch,              \
                   const double *u, const double *numbers, const hf_real *along,                    \
                   const hf_real *values, const hf_real *base, const hf_real *before,               \
                   const hf_real *lower, const hf_real *upper, hf_real *out, uint8_t *active,       \
                   uint8_t *marks, uint8_t *own, hf_int own_count, hf_bits64 *counts)               \
    {                                                                                               \
        hf_stage_of(measures, grid, units, axes, pitch, u, numbers, along, values, base, before,    \
                    lower, upper, out, active, marks, own, own_count, counts);                      \
    }

HF_STAGE(hf_stage, false)
HF_STAGE(hf_measured, true)

/* Values at the chosen places along an axis, from the nodes that they reflect. */
HF_KERNEL hf_mirror(const hf_int *grid, hf_int size, const hf_int *places, hf_int pitch, hf_int axis,
                    const hf_int *chosen, hf_int many, hf_real *values)
{
    const hf_int *shape = grid, *stride = grid + HF_AXES;
    const hf_int inner = stride[axis], count = size / shape[axis] * many;
    HF_EACH(t)
        for (hf_int k = HF_BLOCK * HF_THREADS + t; k < count; k += HF_BLOCKS * HF_THREADS) {
            const hf_int to = (k / inner / many * shape[axis] + chosen[k / inner % many]) * inner + k % inner;
            hf_int from = 0;
            for (int i = 0; i < HF_AXES; i++)
                from += places[i * pitch + to / stride[i] % shape[i]] * stride[i];
            values[to] = values[from];
        }
}
