// A law on given directions, one per pixel: what Renderer.evaluate_brdf runs.
#include "brdf"

uniform sampler2D to_sun;
uniform sampler2D to_camera;
uniform sampler2D normal;
uniform sampler2D albedo_scale;
out float value;

void main()
{
    ivec2 texel = ivec2(gl_FragCoord.xy);
    value = brdf(texelFetch(to_sun, texel, 0).xyz, texelFetch(to_camera, texel, 0).xyz,
                 texelFetch(normal, texel, 0).xyz, texelFetch(albedo_scale, texel, 0).x);
}
