// The weights K = k r^2 of a field, and their integral over theta along a ray; twin: emission/column.py.
uniform sampler3D weights;
#if HAS_SHADOW
uniform sampler2DShadow shadow_map;
#endif

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
    float value = texture(weights, vec3(uv, (shell + 0.5) / size.z)).r;
#else
    float value = texture(weights, (r - low_m) / (high_m - low_m)).r;
#endif
    return value;
}

float sunlit(vec3 r)
{
#if HAS_SHADOW
    return texture(shadow_map, (shadow_from_field * vec4(r, 1.0)).xyz);
#else
    return 1.0;
#endif
}

vec3 place_at(Ray ray, float theta)
{
    // Below 1e-7 float32 knows no cosine.
    return ray.closest + ray.a * sin(theta) / max(cos(theta), 1e-7) * ray.direction;
}

#if HAS_SHADOW
// What an edge of the shadow near the border of two steps adds to the sum of K in steps that are lit as their middles
// are. It is found to a 32nd of a step; K is linear there, and a sum of middles that ends there lacks K' / 24.
// `edge`: the border's angle; K there and K's rise over a step, both negative where the sunlight begins.
float at_edge(Ray ray, vec3 edge, float width)
{
    float low = -0.5, high = 0.5;
    for (int halving = 0; halving < 4; ++halving) {
        float middle = 0.5 * (low + high);
        bool is_like_low = (sunlit(place_at(ray, edge.x + middle * width)) > 0.5) == (edge.y > 0.0);
        low = is_like_low ? middle : low;
        high = is_like_low ? high : middle;
    }
    float beyond = 0.5 * (low + high);
    return edge.y * beyond + edge.z * (0.5 * beyond * beyond + 1.0 / 24.0);
}
#endif

// Integral of K dtheta between two angles, in steps of what the half circle has `steps` of, and no fewer than a quarter
// of them: straight before a nucleus all distances are within some degrees. A ray through the body's inside is only
// seen by its neighbours: to them it stays smooth without what makes `a` up for rho.
float integral(Ray ray, vec2 span)
{
    float count = max(ceil(float(steps) * (span.y - span.x) / PI), 0.25 * float(steps));
    float width = (span.y - span.x) / count;
    // Sine and cosine of theta are turned on from step to step, which costs less than a tangent.
    float sine = sin(span.x + 0.5 * width), cosine = cos(span.x + 0.5 * width);
    float sine_step = sin(width), cosine_step = cos(width);
    float rho2 = ray.rho * ray.rho, a2 = ray.a * ray.a, total = 0.0;
#if HAS_SHADOW
    // A step is in the shadow as its middle is. The first and the last edge are found once all steps are done: within
    // the loop llvmpipe would look for one at every step.
    float lit_before = 0.0, value_before = 0.0;
    vec3 first_edge = vec3(0.0), last_edge = vec3(0.0);
#endif
    int last = width > 0.0 ? int(count) : 0;
    for (int step = 0; step < last; ++step) {
        // Below 1e-7 float32 knows no cosine.
        float s = ray.a * sine / max(cosine, 1e-7);
        vec3 r = ray.closest + s * ray.direction;
        float value = weight(r);
#if ENDS_AT_SURFACE
        value *= (a2 + s * s) / max(rho2 + s * s, a2);
#endif
#if HAS_SHADOW
        float lit = sunlit(r);
        vec3 edge = vec3(span.x + float(step) * width,
                         (lit_before - lit) * vec2(0.5 * (value + value_before), value - value_before));
        bool is_edge = step > 0 && abs(lit - lit_before) > 0.5;
        last_edge = is_edge && first_edge.y != 0.0 ? edge : last_edge;
        first_edge = is_edge && first_edge.y == 0.0 ? edge : first_edge;
        lit_before = lit;
        value_before = value;
        value *= lit;
#endif
        total += value;
        float turned = sine * cosine_step + cosine * sine_step;
        cosine = cosine * cosine_step - sine * sine_step;
        sine = turned;
    }
#if HAS_SHADOW
    total += at_edge(ray, first_edge, width) + at_edge(ray, last_edge, width);
#endif
    return total * width;
}
