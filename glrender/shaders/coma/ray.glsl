// The ray of a pixel, about the point of it that is closest to the body's origin; metres, the field's frame.
struct Ray {
    vec3 direction; // away from the camera
    vec3 closest;
    float rho;
    float a;        // rho, but at least `least_m`: there is only the body
    float camera;   // where the camera is along the ray, from the closest point
};

Ray ray_of(vec2 pixel)
{
    Ray ray;
    vec3 closest;
    if (is_ahead != 0) {
        // Offsets from the origin's own pixel: nothing cancels, from any distance.
        vec2 offset = (pixel - focus_px) / focal_length_px;
        vec3 along = vec3(focus_slope + offset, 1.0);
        float squared = dot(along, along);
        closest = focus_depth_m * (vec3(offset, 0.0) - dot(offset, along.xy) / squared * along);
        ray.direction = along * inversesqrt(squared);
        ray.camera = -focus_depth_m * dot(vec3(focus_slope, 1.0), along) * inversesqrt(squared);
    } else {
        ray.direction = normalize(vec3((pixel - principal_point_px) / focal_length_px, 1.0));
        ray.camera = -dot(r_focus_camera, ray.direction);
        closest = -r_focus_camera - ray.camera * ray.direction;
    }
    // Before the turn into the field's frame: who needs only `a` is spared that.
    ray.rho = length(closest);
    ray.direction = mat3(field_from_camera) * ray.direction;
    ray.closest = mat3(field_from_camera) * closest;
    ray.a = max(ray.rho, least_m);
    return ray;
}

// Where the dust of a ray begins and ends, as angles theta of s = a tan(theta); equal where there is none.
vec2 span_of(Ray ray)
{
#if SPHERICAL
    // A field without an end: a square beyond float32 would be infinite, and so would be the sum.
    float leave = sqrt(max(high_m.x * high_m.x - ray.rho * ray.rho, 0.0));
    float enter = -leave;
#else
    vec3 safe = mix(ray.direction, vec3(1e-12), lessThan(abs(ray.direction), vec3(1e-12)));
    vec3 first = (low_m - ray.closest) / safe, second = (high_m - ray.closest) / safe;
    vec3 near = min(first, second), far = max(first, second);
    float enter = max(max(near.x, near.y), near.z), leave = min(min(far.x, far.y), far.z);
#endif
    enter = max(enter, ray.camera);
    return atan(vec2(enter, max(leave, enter)) / ray.a);
}

#if HAS_SURFACE
// What a pixel sees of the surface that was drawn in a box of the tile: how far along its ray the mean of it is, and
// what share of the pixel it covers. Nothing beside the box.
vec2 seen_at(sampler2D surface, vec2 pixel, Ray ray)
{
    if (any(lessThan(pixel, body_px.xy)) || any(greaterThanEqual(pixel, body_px.zw)))
        return vec2(0.0);
    ivec2 first = ivec2(pixel - body_px.xy + 0.5) * SURFACE_SAMPLES;
    float along = 0.0, hits = 0.0;
    for (int y = 0; y < SURFACE_SAMPLES; ++y)
        for (int x = 0; x < SURFACE_SAMPLES; ++x) {
            // From the point of the ray closest to the origin of the body that it meets, and which.
            vec2 seen = texelFetch(surface, first + ivec2(x, y), 0).rg;
            if (seen.y > 0.5) {
                along += seen.x;
#if SEVERAL_BODIES
                along += dot(ray.direction, r_body_m[int(seen.y) - 1].xyz);
#endif
                hits += 1.0;
            }
        }
    return hits > 0.0 ? vec2(along / hits, hits / float(SURFACE_SAMPLES * SURFACE_SAMPLES)) : vec2(0.0);
}
#endif
