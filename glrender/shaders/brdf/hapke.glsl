// Twin of glrender/brdf/hapke.py: only the terms that the body uses are compiled in.
#include "brdf/angles.glsl"
#ifndef HAS_ALBEDO_TEXTURE
#define HAS_ALBEDO_TEXTURE 0
#endif

// law_albedo: w, r0, gamma, 1 - gamma
// law_lobes: (1 + c)/2 (1 - b^2), (1 - c)/2 (1 - b^2), (1 - b)^2, b
// law_opposition: Bs0, hs, Bc0, 1/hc
// law_roughness: tan, and the exponents of E1 and E2 in powers of 2 per cot and cot^2
// law_scale: K/(4 pi), chi/K, constant of anisotropic scattering

// H(x) - 1 as numerator, denominator: one division serves both directions, and nothing cancels.
vec2 h_minus_1(float x, vec4 albedo)
{
#if LAW_H_1981
    return vec2(2.0 * x * albedo.w, 1.0 + 2.0 * x * albedo.z);
#else
    // ln((1 + x)/x); 1e-20 keeps 0 * infinity out of the limb.
    float logarithm = 0.693147181 * log2(1.0 + 1.0 / max(x, 1e-20));
    float u = albedo.x * x * (albedo.y + (0.5 - albedo.y * x) * logarithm);
    return vec2(u, 1.0 - u);
#endif
}

#if LAW_ANISOTROPIC
// P(x): Clenshaw's sum of a Chebyshev series in 2 x - 1, four terms to a vector.
float averaged_phase_function(float x)
{
    float y = 4.0 * x - 2.0;
    float next = 0.0, after = 0.0;
    for (int i = LAW_ANISOTROPIC - 1; i >= 0; --i) {
        vec4 term = law_averaged_phase[i];
        after = term.w + y * next - after;
        next = term.z + y * after - next;
        after = term.y + y * next - after;
        next = term.x + (i == 0 ? 0.5 * y : y) * after - next;
    }
    return 1.0 + next;
}
#endif

float brdf(vec3 to_sun, vec3 to_camera, vec3 normal, float albedo_scale)
{
    float cos_incidence = dot(normal, to_sun), cos_emission = dot(normal, to_camera);
    bool lit = cos_incidence > 0.0 && cos_emission > 0.0;
    vec4 albedo = law_albedo;
#if HAS_ALBEDO_TEXTURE
    albedo.x = clamp(albedo.x * albedo_scale, 0.0, 1.0);
    albedo.z = sqrt(1.0 - albedo.x);
    albedo.w = albedo.x / (1.0 + albedo.z);
    albedo.y = albedo.w / (1.0 + albedo.z);
#endif
    vec3 difference = to_sun - to_camera, bisector = to_sun + to_camera;
    float distance2 = dot(difference, difference), bisector2 = dot(bisector, bisector);

    // What both cosines share: mu_small belongs to the smaller angle, whichever direction that is.
    float cos_small = max(max(cos_incidence, cos_emission), MIN_COSINE);
    float cos_large = max(min(cos_incidence, cos_emission), MIN_COSINE);
#if LAW_ROUGHNESS
    vec3 sun_side = cross(normal, to_sun), camera_side = cross(normal, to_camera);
    // 1e-20 bounds the cotangent by 1e10; at the zenith every term with the azimuth vanishes.
    float sin2_i = max(dot(sun_side, sun_side), 1e-20), sin2_e = max(dot(camera_side, camera_side), 1e-20);
    float sin2_small = min(sin2_i, sin2_e), sin2_large = max(sin2_i, sin2_e);
    float inverse_small = inversesqrt(sin2_small), inverse_large = inversesqrt(sin2_large);
    float inverse_sines = inverse_small * inverse_large;
    float cos_azimuth = clamp(dot(sun_side, camera_side) * inverse_sines, -1.0, 1.0);
    float sin_azimuth = abs(dot(normal, cross(to_sun, to_camera))) * inverse_sines;
    // tan of half the azimuth, or of half its supplement: 0..1 either way.
    float half_tan = min(sin_azimuth / (1.0 + abs(cos_azimuth)), 1.0);
    float turn = (2.0 / PI) * atan_below_1(half_tan);
    bool is_ahead = cos_azimuth >= 0.0;
    // exp(-2 tan(azimuth / 2)); 1e-3 takes it to exp(-2000) = 0.
    float f = exp2(-2.88539008 * (is_ahead ? half_tan : 1.0 / max(half_tan, 1e-3)));
    // Both are small where the Sun is behind the surface, and what they stand beside cancels there.
    float away = is_ahead ? 1.0 - turn : turn;    // 1 - azimuth / pi
    float near = 0.5 * half_tan * sin_azimuth;
    float cos2_half = is_ahead ? 1.0 - near : near;
    float cot_small = cos_small * inverse_small, cot_large = cos_large * inverse_large;
    float e1_small = exp2(law_roughness.y * cot_small), e1_large = exp2(law_roughness.y * cot_large);
    float e2_small = exp2(law_roughness.z * cot_small * cot_small);
    float e2_large = exp2(law_roughness.z * cot_large * cot_large);
    float slope_small = law_roughness.x * sin2_small * inverse_small;
    float slope_large = law_roughness.x * sin2_large * inverse_large;
    // 1e-7 and 1e-12 bound what is 0/0 where Sun and camera graze from opposite sides.
    float inverse = 1.0 / max((1.0 - e1_large) + (1.0 - e1_small) + away * e1_small, 1e-7);
    float excess = e2_large - e2_small;
    float mu_small = max(
        cos_small + slope_small * (cos2_half * (2.0 * e2_large - e2_small) - excess) * inverse, 1e-12);
    float mu_large = max(cos_large + slope_large * (cos2_half * e2_small + excess) * inverse, 1e-12);
    float eta_small = cos_small + slope_small * e2_small / (2.0 - e1_small);
    float eta_large = cos_large + slope_large * e2_large / (2.0 - e1_large);
    float spread = mu_small * mu_large
        / ((mu_small + mu_large) * eta_large * ((1.0 - f) * eta_small + f * cos_small));
#else
    float mu_small = cos_small, mu_large = cos_large;
    float spread = 1.0 / (mu_small + mu_large);
#endif

    // 1 + b^2 -+ 2 b cos g without its cancellation at b -> 1.
#if LAW_BACK_LOBE
    float back = inversesqrt(law_lobes.z + law_lobes.w * distance2);
    float phase_function = law_lobes.x * back * back * back;
#elif LAW_FORWARD_LOBE
    float phase_function = 0.0;
#else
    float phase_function = 1.0;
#endif
#if LAW_FORWARD_LOBE
    float forward = inversesqrt(law_lobes.z + law_lobes.w * bisector2);
    phase_function += law_lobes.y * forward * forward * forward;
#endif

#if LAW_SHOE || LAW_CBOE
    float tan_half_phase = sqrt(distance2 / max(bisector2, 1e-12));
#endif
#if LAW_SHOE
    phase_function += phase_function * law_opposition.x * law_opposition.y / (law_opposition.y + tan_half_phase);
#endif

    float x_small = mu_small * law_scale.y, x_large = mu_large * law_scale.y;
    vec2 h_small = h_minus_1(x_small, albedo), h_large = h_minus_1(x_large, albedo);
    float inverse_h = 1.0 / (h_small.y * h_large.y);
#if LAW_ANISOTROPIC
    float multiple = (averaged_phase_function(x_small) * h_large.x * h_small.y
        + averaged_phase_function(x_large) * h_small.x * h_large.y + law_scale.z * h_small.x * h_large.x) * inverse_h;
#else
    float multiple = (h_large.x * h_small.y + h_small.x * h_large.y + h_small.x * h_large.x) * inverse_h;
#endif

    float value = law_scale.x * albedo.x * spread * max(phase_function + multiple, 0.0);
#if LAW_CBOE
    float z = tan_half_phase * law_opposition.w;
    // (1 - exp(-z))/z loses 1e-7/z to round-off: its series below 1/4.
    float mean_decay = z > 0.25 ? (1.0 - exp2(-1.44269504 * z)) / z
        : 1.0 + z * (-1.0 / 2.0 + z * (1.0 / 6.0 + z * (-1.0 / 24.0 + z * (1.0 / 120.0
            + z * (-1.0 / 720.0 + z * (1.0 / 5040.0))))));
    value += value * law_opposition.z * (1.0 + mean_decay) / (2.0 * (1.0 + z) * (1.0 + z));
#endif
    return lit ? max(value, 0.0) : 0.0;
}
