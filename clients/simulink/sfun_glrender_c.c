/* Simulink block in C: a frame per sample time. Works where MATLAB code does not: Rapid Accelerator.
 *
 *     mex sfun_glrender_c.c glr_client.c glr_request.c glr_reply.c glr_socket.c glr_wire.c     (Windows: add -lws2_32)
 *
 * Inputs: r_sun_inertial_m (3); spacecraft (7): r_inertial_m, q_from_inertial; bodies (7 x n): the same for each.
 * Outputs: the image, height x width; facts (4), as in sfun_glrender.m. Parameters: those of glr_settings.m.
 */
#define S_FUNCTION_NAME sfun_glrender_c
#define S_FUNCTION_LEVEL 2

#include "simstruc.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "glr_client.h"

enum { HOST, PORT, CAMERA, BODIES, PIXEL_CLASS, IMAGE_SIZE, EXPOSURE_S, SEED, SAMPLE_TIME_S, TIMEOUT_S, DEADLINE_S,
       N_PARAMETERS };
enum { SUN, SPACECRAFT, BODY_POSES, N_INPUTS };
enum { IMAGE, FACTS, N_OUTPUTS };
enum { PREDICTED_ERROR, EXPOSURE, IS_LATE, N_WARNINGS, N_FACTS };
#define MAX_BODIES 32
#define TEXT_BYTES 1024
#define MAX_SIDE_PX 32768 /* of the image: beyond what a server draws, and its area fits Simulink's int */
#define MAX_SEED 4294967295.0 /* 2^32 - 1: above the number of the frame in the 64 bits of the service's seed */

/* What a block keeps between steps. */
typedef struct {
    glr_client *client;
    glr_options options;
    uint64_t first_seed, n_frames;
    char camera[TEXT_BYTES], bodies[TEXT_BYTES];
    const char *names[MAX_BODIES];
    glr_pose poses[MAX_BODIES];
    uint32_t n_bodies, n_told;
    char told[GLR_MAX_WARNINGS][32]; /* codes of the warnings that Simulink has shown */
} block;

/* NaN where the parameter is not one number. */
static double parameter(SimStruct *S, int index) {
    const mxArray *value = ssGetSFcnParam(S, index);
    return mxIsDouble(value) && mxGetNumberOfElements(value) == 1 ? mxGetPr(value)[0] : NAN;
}

/* 0 where the parameter is no text or too long. */
static int text_parameter(SimStruct *S, int index, char *text) {
    const mxArray *value = ssGetSFcnParam(S, index);
    return mxIsChar(value) && mxGetString(value, text, TEXT_BYTES) == 0;
}

static int_T class_id(SimStruct *S) {
    char name[TEXT_BYTES] = "";
    text_parameter(S, PIXEL_CLASS, name);
    if (!strcmp(name, "uint8"))
        return SS_UINT8;
    if (!strcmp(name, "uint16"))
        return SS_UINT16;
    return strcmp(name, "single") ? -1 : SS_SINGLE;
}

/* Cuts the names, separated by commas, in place; their number. */
static uint32_t cut_names(char *text, const char **names) {
    uint32_t count = 0;
    char *at = text;
    while (count < MAX_BODIES && *at) {
        char *comma = strchr(at, ',');
        names[count++] = at;
        if (!comma)
            break;
        *comma = '\0';
        at = comma + 1;
    }
    return count;
}

static uint32_t count_bodies(SimStruct *S) {
    char text[TEXT_BYTES];
    const char *names[MAX_BODIES];
    return text_parameter(S, BODIES, text) ? cut_names(text, names) : 0;
}

static int is_side(double size) { return size >= 1.0 && size <= MAX_SIDE_PX && size == floor(size); }

static int is_seed(double seed) { return seed >= 0.0 && seed <= MAX_SEED && seed == floor(seed); }

#define MDL_CHECK_PARAMETERS
static void mdlCheckParameters(SimStruct *S) {
    static char message[128]; /* Simulink reads it after this function has returned */
    char text[TEXT_BYTES];
    const mxArray *size = ssGetSFcnParam(S, IMAGE_SIZE);
    if (!text_parameter(S, HOST, text) || !text_parameter(S, CAMERA, text))
        ssSetErrorStatus(S, "glrender: Host and Camera must be text");
    else if (!(parameter(S, PORT) >= 1 && parameter(S, PORT) <= 65535))
        ssSetErrorStatus(S, "glrender: Port must be 1 to 65535");
    else if (count_bodies(S) == 0)
        ssSetErrorStatus(S, "glrender: Bodies must name 1 to 32 bodies, separated by commas");
    else if (class_id(S) < 0)
        ssSetErrorStatus(S, "glrender: PixelClass must be uint8, uint16 or single");
    else if (!mxIsDouble(size) || mxGetNumberOfElements(size) != 2 || !is_side(mxGetPr(size)[0])
             || !is_side(mxGetPr(size)[1]))
        ssSetErrorStatus(S, "glrender: ImageSize must be [height width] in pixels, integers from 1 to 32768");
    else if (!(parameter(S, EXPOSURE_S) >= 0.0))
        ssSetErrorStatus(S, "glrender: Exposure_s must be >= 0 [s]; 0 is the camera's");
    else if (!is_seed(parameter(S, SEED))) {
        snprintf(message, sizeof message, "glrender: Seed must be an integer from 0 to 2^32 - 1, got %.17g",
                 parameter(S, SEED));
        ssSetErrorStatus(S, message);
    } else if (!(parameter(S, SAMPLE_TIME_S) > 0.0) || !(parameter(S, TIMEOUT_S) > 0.0))
        ssSetErrorStatus(S, "glrender: SampleTime and Timeout must be > 0");
    else if (!(parameter(S, DEADLINE_S) >= 0.0))
        ssSetErrorStatus(S, "glrender: Deadline_s must be >= 0 [s]; 0 is none");
}

static void mdlInitializeSizes(SimStruct *S) {
    const double *size;
    int_T k;
    ssSetNumSFcnParams(S, N_PARAMETERS);
    if (ssGetNumSFcnParams(S) != ssGetSFcnParamsCount(S))
        return; /* Simulink tells of the mismatch */
    mdlCheckParameters(S);
    if (ssGetErrorStatus(S) != NULL)
        return;
    for (k = 0; k < N_PARAMETERS; k++)
        ssSetSFcnParamTunable(S, k, 0);
    if (!ssSetNumInputPorts(S, N_INPUTS) || !ssSetNumOutputPorts(S, N_OUTPUTS))
        return;
    ssSetInputPortWidth(S, SUN, 3);
    ssSetInputPortWidth(S, SPACECRAFT, 7);
    ssSetInputPortWidth(S, BODY_POSES, 7 * (int_T)count_bodies(S));
    for (k = 0; k < N_INPUTS; k++) {
        ssSetInputPortDataType(S, k, SS_DOUBLE);
        ssSetInputPortDirectFeedThrough(S, k, 1);
        ssSetInputPortRequiredContiguous(S, k, 1);
    }
    size = mxGetPr(ssGetSFcnParam(S, IMAGE_SIZE));
    ssSetOutputPortMatrixDimensions(S, IMAGE, (int_T)size[0], (int_T)size[1]);
    ssSetOutputPortDataType(S, IMAGE, class_id(S));
    ssSetOutputPortWidth(S, FACTS, N_FACTS);
    ssSetOutputPortDataType(S, FACTS, SS_DOUBLE);
    ssSetNumSampleTimes(S, 1);
    ssSetNumPWork(S, 1);
    ssSetOptions(S, SS_OPTION_EXCEPTION_FREE_CODE);
}

static void mdlInitializeSampleTimes(SimStruct *S) {
    ssSetSampleTime(S, 0, parameter(S, SAMPLE_TIME_S));
    ssSetOffsetTime(S, 0, 0.0);
}

#define MDL_START
static void mdlStart(SimStruct *S) {
    char host[TEXT_BYTES];
    block *self = calloc(1, sizeof *self);
    ssSetPWorkValue(S, 0, self);
    if (!self || !text_parameter(S, HOST, host)) {
        ssSetErrorStatus(S, "glrender: memory is out");
        return;
    }
    text_parameter(S, CAMERA, self->camera);
    text_parameter(S, BODIES, self->bodies);
    self->n_bodies = cut_names(self->bodies, self->names);
    self->options.camera = self->camera;
    self->options.is_dn = class_id(S) != SS_SINGLE;
    self->options.exposure_s = parameter(S, EXPOSURE_S);
    self->options.deadline_s = parameter(S, DEADLINE_S);
    self->options.is_column_major = 1;
    self->first_seed = (uint64_t)parameter(S, SEED);
    self->client = glr_open(host, (int)parameter(S, PORT), parameter(S, TIMEOUT_S));
    if (!self->client)
        ssSetErrorStatus(S, "glrender: memory is out");
}

static void get_pose(glr_pose *pose, const real_T *values) {
    memcpy(pose->r_inertial_m, values, sizeof pose->r_inertial_m);
    memcpy(pose->q_from_inertial, values + 3, sizeof pose->q_from_inertial);
}

/* Whether the image is the output's to the last byte: what a server sends must never reach beyond it. */
static int fits_output(SimStruct *S, const glr_image *image, const char *dtype, size_t item_bytes) {
    const double *size = mxGetPr(ssGetSFcnParam(S, IMAGE_SIZE));
    return image->height == size[0] && image->width == size[1] && image->depth == 1 && !strcmp(image->name, "image")
           && !strcmp(image->dtype, dtype)
           && image->n_bytes == (size_t)ssGetOutputPortWidth(S, IMAGE) * item_bytes;
}

/* Each kind of warning once in a simulation. */
static void show_warnings(SimStruct *S, block *self, const glr_reply *reply) {
    static char message[320];
    uint32_t k, j;
    for (k = 0; k < reply->n_warnings; k++) {
        const glr_warning *warning = &reply->warnings[k];
        for (j = 0; j < self->n_told && strcmp(self->told[j], warning->code); j++)
            ;
        if (j < self->n_told || j == GLR_MAX_WARNINGS)
            continue;
        memcpy(self->told[self->n_told++], warning->code, sizeof warning->code);
        snprintf(message, sizeof message, "glrender:%s: %s", warning->code, warning->message);
        ssWarning(S, message);
    }
}

static void put_facts(SimStruct *S, const glr_reply *reply) {
    real_T *facts = ssGetOutputPortSignal(S, FACTS);
    facts[PREDICTED_ERROR] = reply->predicted_error[0];
    facts[EXPOSURE] = reply->exposure_s[0];
    facts[IS_LATE] = reply->is_late[0];
    facts[N_WARNINGS] = reply->n_warnings;
}

static void mdlOutputs(SimStruct *S, int_T tid) {
    static char message[2048]; /* Simulink reads it after this function has returned */
    static const struct {
        const char *dtype;
        size_t item_bytes;
    } classes[] = {{"uint8", 1}, {"uint16", 2}, {"float32", 4}}, *wanted;
    block *self = ssGetPWorkValue(S, 0);
    int_T id = class_id(S);
    const double *size = mxGetPr(ssGetSFcnParam(S, IMAGE_SIZE));
    const real_T *poses = ssGetInputPortSignal(S, BODY_POSES);
    glr_state state;
    static glr_reply reply; /* some KiB */
    const glr_image *image = &reply.images[0];
    uint32_t k;
    (void)tid;
    wanted = &classes[id == SS_UINT8 ? 0 : id == SS_UINT16 ? 1 : 2];
    state.t_s = ssGetT(S);
    memcpy(state.r_sun_inertial_m, ssGetInputPortSignal(S, SUN), sizeof state.r_sun_inertial_m);
    get_pose(&state.spacecraft, ssGetInputPortSignal(S, SPACECRAFT));
    for (k = 0; k < self->n_bodies; k++)
        get_pose(&self->poses[k], poses + 7 * k);
    state.n_bodies = self->n_bodies;
    state.body_names = self->names;
    state.bodies = self->poses;
    /* Frames of two seeds share no noise: the seed above, the number of the frame below 2^32. */
    self->options.seed = (self->first_seed << 32) + self->n_frames++;
    if (glr_render_frames(self->client, &state, &self->options, 1, &reply)) {
        snprintf(message, sizeof message, "glrender:%s: %s", glr_error_code(self->client),
                 glr_error_message(self->client));
        ssSetErrorStatus(S, message);
    } else if (!fits_output(S, image, wanted->dtype, wanted->item_bytes)) {
        snprintf(message, sizeof message, "glrender: camera %s gives %u x %u%s %s, the block expects %.0f x %.0f %s",
                 self->camera, (unsigned)image->height, (unsigned)image->width,
                 image->depth == 1 ? "" : image->depth == 2 ? " x 2" : " x 3", image->dtype, size[0], size[1],
                 wanted->dtype);
        ssSetErrorStatus(S, message);
    } else {
        memcpy(ssGetOutputPortSignal(S, IMAGE), image->pixels, image->n_bytes);
        put_facts(S, &reply);
        show_warnings(S, self, &reply);
    }
}

static void mdlTerminate(SimStruct *S) {
    block *self = ssGetPWorkValue(S, 0);
    if (self) {
        glr_close(self->client);
        free(self);
        ssSetPWorkValue(S, 0, NULL);
    }
}

#ifdef MATLAB_MEX_FILE
#include "simulink.c"
#else
#include "cg_sfun.h"
#endif
