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

static int has_both_unknown(const glr_frame *compare) { return !compare->is_gain_known && !compare->is_offset_known; }

static uint32_t n_fields(const glr_options *frame) {
    const glr_frame *compare = frame->compare;
    uint32_t n_of_output = 1u + (frame->is_dn ? 1u + (frame->exposure_s != 0.0) : 0u);
    if (compare)
        n_of_output = 1u + (frame->exposure_s != 0.0) + (compare->n_derivatives > 0) + !has_both_unknown(compare);
    return n_of_output + (frame->camera != NULL)
           + (frame->max_error > 0.0 || n_units(frame)) + (frame->samples > 0) + (frame->n_products > 0) + (uint32_t)has_roi(frame)
           + (frame->deadline_s > 0.0);
}

/* As glr_put_text, of a list. */
static void put_texts(glr_buffer *out, const char *name, const char *const *texts, uint32_t count) {
    uint32_t k;
    glr_put_text(out, name);
    glr_put_list(out, count);
    for (k = 0; k < count; k++)
        glr_put_text(out, texts[k]);
}

static size_t width_of(const char *dtype) {
    return !strcmp(dtype, "uint8") ? 1 : !strcmp(dtype, "uint16") ? 2 : !strcmp(dtype, "float32") ? 4 : 8;
}

static void put_compare(glr_buffer *out, const glr_frame *compare) {
    const char *unknown[2];
    uint32_t n_unknown = 0;
    if (compare->n_derivatives)
        put_texts(out, "derivatives", compare->derivatives, compare->n_derivatives);
    if (!has_both_unknown(compare)) {
        if (!compare->is_gain_known)
            unknown[n_unknown++] = "gain";
        if (!compare->is_offset_known)
            unknown[n_unknown++] = "offset";
        put_texts(out, "unknown", unknown, n_unknown);
    }
    glr_put_text(out, "compare");
    glr_put_map(out, 3u + (compare->blur_px > 0.0) + (compare->is_robust != 0));
    glr_put_text(out, "pixels");
    glr_put_bytes(out, compare->pixels, (size_t)compare->height * compare->width * width_of(compare->dtype));
    glr_put_text(out, "dtype");
    glr_put_text(out, compare->dtype);
    glr_put_text(out, "shape");
    glr_put_list(out, 2);
    glr_put_uint(out, compare->height);
    glr_put_uint(out, compare->width);
    put_positive(out, "blur_px", compare->blur_px);
    if (compare->is_robust) {
        glr_put_text(out, "robust");
        glr_put_bool(out, 1);
    }
}

/* The pairs of one frame, `n_fields` of them. */
static void put_frame(glr_buffer *out, const glr_options *frame) {
    uint32_t k;
    if (frame->camera) {
        glr_put_text(out, "camera");
        glr_put_text(out, frame->camera);
    }
    if (!frame->compare) {
        glr_put_text(out, "output");
        glr_put_text(out, frame->is_dn ? "dn" : "irradiance");
    }
    if ((frame->is_dn || frame->compare) && frame->exposure_s != 0.0) {
        glr_put_text(out, "exposure_s");
        if (frame->exposure_s < 0.0)
            glr_put_text(out, "auto");
        else
            glr_put_double(out, frame->exposure_s);
    }
    if (frame->is_dn && !frame->compare) {
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
    if (frame->n_products)
        put_texts(out, "products", frame->products, frame->n_products);
    if (frame->compare)
        put_compare(out, frame->compare);
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
