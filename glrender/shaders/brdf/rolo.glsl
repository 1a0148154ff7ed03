// Twin of glrender/brdf/rolo.py.
#include "brdf/phase_curve.glsl"

float brdf(vec3 to_sun, vec3 to_camera, vec3 normal, float albedo_scale)
{
    float cos_incidence = dot(normal, to_sun), cos_emission = dot(normal, to_camera);
    bool lit = cos_incidence > 0.0 && cos_emission > 0.0;
    cos_incidence = max(cos_incidence, MIN_COSINE);
    cos_emission = max(cos_emission, MIN_COSINE);
    float phase = phase_degrees(to_sun, to_camera);
    float curve = law_surge.x * exp2(law_surge.y * phase) + polynomial(law_terms_low, law_terms_high, phase);
    return lit ? max(albedo_scale * curve, 0.0) / (PI * (cos_incidence + cos_emission)) : 0.0;
}
