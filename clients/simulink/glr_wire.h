/* MessagePack as docs/protocol.md uses it: a writer that grows, a reader that never leaves its bytes. C99. */
#ifndef GLR_WIRE_H
#define GLR_WIRE_H

#include <stddef.h>
#include <stdint.h>

/* Bytes being written. `failed` stays set once memory ran out; zero-initialise, and free(data) at the end. */
typedef struct {
    uint8_t *data;
    size_t size, capacity;
    int failed;
} glr_buffer;

/* Room for `size` further bytes, or NULL. The caller fills them. */
uint8_t *glr_reserve(glr_buffer *out, size_t size);
void glr_put_map(glr_buffer *out, uint32_t n_pairs);
void glr_put_list(glr_buffer *out, uint32_t count);
void glr_put_text(glr_buffer *out, const char *text);
void glr_put_uint(glr_buffer *out, uint64_t value);
void glr_put_double(glr_buffer *out, double value);
void glr_put_bytes(glr_buffer *out, const void *bytes, size_t size);
void glr_put_bool(glr_buffer *out, int value);
/* A key and a list of numbers. */
void glr_put_vector(glr_buffer *out, const char *key, const double *values, uint32_t count);

/* Bytes being read. `failed` stays set after the first that cannot be; then every getter returns 0. */
typedef struct {
    const uint8_t *at, *end;
    int failed;
} glr_reader;

typedef struct {
    const char *at; /* not terminated */
    size_t size;
} glr_text;

uint32_t glr_get_map(glr_reader *in);
uint32_t glr_get_list(glr_reader *in);
glr_text glr_get_text(glr_reader *in);
uint64_t glr_get_uint(glr_reader *in);
/* A number of any type. */
double glr_get_double(glr_reader *in);
/* The same; NaN of nil, which stands for numbers that are not finite. */
double glr_get_number(glr_reader *in);
int glr_get_bool(glr_reader *in);
/* Step over one value of any type; nesting beyond 32 fails. */
void glr_skip(glr_reader *in);
int glr_text_is(glr_text text, const char *other);
/* Copies what fits, and terminates. */
void glr_copy_text(char *target, size_t capacity, glr_text text);

#endif
