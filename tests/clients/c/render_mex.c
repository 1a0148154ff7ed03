/* The MEX function without MATLAB: render_mex HOST PORT TIMEOUT COUNT; a line for each of COUNT calls. */
#include "glrender_mex.c"

static void put(mxArray *a, const char *name, mxArray *value) { mxSetFieldByNumber(a, 0, mxAddField(a, name), value); }

static mxArray *vector(size_t count, double first, double last) {
    mxArray *a = mex_array(mxDOUBLE_CLASS, count);
    mxGetPr(a)[0] = first;
    mxGetPr(a)[count - 1] = last;
    return a;
}

static mxArray *new_struct(void) { return mxCreateStructMatrix(1, 1, 0, NULL); }

static mxArray *pose(double z) {
    mxArray *a = new_struct();
    put(a, "r_inertial_m", vector(3, 0.0, z));
    put(a, "q_from_inertial", vector(4, 1.0, 0.0));
    return a;
}

static void say(const mxArray *a, const char *name) {
    const uint8_t *at = a->data;
    unsigned long long sum = 0;
    size_t k;
    for (k = 0; k < a->count * mxGetElementSize(a); k++)
        sum += at[k];
    printf(" | %s %u %llu", name, (unsigned)a->count, sum);
}

static void call(int n, const mxArray *given[]) {
    mxArray *result[1] = {NULL}, *state, *bodies, *options[2], *frames;
    int k, field;
    mexFunction(1, result, n, given);
    if (!result[0])
        return;
    state = new_struct(), bodies = new_struct(), frames = mxCreateCellMatrix(1, 2);
    put(bodies, "body", pose(0.0));
    put(state, "r_sun_inertial_m", vector(3, 1.5e11, -1e11));
    put(state, "spacecraft", pose(-2000.0));
    put(state, "bodies", bodies);
    for (k = 0; k < 2; k++) {
        options[k] = new_struct();
        put(options[k], "camera", mxCreateString("navcam"));
        put(options[k], "products", mxCreateString("range"));
        mxSetCell(frames, (size_t)k, options[k]);
    }
    given[0] = mxCreateString("render");
    given[1] = result[0];
    given[2] = state;
    given[3] = frames;
    mexFunction(1, result, 4, given);
    printf("frames");
    for (k = 0; k < 2; k++)
        for (field = 0; field < mxGetNumberOfFields(mxGetCell(result[0], (size_t)k)); field++)
            say(mxGetFieldByNumber(mxGetCell(result[0], (size_t)k), 0, field),
                mxGetFieldNameByNumber(mxGetCell(result[0], (size_t)k), field));
    printf("\n");
}

int main(int argc, char **argv) {
    const mxArray *given[4];
    volatile int k;
    assert(argc == 5);
    for (k = 0; k < atoi(argv[4]); k++) {
        if (setjmp(mex_failed) == 0) {
            given[0] = mxCreateString("open");
            given[1] = mxCreateString(argv[1]);
            given[2] = mxCreateDoubleScalar(atof(argv[2]));
            given[3] = mxCreateDoubleScalar(atof(argv[3]));
            call(4, given);
        } else {
            printf("error %s\n", mex_error);
        }
        close_all();
        mex_free_all();
    }
    return 0;
}
