// Twin of glrender/brdf/lunar_lambert.py.
#include "brdf/phase_curve.glsl"

float brdf(vec3 to_sun, vec3 to_camera, vec3 normal, float albedo_scale)
{
    float cos_incidence = dot(normal, to_sun), cos_emission = dot(normal, to_camera);
    bool lit = cos_incidence > 0.0 && cos_emission > 0.0;
    cos_incidence = max(cos_incidence, MIN_COSINE);
    cos_emission = max(cos_emission, MIN_COSINE);
    float phase = phase_degrees(to_sun, to_camera);
#if LAW_WEIGHT_KNOTS
    float weight = piecewise(phase, LAW_PHASE_KNOTS, LAW_WEIGHT_KNOTS);
#elif LAW_WEIGHT_EXPONENTIAL
    float weight = exp2(polynomial(law_weight_low, law_weight_high, phase));
#else
    // law_parameter: the phase from which the polynomial is held.
    float weight = polynomial(law_weight_low, law_weight_high, min(phase, law_parameter));
#endif
    float albedo = clamp(law_albedo * albedo_scale, 0.0, 1.0);
    // The factor 2 makes I/F(0, 0, 0) the normal albedo. A negative weight may not give a negative radiance.
    float blend = max(2.0 * weight / (cos_incidence + cos_emission) + 1.0 - weight, 0.0);
    return lit ? albedo / PI * phase_curve(to_sun, to_camera) * blend : 0.0;
}
