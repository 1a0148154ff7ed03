#ifndef _WIN32
#define _POSIX_C_SOURCE 200809L
#endif
#include "glr_client.h"

#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "glr_message.h"
#include "glr_socket.h"

#ifndef MAX_MESSAGE_BYTES /* tests take less */
#define MAX_MESSAGE_BYTES (1u << 30)
#endif
#define N_TRIES 2
#define ALIGNMENT 16 /* of every part: any pixel may stand there */

struct glr_client {
    char host[256];
    int port;
    double timeout_s;
    glr_socket handle;
    char name[64];
    uint64_t next_id;
    glr_buffer request, held;
    glr_message reply;
    glr_error error;
};

int glr_fail(glr_error *error, const char *code, const char *form, ...) {
    va_list values;
    snprintf(error->code, sizeof error->code, "%s", code);
    va_start(values, form);
    vsnprintf(error->message, sizeof error->message, form, values);
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
    free(client->held.data);
    free(client);
}

const char *glr_error_code(const glr_client *client) { return client ? client->error.code : "memory"; }

const char *glr_error_message(const glr_client *client) { return client ? client->error.message : "memory is out"; }

static uint32_t little(const uint8_t *at, int width) {
    uint32_t value = 0;
    while (width--)
        value = value << 8 | at[width];
    return value;
}

static int told(glr_client *client, glr_outcome outcome) {
    if (outcome == GLR_LATE)
        return glr_fail(&client->error, "timeout", "%s:%d did not answer within %g s: %s", client->host, client->port,
                        client->timeout_s, client->handle == GLR_NO_SOCKET ? "no connection; is glrender-server there?"
                        : "the connection stands, so the server is busy, with this request or with others before it; "
                        "open the client with a longer timeout");
    return glr_fail(&client->error, "connection", "no connection to %s:%d; start a server with: glrender-server "
                    "scene.toml --tcp %s:%d", client->host, client->port, client->host, client->port);
}

static size_t aligned(size_t size) { return (size + ALIGNMENT - 1) / ALIGNMENT * ALIGNMENT; }

/* One whole message into client->held, whose parts client->reply names. */
static int receive(glr_client *client, double deadline_s) {
    glr_message *reply = &client->reply;
    uint8_t prefix[8 + 4 * GLR_MAX_PARTS];
    uint64_t total = ALIGNMENT; /* never nothing */
    uint8_t *place;
    uint32_t k;
    glr_outcome outcome = glr_receive_all(client->handle, prefix, 8, deadline_s);
    if (outcome != GLR_DONE)
        return told(client, outcome);
    reply->n_parts = little(prefix + 4, 2);
    if (memcmp(prefix, "GLR1", 4) || reply->n_parts < 1 || reply->n_parts > GLR_MAX_PARTS || little(prefix + 6, 2))
        return glr_fail(&client->error, "protocol", "the server at %s:%d does not speak GLR1", client->host,
                        client->port);
    outcome = glr_receive_all(client->handle, prefix + 8, 4 * (size_t)reply->n_parts, deadline_s);
    if (outcome != GLR_DONE)
        return told(client, outcome);
    for (k = 0; k < reply->n_parts; k++) {
        reply->sizes[k] = little(prefix + 8 + 4 * k, 4);
        total += aligned(reply->sizes[k]);
    }
    if (total > MAX_MESSAGE_BYTES)
        return glr_fail(&client->error, "protocol", "a reply of %llu bytes is too large", (unsigned long long)total);
    client->held.size = 0;
    client->held.failed = 0;
    if (!glr_reserve(&client->held, (size_t)total))
        return glr_fail(&client->error, "memory", "memory is out for a reply of %llu bytes",
                        (unsigned long long)total);
    place = client->held.data;
    for (k = 0; k < reply->n_parts && outcome == GLR_DONE; k++) {
        reply->parts[k] = place;
        outcome = glr_receive_all(client->handle, place, reply->sizes[k], deadline_s);
        place += aligned(reply->sizes[k]);
    }
    return outcome == GLR_DONE ? 0 : told(client, outcome);
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
        uint64_t found;
        if (receive(client, deadline_s))
            return -1;
        if (!glr_read_id(&client->reply, &found))
            return glr_fail(&client->error, "protocol", "a reply's header cannot be read");
        /* Any other is the late reply to a request given up before. */
        if (found == id || found == 0)
            return 0;
        /* Who sends others without a pause must not hold the caller longer than silence does. */
        if (!(glr_now_s() < deadline_s))
            return told(client, GLR_LATE);
    }
}

/* The same request over a new connection after a timeout or a lost one: the server knows a retry. */
static int exchange(glr_client *client, uint64_t id) {
    int attempt, result = -1;
    for (attempt = 0; attempt < N_TRIES; attempt++) {
        result = once(client, id);
        if (result == 0) {
            client->error.code[0] = client->error.message[0] = '\0'; /* of the first try */
            return 0;
        }
        hang_up(client);
        if (strcmp(client->error.code, "timeout") && strcmp(client->error.code, "connection"))
            break;
    }
    return result;
}

static int render(glr_client *client, const glr_state *state, const glr_options *frames, uint32_t n_frames,
                  int is_list, glr_reply *reply) {
    uint64_t id;
    memset(reply, 0, sizeof *reply);
    if (!client)
        return -1;
    id = client->next_id++;
    client->error.code[0] = client->error.message[0] = '\0';
    if (glr_build_render(&client->request, client->name, id, state, frames, n_frames, is_list, &client->error) == 0
        && exchange(client, id) == 0 && glr_read_render(&client->reply, reply, &client->error) == 0) {
        if (reply->n_images || frames->compare)
            return 0;
        glr_fail(&client->error, "protocol", "a reply without an image");
    }
    memset(reply, 0, sizeof *reply);
    return -1;
}

int glr_render(glr_client *client, const glr_state *state, const glr_options *options, glr_image *image) {
    glr_options alone = *options;
    glr_reply reply;
    int result;
    alone.n_products = 0;
    result = render(client, state, &alone, 1, 0, &reply);
    if (result == 0 && strcmp(reply.images[0].name, "image")) {
        result = glr_fail(&client->error, "protocol", "the first array is %s, no image", reply.images[0].name);
        memset(&reply, 0, sizeof reply);
    }
    *image = reply.images[0];
    return result;
}

int glr_compare(glr_client *client, const glr_state *state, const glr_options *options, const glr_frame *frame,
                glr_comparison *comparison) {
    glr_options alone = *options;
    glr_reply reply;
    int result;
    alone.n_products = 0;
    alone.compare = frame;
    result = render(client, state, &alone, 1, 0, &reply);
    *comparison = reply.comparison;
    return result;
}

int glr_render_frames(glr_client *client, const glr_state *state, const glr_options *frames, uint32_t n_frames,
                      glr_reply *reply) {
    /* One frame alone: errors name its fields without its place in a list. */
    return render(client, state, frames, n_frames, n_frames != 1, reply);
}
