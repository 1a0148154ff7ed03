// Twin of glrender/brdf/lommel_seeliger.py.
#include "brdf/phase_curve.glsl"

float brdf(vec3 to_sun, vec3 to_camera, vec3 normal, float albedo_scale)
{
    float cos_incidence = dot(normal, to_sun), cos_emission = dot(normal, to_camera);
    bool lit = cos_incidence > 0.0 && cos_emission > 0.0;
    cos_incidence = max(cos_incidence, MIN_COSINE);
    cos_emission = max(cos_emission, MIN_COSINE);
    float albedo = clamp(law_albedo * albedo_scale, 0.0, 1.0);
    return lit ? albedo / (4.0 * PI) * phase_curve(to_sun, to_camera) / (cos_incidence + cos_emission) : 0.0;
}
