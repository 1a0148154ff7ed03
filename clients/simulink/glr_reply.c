#include "glr_message.h"

#include <math.h>
#include <string.h>

static glr_reader header_of(const glr_message *message) {
    glr_reader in = {NULL, NULL, 0};
    in.at = message->parts[0];
    in.end = in.at + message->sizes[0];
    return in;
}

int glr_read_id(const glr_message *message, uint64_t *id) {
    glr_reader in = header_of(message);
    uint32_t n_pairs = glr_get_map(&in), k;
    *id = 0;
    for (k = 0; k < n_pairs && !in.failed; k++) {
        if (glr_text_is(glr_get_text(&in), "id")) {
            *id = glr_get_uint(&in);
            break;
        }
        glr_skip(&in);
    }
    return !in.failed;
}

static void read_error(glr_reader *in, glr_error *error) {
    uint32_t n_pairs = glr_get_map(in), k;
    for (k = 0; k < n_pairs && !in->failed; k++) {
        glr_text key = glr_get_text(in);
        if (glr_text_is(key, "code"))
            glr_copy_text(error->code, sizeof error->code, glr_get_text(in));
        else if (glr_text_is(key, "message"))
            glr_copy_text(error->message, sizeof error->message, glr_get_text(in));
        else
            glr_skip(in);
    }
}

/* A number that must not lose its upper half. */
static uint32_t read_uint32(glr_reader *in) {
    uint64_t value = glr_get_uint(in);
    if (value > UINT32_MAX)
        in->failed = 1;
    return (uint32_t)value;
}

/* {name, dtype, shape, order, unit, part, frame}; the number of the part. */
static uint64_t read_image(glr_reader *in, glr_image *image) {
    uint32_t n_pairs = glr_get_map(in), n_axes, k;
    uint64_t part = 0;
    memset(image, 0, sizeof *image);
    image->depth = 1;
    for (k = 0; k < n_pairs && !in->failed; k++) {
        glr_text key = glr_get_text(in);
        if (glr_text_is(key, "name")) {
            glr_copy_text(image->name, sizeof image->name, glr_get_text(in));
        } else if (glr_text_is(key, "dtype")) {
            glr_copy_text(image->dtype, sizeof image->dtype, glr_get_text(in));
        } else if (glr_text_is(key, "shape")) {
            n_axes = glr_get_list(in);
            if (n_axes != 2 && n_axes != 3)
                in->failed = 1;
            image->height = read_uint32(in);
            image->width = read_uint32(in);
            if (n_axes == 3)
                image->depth = read_uint32(in);
        } else if (glr_text_is(key, "part")) {
            part = glr_get_uint(in);
        } else if (glr_text_is(key, "frame")) {
            image->frame = read_uint32(in);
        } else {
            glr_skip(in);
        }
    }
    return part;
}

static size_t width_of(const char *dtype) {
    static const struct {
        const char *dtype;
        size_t width;
    } known[] = {{"uint8", 1}, {"uint16", 2}, {"int32", 4}, {"float32", 4}, {"float64", 8}};
    size_t k;
    for (k = 0; k < sizeof known / sizeof known[0]; k++)
        if (!strcmp(dtype, known[k].dtype))
            return known[k].width;
    return 0;
}

/* The list of images; each must be what its part holds. */
static int read_images(glr_reader *in, const glr_message *message, glr_reply *reply, glr_error *error) {
    uint32_t count = glr_get_list(in), k;
    if (count > GLR_MAX_IMAGES)
        in->failed = 1;
    for (k = 0; k < count && !in->failed; k++) {
        glr_image *image = &reply->images[k];
        uint64_t part = read_image(in, image), needed;
        if (in->failed)
            break;
        if (part < 1 || part >= message->n_parts)
            return glr_fail(error, "protocol", "image %u is part %llu of %u", (unsigned)k, (unsigned long long)part,
                            (unsigned)message->n_parts);
        image->pixels = message->parts[part];
        image->n_bytes = message->sizes[part];
        /* In steps that cannot overflow: each side is below 2^32, the rest at most 24. */
        needed = (uint64_t)image->height * image->width;
        if (image->depth < 1 || image->depth > 3 || needed > UINT32_MAX
            || needed * image->depth * width_of(image->dtype) != image->n_bytes || !image->n_bytes)
            return glr_fail(error, "protocol", "%llu bytes are no image of %u x %u x %u %s",
                            (unsigned long long)image->n_bytes, (unsigned)image->width, (unsigned)image->height,
                            (unsigned)image->depth, image->dtype);
        reply->n_images = k + 1;
    }
    return 0;
}

static void read_warnings(glr_reader *in, glr_reply *reply, uint32_t frame) {
    uint32_t count = glr_get_list(in), k, j;
    for (k = 0; k < count && !in->failed; k++) {
        const int has_place = reply->n_warnings < GLR_MAX_WARNINGS;
        glr_warning spare, *warning = has_place ? &reply->warnings[reply->n_warnings++] : &spare;
        uint32_t n_pairs = glr_get_map(in);
        memset(warning, 0, sizeof *warning);
        warning->frame = frame;
        for (j = 0; j < n_pairs && !in->failed; j++) {
            glr_text key = glr_get_text(in);
            if (glr_text_is(key, "code"))
                glr_copy_text(warning->code, sizeof warning->code, glr_get_text(in));
            else if (glr_text_is(key, "message"))
                glr_copy_text(warning->message, sizeof warning->message, glr_get_text(in));
            else
                glr_skip(in);
        }
    }
}

/* `n` numbers; no others may stand there. */
static void read_vector(glr_reader *in, double *values, uint32_t n) {
    uint32_t k;
    if (glr_get_list(in) != n)
        in->failed = 1;
    for (k = 0; k < n && !in->failed; k++)
        values[k] = glr_get_double(in);
}

/* Names come first: they say how many numbers there are. */
static void read_comparison(glr_reader *in, glr_comparison *found) {
    uint32_t n_pairs = glr_get_map(in), k, j;
    for (k = 0; k < n_pairs && !in->failed; k++) {
        glr_text key = glr_get_text(in);
        if (glr_text_is(key, "names")) {
            found->n = glr_get_list(in);
            if (found->n > GLR_MAX_PARAMETERS)
                in->failed = 1;
            for (j = 0; j < found->n && !in->failed; j++)
                glr_copy_text(found->names[j], sizeof found->names[j], glr_get_text(in));
        } else if (glr_text_is(key, "matrix")) {
            if (glr_get_list(in) != found->n)
                in->failed = 1;
            for (j = 0; j < found->n && !in->failed; j++)
                read_vector(in, found->matrix[j], found->n);
        } else if (glr_text_is(key, "vector"))
            read_vector(in, found->vector, found->n);
        else if (glr_text_is(key, "chi2"))
            found->chi2 = glr_get_double(in);
        else if (glr_text_is(key, "n_pixels"))
            found->n_pixels = glr_get_double(in);
        else if (glr_text_is(key, "gain"))
            found->gain = glr_get_double(in);
        else if (glr_text_is(key, "offset_DN"))
            found->offset_DN = glr_get_double(in);
        else
            glr_skip(in);
    }
}

static double read_predicted_error(glr_reader *in) {
    uint32_t n_pairs = glr_get_map(in), k;
    double found = NAN;
    for (k = 0; k < n_pairs && !in->failed; k++)
        if (glr_text_is(glr_get_text(in), "predicted_error"))
            found = glr_get_number(in);
        else
            glr_skip(in);
    return found;
}

/* Whether a pair is a fact of one frame; its value is read then. */
static int read_fact(glr_reader *in, glr_text key, glr_reply *reply, uint32_t frame) {
    if (frame >= GLR_MAX_IMAGES)
        return 0;
    if (glr_text_is(key, "warnings"))
        read_warnings(in, reply, frame);
    else if (glr_text_is(key, "seed"))
        reply->seeds[frame] = glr_get_uint(in);
    else if (glr_text_is(key, "is_late"))
        reply->is_late[frame] = glr_get_bool(in);
    else if (glr_text_is(key, "exposure_s"))
        reply->exposure_s[frame] = glr_get_number(in);
    else if (glr_text_is(key, "plan"))
        reply->predicted_error[frame] = read_predicted_error(in);
    else
        return 0;
    return 1;
}

static void read_frames(glr_reader *in, glr_reply *reply) {
    uint32_t count = glr_get_list(in), k, j;
    for (k = 0; k < count && !in->failed; k++) {
        uint32_t n_pairs = glr_get_map(in);
        for (j = 0; j < n_pairs && !in->failed; j++)
            if (!read_fact(in, glr_get_text(in), reply, k))
                glr_skip(in);
    }
}

int glr_read_render(const glr_message *message, glr_reply *reply, glr_error *error) {
    glr_reader in = header_of(message);
    uint32_t n_pairs = glr_get_map(&in), k;
    int ok = 0, has_comparison = 0;
    memset(reply, 0, sizeof *reply);
    for (k = 0; k < GLR_MAX_IMAGES; k++)
        reply->exposure_s[k] = reply->predicted_error[k] = NAN;
    reply->header = message->parts[0];
    reply->n_header_bytes = message->sizes[0];
    for (k = 0; k < n_pairs && !in.failed; k++) {
        glr_text key = glr_get_text(&in);
        if (glr_text_is(key, "ok"))
            ok = glr_get_bool(&in);
        else if (glr_text_is(key, "error"))
            read_error(&in, error);
        else if (glr_text_is(key, "arrays")) {
            if (read_images(&in, message, reply, error))
                return -1;
        } else if (glr_text_is(key, "frames"))
            read_frames(&in, reply);
        else if (glr_text_is(key, "comparison")) {
            read_comparison(&in, &reply->comparison);
            has_comparison = 1;
        } else if (!read_fact(&in, key, reply, 0))
            glr_skip(&in);
    }
    if (in.failed)
        return glr_fail(error, "protocol", "a reply's header cannot be read");
    if (!ok)
        return error->code[0] ? -1 : glr_fail(error, "protocol", "a refusal without a code");
    if (!reply->n_images && !has_comparison)
        return glr_fail(error, "protocol", "a reply without an image");
    return 0;
}
