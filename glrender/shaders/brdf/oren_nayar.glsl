// Twin of glrender/brdf/oren_nayar.py.
#include "brdf/angles.glsl"

float brdf(vec3 to_sun, vec3 to_camera, vec3 normal, float albedo_scale)
{
    float cos_incidence = dot(normal, to_sun), cos_emission = dot(normal, to_camera);
    bool lit = cos_incidence > 0.0 && cos_emission > 0.0;
    cos_incidence = max(cos_incidence, MIN_COSINE);
    cos_emission = max(cos_emission, MIN_COSINE);
    float albedo = clamp(law_albedo * albedo_scale, 0.0, 1.0);
    // sin i sin e cos(azimuth), then over the larger cosine: max(0, cos psi) sin a tan b.
    float aligned = max(dot(cross(normal, to_sun), cross(normal, to_camera)), 0.0);
    float groove = aligned / max(cos_incidence, cos_emission);
    return lit ? albedo / PI * (law_roughness.x + law_roughness.y * groove) : 0.0;
}
