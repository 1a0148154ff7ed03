#include "glr_message.h"

#include <string.h>

#define PREFIX_BYTES 12 /* "GLR1", one part, no flags, its size */

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

static int has_roi(const glr_options *frame) {
    return frame->roi[0] || frame->roi[1] || frame->roi[2] || frame->roi[3];
}

static uint32_t n_units(const glr_options *frame) {
    return (uint32_t)(frame->max_flux > 0.0) + (frame->max_centroid_px > 0.0) + (frame->max_limb_px > 0.0)
           + (frame->max_range > 0.0);
}

static void put_positive(glr_buffer *out, const char *name, double number) {
    if (number > 0.0) {
        glr_put_text(out, name);
        glr_put_double(out, number);
    }
}

static uint32_t n_fields(const glr_options *frame) {
    return 1u + (frame->camera != NULL) + (frame->is_dn ? 1u + (frame->exposure_s != 0.0) : 0u)
           + (frame->max_error > 0.0 || n_units(frame)) + (frame->samples > 0) + (frame->n_products > 0) + (uint32_t)has_roi(frame)
           + (frame->deadline_s > 0.0);
}

/* The pairs of one frame, `n_fields` of them. */
static void put_frame(glr_buffer *out, const glr_options *frame) {
    uint32_t k;
    if (frame->camera) {
        glr_put_text(out, "camera");
        glr_put_text(out, frame->camera);
    }
    glr_put_text(out, "output");
    glr_put_text(out, frame->is_dn ? "dn" : "irradiance");
    if (frame->is_dn && frame->exposure_s != 0.0) {
        glr_put_text(out, "exposure_s");
        if (frame->exposure_s < 0.0)
            glr_put_text(out, "auto");
        else
            glr_put_double(out, frame->exposure_s);
    }
    if (frame->is_dn) {
        glr_put_text(out, "seed");
        glr_put_uint(out, frame->seed);
    }
    if (n_units(frame)) {
        glr_put_text(out, "max_error");
        glr_put_map(out, n_units(frame) + (frame->max_error > 0.0));
        put_positive(out, "rms", frame->max_error);
        put_positive(out, "flux", frame->max_flux);
        put_positive(out, "centroid_px", frame->max_centroid_px);
        put_positive(out, "limb_px", frame->max_limb_px);
        put_positive(out, "range", frame->max_range);
    } else {
        put_positive(out, "max_error", frame->max_error);
    }
    if (frame->samples) {
        glr_put_text(out, "samples");
        glr_put_uint(out, frame->samples);
    }
    if (frame->n_products) {
        glr_put_text(out, "products");
        glr_put_list(out, frame->n_products);
        for (k = 0; k < frame->n_products; k++)
            glr_put_text(out, frame->products[k]);
    }
    put_positive(out, "deadline_s", frame->deadline_s);
    if (has_roi(frame)) {
        glr_put_text(out, "roi");
        glr_put_list(out, 4);
        for (k = 0; k < 4; k++)
            glr_put_uint(out, frame->roi[k]);
    }
}

int glr_build_render(glr_buffer *out, const char *client, uint64_t id, const glr_state *state,
                     const glr_options *frames, uint32_t n_frames, int is_list, glr_error *error) {
    uint8_t *prefix;
    uint32_t size, k;
    out->size = 0;
    out->failed = 0;
    prefix = glr_reserve(out, PREFIX_BYTES);
    if (prefix)
        memcpy(prefix, "GLR1\1\0\0\0\0\0\0\0", PREFIX_BYTES);
    glr_put_map(out, 6u + (n_frames && frames[0].backend) + (n_frames && frames[0].scene) + (is_list ? 1u : n_fields(frames)));
    glr_put_text(out, "v");
    glr_put_uint(out, 1);
    glr_put_text(out, "op");
    glr_put_text(out, "render");
    glr_put_text(out, "id");
    glr_put_uint(out, id);
    glr_put_text(out, "client");
    glr_put_text(out, client);
    glr_put_text(out, "state");
    put_state(out, state);
    glr_put_text(out, "order");
    glr_put_text(out, n_frames && frames[0].is_column_major ? "F" : "C");
    if (n_frames && frames[0].scene) {
        glr_put_text(out, "scene");
        glr_put_text(out, frames[0].scene);
    }
    if (n_frames && frames[0].backend) {
        glr_put_text(out, "backend");
        glr_put_text(out, frames[0].backend);
    }
    if (is_list) {
        glr_put_text(out, "frames");
        glr_put_list(out, n_frames);
        for (k = 0; k < n_frames; k++) {
            glr_put_map(out, n_fields(&frames[k]));
            put_frame(out, &frames[k]);
        }
    } else {
        put_frame(out, frames);
    }
    if (out->failed || out->size > UINT32_MAX)
        return glr_fail(error, "memory", "memory is out for a request");
    size = (uint32_t)(out->size - PREFIX_BYTES);
    for (k = 0; k < 4; k++)
        out->data[8 + k] = (uint8_t)(size >> (8 * k));
    return 0;
}
