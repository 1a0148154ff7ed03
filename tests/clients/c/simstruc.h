/* A stand-in for Simulink's simstruc.h: what sfun_glrender_c.c uses of it, with the checks that Simulink would make. */
#ifndef SIMSTRUC_H
#define SIMSTRUC_H
#include <assert.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

typedef int int_T;
typedef double real_T;
enum { SS_DOUBLE = 0, SS_SINGLE = 1, SS_UINT8 = 3, SS_UINT16 = 5 };
#define SS_OPTION_EXCEPTION_FREE_CODE 1

typedef struct { const char *text; double numbers[8]; size_t count; } mxArray;
static int mxIsChar(const mxArray *a) { return a->text != NULL; }
static int mxIsDouble(const mxArray *a) { return a->text == NULL; }
static size_t mxGetNumberOfElements(const mxArray *a) { return a->count; }
static double *mxGetPr(const mxArray *a) { return (double *)a->numbers; }
static double mxGetScalar(const mxArray *a) { return a->text ? (double)a->text[0] : a->numbers[0]; }
static int mxGetString(const mxArray *a, char *out, size_t size) {
    snprintf(out, size, "%s", a->text);
    return strlen(a->text) >= size;
}

typedef struct { int_T width, type, is_direct, is_contiguous; double *signal; } port;
typedef struct { int_T height, width, type; void *signal; } output_port;
typedef struct {
    mxArray parameters[16];
    int_T n_expected, n_given, n_inputs, n_outputs, n_sample_times, n_pwork, in_start;
    port inputs[8];
    output_port outputs[2];
    void *pwork[1];
    double sample_time, t;
    const char *error;
} SimStruct;

#define ssSetNumSFcnParams(S, n) ((S)->n_expected = (n))
#define ssGetNumSFcnParams(S) ((S)->n_expected)
#define ssGetSFcnParamsCount(S) ((S)->n_given)
#define ssGetSFcnParam(S, k) (assert((k) >= 0 && (k) < (S)->n_given), &(S)->parameters[k])
#define ssSetSFcnParamTunable(S, k, is) assert((k) < (S)->n_expected && !(is))
#define ssSetNumInputPorts(S, n) ((S)->n_inputs = (n), 1)
#define ssSetNumOutputPorts(S, n) ((S)->n_outputs = (n), 1)
#define ssSetInputPortWidth(S, k, w) (assert((k) < (S)->n_inputs && (w) > 0), (S)->inputs[k].width = (w))
#define ssSetInputPortDataType(S, k, t) (assert((k) < (S)->n_inputs), (S)->inputs[k].type = (t))
#define ssSetInputPortDirectFeedThrough(S, k, is) ((S)->inputs[k].is_direct = (is))
#define ssSetInputPortRequiredContiguous(S, k, is) ((S)->inputs[k].is_contiguous = (is))
#define OUTPUT(S, k) (assert((k) < (S)->n_outputs), &(S)->outputs[k])
#define ssSetOutputPortMatrixDimensions(S, k, h, w) (OUTPUT(S, k)->height = (h), (S)->outputs[k].width = (w))
#define ssSetOutputPortWidth(S, k, w) ssSetOutputPortMatrixDimensions(S, k, w, 1)
#define ssGetOutputPortWidth(S, k) (OUTPUT(S, k)->height * (S)->outputs[k].width)
#define ssSetOutputPortDataType(S, k, t) (OUTPUT(S, k)->type = (t))
#define ssWarning(S, m) ((void)(S), printf("warning: %s\n", (m)))
#define ssSetNumSampleTimes(S, n) ((S)->n_sample_times = (n))
#define ssSetNumPWork(S, n) (assert((n) <= 1), (S)->n_pwork = (n))
#define ssSetOptions(S, o) ((void)(S), (void)(o))
#define ssSetSampleTime(S, k, t) (assert((k) < (S)->n_sample_times), (S)->sample_time = (t))
#define ssSetOffsetTime(S, k, t) assert((t) == 0.0)
#define ssSetPWorkValue(S, k, v) (assert((k) < (S)->n_pwork), (S)->pwork[k] = (v))
#define ssGetPWorkValue(S, k) (assert((k) < (S)->n_pwork), (S)->pwork[k])
#define ssSetErrorStatus(S, m) ((S)->error = (m))
#define ssGetErrorStatus(S) ((S)->error)
#define ssGetT(S) ((S)->t)
/* Simulink allows direct access to inputs in mdlOutputs only with direct feedthrough, and as one array only when
 * contiguity was required. */
#define ssGetInputPortSignal(S, k) \
    (assert((k) < (S)->n_inputs && (S)->inputs[k].is_direct && (S)->inputs[k].is_contiguous), (S)->inputs[k].signal)
#define ssGetOutputPortSignal(S, k) (OUTPUT(S, k)->signal)
#endif
