/* Compares a uint16 frame by the C client, and prints what comes back:  compare HOST PORT FILE HEIGHT WIDTH */
#include "glr_client.h"

#include <stdio.h>
#include <stdlib.h>

int main(int argc, char **argv) {
    const char *names[] = {"body"}, *derivatives[] = {"spacecraft"};
    glr_pose body = {{0, 0, 0}, {0.6, 0, 0, 0.8}};
    glr_state state = {12.5, {1.5e11, 0, 0}, {{0, 0, -2000}, {1, 0, 0, 0}}, 1, names, &body};
    glr_options options = {.camera = "navcam", .exposure_s = 0.1, .is_column_major = 1};
    glr_frame frame = {.dtype = "uint16", .blur_px = 1.5, .is_robust = 1, .n_derivatives = 1, .is_offset_known = 1};
    glr_comparison found;
    glr_client *client;
    size_t size;
    void *pixels;
    FILE *in;
    uint32_t i, j;
    if (argc != 6 || !(in = fopen(argv[3], "rb")))
        return 2;
    frame.height = (uint32_t)atoi(argv[4]);
    frame.width = (uint32_t)atoi(argv[5]);
    size = 2u * frame.height * frame.width;
    pixels = malloc(size);
    if (fread(pixels, 1, size, in) != size)
        return 2;
    fclose(in);
    frame.pixels = pixels;
    frame.derivatives = derivatives;
    client = glr_open(argv[1], atoi(argv[2]), 30.0);
    if (glr_compare(client, &state, &options, &frame, &found)) {
        printf("error %s: %s\n", glr_error_code(client), glr_error_message(client));
    } else {
        for (i = 0; i < found.n; i++) {
            printf("%s %.17g", found.names[i], found.vector[i]);
            for (j = 0; j < found.n; j++)
                printf(" %.17g", found.matrix[i][j]);
            printf("\n");
        }
        printf("%.17g %.17g %.17g %.17g\n", found.chi2, found.n_pixels, found.gain, found.offset_DN);
    }
    free(pixels);
    glr_close(client);
    return 0;
}
