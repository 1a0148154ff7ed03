/* Render requests and their replies, as docs/protocol.md writes them down. Private to glr_client.c. */
#ifndef GLR_MESSAGE_H
#define GLR_MESSAGE_H

#include "glr_client.h"
#include "glr_wire.h"

#define GLR_MAX_PARTS 16

typedef struct {
    char code[32], message[512];
} glr_error;

/* Says what is wrong; -1. */
int glr_fail(glr_error *error, const char *code, const char *form, ...);

/* The TCP frame of a request into `out`. One frame's fields stand in the request itself, unless `is_list`. */
int glr_build_render(glr_buffer *out, const char *client, uint64_t id, const glr_state *state,
                     const glr_options *frames, uint32_t n_frames, int is_list, glr_error *error);

/* A message that came: part 0 is the header. */
typedef struct {
    uint32_t n_parts;
    const uint8_t *parts[GLR_MAX_PARTS];
    uint32_t sizes[GLR_MAX_PARTS];
} glr_message;

/* Whether the header can be read, and the id in it. */
int glr_read_id(const glr_message *message, uint64_t *id);

/* 0 and the images, which point into the message; or -1: the server's own error, or a reply that breaks the protocol. */
int glr_read_render(const glr_message *message, glr_reply *reply, glr_error *error);

#endif
