#include "glr_wire.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#define MAX_DEPTH 32

uint8_t *glr_reserve(glr_buffer *out, size_t size) {
    uint8_t *place;
    if (out->failed)
        return NULL;
    if (size > out->capacity - out->size) {
        size_t capacity = out->capacity ? out->capacity : 512;
        uint8_t *data;
        while (capacity - out->size < size) {
            if (capacity > SIZE_MAX / 2) {
                out->failed = 1;
                return NULL;
            }
            capacity *= 2;
        }
        data = realloc(out->data, capacity);
        if (!data) {
            out->failed = 1;
            return NULL;
        }
        out->data = data;
        out->capacity = capacity;
    }
    place = out->data + out->size;
    out->size += size;
    return place;
}

/* A type byte and a number of `width` bytes, the most significant first. */
static void put(glr_buffer *out, uint8_t type, uint64_t number, int width) {
    uint8_t *place = glr_reserve(out, 1 + (size_t)width);
    int k;
    if (!place)
        return;
    place[0] = type;
    for (k = 0; k < width; k++)
        place[1 + k] = (uint8_t)(number >> (8 * (width - 1 - k)));
}

void glr_put_map(glr_buffer *out, uint32_t n_pairs) {
    if (n_pairs < 16)
        put(out, (uint8_t)(0x80 + n_pairs), 0, 0);
    else if (n_pairs < 65536)
        put(out, 0xde, n_pairs, 2);
    else
        put(out, 0xdf, n_pairs, 4);
}

void glr_put_list(glr_buffer *out, uint32_t count) {
    if (count < 16)
        put(out, (uint8_t)(0x90 + count), 0, 0);
    else if (count < 65536)
        put(out, 0xdc, count, 2);
    else
        put(out, 0xdd, count, 4);
}

static void put_raw(glr_buffer *out, const void *bytes, size_t size) {
    uint8_t *place = glr_reserve(out, size);
    if (place && size)
        memcpy(place, bytes, size);
}

void glr_put_text(glr_buffer *out, const char *text) {
    size_t size = strlen(text);
    if (size > UINT32_MAX) {
        out->failed = 1;
        return;
    }
    if (size < 32)
        put(out, (uint8_t)(0xa0 + size), 0, 0);
    else if (size < 256)
        put(out, 0xd9, size, 1);
    else
        put(out, 0xdb, size, 4);
    put_raw(out, text, size);
}

void glr_put_uint(glr_buffer *out, uint64_t value) {
    if (value < 128)
        put(out, (uint8_t)value, 0, 0);
    else if (value < 256)
        put(out, 0xcc, value, 1);
    else
        put(out, 0xcf, value, 8);
}

void glr_put_double(glr_buffer *out, double value) {
    uint64_t bits;
    memcpy(&bits, &value, sizeof bits);
    put(out, 0xcb, bits, 8);
}

void glr_put_bytes(glr_buffer *out, const void *bytes, size_t size) {
    if (size > UINT32_MAX) {
        out->failed = 1;
        return;
    }
    if (size < 256)
        put(out, 0xc4, size, 1);
    else if (size < 65536)
        put(out, 0xc5, size, 2);
    else
        put(out, 0xc6, size, 4);
    put_raw(out, bytes, size);
}

void glr_put_bool(glr_buffer *out, int value) { put(out, value ? 0xc3 : 0xc2, 0, 0); }

void glr_put_vector(glr_buffer *out, const char *key, const double *values, uint32_t count) {
    uint32_t k;
    glr_put_text(out, key);
    glr_put_list(out, count);
    for (k = 0; k < count; k++)
        glr_put_double(out, values[k]);
}

/* The next `size` bytes, or NULL. */
static const uint8_t *take(glr_reader *in, size_t size) {
    const uint8_t *place = in->at;
    if (in->failed || size > (size_t)(in->end - in->at)) {
        in->failed = 1;
        return NULL;
    }
    in->at += size;
    return place;
}

static uint64_t number(glr_reader *in, size_t width) {
    const uint8_t *place = take(in, width);
    uint64_t value = 0;
    size_t k;
    for (k = 0; place && k < width; k++)
        value = value << 8 | place[k];
    return value;
}

/* A count: in the type byte's low bits (from `fixed`, `mask`), or behind `wide` (2 bytes) and `wide` + 1 (4). */
static uint32_t count_of(glr_reader *in, uint8_t fixed, uint8_t mask, uint8_t wide) {
    uint8_t type = (uint8_t)number(in, 1);
    if (in->failed)
        return 0;
    if ((type & (uint8_t)~mask) == fixed)
        return type & mask;
    if (type == wide)
        return (uint32_t)number(in, 2);
    if (type == wide + 1)
        return (uint32_t)number(in, 4);
    in->failed = 1;
    return 0;
}

uint32_t glr_get_map(glr_reader *in) { return count_of(in, 0x80, 0x0f, 0xde); }

uint32_t glr_get_list(glr_reader *in) { return count_of(in, 0x90, 0x0f, 0xdc); }

glr_text glr_get_text(glr_reader *in) {
    glr_text text = {"", 0};
    const uint8_t *place;
    size_t size;
    if (!in->failed && in->at < in->end && *in->at == 0xd9) {
        in->at++;
        size = (size_t)number(in, 1);
    } else {
        size = count_of(in, 0xa0, 0x1f, 0xda);
    }
    place = take(in, size);
    if (place) {
        text.at = (const char *)place;
        text.size = size;
    }
    return text;
}

uint64_t glr_get_uint(glr_reader *in) {
    uint8_t type = (uint8_t)number(in, 1);
    if (type < 128)
        return type;
    if (type >= 0xcc && type <= 0xcf)
        return number(in, (size_t)1 << (type - 0xcc));
    in->failed = 1;
    return 0;
}

double glr_get_double(glr_reader *in) {
    uint64_t bits;
    double value = 0.0;
    if (in->failed || in->at >= in->end || *in->at != 0xcb)
        return (double)glr_get_uint(in);
    in->at++;
    bits = number(in, sizeof bits);
    memcpy(&value, &bits, sizeof value);
    return in->failed ? 0.0 : value;
}

double glr_get_number(glr_reader *in) {
    if (in->failed || in->at >= in->end || *in->at != 0xc0)
        return glr_get_double(in);
    in->at++;
    return NAN;
}

int glr_get_bool(glr_reader *in) {
    uint8_t type = (uint8_t)number(in, 1);
    if (type != 0xc2 && type != 0xc3)
        in->failed = 1;
    return !in->failed && type == 0xc3;
}

static void skip(glr_reader *in, int depth) {
    uint64_t n_values = 0, k;
    uint8_t type;
    if (depth > MAX_DEPTH) {
        in->failed = 1;
        return;
    }
    type = (uint8_t)number(in, 1);
    if (in->failed || type < 0x80 || type >= 0xe0)
        return;
    if (type < 0x90)
        n_values = 2u * (type & 0x0f);
    else if (type < 0xa0)
        n_values = type & 0x0f;
    else if (type < 0xc0)
        take(in, type & 0x1f);
    else
        switch (type) {
        case 0xc0: case 0xc2: case 0xc3: break;
        case 0xc4: case 0xd9: take(in, (size_t)number(in, 1)); break;
        case 0xc5: case 0xda: take(in, (size_t)number(in, 2)); break;
        case 0xc6: case 0xdb: take(in, (size_t)number(in, 4)); break;
        case 0xcc: case 0xd0: take(in, 1); break;
        case 0xcd: case 0xd1: take(in, 2); break;
        case 0xca: case 0xce: case 0xd2: take(in, 4); break;
        case 0xcb: case 0xcf: case 0xd3: take(in, 8); break;
        case 0xdc: n_values = number(in, 2); break;
        case 0xdd: n_values = number(in, 4); break;
        case 0xde: n_values = 2 * number(in, 2); break;
        case 0xdf: n_values = 2 * number(in, 4); break;
        default: in->failed = 1;
        }
    for (k = 0; k < n_values && !in->failed; k++)
        skip(in, depth + 1);
}

void glr_skip(glr_reader *in) { skip(in, 0); }

int glr_text_is(glr_text text, const char *other) {
    return text.size == strlen(other) && memcmp(text.at, other, text.size) == 0;
}

void glr_copy_text(char *target, size_t capacity, glr_text text) {
    size_t size = text.size < capacity - 1 ? text.size : capacity - 1;
    memcpy(target, text.at, size);
    target[size] = '\0';
}
