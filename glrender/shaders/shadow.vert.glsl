// Depth below the plane that faces the Sun, for the shadow map.
in vec3 position;

void main()
{
    gl_Position = sun_clip_from_body * vec4(position, 1.0);
    // A caster between the map's near plane and the Sun still casts: hold it at the plane.
    gl_Position.z = max(gl_Position.z, -1.0);
}
