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

#define GLR_MAX_IMAGES 15 /* images and products of one reply */
#define GLR_MAX_PARAMETERS 16 /* of a comparison */
#define GLR_MAX_WARNINGS 8 /* warnings that a reply keeps; `header` has all */

typedef struct glr_client glr_client;

typedef struct {
    double r_inertial_m[3];
    double q_from_inertial[4]; /* unit quaternion [w, x, y, z]: components in inertial to those in the frame */
} glr_pose;

typedef struct {
    double t_s;
    double r_sun_inertial_m[3];
    glr_pose spacecraft;
    uint32_t n_bodies; /* every body of the scene */
    const char *const *body_names;
    const glr_pose *bodies;
} glr_state;

/* A camera's frame, or the part of it that `roi` is, to be compared with the predicted one; about 1 MB at most. */
typedef struct {
    const void *pixels; /* row by row, little-endian */
    const char *dtype;  /* "uint8", "uint16", "float32", "float64" */
    uint32_t height, width;
    double blur_px; /* deviation of a Gaussian by which both are blurred; 0: none */
    int is_robust;  /* whether pixels that differ by much more than most weigh less */
    uint32_t n_derivatives; /* 0: the six of the spacecraft */
    const char *const *derivatives;
    int is_gain_known, is_offset_known;
} glr_frame;

/* The normal equations of the fit that explains a frame: matrix x step = vector. The last are "gain" and "offset", unless
 * they are known; a parameter that is known is left out with its row and column. */
typedef struct {
    uint32_t n;
    char names[GLR_MAX_PARAMETERS][48]; /* "spacecraft[0]" [m], ...: units as in docs/derivatives.md */
    double matrix[GLR_MAX_PARAMETERS][GLR_MAX_PARAMETERS];
    double vector[GLR_MAX_PARAMETERS];
    double chi2, n_pixels; /* of the weighted residuals; pixels that count */
    double gain, offset_DN; /* best ones at the state that was sent */
} glr_comparison;

/* Zero-initialise: then the scene's only camera, its irradiance, row-major, nothing beside it. */
typedef struct {
    const char *camera; /* NULL: the scene's only one */
    int is_dn;          /* digital numbers instead of irradiance [W/m2 per pixel]; streams are not for this client */
    double exposure_s;  /* of digital numbers; 0: the camera's; below 0: automatic */
    uint64_t seed;      /* of the noise of digital numbers; equal seeds give equal noise: count your frames */
    double max_error;   /* RMS tolerance; 0, and none of the next four: the scene's */
    double max_flux, max_centroid_px, max_limb_px, max_range; /* tolerances in further units; 0: none */
    int is_column_major;
    uint32_t samples; /* along a pixel's side; 0: the planner's choice */
    uint32_t n_products;
    const char *const *products; /* "range", "body_id", "facet_id", "incidence", "emission", "phase", ... */
    const char *backend; /* who draws instead of the server's own backend, in seconds or minutes: "raytrace" or "cycles";
                            NULL: the server's. Of the first frame, for all; open the client with a timeout as long */
    uint32_t roi[4]; /* region of interest [px]: x0, y0, x1, y1, one past the last; 0, 0, 0, 0: the whole */
    const char *scene; /* digest of the scene that is meant (docs/protocol.md): where another is served, the frame is
                          refused; NULL: whatever is served. Of the first frame, for all */
    double deadline_s; /* [s] after which nothing more of the frame is begun; 0: none */
    const glr_frame *compare; /* of glr_compare */
} glr_options;

/* The image or a product of a frame. */
typedef struct {
    char name[24];          /* "image", or the product's */
    char dtype[16];         /* "uint8", "uint16", "int32", "float32", "float64" */
    uint32_t frame;         /* index of its frame in the request */
    uint32_t height, width; /* pixels */
    uint32_t depth;         /* numbers per pixel: 1, or 3 */
    const void *pixels;     /* the client's, until its next call */
    size_t n_bytes;
} glr_image;

/* A warning of a frame: what is odd in its view, or a tolerance that is missed. */
typedef struct {
    uint32_t frame;    /* index of its frame in the request */
    char code[32];     /* as in docs/protocol.md */
    char message[256]; /* a longer one ends early */
} glr_warning;

typedef struct {
    uint32_t n_images;
    glr_image images[GLR_MAX_IMAGES];
    uint32_t n_warnings;
    glr_warning warnings[GLR_MAX_WARNINGS];
    uint64_t seeds[GLR_MAX_IMAGES]; /* by frame: of the noise of digital numbers */
    int is_late[GLR_MAX_IMAGES];    /* by frame: whether it took longer than its deadline_s */
    glr_comparison comparison;      /* of glr_compare */
    double exposure_s[GLR_MAX_IMAGES];      /* by frame: of digital numbers, as "auto" chose it [s]; else NaN */
    double predicted_error[GLR_MAX_IMAGES]; /* by frame: RMS over the mean of lit pixels [1] */
    const void *header;             /* all of it as msgpack, the client's until its next call: plan, stages, ... */
    size_t n_header_bytes;
} glr_reply;

/* A client, connected at its first request; NULL when memory is out.
 * timeout_s [s]: of each try of a request; there are two, the second over a new connection. */
glr_client *glr_open(const char *host, int port, double timeout_s);

/* One frame; its products are left out. 0, or -1: then the error below says why, and the client may be used on. */
int glr_render(glr_client *client, const glr_state *state, const glr_options *options, glr_image *image);

/* Several frames of one state in one request, with their products; `is_column_major` of the first holds for all.
 * The images come in the order of the frames, each frame's image before its products. */
int glr_render_frames(glr_client *client, const glr_state *state, const glr_options *frames, uint32_t n_frames,
                      glr_reply *reply);

/* How a frame differs from the one that a state, and the exposure of `options`, predict. 0, or -1 as above. */
int glr_compare(glr_client *client, const glr_state *state, const glr_options *options, const glr_frame *frame,
                glr_comparison *comparison);

/* Code of the last error: those of docs/protocol.md, or "timeout", "connection", "protocol", "memory".
 * The message names field, rule and value. Both are the client's, until its next call. NULL client: "memory". */
const char *glr_error_code(const glr_client *client);
const char *glr_error_message(const glr_client *client);

/* Hang up and free; NULL is welcome. */
void glr_close(glr_client *client);

#endif
