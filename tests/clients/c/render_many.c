/* N requests through the C client against any server, good or hostile; prints what each gave. */
#include "glr_client.h"

#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>

/* Fields are added at the end: sources written for an older header mean the same by their places. */
_Static_assert(offsetof(glr_options, scene) > offsetof(glr_options, roi), "scene came after roi");

int main(int argc, char **argv) {
    const char *names[] = {"body"};
    glr_pose body = {{0, 0, 0}, {0.6, 0, 0, 0.8}};
    glr_state state = {12.5, {1.5e11, 0, 0}, {{0, 0, -2000}, {1, 0, 0, 0}}, 1, names, &body};
    glr_options options = {.camera = "navcam", .is_dn = 1, .exposure_s = 0.1, .seed = 7, .is_column_major = 1};
    glr_client *client;
    int k;
    if (argc != 5)
        return 2;
    client = glr_open(argv[1], atoi(argv[2]), atof(argv[3]));
    for (k = 0; k < atoi(argv[4]); k++) {
        glr_image image;
        size_t i;
        if (glr_render(client, &state, &options, &image)) {
            printf("error %s: %s\n", glr_error_code(client), glr_error_message(client));
        } else {
            /* Read every byte: the sanitizer sees whether they are ours. */
            unsigned sum = 0;
            for (i = 0; i < image.n_bytes; i++)
                sum += ((const unsigned char *)image.pixels)[i];
            printf("image %u %u %s %u\n", (unsigned)image.height, (unsigned)image.width, image.dtype, sum);
        }
    }
    glr_close(client);
    glr_close(NULL);
    return 0;
}
