
/* Simulate the runs. HF_SIZE and HF_ENTRIES: how many numbers and whole numbers a run has. first, entries: their numbers before the first sample, but for what differs
 * between them (given, in columns). records: how many each has. noted: what is known at the end. */
HF_KERNEL hf_simulate(hf_int runs, hf_int pitch, const double *first, const hf_int *entries,
                      const double *given, hf_int records, hf_int in_rings, double *log, double *rings,
                      double *noted)
{
    HF_EACH(t)
        for (hf_int run = HF_BLOCK * HF_THREADS + t; run < runs; run += HF_BLOCKS * HF_THREADS) {
            double w[HF_SIZE];
            hf_int s[HF_ENTRIES];
            for (int i = 0; i < HF_SIZE; i++) w[i] = first[i];
            for (int i = 0; i < HF_ENTRIES; i++) s[i] = entries[i];
            const hf_run r = {w, s, log + run, rings + run, pitch};
            hf_given(w, given + run, pitch);
            for (hf_int k = 0; k < in_rings; k++) r.rings[k * pitch] = 0.0;
            for (hf_int k = 0; k < s[HF_LATE + 1] * HF_STATES; k++)
                r.rings[(s[HF_LATE + 2] + k) * pitch] = w[HF_Q + k % HF_STATES];
            holdfast_begin(r);
            for (int j = 0; j < HF_WATCHED; j++) w[HF_WORST + j] = w[HF_C0 + j];
            for (int j = HF_WATCHED - 1; j >= 0; j--)
                if (w[HF_C0 + j] > w[HF_TOLERANCE]) {
                    w[HF_OUTCOME] = HF_LEFT;
                    w[HF_EXIT_TIME] = 0.0;
                    w[HF_EXIT_CONSTRAINT] = (double)j;
                }
            if (records > 1) {
                s[HF_RECORDS] = records - 1;
                holdfast_advance(r);
            }
            holdfast_finish(r);
            hf_noted(w, noted + run, pitch);
        }
}
