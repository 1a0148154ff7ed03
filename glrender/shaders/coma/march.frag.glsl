// Columns of dust along the rays of a coarse grid of pixels, summed up to eight ends; twin: emission/column.py.
// A column is 1/a times the integral of K = k r^2 over theta: what is written is the integral, which is smooth.
#include "coma/ray.glsl"
uniform sampler3D weights;
#if HAS_SHADOW
uniform sampler2DShadow shadow_map;
#endif
layout(location = 0) out vec4 first_ends;
layout(location = 1) out vec4 last_ends;

float weight(vec3 r)
{
#if SPHERICAL
    vec3 size = vec3(textureSize(weights, 0));
    vec3 unit = r / (abs(r.x) + abs(r.y) + abs(r.z) + 1e-30);
    vec2 side = vec2(unit.x < 0.0 ? -1.0 : 1.0, unit.y < 0.0 ? -1.0 : 1.0);
    vec2 place = unit.z < 0.0 ? (1.0 - abs(unit.yx)) * side : unit.xy;
    // The outermost texels are neighbours across the map's edges.
    vec2 uv = ((place * 0.5 + 0.5) * (size.xy - 2.0) + 1.0) / size.xy;
    float shell = log2(max(length(r), 1e-30) / inner_m) * shells_per_octave;
    return texture(weights, vec3(uv, (shell + 0.5) / size.z)).r;
#else
    return texture(weights, (r - low_m) / (high_m - low_m)).r;
#endif
}

void main()
{
    Ray ray = ray_of((gl_FragCoord.xy - 0.5) * pixels_per_node);
    vec2 span = span_of(ray);
    int steps = steps_per_end;
    float width = (span.y - span.x) / float(8 * steps);
    // sin and cos of theta are turned on from step to step: 1e-7 a step, some thousand steps at most.
    float sine = sin(span.x + 0.5 * width), cosine = cos(span.x + 0.5 * width);
    float sine_step = sin(width), cosine_step = cos(width);
    float rho2 = ray.rho * ray.rho, a2 = ray.a * ray.a;
    float total = 0.0;
    float ends[8];
    for (int end = 0; end < 8; ++end) {
        for (int step = 0; step < steps; ++step) {
            float s = ray.a * sine / max(cosine, 1e-7);
            vec3 r = ray.closest + s * ray.direction;
            float value = weight(r) * (a2 + s * s) / max(rho2 + s * s, a2);
#if HAS_SHADOW
            value *= texture(shadow_map, (shadow_from_field * vec4(r, 1.0)).xyz);
#endif
            total += value;
            float turned = sine * cosine_step + cosine * sine_step;
            cosine = cosine * cosine_step - sine * sine_step;
            sine = turned;
        }
        ends[end] = total * width;
    }
    first_ends = vec4(ends[0], ends[1], ends[2], ends[3]);
    last_ends = vec4(ends[4], ends[5], ends[6], ends[7]);
}
