// The column of dust of each pixel, from the coarse grid's sums: up to the surface that its centre sees.
#include "coma/ray.glsl"
uniform sampler2D last_ends;
#if HAS_SURFACE
uniform sampler2D first_ends;
uniform sampler2D surface;  // how far along its ray from the point closest to its body's origin, and which body
#endif
layout(location = 0) out float column;

void main()
{
    vec2 pixel = gl_FragCoord.xy - 0.5;
    vec2 uv = (pixel / pixels_per_node + 0.5) / vec2(textureSize(last_ends, 0));
    Ray ray = ray_of(pixel);
#if HAS_SURFACE
    vec2 seen = texelFetch(surface, ivec2(gl_FragCoord.xy), 0).rg;
    vec4 last = texture(last_ends, uv);
    float sum = last.w;
    if (seen.y > 0.5) {
        vec2 span = span_of(ray);
        float s = seen.x + dot(ray.direction, r_body_m[int(seen.y) - 1].xyz);
        float place = 8.0 * clamp((atan(s / ray.a) - span.x) / max(span.y - span.x, 1e-6), 0.0, 1.0);
        vec4 first = texture(first_ends, uv);
        float ends[9] = float[9](0.0, first.x, first.y, first.z, first.w, last.x, last.y, last.z, last.w);
        int end = min(int(place), 7);
        sum = mix(ends[end], ends[end + 1], place - float(end));
    }
#else
    float sum = texture(last_ends, uv).w;
#endif
    column = sum / ray.a;
}
