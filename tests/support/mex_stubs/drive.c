/*
 * A gateway, called as the class of streams calls it.
 *
 * Compiled with -DGATEWAY="..." to include. Reads the 6 options of a stream, the number of updates, the output and the
 * coordinates at the start, then the sample of each update; writes the motor torques. Exit status 3: an error.
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

int main(void)
{
    const mxArray *const options = read_column(6), *const updates = read_column(1);
    mxArray *memory[1];
    const mxArray *const y_start = read_column(MODEL_NT), *const q_start = read_column(MODEL_NA);
    mexFunction(1, memory, 4, (const mxArray *[]){mxCreateString("stream_start"), options, y_start, q_start});
    for (int k = 0; k < (int)updates->numbers[0]; ++k) {
        const mxArray *const y = read_column(MODEL_NT), *const dy = read_column(MODEL_NY);
        const mxArray *const ddy = read_column(MODEL_NY);
        mxArray *found[9];
        mexFunction(9, found, 6, (const mxArray *[]){mxCreateString("stream_update"), options, memory[0], y, dy, ddy});
        memory[0] = found[0];
        fwrite(found[7]->numbers, sizeof(double), mxGetNumberOfElements(found[7]), stdout);
    }
    return 0;
}
