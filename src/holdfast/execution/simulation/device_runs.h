/* Runs of a closed loop, one for each thread.
 *
 * What belongs to one loop follows: its leaves, its functions, and then `device_simulate.h`.
 */

/* What a run has: its numbers, its whole numbers, and its columns of arrays of all runs. */
struct hf_run {
    double *w;
    hf_int *s;
    double *log, *rings;
    hf_int pitch;
};

HF_FUNCTION void hf_copy(const double *source, double *target, int rows)
{
    for (int i = 0; i < rows; i++) target[i] = source[i];
}

HF_FUNCTION void hf_append(hf_run r, hf_int *at, const double *source, int rows)
{
    for (int i = 0; i < rows; i++) r.log[(*at + i) * r.pitch] = source[i];
    *at += rows;
}

/* Store rows in a ring; the oldest rows of it to `target`. entry: the next slot, the number of
 * slots, the place of the first. */
HF_FUNCTION void hf_late(hf_run r, hf_int *entry, const double *source, double *target, int rows)
{
    const hf_int now = entry[0], oldest = now + 1 == entry[1] ? 0 : now + 1;
    double *ring = r.rings + entry[2] * r.pitch;
    for (int i = 0; i < rows; i++) ring[(now * rows + i) * r.pitch] = source[i];
    entry[0] = oldest;
    for (int i = 0; i < rows; i++) target[i] = ring[(oldest * rows + i) * r.pitch];
}
