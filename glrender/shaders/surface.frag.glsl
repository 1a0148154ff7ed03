// Irradiance at the aperture from one pixel: BRDF * cos(incidence) * F_sun * solid angle.
#include "constants.glsl"
#include "surface.glsl"
#include "brdf"
#if HAS_RELIEF
#include "relief.glsl"
#endif
#if HAS_ALBEDO_TEXTURE
in vec2 uv;
uniform sampler2D albedo_texture;
#endif
layout(location = 0) out float irradiance;

void main()
{
    vec3 to_camera = normalize(camera_offset());
    vec3 geometric_normal = facet_normal(to_camera);
    float albedo_scale = 1.0;
    vec3 normal = surface_normal(geometric_normal, to_camera);
    float cos_incidence = dot(geometric_normal, sun_direction_body);
    float above = cos_incidence > 0.0 ? 1.0 : 0.0;
    vec3 to_sun = sun_direction_body;
    if (abs(cos_incidence) < sun_radius_rad) {
        // What of the Sun's disc is above the facet's plane lights it, from the middle of that segment.
        float height = cos_incidence / sun_radius_rad, across = sqrt(1.0 - height * height);
        above = 0.5 + (asin(height) + height * across) / PI;
        float middle = min(across * across * across / (1.5 * PI * max(above, 1e-6)), 1.0);
        to_sun += sun_radius_rad * middle * geometric_normal;
    }
    float lit = above > 0.0 ? above * sunlit(cos_incidence) : 0.0;
#if HAS_ALBEDO_TEXTURE
    albedo_scale = texture(albedo_texture, uv).r;
#endif
#if HAS_RELIEF
    normal = relief_normal(normal, r_surface, length(camera_offset()) * footprint_per_m, to_camera);
#endif
    float value = brdf(to_sun, to_camera, normal, albedo_scale);
    // A pixel's solid angle falls off as cos^3 of its angle from the boresight.
    float cos_boresight = -dot(to_camera, boresight_body);
    irradiance = lit * value * max(dot(normal, to_sun), 0.0) * irradiance_scale
        * cos_boresight * cos_boresight * cos_boresight;
}
