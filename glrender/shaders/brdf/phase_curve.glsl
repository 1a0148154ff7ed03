// What depends on the phase angle: polynomials and tables in degrees. Twin of glrender/brdf/curve.py.
#include "brdf/angles.glsl"
#ifndef LAW_PHASE_KNOTS
#define LAW_PHASE_KNOTS 0
#define LAW_PHASE_TERMS 0
#endif
#ifndef LAW_WEIGHT_KNOTS
#define LAW_WEIGHT_KNOTS 0
#endif

float phase_degrees(vec3 to_sun, vec3 to_camera)
{
    vec3 difference = to_sun - to_camera, bisector = to_sun + to_camera;
    return (180.0 / PI) * phase_angle(dot(difference, difference), dot(bisector, bisector));
}

float polynomial(vec4 low, vec4 high, float x)
{
    return low.x + x * (low.y + x * (low.z + x * (low.w + x * (high.x + x * (high.y + x * (high.z + x * high.w))))));
}

#if LAW_PHASE_KNOTS || LAW_WEIGHT_KNOTS
// Straight lines between the knots (x, value, slope), held beyond the ends.
float piecewise(float x, int first, int count)
{
    vec4 knot = law_knots[first];
    for (int i = first + 1; i < first + count; ++i)
        if (x >= law_knots[i].x) knot = law_knots[i];
    return knot.y + knot.z * max(x - knot.x, 0.0);
}
#endif

// f(g), the factor that the albedo takes with phase.
float phase_curve(vec3 to_sun, vec3 to_camera)
{
#if LAW_PHASE_KNOTS
    return exp2(piecewise(phase_degrees(to_sun, to_camera), 0, LAW_PHASE_KNOTS));
#elif LAW_PHASE_TERMS
    return exp2(polynomial(law_phase_low, law_phase_high, phase_degrees(to_sun, to_camera)));
#else
    return 1.0;
#endif
}
