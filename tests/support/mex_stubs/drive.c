/*
 * A gateway, called as the class of streams calls it.
 *
 * Compiled with -DGATEWAY="..." to include. Reads the 6 options of a stream, the number of
 * updates, the output and the coordinates at the start, then the sample of each update; writes the
 * motor torques. With an argument it reads all limits before the samples: rows, columns and
 * numbers of each. Exit status 3: an error.
 */
#include GATEWAY

static mxArray *read_column(size_t n)
{
    mxArray *const made = mxCreateDoubleMatrix(n, 1, mxREAL);
    if (fread(made->numbers, sizeof(double), n, stdin) != n) {
        exit(2);
    }
    return made;
}

static mxArray *read_matrix(void)
{
    const mxArray *const size = read_column(2);
    mxArray *const made = read_column((size_t)(size->numbers[0] * size->numbers[1]));
    made->rows = (size_t)size->numbers[0];
    made->columns = (size_t)size->numbers[1];
    return made;
}

int main(int argc, char **argv)
{
    (void)argv;
    const mxArray *const options = read_column(6), *const updates = read_column(1);
    mxArray *memory[1];
    const mxArray *const y_start = read_column(MODEL_NT), *const q_start = read_column(MODEL_NA);
    mexFunction(1, memory, 4,
        (const mxArray *[]){mxCreateString("stream_start"), options, y_start, q_start});
    if (argc > 1) {
        const mxArray *given[14] = {mxCreateString("stream_all_limits"), options, memory[0]};
        for (int k = 3; k < 14; ++k) {
            given[k] = read_matrix();
        }
        mexFunction(1, memory, 14, given);
    }
    for (int k = 0; k < (int)updates->numbers[0]; ++k) {
        const mxArray *const y = read_column(MODEL_NT), *const dy = read_column(MODEL_NY);
        const mxArray *const ddy = read_column(MODEL_NY);
        mxArray *found[9];
        mexFunction(9, found, 6,
            (const mxArray *[]){mxCreateString("stream_update"), options, memory[0], y, dy, ddy});
        memory[0] = found[0];
        fwrite(found[7]->numbers, sizeof(double), mxGetNumberOfElements(found[7]), stdout);
    }
    return 0;
}
