
/* Prints the nanoseconds of a step of NAME: the least of five times a fifth of a second.
 * Arguments: a file of rows, how many there are, how many numbers each has, the sample time. A row
 * is 1 where a run begins, the time, and the state. */
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

int main(int argc, char **argv) {
    if (argc != 5 || loaded() != 0) return 2;
    const long count = atol(argv[2]), width = atol(argv[3]);
    const double sample_time = atof(argv[4]);
    const long pitch = UPPER_SEEN + 2;
    double *rows = calloc((size_t)(count * pitch), sizeof(double)), least = INFINITY;
    double command[UPPER_INPUTS], actuators[UPPER_ACTUATORS];
    volatile double used = 0.0;
    FILE *file = fopen(argv[1], "rb");
    if (!rows || !file || width > pitch) return 1;
    for (long i = 0; i < count; i++)
        if (fread(rows + i * pitch, sizeof(double), (size_t)width, file) != (size_t)width) return 1;
    for (int repetition = 0; repetition < 5; repetition++) {
        const clock_t begin = clock();
        double calls = 0.0, seconds = 0.0;
        while (seconds < 0.2) {
            NAME_state s;
            NAME_start(&s);
            for (long i = 0; i < count; i++) {
                const double *row = rows + i * pitch;
                if (row[0] != 0.0) NAME_start(&s);
                NAME_step(&s, row[1], sample_time, row + 2, NAME_parameters, command, actuators);
                used += actuators[0];
            }
            calls += (double)count;
            seconds = (double)(clock() - begin) / CLOCKS_PER_SEC;
        }
        if (1e9 * seconds / calls < least) least = 1e9 * seconds / calls;
    }
    printf("%.17g\n", least);
    return 0;
}
