// Twin of glrender/brdf/minnaert.py.
#include "brdf/phase_curve.glsl"

float brdf(vec3 to_sun, vec3 to_camera, vec3 normal, float albedo_scale)
{
    float cos_incidence = dot(normal, to_sun), cos_emission = dot(normal, to_camera);
    bool lit = cos_incidence > 0.0 && cos_emission > 0.0;
    cos_incidence = max(cos_incidence, MIN_COSINE);
    cos_emission = max(cos_emission, MIN_COSINE);
    float albedo = clamp(law_albedo * albedo_scale, 0.0, 1.0);
    float power = law_exponent.x + law_exponent.y * phase_degrees(to_sun, to_camera);
    float disk = exp2(power * log2(cos_incidence * cos_emission));
    return lit ? albedo / PI * phase_curve(to_sun, to_camera) * disk : 0.0;
}
