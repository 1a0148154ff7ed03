// Twin of glrender/brdf/microfacet.py.
#include "brdf/angles.glsl"

// Share of the light that a paint's coat leaves at a cosine.
float left_at(float mu)
{
    float place = 32.0 * sqrt(min(mu, 1.0));
    int k = min(int(place), 31);
    vec4 row = law_left[k];
    return mix(row.x, row.y, place - float(k));
}

float brdf(vec3 to_sun, vec3 to_camera, vec3 normal, float albedo_scale)
{
    float mu0 = dot(normal, to_sun), mu = dot(normal, to_camera);
    bool lit = mu0 > 0.0 && mu > 0.0;
    mu0 = max(mu0, MIN_COSINE);
    mu = max(mu, MIN_COSINE);
    vec3 bisector = to_sun + to_camera, aside = cross(normal, bisector);
    float squared = max(dot(bisector, bisector), 1e-20), tail = dot(aside, aside) / squared;
    float spread = tail + law_alpha2 * (1.0 - tail);
    float seen = (mu0 + sqrt(law_alpha2 + (1.0 - law_alpha2) * mu0 * mu0))
        * (mu + sqrt(law_alpha2 + (1.0 - law_alpha2) * mu * mu));
    float lobe = law_alpha2 / (PI * spread * spread * seen);
    float base = clamp(law_base_albedo * albedo_scale, 0.0, 1.0);
    float grazing = pow(1.0 - min(0.5 * sqrt(squared), 1.0), 5.0);
    float paint = lobe * (0.04 + 0.96 * grazing) + base / PI * left_at(mu0) * left_at(mu) / law_mean_left;
    return lit ? mix(paint, lobe * (base + (1.0 - base) * grazing), law_metalness) : 0.0;
}
