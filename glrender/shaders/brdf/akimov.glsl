// Twin of glrender/brdf/akimov.py.
#include "brdf/phase_curve.glsl"

float brdf(vec3 to_sun, vec3 to_camera, vec3 normal, float albedo_scale)
{
    float cos_incidence = dot(normal, to_sun), cos_emission = dot(normal, to_camera);
    bool lit = cos_incidence > 0.0 && cos_emission > 0.0;
    cos_incidence = max(cos_incidence, MIN_COSINE);
    cos_emission = max(cos_emission, MIN_COSINE);
    float albedo = clamp(law_albedo * albedo_scale, 0.0, 1.0);
    vec3 difference = to_sun - to_camera, bisector = to_sun + to_camera;
    // 1e-20: at opposition the direction across is any, and its share is 0.
    float distance2 = max(dot(difference, difference), 1e-20), bisector2 = max(dot(bisector, bisector), 1e-20);
    float sin_half = 0.5 * sqrt(distance2), cos_half = 0.5 * sqrt(bisector2);
    float low = min(cos_incidence, cos_emission);
    float across = abs(dot(normal, difference)) * inversesqrt(distance2);
    float along = dot(normal, bisector) * inversesqrt(bisector2);
    // Longitude from the nearer of limb and terminator, 0..pi/2.
    float opposite = max(low * cos_half, 0.0), adjacent = across + low * sin_half;
    float ratio = min(opposite, adjacent) / max(max(opposite, adjacent), 1e-20);
    float to_edge = atan_below_1(max(ratio, 0.0));
    to_edge = opposite <= adjacent ? to_edge : 0.5 * PI - to_edge;
    float supplement = PI - phase_angle(distance2, bisector2);
    float stretch = PI / max(supplement, 1e-6);
    float cos_latitude2 = clamp(across * across + along * along, 1e-20, 1.0);
    float disk = cos_half * sin(min(stretch * to_edge, 0.5 * PI)) * exp2(0.5 * stretch * log2(cos_latitude2));
    return lit ? albedo / PI * phase_curve(to_sun, to_camera) * disk / (cos_incidence * cos_emission) : 0.0;
}
