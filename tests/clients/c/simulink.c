/* A stand-in for Simulink: drives the S-function through a run, with blocks of memory of exactly the sizes declared.
 *
 *     sfun HOST PORT CAMERA BODIES CLASS HEIGHT WIDTH EXPOSURE SEED SAMPLE_TIME TIMEOUT DEADLINE N_STEPS OUT < numbers
 *
 * The numbers are the inputs' bytes (double), the same at each step; OUT receives each image with its facts behind it. */
static void put_text(SimStruct *S, int k, const char *text) {
    S->parameters[k].text = text;
    S->parameters[k].count = strlen(text);
}

static void put_number(SimStruct *S, int k, const char *text) {
    S->parameters[k].text = NULL;
    S->parameters[k].numbers[0] = atof(text);
    S->parameters[k].count = 1;
}

static int stop(SimStruct *S, const char *where) {
    fprintf(stdout, "%s: %s\n", where, S->error);
    return 3;
}

int main(int argc, char **argv) {
    static SimStruct S[1];
    int result = 0, step, k, bytes;
    size_t n_pixels;
    FILE *out;
    assert(argc == 15);
    put_text(S, 0, argv[1]);
    put_number(S, 1, argv[2]);
    put_text(S, 2, argv[3]);
    put_text(S, 3, argv[4]);
    put_text(S, 4, argv[5]);
    put_number(S, 5, argv[6]);
    S->parameters[5].numbers[1] = atof(argv[7]);
    S->parameters[5].count = 2;
    for (k = 6; k < 11; k++)
        put_number(S, k, argv[k + 2]);
    S->n_given = 11;
    mdlInitializeSizes(S);
    if (S->error)
        return stop(S, "mdlInitializeSizes");
    assert(S->n_expected == S->n_given && S->n_inputs == 3 && S->n_outputs == 2);
    mdlInitializeSampleTimes(S);
    assert(S->sample_time == atof(argv[10]));
    for (k = 0; k < S->n_inputs; k++) {
        size_t n = (size_t)S->inputs[k].width;
        assert(S->inputs[k].type == SS_DOUBLE);
        S->inputs[k].signal = malloc(n * sizeof(double));
        assert(fread(S->inputs[k].signal, sizeof(double), n, stdin) == n);
    }
    bytes = S->outputs[0].type == SS_UINT8 ? 1 : S->outputs[0].type == SS_UINT16 ? 2 : 4;
    n_pixels = (size_t)(S->outputs[0].height * S->outputs[0].width);
    assert(S->outputs[1].type == SS_DOUBLE && S->outputs[1].width == 1);
    S->outputs[0].signal = malloc(n_pixels * (size_t)bytes);
    S->outputs[1].signal = malloc((size_t)S->outputs[1].height * sizeof(double));
    out = fopen(argv[14], "wb");
    assert(out);
    mdlStart(S);
    for (step = 0; step < atoi(argv[13]) && !S->error; step++) {
        S->t = step * S->sample_time;
        mdlOutputs(S, 0);
        if (!S->error) {
            fwrite(S->outputs[0].signal, (size_t)bytes, n_pixels, out);
            fwrite(S->outputs[1].signal, sizeof(double), (size_t)S->outputs[1].height, out);
        }
    }
    if (S->error)
        result = stop(S, "mdlOutputs");
    mdlTerminate(S);
    mdlTerminate(S);
    fclose(out);
    for (k = 0; k < S->n_inputs; k++)
        free(S->inputs[k].signal);
    free(S->outputs[0].signal);
    free(S->outputs[1].signal);
    return result;
}
