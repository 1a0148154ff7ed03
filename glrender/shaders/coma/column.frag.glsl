// The column of dust of each pixel, from the coarse grid: up to the surface, over the share of it that has one.
#include "constants.glsl"
#include "coma/ray.glsl"
uniform sampler2D total;
#if HAS_SURFACE
#include "coma/field.glsl"
#if HAS_FRONT
uniform sampler2D front;
#endif
uniform sampler2D surface;
#endif
layout(location = 0) out float column;

void main()
{
    vec2 pixel = near_px + gl_FragCoord.xy - 0.5;
    Ray ray = ray_of(pixel);
    float sum = texture(total, ((pixel - first_node_px) / pixels_per_node + 0.5) / vec2(textureSize(total, 0))).r;
#if HAS_SURFACE
    vec2 seen = seen_at(surface, pixel, ray);
    vec2 span = span_of(ray);
    float beside = sum;
    if (seen.y > 0.0) {
        span.y = clamp(atan(seen.x / ray.a), span.x, span.y);
        sum = 0.0;
#if HAS_FRONT
        // Nodes count that saw a surface at nearly the same angle, each brought to this pixel's with its K.
        vec2 place = (pixel - first_front_px) / pixels_per_front_node;
        ivec2 first = ivec2(place);
        vec2 part = place - vec2(first);
        float shares = 0.0, values = 0.0;
        for (int corner = 0; corner < 4; ++corner) {
            ivec2 step = ivec2(corner & 1, corner >> 1);
            vec4 near = texelFetch(front, first + step, 0);
            vec2 along = mix(1.0 - part, part, vec2(step));
            float apart = span.y - near.y;
            float share = along.x * along.y * near.w * max(1.0 - abs(apart) / nodes_reach_rad, 0.0);
            shares += share;
            values += share * (near.x + near.z * apart);
        }
        // At an edge of the surface no node is near: then this pixel's own ray.
        if (shares > 0.1) {
            sum = values / shares;
            span.x = span.y;
        }
#endif
    } else {
        span.x = span.y;
    }
    sum = mix(beside, sum + integral(ray, span), seen.y);
#endif
    column = max(sum, 0.0) / ray.a;
}
