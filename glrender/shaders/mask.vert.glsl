// One point a pixel, as large as its samples, at the farthest depth.
in vec2 pixel;
uniform vec2 window_px;
uniform float samples;

void main()
{
    gl_Position = vec4(pixel / window_px * 2.0 - 1.0, 1.0, 1.0);
    gl_PointSize = samples;
}
