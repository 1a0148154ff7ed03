// Angles between unit vectors without acos of a dot product, which loses 0.02 deg at opposition
// and is NaN for 5 % of equal float32 vectors. Twin of glrender/brdf/geometry.py.
#include "constants.glsl"

// Cosines are held at this, as in law.py: a BRDF may grow as 1 / (mu0 + mu) and float32 may not.
const float MIN_COSINE = 1e-6;

// atan on 0..1: minimax polynomial, relative error 1.4e-7 in float32; the driver's may be off by 2e-5.
float atan_below_1(float t)
{
    float u = t * t;
    float p = 0.00284989008;
    p = p * u - 0.0160686314;
    p = p * u + 0.0426915242;
    p = p * u - 0.0750429507;
    p = p * u + 0.106409343;
    p = p * u - 0.142036446;
    p = p * u + 0.199926194;
    p = p * u - 0.333330733;
    p = p * u + 0.999999985;
    return p * t;
}

// Phase angle, 0..pi [rad], from 2 sin(g/2) squared and 2 cos(g/2) squared.
float phase_angle(float distance2, float bisector2)
{
    float ratio = sqrt(min(distance2, bisector2) / max(distance2, bisector2));
    float angle = 2.0 * atan_below_1(ratio);
    return distance2 <= bisector2 ? angle : PI - angle;
}
