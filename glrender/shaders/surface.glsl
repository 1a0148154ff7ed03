// What the surface's fragment shaders share: where the fragment is, its normal, its shadow.
in vec3 r_surface;
#if RELATIVE_TO_CAMERA
in vec3 r_body;
#endif
#if SMOOTH_NORMALS
in vec3 shading_normal;
#endif
#if NORMAL_LOOKUP
uniform sampler2D facet_normals;
#endif
#if HAS_SHADOWS
uniform sampler2DShadow shadow_map;
#endif


int facet_index() { return gl_PrimitiveID; }

vec3 body_position()
{
#if RELATIVE_TO_CAMERA
    return r_body;
#else
    return r_surface;
#endif
}

vec3 camera_offset()
{
#if RELATIVE_TO_CAMERA
    return -r_surface;
#else
    return r_camera_body - r_surface;
#endif
}

// A shape model is a polyhedron: the normal is its facet's. Screen-space derivatives give it
// without a fetch, until a pixel nears float32's resolution of the coordinates.
vec3 facet_normal(vec3 to_camera)
{
#if NORMAL_LOOKUP
    ivec2 size = textureSize(facet_normals, 0);
    return texelFetch(facet_normals, ivec2(facet_index() % size.x, facet_index() / size.x), 0).xyz;
#else
    vec3 normal = normalize(cross(dFdx(r_surface), dFdy(r_surface)));
    return dot(normal, to_camera) < 0.0 ? -normal : normal;
#endif
}

vec3 surface_normal(vec3 geometric_normal, vec3 to_camera)
{
#if SMOOTH_NORMALS
    vec3 normal = normalize(shading_normal);
    // An interpolated normal may turn away where the facet does not: no black limb.
    float excess = 1e-3 - dot(normal, to_camera);
    return excess > 0.0 ? normalize(normal + excess * to_camera) : normal;
#else
    return geometric_normal;
#endif
}

// 1 in sunlight, 0 in a cast shadow. The bias follows the slope within a texel: tan(incidence)
// texels, held at 20 where the surface is nearly edge-on to the Sun.
float sunlit(float cos_incidence)
{
#if HAS_SHADOWS
    float tan_incidence = sqrt(max(1.0 - cos_incidence * cos_incidence, 0.0)) / max(cos_incidence, 0.05);
    vec3 coordinates = (shadow_from_body * vec4(body_position(), 1.0)).xyz;
    coordinates.z -= shadow_bias_per_texel * (0.2 + min(tan_incidence, 20.0));
    return texture(shadow_map, coordinates);
#else
    return 1.0;
#endif
}
