// The integral of K over theta along the rays of a coarse grid of pixels: of all that a ray meets, or up to the
// surface. The column is that over a; the integral is what is smooth from ray to ray.
#include "constants.glsl"
#include "coma/ray.glsl"
#include "coma/field.glsl"
#if HAS_SURFACE
uniform sampler2D surface;
layout(location = 0) out vec4 front; // integral, theta of the surface, K there, 1 where there is a surface
#else
layout(location = 0) out float total;
#endif

void main()
{
    vec2 pixel = first_node_px + (gl_FragCoord.xy - 0.5) * pixels_per_node;
    Ray ray = ray_of(pixel);
    vec2 span = span_of(ray);
#if HAS_SURFACE
    vec2 seen = seen_at(surface, pixel, ray);
    if (seen.y == 0.0) {
        front = vec4(0.0);
        return;
    }
    span.y = clamp(atan(seen.x / ray.a), span.x, span.y);
    vec3 end = ray.closest + ray.a * tan(span.y) * ray.direction;
    front = vec4(integral(ray, span), span.y, weight(end) * sunlit(end), 1.0);
#else
    // Away from the origin it is the column that is smooth: a goes through zero where the origin is straight behind.
    total = integral(ray, span) / (is_ahead != 0 ? 1.0 : ray.a);
#endif
}
