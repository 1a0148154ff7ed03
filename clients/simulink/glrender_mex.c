/* The C client as a MEX function: plain sockets, no tcpclient, no MATLAB code between. Build: build_glrender_mex.m
 *
 *     handle = glrender_mex('open', host, port, timeout_s)
 *     reply = glrender_mex('render', handle, state, options)      struct: image, each product asked for, header_bytes
 *     replies = glrender_mex('render', handle, state, {options, ...})     cell of such: several frames in one request
 *     glrender_mex('close', handle)
 *
 * state: as for GlRenderClient, `bodies` a struct. options: struct with any of camera, output, exposure_s, seed,
 * max_error, samples, products, roi, deadline_s, backend, scene (docs/protocol.md; the last two of the first struct hold
 * for all). Without a seed, a handle's frames with noise are counted from 0.
 * glr_unpack(reply.header_bytes) has the rest: warnings, plan, seed, is_late, stages; of several frames, of them all.
 * Errors: glrender:CODE, glrender:argument.
 */
#include <ctype.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>

#include "glr_client.h"
#include "mex.h"

#define MAX_CLIENTS 64
#define MAX_BODIES 256
#define ARGUMENT "glrender:argument"

static glr_client *clients[MAX_CLIENTS];
static uint64_t n_noisy[MAX_CLIENTS]; /* frames with noise without a seed: the number of each is its seed */

static void close_all(void) {
    int k;
    for (k = 0; k < MAX_CLIENTS; k++) {
        glr_close(clients[k]);
        clients[k] = NULL;
    }
}

/* Text of a char array; MATLAB frees it when the function returns, also by an error. */
static char *text_of(const mxArray *value, const char *what) {
    if (!value || !mxIsChar(value))
        mexErrMsgIdAndTxt(ARGUMENT, "%s must be text", what);
    return mxArrayToString(value);
}

static void numbers_of(const mxArray *value, const char *what, size_t count, double *numbers) {
    if (!value || !mxIsDouble(value) || mxIsComplex(value) || mxGetNumberOfElements(value) != count)
        mexErrMsgIdAndTxt(ARGUMENT, "%s must be %u real doubles", what, (unsigned)count);
    memcpy(numbers, mxGetPr(value), count * sizeof *numbers);
}

/* An integer of any numeric class; beyond 2^53 only uint64 holds it. */
static uint64_t integer_of(const mxArray *value, const char *what) {
    double number;
    if (mxIsUint64(value) && mxGetNumberOfElements(value) == 1)
        return *(const uint64_t *)mxGetData(value);
    if (!mxIsNumeric(value) || mxIsComplex(value) || mxGetNumberOfElements(value) != 1)
        mexErrMsgIdAndTxt(ARGUMENT, "%s must be an integer", what);
    number = mxGetScalar(value);
    if (!(number >= 0.0 && number <= 9007199254740992.0) || number != (double)(uint64_t)number)
        mexErrMsgIdAndTxt(ARGUMENT, "%s must be an integer between 0 and 2^53 (or a uint64)", what);
    return (uint64_t)number;
}

static void get_pose(const mxArray *value, const char *what, glr_pose *pose) {
    static const double no_turn[4] = {1.0, 0.0, 0.0, 0.0};
    const mxArray *turn;
    char path[256];
    if (!value || !mxIsStruct(value) || mxGetNumberOfElements(value) != 1)
        mexErrMsgIdAndTxt(ARGUMENT, "%s must be a struct", what);
    snprintf(path, sizeof path, "%s.r_inertial_m", what);
    numbers_of(mxGetField(value, 0, "r_inertial_m"), path, 3, pose->r_inertial_m);
    snprintf(path, sizeof path, "%s.q_from_inertial", what);
    turn = mxGetField(value, 0, "q_from_inertial");
    if (turn)
        numbers_of(turn, path, 4, pose->q_from_inertial);
    else
        memcpy(pose->q_from_inertial, no_turn, sizeof no_turn);
}

static void get_state(const mxArray *value, glr_state *state, const char **names, glr_pose *poses) {
    const mxArray *bodies;
    char path[256];
    int k;
    if (!mxIsStruct(value) || mxGetNumberOfElements(value) != 1)
        mexErrMsgIdAndTxt(ARGUMENT, "state must be a struct");
    state->t_s = 0.0;
    if (mxGetField(value, 0, "t_s"))
        numbers_of(mxGetField(value, 0, "t_s"), "state.t_s", 1, &state->t_s);
    numbers_of(mxGetField(value, 0, "r_sun_inertial_m"), "state.r_sun_inertial_m", 3, state->r_sun_inertial_m);
    get_pose(mxGetField(value, 0, "spacecraft"), "state.spacecraft", &state->spacecraft);
    bodies = mxGetField(value, 0, "bodies");
    if (!bodies || !mxIsStruct(bodies) || mxGetNumberOfElements(bodies) != 1
        || mxGetNumberOfFields(bodies) > MAX_BODIES)
        mexErrMsgIdAndTxt(ARGUMENT, "state.bodies must be a struct of at most %d bodies", MAX_BODIES);
    state->n_bodies = (uint32_t)mxGetNumberOfFields(bodies);
    for (k = 0; k < (int)state->n_bodies; k++) {
        names[k] = mxGetFieldNameByNumber(bodies, k);
        snprintf(path, sizeof path, "state.bodies.%s", names[k]);
        get_pose(mxGetFieldByNumber(bodies, 0, k), path, &poses[k]);
    }
    state->body_names = names;
    state->bodies = poses;
}

static void get_products(const mxArray *value, glr_options *options) {
    size_t count = mxIsCell(value) ? mxGetNumberOfElements(value) : 1, k;
    const char **names = mxCalloc(count + 1, sizeof *names);
    for (k = 0; k < count; k++)
        names[k] = text_of(mxIsCell(value) ? mxGetCell(value, k) : value, "products");
    options->products = names;
    options->n_products = (uint32_t)count;
}

/* A number, or a struct with one for each unit that is asked for. */
static void get_tolerance(const mxArray *value, glr_options *options) {
    const char *const units[] = {"rms", "flux", "centroid_px", "limb_px", "range"};
    double *const places[] = {&options->max_error, &options->max_flux, &options->max_centroid_px,
                              &options->max_limb_px, &options->max_range};
    int field, k;
    if (!mxIsStruct(value)) {
        numbers_of(value, "max_error", 1, &options->max_error);
        if (!(options->max_error > 0.0))
            mexErrMsgIdAndTxt(ARGUMENT, "max_error must be > 0");
        return;
    }
    if (mxGetNumberOfElements(value) != 1 || !mxGetNumberOfFields(value))
        mexErrMsgIdAndTxt(ARGUMENT, "max_error must be a number, or a struct of rms, flux, centroid_px, limb_px, range");
    for (field = 0; field < mxGetNumberOfFields(value); field++) {
        const char *name = mxGetFieldNameByNumber(value, field);
        for (k = 0; k < 5 && strcmp(name, units[k]); k++)
            ;
        if (k == 5)
            mexErrMsgIdAndTxt(ARGUMENT, "unknown unit max_error.%s; known are rms, flux, centroid_px, limb_px, range",
                              name);
        numbers_of(mxGetFieldByNumber(value, 0, field), name, 1, places[k]);
        if (!(*places[k] > 0.0))
            mexErrMsgIdAndTxt(ARGUMENT, "max_error.%s must be > 0", name);
    }
}

static void get_options(const mxArray *value, glr_options *options, uint64_t *n_unseeded) {
    double roi[4];
    int field, k;
    if (!value || !mxIsStruct(value) || mxGetNumberOfElements(value) != 1)
        mexErrMsgIdAndTxt(ARGUMENT, "options must be a struct, or a cell of structs");
    options->is_column_major = 1;
    for (field = 0; field < mxGetNumberOfFields(value); field++) {
        const char *name = mxGetFieldNameByNumber(value, field);
        const mxArray *given = mxGetFieldByNumber(value, 0, field);
        if (!strcmp(name, "camera")) {
            options->camera = text_of(given, name);
        } else if (!strcmp(name, "output")) {
            const char *output = text_of(given, name);
            options->is_dn = !strcmp(output, "dn");
            if (!options->is_dn && strcmp(output, "irradiance"))
                mexErrMsgIdAndTxt(ARGUMENT, "output must be 'irradiance' or 'dn'");
        } else if (!strcmp(name, "exposure_s")) {
            if (mxIsChar(given) && !strcmp(text_of(given, name), "auto")) {
                options->exposure_s = -1.0;
            } else {
                numbers_of(given, name, 1, &options->exposure_s);
                if (!(options->exposure_s > 0.0))
                    mexErrMsgIdAndTxt(ARGUMENT, "exposure_s must be > 0, or 'auto'");
            }
        } else if (!strcmp(name, "seed")) {
            options->seed = integer_of(given, name);
        } else if (!strcmp(name, "max_error")) {
            get_tolerance(given, options);
        } else if (!strcmp(name, "samples")) {
            uint64_t samples = integer_of(given, name);
            if (samples < 1 || samples > 16)
                mexErrMsgIdAndTxt(ARGUMENT, "samples must be 1 to 16");
            options->samples = (uint32_t)samples;
        } else if (!strcmp(name, "products")) {
            get_products(given, options);
        } else if (!strcmp(name, "deadline_s")) {
            numbers_of(given, name, 1, &options->deadline_s);
            if (!(options->deadline_s > 0.0))
                mexErrMsgIdAndTxt(ARGUMENT, "deadline_s must be > 0");
        } else if (!strcmp(name, "backend")) {
            options->backend = text_of(given, name);
        } else if (!strcmp(name, "scene")) {
            options->scene = text_of(given, name);
        } else if (!strcmp(name, "roi")) {
            numbers_of(given, name, 4, roi);
            for (k = 0; k < 4; k++) {
                if (!(roi[k] >= 0.0 && roi[k] < 4294967296.0) || roi[k] != (double)(uint32_t)roi[k])
                    mexErrMsgIdAndTxt(ARGUMENT, "roi must be four integers: x0, y0, x1, y1, one past the last");
                options->roi[k] = (uint32_t)roi[k];
            }
            if (!(roi[0] < roi[2] && roi[1] < roi[3]))
                mexErrMsgIdAndTxt(ARGUMENT, "roi must have x0 < x1 and y0 < y1");
        } else {
            mexErrMsgIdAndTxt(ARGUMENT, "unknown option %s", name);
        }
    }
    if (!options->is_dn && (options->exposure_s != 0.0 || mxGetField(value, 0, "seed")))
        mexErrMsgIdAndTxt(ARGUMENT, "exposure_s and seed belong to output 'dn'");
    if (options->is_dn && !mxGetField(value, 0, "seed"))
        options->seed = (*n_unseeded)++;
}

/* The array, whose column-major bytes came as MATLAB keeps them. */
static mxArray *array_of(const glr_image *image) {
    static const struct {
        const char *dtype;
        mxClassID id;
    } known[] = {{"uint8", mxUINT8_CLASS}, {"uint16", mxUINT16_CLASS}, {"int32", mxINT32_CLASS},
                 {"float32", mxSINGLE_CLASS}, {"float64", mxDOUBLE_CLASS}};
    enum { N_KNOWN = sizeof known / sizeof known[0] };
    mwSize shape[3];
    mxArray *array;
    size_t k = 0;
    shape[0] = image->height;
    shape[1] = image->width;
    shape[2] = image->depth;
    while (k < N_KNOWN && strcmp(image->dtype, known[k].dtype))
        k++;
    if (k == N_KNOWN)
        mexErrMsgIdAndTxt("glrender:protocol", "an array of %s", image->dtype);
    array = mxCreateNumericArray(image->depth > 1 ? 3 : 2, shape, known[k].id, mxREAL);
    if (mxGetNumberOfElements(array) * mxGetElementSize(array) != image->n_bytes)
        mexErrMsgIdAndTxt("glrender:protocol", "array %s has %.0f bytes", image->name, (double)image->n_bytes);
    memcpy(mxGetData(array), image->pixels, image->n_bytes);
    return array;
}

/* A new field of this name: a server's word, which may be no name at all, or one that is there. */
static void put_array(mxArray *target, const glr_image *image) {
    const char *at = image->name;
    int field, is_name = isalpha((unsigned char)*at) != 0;
    for (; *at; at++)
        is_name = is_name && (isalnum((unsigned char)*at) || *at == '_');
    field = is_name && mxGetFieldNumber(target, image->name) < 0 ? mxAddField(target, image->name) : -1;
    if (field < 0)
        mexErrMsgIdAndTxt("glrender:protocol", "an array is named %s", is_name ? image->name : "otherwise than a field");
    mxSetFieldByNumber(target, 0, field, array_of(image));
}

static mxArray *render(int place, const mxArray *given_state, const mxArray *given_options) {
    glr_client *client = clients[place];
    const int is_list = mxIsCell(given_options);
    const size_t n_frames = is_list ? mxGetNumberOfElements(given_options) : 1;
    const char *names[MAX_BODIES];
    glr_pose poses[MAX_BODIES];
    mxArray *made[GLR_MAX_IMAGES], *result;
    glr_options *frames;
    glr_state state;
    glr_reply reply;
    size_t k;
    if (n_frames < 1 || n_frames > GLR_MAX_IMAGES)
        mexErrMsgIdAndTxt(ARGUMENT, "there must be 1 to %d frames", GLR_MAX_IMAGES);
    frames = mxCalloc(n_frames, sizeof *frames);
    get_state(given_state, &state, names, poses);
    for (k = 0; k < n_frames; k++)
        get_options(is_list ? mxGetCell(given_options, k) : given_options, &frames[k], &n_noisy[place]);
    if (glr_render_frames(client, &state, frames, (uint32_t)n_frames, &reply)) {
        char id[64];
        snprintf(id, sizeof id, "glrender:%s", glr_error_code(client));
        mexErrMsgIdAndTxt(id, "%s", glr_error_message(client));
    }
    for (k = 0; k < n_frames; k++)
        made[k] = mxCreateStructMatrix(1, 1, 0, NULL);
    for (k = 0; k < reply.n_images; k++) {
        const glr_image *image = &reply.images[k];
        if (image->frame >= n_frames)
            mexErrMsgIdAndTxt("glrender:protocol", "an image of frame %u of %u", (unsigned)image->frame,
                              (unsigned)n_frames);
        put_array(made[image->frame], image);
    }
    for (k = 0; k < n_frames; k++) {
        const mwSize shape[2] = {1, reply.n_header_bytes};
        mxArray *bytes = mxCreateNumericArray(2, shape, mxUINT8_CLASS, mxREAL);
        memcpy(mxGetData(bytes), reply.header, reply.n_header_bytes);
        mxSetFieldByNumber(made[k], 0, mxAddField(made[k], "header_bytes"), bytes);
    }
    if (!is_list)
        return made[0];
    result = mxCreateCellMatrix(1, n_frames);
    for (k = 0; k < n_frames; k++)
        mxSetCell(result, k, made[k]);
    return result;
}

static void open_client(int n_given, const mxArray *given[], mxArray *result[]) {
    const char *host;
    double port, timeout_s;
    int place = 0;
    if (n_given != 4)
        mexErrMsgIdAndTxt(ARGUMENT, "handle = glrender_mex('open', host, port, timeout_s)");
    host = text_of(given[1], "host");
    numbers_of(given[2], "port", 1, &port);
    numbers_of(given[3], "timeout_s", 1, &timeout_s);
    if (!(port >= 1.0 && port <= 65535.0) || !(timeout_s > 0.0))
        mexErrMsgIdAndTxt(ARGUMENT, "port must be 1 to 65535 and timeout_s > 0");
    while (place < MAX_CLIENTS && clients[place])
        place++;
    if (place == MAX_CLIENTS)
        mexErrMsgIdAndTxt(ARGUMENT, "%d clients are open; close one", MAX_CLIENTS);
    clients[place] = glr_open(host, (int)port, timeout_s);
    if (!clients[place])
        mexErrMsgIdAndTxt("glrender:memory", "memory is out");
    n_noisy[place] = 0;
    result[0] = mxCreateDoubleScalar(place + 1);
}

static int place_of(const mxArray *handle) {
    double number = mxIsDouble(handle) && mxGetNumberOfElements(handle) == 1 ? mxGetScalar(handle) : 0.0;
    if (!(number >= 1.0 && number <= MAX_CLIENTS) || number != (int)number || !clients[(int)number - 1])
        mexErrMsgIdAndTxt("glrender:closed", "no open client has this handle");
    return (int)number - 1;
}

void mexFunction(int n_results, mxArray *result[], int n_given, const mxArray *given[]) {
    const char *command = n_given ? text_of(given[0], "the command") : "";
    (void)n_results;
    mexAtExit(close_all);
    if (!strcmp(command, "open")) {
        open_client(n_given, given, result);
    } else if (!strcmp(command, "render") && n_given == 4) {
        result[0] = render(place_of(given[1]), given[2], given[3]);
    } else if (!strcmp(command, "close") && n_given == 2) {
        int place = place_of(given[1]);
        glr_close(clients[place]);
        clients[place] = NULL;
    } else {
        mexErrMsgIdAndTxt(ARGUMENT, "glrender_mex('open', host, port, timeout_s), ('render', handle, state, options) or "
                          "('close', handle)");
    }
}
