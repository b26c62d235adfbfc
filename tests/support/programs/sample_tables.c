/*
 * Samples each table of a file, which holds its length and its numbers, from a heap block of the
 * exact size.
 */
#include "@_inversion.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static double *block(size_t numbers)
{
    double *x = malloc(numbers * sizeof *x + (numbers == 0));
    if (x == NULL) {
        abort();
    }
    return x;
}

int main(int count, char **words)
{
    static const double at[] = {-1.0, 0.0, 0.1, 0.35, 0.8, 1.7, 3.3, 1e9};
    FILE *file = count == 2 ? fopen(words[1], "rb") : NULL;
    double length;
    long tables = 0;
    if (file == NULL) {
        return 9;
    }
    while (fread(&length, sizeof length, 1, file) == 1) {
        const size_t size = (size_t)length;
        double *table = block(size), *work = block((size_t)@_path_work());
        double *y = block(@_NT), *dy = block(@_NY), *ddy = block(@_NY), *q_start = block(@_NA),
               *duration = block(1);
        if (fread(table, sizeof *table, size, file) != size) {
            return 9;
        }
        (void)@_path_start(table, (int64_t)size, duration, q_start);
        for (size_t k = 0; k < sizeof at / sizeof *at; ++k) {
            (void)@_path_sample(table, (int64_t)size, at[k], y, dy, ddy, work, @_path_work());
        }
        free(table);
        free(work);
        free(y);
        free(dy);
        free(ddy);
        free(q_start);
        free(duration);
        ++tables;
    }
    fclose(file);
    printf("%ld tables\n", tables);
    return 0;
}
