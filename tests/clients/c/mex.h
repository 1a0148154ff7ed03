/* A stand-in for MATLAB's mex.h: what glrender_mex.c uses of it, with arrays of exactly the sizes declared, names and
 * indices checked, and all memory freed when the function returns or fails, as MATLAB does. */
#ifndef MEX_H
#define MEX_H
#include <assert.h>
#include <ctype.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

typedef size_t mwSize;
typedef enum { mxCHAR_CLASS, mxCELL_CLASS, mxSTRUCT_CLASS, mxDOUBLE_CLASS, mxSINGLE_CLASS, mxUINT8_CLASS,
               mxUINT16_CLASS, mxINT32_CLASS, mxUINT64_CLASS, mxLOGICAL_CLASS } mxClassID;
typedef enum { mxREAL, mxCOMPLEX } mxComplexity;
#define MEX_MAX_FIELDS 16
typedef struct mxArray {
    mxClassID id;
    size_t count;
    void *data; /* numbers, text, or the cells' and fields' arrays */
    char names[MEX_MAX_FIELDS][64];
    int n_fields;
} mxArray;

static jmp_buf mex_failed;
static char mex_error[4096];
static void *mex_held[4096];
static size_t mex_n_held;

static void *mxCalloc(size_t count, size_t size) {
    void *data = calloc(count ? count : 1, size);
    assert(data && mex_n_held < sizeof mex_held / sizeof *mex_held);
    return mex_held[mex_n_held++] = data;
}
static void mex_free_all(void) {
    while (mex_n_held)
        free(mex_held[--mex_n_held]);
}
__attribute__((noreturn, format(printf, 2, 3))) static void mexErrMsgIdAndTxt(const char *id, const char *form, ...) {
    va_list values;
    int n = snprintf(mex_error, sizeof mex_error, "%s: ", id);
    va_start(values, form);
    vsnprintf(mex_error + n, sizeof mex_error - (size_t)n, form, values);
    va_end(values);
    longjmp(mex_failed, 1);
}
static void mexAtExit(void (*f)(void)) { (void)f; }

static size_t mxGetElementSize(const mxArray *a) {
    static const size_t sizes[] = {1, sizeof(void *), sizeof(void *), 8, 4, 1, 2, 4, 8, 1};
    return sizes[a->id];
}
static mxArray *mex_array(mxClassID id, size_t count) {
    mxArray *a = mxCalloc(1, sizeof *a);
    a->id = id;
    a->count = count;
    a->data = mxCalloc(count, mxGetElementSize(a));
    return a;
}
static mxArray *mxCreateNumericArray(mwSize n_axes, const mwSize *shape, mxClassID id, mxComplexity is) {
    size_t count = 1;
    (void)is;
    while (n_axes--)
        count *= *shape++;
    return mex_array(id, count);
}
static mxArray *mxCreateDoubleScalar(double value) {
    mxArray *a = mex_array(mxDOUBLE_CLASS, 1);
    *(double *)a->data = value;
    return a;
}
static mxArray *mxCreateString(const char *text) {
    mxArray *a = mex_array(mxCHAR_CLASS, strlen(text) + 1);
    memcpy(a->data, text, a->count--);
    return a;
}
static mxArray *mxCreateCellMatrix(mwSize m, mwSize n) { return mex_array(mxCELL_CLASS, m * n); }
static mxArray *mxCreateStructMatrix(mwSize m, mwSize n, int n_fields, const char **names) {
    mxArray *a = mex_array(mxSTRUCT_CLASS, MEX_MAX_FIELDS);
    assert(m == 1 && n == 1 && n_fields == 0 && !names);
    a->count = 1;
    return a;
}
static int mxGetFieldNumber(const mxArray *a, const char *name) {
    int k;
    for (k = 0; k < a->n_fields; k++)
        if (!strcmp(a->names[k], name))
            return k;
    return -1;
}
static int mxAddField(mxArray *a, const char *name) {
    const char *at;
    assert(a->id == mxSTRUCT_CLASS && a->n_fields < MEX_MAX_FIELDS);
    if (!isalpha((unsigned char)*name) || strlen(name) > 63 || mxGetFieldNumber(a, name) >= 0)
        return -1;
    for (at = name; *at; at++)
        if (!isalnum((unsigned char)*at) && *at != '_')
            return -1;
    memcpy(a->names[a->n_fields], name, strlen(name) + 1);
    return a->n_fields++;
}
static void mxSetFieldByNumber(mxArray *a, mwSize index, int field, mxArray *value) {
    assert(a->id == mxSTRUCT_CLASS && index == 0 && field >= 0 && field < a->n_fields);
    ((mxArray **)a->data)[field] = value;
}
static mxArray *mxGetFieldByNumber(const mxArray *a, mwSize index, int field) {
    assert(a->id == mxSTRUCT_CLASS && index == 0 && field >= 0 && field < a->n_fields);
    return ((mxArray **)a->data)[field];
}
static mxArray *mxGetField(const mxArray *a, mwSize index, const char *name) {
    int field = mxGetFieldNumber(a, name);
    return field < 0 ? NULL : mxGetFieldByNumber(a, index, field);
}
static int mxGetNumberOfFields(const mxArray *a) { return a->n_fields; }
static const char *mxGetFieldNameByNumber(const mxArray *a, int field) {
    assert(field >= 0 && field < a->n_fields);
    return a->names[field];
}
static mxArray *mxGetCell(const mxArray *a, mwSize k) {
    assert(a->id == mxCELL_CLASS && k < a->count);
    return ((mxArray **)a->data)[k];
}
static void mxSetCell(mxArray *a, mwSize k, mxArray *value) {
    assert(a->id == mxCELL_CLASS && k < a->count);
    ((mxArray **)a->data)[k] = value;
}
static int mxIsChar(const mxArray *a) { return a->id == mxCHAR_CLASS; }
static int mxIsCell(const mxArray *a) { return a->id == mxCELL_CLASS; }
static int mxIsStruct(const mxArray *a) { return a->id == mxSTRUCT_CLASS; }
static int mxIsDouble(const mxArray *a) { return a->id == mxDOUBLE_CLASS; }
static int mxIsUint64(const mxArray *a) { return a->id == mxUINT64_CLASS; }
static int mxIsNumeric(const mxArray *a) { return a->id >= mxDOUBLE_CLASS && a->id <= mxUINT64_CLASS; }
static int mxIsComplex(const mxArray *a) { return (void)a, 0; }
static int mxIsLogicalScalar(const mxArray *a) { return a->id == mxLOGICAL_CLASS && a->count == 1; }
static int mxIsLogicalScalarTrue(const mxArray *a) { return mxIsLogicalScalar(a) && *(const uint8_t *)a->data; }
static size_t mxGetNumberOfElements(const mxArray *a) { return a->count; }
static void *mxGetData(const mxArray *a) { return a->data; }
static double *mxGetPr(const mxArray *a) { return (double *)a->data; }
static double mxGetScalar(const mxArray *a) { return a->id == mxDOUBLE_CLASS ? *(const double *)a->data : 0.0; }
static char *mxArrayToString(const mxArray *a) {
    char *text = mxCalloc(a->count + 1, 1);
    memcpy(text, a->data, a->count);
    return text;
}
#endif
