/* Milliseconds of each of N frames through the C client: transport_client HOST PORT CAMERA DN COUNT < state (doubles) */
#define _POSIX_C_SOURCE 200809L
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "glr_client.h"

static double now_ms(void) {
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return 1e3 * (double)now.tv_sec + 1e-6 * (double)now.tv_nsec;
}

int main(int argc, char **argv) {
    const char *names[] = {"body"};
    glr_pose body;
    glr_state state;
    glr_options options;
    glr_client *client;
    double numbers[17], began;
    int k;
    if (argc != 6 || fread(numbers, sizeof(double), 17, stdin) != 17)
        return 2;
    memset(&options, 0, sizeof options);
    memcpy(state.r_sun_inertial_m, numbers, sizeof state.r_sun_inertial_m);
    memcpy(&state.spacecraft, numbers + 3, sizeof state.spacecraft);
    memcpy(&body, numbers + 10, sizeof body);
    state.n_bodies = 1;
    state.body_names = names;
    state.bodies = &body;
    options.camera = argv[3];
    options.is_dn = atoi(argv[4]);
    options.is_column_major = 1;
    client = glr_open(argv[1], atoi(argv[2]), 60.0);
    for (k = 0; k < atoi(argv[5]); k++) {
        glr_image image;
        state.t_s = k;
        began = now_ms();
        if (glr_render(client, &state, &options, &image)) {
            fprintf(stderr, "%s\n", glr_error_message(client));
            return 1;
        }
        printf("%.4f\n", now_ms() - began);
    }
    glr_close(client);
    return 0;
}
