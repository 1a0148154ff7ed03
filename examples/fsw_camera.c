/* A camera for 42, or for an application of cFS: one line of numbers in, one picture (PGM) out.
 *     cc -Iclients/simulink examples/fsw_camera.c clients/simulink/glr_*.c -lm -o fsw_camera
 *     glrender-server scene.toml --tcp 127.0.0.1:5556 &  ./fsw_camera 5556 itokawa navcam < states.txt
 * A line: time [s], spacecraft from the body [m], 42's qn (scalar last, N to B), the Sun from the body [m]. In 42 these
 * are SC[0].PosN, SC[0].B[0].qn and minus the world's PosH; in cFS fields of your navigation message.
 */
#include "glr_client.h"

#include <stdio.h>
#include <stdlib.h>

int main(int argc, char **argv) {
    glr_pose body = {{0, 0, 0}, {1, 0, 0, 0}};
    glr_state s = {0};
    glr_options options = {.is_dn = 1};
    glr_client *client = argc == 4 ? glr_open("127.0.0.1", atoi(argv[1]), 10.0) : NULL;
    glr_image image;
    double q[4], *r = s.spacecraft.r_inertial_m, *sun = s.r_sun_inertial_m;
    s.n_bodies = 1, s.body_names = (const char *const *)&argv[2], s.bodies = &body;
    options.camera = argc == 4 ? argv[3] : NULL;
    while (client && scanf("%lf %lf %lf %lf %lf %lf %lf %lf %lf %lf %lf", &s.t_s, r, r + 1, r + 2, q, q + 1, q + 2,
                           q + 3, sun, sun + 1, sun + 2) == 11) {
        /* 42 turns frames, glrender vectors, and has the scalar first. */
        double turned[4] = {q[3], -q[0], -q[1], -q[2]};
        for (int k = 0; k < 4; k++)
            s.spacecraft.q_from_inertial[k] = turned[k];
        if (glr_render(client, &s, &options, &image)) {
            fprintf(stderr, "%g s: %s: %s\n", s.t_s, glr_error_code(client), glr_error_message(client));
            continue; /* the loop flies on without this picture */
        }
        printf("P5\n%u %u\n255\n", image.width, image.height);
        fwrite(image.pixels, 1, image.n_bytes, stdout); /* of a detector of 8 bits */
    }
    glr_close(client);
    return client ? 0 : 2;
}
