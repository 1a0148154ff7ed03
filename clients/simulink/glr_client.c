#ifndef _WIN32
#define _POSIX_C_SOURCE 200809L
#endif
#include "glr_client.h"

#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "glr_socket.h"
#include "glr_wire.h"

#define MAX_PARTS 16
#define MAX_MESSAGE_BYTES (1u << 30)
#define N_TRIES 2
#define PIXEL_ALIGNMENT 16

struct glr_client {
    char host[256];
    int port;
    double timeout_s;
    glr_socket handle;
    char name[64];
    uint64_t next_id;
    glr_buffer request, reply;
    uint32_t sizes[MAX_PARTS], n_parts;
    char code[32], message[512];
};

static int fail(glr_client *client, const char *code, const char *form, ...) {
    va_list values;
    snprintf(client->code, sizeof client->code, "%s", code);
    va_start(values, form);
    vsnprintf(client->message, sizeof client->message, form, values);
    va_end(values);
    return -1;
}

static void hang_up(glr_client *client) {
    if (client->handle != GLR_NO_SOCKET)
        glr_close_socket(client->handle);
    client->handle = GLR_NO_SOCKET;
}

glr_client *glr_open(const char *host, int port, double timeout_s) {
    static unsigned n_opened;
    glr_client *client = calloc(1, sizeof *client);
    uint64_t salt;
    if (!client)
        return NULL;
    snprintf(client->host, sizeof client->host, "%s", strcmp(host, "localhost") ? host : "127.0.0.1");
    client->port = port;
    client->timeout_s = timeout_s;
    client->handle = GLR_NO_SOCKET;
    client->next_id = 1;
    /* Unique among clients: clock, address space and a counter. */
    salt = (uint64_t)time(NULL) * 1000003u ^ (uint64_t)(1e6 * glr_now_s()) ^ (uint64_t)(uintptr_t)client;
    snprintf(client->name, sizeof client->name, "c-%016llx-%u", (unsigned long long)salt, ++n_opened);
    return client;
}

void glr_close(glr_client *client) {
    if (!client)
        return;
    hang_up(client);
    free(client->request.data);
    free(client->reply.data);
    free(client);
}

const char *glr_error_code(const glr_client *client) { return client ? client->code : "memory"; }

const char *glr_error_message(const glr_client *client) { return client ? client->message : "memory is out"; }

static void put_pose(glr_buffer *out, const glr_pose *pose) {
    glr_put_map(out, 2);
    glr_put_vector(out, "r_inertial_m", pose->r_inertial_m, 3);
    glr_put_vector(out, "q_from_inertial", pose->q_from_inertial, 4);
}

static void put_state(glr_buffer *out, const glr_state *state) {
    uint32_t k;
    glr_put_map(out, 4);
    glr_put_text(out, "t_s");
    glr_put_double(out, state->t_s);
    glr_put_vector(out, "r_sun_inertial_m", state->r_sun_inertial_m, 3);
    glr_put_text(out, "spacecraft");
    put_pose(out, &state->spacecraft);
    glr_put_text(out, "bodies");
    glr_put_map(out, state->n_bodies);
    for (k = 0; k < state->n_bodies; k++) {
        glr_put_text(out, state->body_names[k]);
        put_pose(out, &state->bodies[k]);
    }
}

/* Frame and header of a render request; the frame's size field is filled in at the end. */
static int build_request(glr_client *client, uint64_t id, const glr_state *state, const glr_options *options) {
    glr_buffer *out = &client->request;
    uint8_t *prefix;
    uint32_t size, k;
    out->size = 0;
    out->failed = 0;
    prefix = glr_reserve(out, 12);
    if (prefix)
        memcpy(prefix, "GLR1\1\0\0\0\0\0\0\0", 12);
    glr_put_map(out, 7u + (options->camera != NULL) + (options->is_dn ? 1u + (options->exposure_s > 0.0) : 0u)
                         + (options->max_error > 0.0));
    glr_put_text(out, "v");
    glr_put_uint(out, 1);
    glr_put_text(out, "op");
    glr_put_text(out, "render");
    glr_put_text(out, "id");
    glr_put_uint(out, id);
    glr_put_text(out, "client");
    glr_put_text(out, client->name);
    glr_put_text(out, "state");
    put_state(out, state);
    if (options->camera) {
        glr_put_text(out, "camera");
        glr_put_text(out, options->camera);
    }
    glr_put_text(out, "output");
    glr_put_text(out, options->is_dn ? "dn" : "irradiance");
    if (options->is_dn && options->exposure_s > 0.0) {
        glr_put_text(out, "exposure_s");
        glr_put_double(out, options->exposure_s);
    }
    if (options->is_dn) {
        glr_put_text(out, "seed");
        glr_put_uint(out, options->seed);
    }
    if (options->max_error > 0.0) {
        glr_put_text(out, "max_error");
        glr_put_double(out, options->max_error);
    }
    glr_put_text(out, "order");
    glr_put_text(out, options->is_column_major ? "F" : "C");
    if (out->failed || out->size > UINT32_MAX)
        return fail(client, "memory", "memory is out for a request");
    size = (uint32_t)(out->size - 12);
    for (k = 0; k < 4; k++)
        out->data[8 + k] = (uint8_t)(size >> (8 * k));
    return 0;
}

static uint32_t little(const uint8_t *at, int width) {
    uint32_t value = 0;
    while (width--)
        value = value << 8 | at[width];
    return value;
}

static int told(glr_client *client, glr_outcome outcome) {
    if (outcome == GLR_LATE)
        return fail(client, "timeout", "%s:%d did not answer within %g s", client->host, client->port,
                    client->timeout_s);
    return fail(client, "connection", "no connection to %s:%d; start a server with: glrender-server scene.toml "
                "--tcp %s:%d", client->host, client->port, client->host, client->port);
}

/* Where the parts behind the header begin: aligned for any pixel. */
static size_t pixels_at(const glr_client *client) {
    return (client->sizes[0] + (size_t)PIXEL_ALIGNMENT - 1) / PIXEL_ALIGNMENT * PIXEL_ALIGNMENT;
}

/* One whole message into client->reply. */
static int receive(glr_client *client, double deadline_s) {
    uint8_t prefix[8 + 4 * MAX_PARTS];
    uint64_t total = PIXEL_ALIGNMENT;
    uint32_t k;
    glr_outcome outcome = glr_receive_all(client->handle, prefix, 8, deadline_s);
    if (outcome != GLR_DONE)
        return told(client, outcome);
    client->n_parts = little(prefix + 4, 2);
    if (memcmp(prefix, "GLR1", 4) || client->n_parts < 1 || client->n_parts > MAX_PARTS)
        return fail(client, "protocol", "the server at %s:%d does not speak GLR1", client->host, client->port);
    outcome = glr_receive_all(client->handle, prefix + 8, 4 * (size_t)client->n_parts, deadline_s);
    if (outcome != GLR_DONE)
        return told(client, outcome);
    for (k = 0; k < client->n_parts; k++) {
        client->sizes[k] = little(prefix + 8 + 4 * k, 4);
        total += client->sizes[k];
    }
    if (total > MAX_MESSAGE_BYTES)
        return fail(client, "protocol", "a reply of %llu bytes is too large", (unsigned long long)total);
    client->reply.size = 0;
    client->reply.failed = 0;
    if (!glr_reserve(&client->reply, (size_t)total))
        return fail(client, "memory", "memory is out for a reply of %llu bytes", (unsigned long long)total);
    outcome = glr_receive_all(client->handle, client->reply.data, client->sizes[0], deadline_s);
    if (outcome == GLR_DONE)
        outcome = glr_receive_all(client->handle, client->reply.data + pixels_at(client),
                                  (size_t)(total - PIXEL_ALIGNMENT - client->sizes[0]), deadline_s);
    return outcome == GLR_DONE ? 0 : told(client, outcome);
}

static int once(glr_client *client, uint64_t id);

/* The same request over a new connection after a timeout or a lost one: the server knows a retry. */
static int exchange(glr_client *client, uint64_t id) {
    int attempt, result = -1;
    for (attempt = 0; attempt < N_TRIES; attempt++) {
        result = once(client, id);
        if (result == 0)
            return 0;
        hang_up(client);
        if (strcmp(client->code, "timeout") && strcmp(client->code, "connection"))
            break;
    }
    return result;
}

static uint64_t reply_id(const glr_client *client, int *failed) {
    glr_reader in = {client->reply.data, client->reply.data + client->sizes[0], 0};
    uint32_t n_pairs = glr_get_map(&in), k;
    uint64_t id = 0;
    for (k = 0; k < n_pairs && !in.failed; k++) {
        if (glr_text_is(glr_get_text(&in), "id")) {
            id = glr_get_uint(&in);
            break;
        }
        glr_skip(&in);
    }
    *failed = in.failed;
    return id;
}

static int once(glr_client *client, uint64_t id) {
    double deadline_s = glr_now_s() + client->timeout_s;
    glr_outcome outcome = GLR_DONE;
    if (client->handle == GLR_NO_SOCKET)
        outcome = glr_connect(&client->handle, client->host, client->port, deadline_s);
    if (outcome == GLR_DONE)
        outcome = glr_send_all(client->handle, client->request.data, client->request.size, deadline_s);
    if (outcome != GLR_DONE)
        return told(client, outcome);
    for (;;) {
        int failed;
        uint64_t found;
        if (receive(client, deadline_s))
            return -1;
        found = reply_id(client, &failed);
        if (failed)
            return fail(client, "protocol", "a reply's header cannot be read");
        /* Any other is the late reply to a request given up before. */
        if (found == id || found == 0)
            return 0;
    }
}

static void read_error(glr_client *client, glr_reader *in) {
    uint32_t n_pairs = glr_get_map(in), k;
    for (k = 0; k < n_pairs && !in->failed; k++) {
        glr_text key = glr_get_text(in);
        if (glr_text_is(key, "code"))
            glr_copy_text(client->code, sizeof client->code, glr_get_text(in));
        else if (glr_text_is(key, "message"))
            glr_copy_text(client->message, sizeof client->message, glr_get_text(in));
        else
            glr_skip(in);
    }
}

/* The first array's description: {name, dtype, shape, order, unit, part}. */
static void read_image(glr_client *client, glr_reader *in, glr_image *image) {
    uint32_t n_arrays = glr_get_list(in), n_pairs, k;
    uint64_t part = 1;
    for (n_pairs = n_arrays ? glr_get_map(in) : 0, k = 0; k < n_pairs && !in->failed; k++) {
        glr_text key = glr_get_text(in);
        if (glr_text_is(key, "dtype")) {
            glr_copy_text(image->dtype, sizeof image->dtype, glr_get_text(in));
        } else if (glr_text_is(key, "shape")) {
            if (glr_get_list(in) != 2)
                in->failed = 1;
            image->height = (uint32_t)glr_get_uint(in);
            image->width = (uint32_t)glr_get_uint(in);
        } else if (glr_text_is(key, "part")) {
            part = glr_get_uint(in);
        } else {
            glr_skip(in);
        }
    }
    for (k = 1; k < n_arrays; k++)
        glr_skip(in);
    if (in->failed || part != 1 || client->n_parts < 2) {
        in->failed |= n_arrays > 0;
        return;
    }
    image->pixels = client->reply.data + pixels_at(client);
    image->n_bytes = client->sizes[1];
}

static size_t width_of(const char *dtype) {
    if (!strcmp(dtype, "uint8"))
        return 1;
    if (!strcmp(dtype, "uint16"))
        return 2;
    return strcmp(dtype, "float32") ? 0 : 4;
}

int glr_render(glr_client *client, const glr_state *state, const glr_options *options, glr_image *image) {
    glr_reader in = {NULL, NULL, 0};
    uint32_t n_pairs, k;
    int ok = 0;
    memset(image, 0, sizeof *image);
    if (!client)
        return -1;
    client->code[0] = client->message[0] = '\0';
    if (build_request(client, client->next_id, state, options) || exchange(client, client->next_id++))
        return -1;
    in.at = client->reply.data;
    in.end = in.at + client->sizes[0];
    n_pairs = glr_get_map(&in);
    for (k = 0; k < n_pairs && !in.failed; k++) {
        glr_text key = glr_get_text(&in);
        if (glr_text_is(key, "ok"))
            ok = glr_get_bool(&in);
        else if (glr_text_is(key, "error"))
            read_error(client, &in);
        else if (glr_text_is(key, "arrays"))
            read_image(client, &in, image);
        else
            glr_skip(&in);
    }
    if (in.failed)
        return fail(client, "protocol", "a reply's header cannot be read");
    if (!ok)
        return client->code[0] ? -1 : fail(client, "protocol", "a refusal without a code");
    if (!image->pixels || !width_of(image->dtype)
        || image->n_bytes != (uint64_t)image->height * image->width * width_of(image->dtype))
        return fail(client, "protocol", "%llu bytes are no image of %u x %u %s", (unsigned long long)image->n_bytes,
                    (unsigned)image->width, (unsigned)image->height, image->dtype);
    return 0;
}
