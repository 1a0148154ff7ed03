// What the pixel's centre sees: range, angles, place and identity; unlit facets too.
#include "constants.glsl"
#include "surface.glsl"
layout(location = 0) out vec4 range_and_angles; // range, or where far off range - range of the body's origin [m]; incidence, emission, phase [rad]
layout(location = 1) out vec4 place;            // r_body [m], 1 in sunlight
layout(location = 2) out vec4 identity;         // body + 1, facet modulo 4096, facet / 4096: exact in float32

float angle(vec3 a, vec3 b) { return 2.0 * atan(length(a - b), length(a + b)); }

void main()
{
    vec3 to_camera = normalize(camera_offset());
    vec3 normal = facet_normal(to_camera);
    float cos_incidence = dot(normal, sun_direction_body);
    vec3 r = body_position();
#if RELATIVE_TO_CAMERA
    float range = length(r_surface);
#else
    // |c - r| - |c| without the loss of taking a difference of ranges.
    float shorter = dot(r, r) - 2.0 * dot(r, r_camera_body);
    float range = shorter / (length(camera_offset()) + length(r_camera_body));
#endif
    range_and_angles = vec4(range, angle(normal, sun_direction_body), angle(normal, to_camera),
                            angle(sun_direction_body, to_camera));
    place = vec4(r, cos_incidence > 0.0 ? sunlit(cos_incidence) : 0.0);
    int facet = first_facet + facet_index();
    identity = vec4(float(body_id + 1), float(facet % 4096), float(facet / 4096), 1.0);
}
