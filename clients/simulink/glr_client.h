/* A C client of the glrender service over framed TCP: plain sockets, C99, no other library.
 *
 *     glr_client *client = glr_open("127.0.0.1", 5556, 10.0);
 *     if (client && glr_render(client, &state, &options, &image) == 0) ... image.pixels ...
 *     else ... glr_error_code(client), glr_error_message(client) ...
 *     glr_close(client);
 *
 * One thread at a time per client. Units and frames as in docs/conventions.md.
 */
#ifndef GLR_CLIENT_H
#define GLR_CLIENT_H

#include <stddef.h>
#include <stdint.h>

typedef struct glr_client glr_client;

typedef struct {
    double r_inertial_m[3];
    double q_from_inertial[4]; /* unit quaternion [w, x, y, z] */
} glr_pose;

typedef struct {
    double t_s;
    double r_sun_inertial_m[3];
    glr_pose spacecraft;
    uint32_t n_bodies; /* every body of the scene */
    const char *const *body_names;
    const glr_pose *bodies;
} glr_state;

/* Zero-initialise: then the scene's only camera, its irradiance, row-major. */
typedef struct {
    const char *camera; /* NULL: the scene's only one */
    int is_dn;          /* digital numbers instead of irradiance [W/m2 per pixel] */
    double exposure_s;  /* of digital numbers; 0: the camera's */
    uint64_t seed;      /* of the noise of digital numbers */
    double max_error;   /* 0: the scene's */
    int is_column_major;
} glr_options;

typedef struct {
    const void *pixels; /* the client's, until its next call */
    size_t n_bytes;
    uint32_t height, width;
    char dtype[16]; /* "uint8", "uint16", "float32" */
} glr_image;

/* A client, connected at its first request; NULL when memory is out.
 * timeout_s [s]: of each try of a request; there are two, the second over a new connection. */
glr_client *glr_open(const char *host, int port, double timeout_s);

/* 0, or -1: then the error below says why, and the client may be used on. */
int glr_render(glr_client *client, const glr_state *state, const glr_options *options, glr_image *image);

/* Code of the last error: those of docs/protocol.md, or "timeout", "connection", "protocol", "memory".
 * The message names field, rule and value. Both are the client's, until its next call. NULL client: "memory". */
const char *glr_error_code(const glr_client *client);
const char *glr_error_message(const glr_client *client);

/* Hang up and free; NULL is welcome. */
void glr_close(glr_client *client);

#endif
