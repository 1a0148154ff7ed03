// Where the ray of a pixel meets a body, from the point closest to that body's origin, and which body.
#include "surface.glsl"
layout(location = 0) out vec2 seen;

void main()
{
    vec3 direction = -normalize(camera_offset());
    seen = vec2(dot(body_position(), direction), float(body_id) + 1.0);
}
