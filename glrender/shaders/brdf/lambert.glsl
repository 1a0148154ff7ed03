// Twin of glrender/brdf/lambert.py.
#include "constants.glsl"

float brdf(vec3 to_sun, vec3 to_camera, vec3 normal, float albedo_scale)
{
    bool lit = dot(normal, to_sun) > 0.0 && dot(normal, to_camera) > 0.0;
    return lit ? clamp(law_normal_albedo * albedo_scale, 0.0, 1.0) / PI : 0.0;
}
