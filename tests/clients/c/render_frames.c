/* N requests for two frames through the C client; prints what each gave, and keeps the last one's pixels:
 *     render_frames HOST PORT TIMEOUT COUNT CAMERA2 PRODUCT X0 Y0 X1 Y1 OUT
 */
#include "glr_client.h"

#include <stdio.h>
#include <stdlib.h>

int main(int argc, char **argv) {
    const char *names[] = {"body"}, *products[1];
    glr_pose body = {{0, 0, 0}, {0.6, 0, 0, 0.8}};
    glr_state state = {12.5, {1.5e11, 0, 0}, {{0, 0, -2000}, {1, 0, 0, 0}}, 1, names, &body};
    glr_options frames[] = {{.camera = "navcam", .is_dn = 1, .exposure_s = 0.1, .seed = 7, .is_column_major = 1},
                            {.is_column_major = 1}};
    glr_client *client;
    glr_reply reply = {0};
    FILE *out;
    uint32_t i;
    int k;
    if (argc != 12)
        return 2;
    frames[1].camera = argv[5];
    products[0] = argv[6];
    frames[0].products = products;
    frames[0].n_products = 1;
    frames[0].scene = getenv("GLR_SCENE");
    frames[0].deadline_s = getenv("GLR_FACTS") ? 1e-6 : 0.0;
    for (k = 0; k < 4; k++)
        frames[1].roi[k] = (uint32_t)atoi(argv[7 + k]);
    client = glr_open(argv[1], atoi(argv[2]), atof(argv[3]));
    for (k = 0; k < atoi(argv[4]); k++) {
        if (glr_render_frames(client, &state, frames, 2, &reply)) {
            printf("error %s: %s\n", glr_error_code(client), glr_error_message(client));
            continue;
        }
        printf("images");
        for (i = 0; i < reply.n_images; i++) {
            /* Read every byte: the sanitizer sees whether they are ours. */
            const glr_image *image = &reply.images[i];
            unsigned sum = 0;
            size_t at;
            for (at = 0; at < image->n_bytes; at++)
                sum += ((const unsigned char *)image->pixels)[at];
            printf(" | %u %s %u %u %u %s %u", (unsigned)image->frame, image->name, (unsigned)image->height,
                   (unsigned)image->width, (unsigned)image->depth, image->dtype, sum);
        }
        printf("\n");
        if (getenv("GLR_FACTS")) {
            printf("header of %u bytes", (unsigned)reply.n_header_bytes);
            for (i = 0; i < 2; i++)
                printf(" | seed %llu late %d", (unsigned long long)reply.seeds[i], reply.is_late[i]);
            for (i = 0; i < reply.n_warnings; i++)
                printf(" | %u %s: %s", (unsigned)reply.warnings[i].frame, reply.warnings[i].code,
                       reply.warnings[i].message);
            printf("\n");
        }
    }
    out = fopen(argv[11], "wb");
    for (i = 0; out && i < reply.n_images; i++)
        fwrite(reply.images[i].pixels, 1, reply.images[i].n_bytes, out);
    if (out)
        fclose(out);
    glr_close(client);
    return out ? 0 : 2;
}
