// A body's surface. Body-fixed float32 coordinates keep 1e-5 px at any range; within half a
// radius of the ground they do not, and coordinates relative to the camera take over.
in vec3 position;
out vec3 r_surface;   // body-fixed, or relative to the camera, metres
#if RELATIVE_TO_CAMERA
in vec3 position_low; // what float32 `position` left out
out vec3 r_body;
#endif
#if SMOOTH_NORMALS
in vec3 vertex_normal;
out vec3 shading_normal;
#endif
#if HAS_ALBEDO_TEXTURE
in vec2 vertex_uv;
out vec2 uv;
#endif

void main()
{
#if RELATIVE_TO_CAMERA
    r_surface = (position - r_camera_body) + (position_low - r_camera_body_low);
    r_body = position;
#else
    r_surface = position;
#endif
    gl_Position = clip_from_surface * vec4(r_surface, 1.0);
#if SMOOTH_NORMALS
    shading_normal = vertex_normal;
#endif
#if HAS_ALBEDO_TEXTURE
    uv = vertex_uv;
#endif
}
