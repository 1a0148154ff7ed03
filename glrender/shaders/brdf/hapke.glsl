// Twin of glrender/brdf/hapke.py: only the terms that the body uses are compiled in.
#include "brdf/angles.glsl"
const float LN2 = 0.693147181;
#ifndef HAS_ALBEDO_TEXTURE
#define HAS_ALBEDO_TEXTURE 0
#endif

// law_surface: w r0 (1981: 2 gamma), w/2, chi/K, tan(mean slope)
// law_lobes: weights of the back and the forward lobe over b^1.5, (1 - b)^2/b, K w/(4 pi)
// law_opposition: Bs0 hs, hs, Bc0/2, 1/hc
// law_more: K/(4 pi), constant of anisotropic scattering, 0, 0
// Each component read costs a software rasteriser eight cycles, a division five: few of either.

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
#if HAS_ALBEDO_TEXTURE
    float half_w = clamp(law_surface.y * albedo_scale, 0.0, 0.5);
    float w = 2.0 * half_w, gamma = sqrt(1.0 - w);
    float scale = law_more.x * w;
#if LAW_H_1981
    float h = 2.0 * gamma;
#else
    float h = w * w / ((1.0 + gamma) * (1.0 + gamma));
#endif
#else
    float half_w = law_surface.y, scale = law_lobes.w, h = law_surface.x;
#endif
    vec3 difference = to_sun - to_camera, bisector = to_sun + to_camera;
    float distance2 = dot(difference, difference), bisector2 = dot(bisector, bisector);

    // What both cosines share: mu_small belongs to the smaller angle, whichever direction that is.
    float cos_small = max(max(cos_incidence, cos_emission), MIN_COSINE);
    float cos_large = max(min(cos_incidence, cos_emission), MIN_COSINE);
#if LAW_ROUGHNESS
    // The sine of the smaller angle by the chord: 1 - cos^2 is 1e-7 off, which shows below 0.3 deg.
    vec3 chord = (cos_incidence > cos_emission ? to_sun : to_camera) - normal;
    float chord2 = dot(chord, chord);
    // 1e-14 and 1e-10 bound the cotangents: at the zenith every term with sines and azimuth vanishes.
    float tangent = law_surface.w;
    float slope_small = tangent * sqrt(max(chord2 - 0.25 * chord2 * chord2, 1e-14));
    float slope_large = tangent * sqrt(max(1.0 - cos_large * cos_large, 1e-10));
    float inverse_slopes = 1.0 / (slope_small * slope_large), inverse_sines = tangent * tangent * inverse_slopes;
    // cot(angle) cot(mean slope)
    float z_small = cos_small * slope_large * inverse_slopes, z_large = cos_large * slope_small * inverse_slopes;
    float cos_azimuth = clamp((1.0 - 0.5 * distance2 - cos_small * cos_large) * inverse_sines, -1.0, 1.0);
    // The shorter of the two has the same triple product and no cancellation, where light grazes at opposition.
    vec3 lever = distance2 < bisector2 ? difference : bisector;
    float sin_azimuth = abs(dot(normal, cross(to_sun, lever))) * inverse_sines;
    // 1e-6 bounds the inverse of the tangent, not the tangent: 1e-6 of azimuth is 1e-4 of eta at 89 deg.
    float sin_bounded = max(sin_azimuth, 1e-6);
    // tan of half the azimuth, or of half its supplement: 0..1 either way.
    float base = 1.0 + abs(cos_azimuth), inverse_tan = 1.0 / (base * sin_bounded);
    float half_tan = min(sin_azimuth * sin_bounded * inverse_tan, 1.0);
    inverse_tan *= base * base;
    bool is_ahead = cos_azimuth >= 0.0;
    // 1 - exp(-2 tan(azimuth / 2)), by its series where the difference would round.
    float decay = 2.0 * (is_ahead ? half_tan : inverse_tan);
    float beside = decay > 0.03 ? 1.0 - exp2(-1.44269504 * decay)
        : decay * (1.0 - decay * (0.5 - decay * (1.0 / 6.0)));
    // Both are small where the Sun is behind the surface, and what they stand beside cancels there.
    float turn = (2.0 / PI) * atan_below_1(half_tan);
    float away = is_ahead ? 1.0 - turn : turn;    // 1 - azimuth / pi
    float near = 0.5 * half_tan * sin_azimuth;
    float cos2_half = is_ahead ? 1.0 - near : near;
    // exp(-2 z/pi), exp(-z^2/pi)
    float e1_small = exp2(-0.918443060 * z_small), e1_large = exp2(-0.918443060 * z_large);
    float e2_small = exp2(-0.459221530 * z_small * z_small), e2_large = exp2(-0.459221530 * z_large * z_large);
    // 1e-7 and 1e-12 bound what is 0/0 where Sun and camera graze from opposite sides.
    float inverse = 1.0 / max((1.0 - e1_large) + (1.0 - e1_small) + away * e1_small, 1e-7);
    float excess = e2_large - e2_small;
    float mu_small = max(
        cos_small + slope_small * (cos2_half * (2.0 * e2_large - e2_small) - excess) * inverse, 1e-12);
    float mu_large = max(cos_large + slope_large * (cos2_half * e2_small + excess) * inverse, 1e-12);
    // eta (2 - E1), so that one division serves all.
    float d_small = 2.0 - e1_small, d_large = 2.0 - e1_large;
    float eta_small = cos_small * d_small + slope_small * e2_small;
    float eta_large = cos_large * d_large + slope_large * e2_large;
    float spread = mu_small * mu_large * d_small * d_large
        / ((mu_small + mu_large) * eta_large * mix(cos_small * d_small, eta_small, beside));
#else
    float mu_small = cos_small, mu_large = cos_large;
    float spread = 1.0 / (mu_small + mu_large);
#endif

    // 1 + b^2 -+ 2 b cos g without its cancellation at b -> 1, to the power 3/2.
#if LAW_BACK_LOBE
    float back = law_lobes.z + distance2;
    back *= sqrt(back);
#endif
#if LAW_FORWARD_LOBE
    float forward = law_lobes.z + bisector2;
    forward *= sqrt(forward);
#endif
#if LAW_BACK_LOBE && LAW_FORWARD_LOBE
    float phase_function = (law_lobes.x * forward + law_lobes.y * back) / (back * forward);
#elif LAW_BACK_LOBE
    float phase_function = law_lobes.x / back;
#elif LAW_FORWARD_LOBE
    float phase_function = law_lobes.y / forward;
#else
    float phase_function = 1.0;
#endif

#if LAW_SHOE || LAW_CBOE
    float tan_half_phase = sqrt(distance2 / max(bisector2, 1e-12));
#endif
#if LAW_SHOE
    phase_function += phase_function * law_opposition.x / (law_opposition.y + tan_half_phase);
#endif

    // H of both directions as numerator / denominator.
    float x_small = mu_small * law_surface.z, x_large = mu_large * law_surface.z;
#if LAW_H_1981
    float over_small = 1.0 + 2.0 * x_small, over_large = 1.0 + 2.0 * x_large;
    float under_small = 1.0 + h * x_small, under_large = 1.0 + h * x_large;
#else
    const float over_small = 1.0, over_large = 1.0;
    float inverse_x = 1.0 / (x_small * x_large);
    // ln((1 + x)/x)
    float log_small = LN2 * log2(1.0 + x_large * inverse_x), log_large = LN2 * log2(1.0 + x_small * inverse_x);
    float under_small = 1.0 - x_small * (h + (half_w - h * x_small) * log_small);
    float under_large = 1.0 - x_large * (h + (half_w - h * x_large) * log_large);
#endif
    float inverse_h = 1.0 / (under_small * under_large);
#if LAW_ANISOTROPIC
    float more_small = over_small - under_small, more_large = over_large - under_large;
    float multiple = (averaged_phase_function(x_small) * more_large * under_small
        + averaged_phase_function(x_large) * more_small * under_large + law_more.y * more_small * more_large)
        * inverse_h;
#else
    float multiple = over_small * over_large * inverse_h - 1.0;
#endif

    float value = scale * spread * max(phase_function + multiple, 0.0);
#if LAW_CBOE
    float z = max(tan_half_phase * law_opposition.w, 1e-6);
    float inverse_z = 1.0 / (z * (1.0 + z)), y = z * inverse_z;
    // (1 - exp(-z))/z loses 1e-7/z to round-off: its series below 1/10.
    float mean_decay = z > 0.1 ? (1.0 - exp2(-1.44269504 * z)) * (1.0 + z) * inverse_z
        : 1.0 + z * (-0.5 + z * (1.0 / 6.0 - z * (1.0 / 24.0)));
    value += value * law_opposition.z * (1.0 + mean_decay) * y * y;
#endif
    return lit ? max(value, 0.0) : 0.0;
}
