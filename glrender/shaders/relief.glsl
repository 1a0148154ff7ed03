// Slope of a body's surface detail: the twin of glrender/relief.py, which says what it is.
// A layer is five vec4: rows of lattice_from_body, each with the origin's place in its cube; the origin's cube and
// the seed; size, scale, share, radius.

const float REACH = 1.6, RIM = 0.2;

uint hashed(uint value)
{
    value = (value ^ (value >> 16)) * 0x7FEB352Du;
    value = (value ^ (value >> 15)) * 0x846CA68Bu;
    return value ^ (value >> 16);
}

uint keyed(ivec3 cell, uint seed)
{
    return seed + uint(cell.x) * 0x8DA6B343u + uint(cell.y) * 0xD8163841u + uint(cell.z) * 0xCB1AB31Fu;
}

float number(uint key) { return float(int(hashed(key) >> 8)) * 1.1920928955078125e-7 - 1.0; }

// Where a point is on a layer's lattice: its cube, and its place within.
vec3 on_lattice(int start, vec3 r, out ivec3 cell)
{
    vec4 x = relief_layers[start], y = relief_layers[start + 1], z = relief_layers[start + 2];
    vec3 place = vec3(dot(x.xyz, r) + x.w, dot(y.xyz, r) + y.w, dot(z.xyz, r) + z.w);
    vec3 corner = floor(place);
    cell = ivec3(corner) + ivec3(relief_layers[start + 3].xyz);
    return place - corner;
}

vec3 to_body(int start, vec3 lattice)
{
    return lattice.x * relief_layers[start].xyz + lattice.y * relief_layers[start + 1].xyz
        + lattice.z * relief_layers[start + 2].xyz;
}

float weight_of(int start, float footprint)
{
    vec4 values = relief_layers[start + 4];
    return values.x * smoothstep(2.0, 4.0, values.y / footprint);
}

vec3 noise_slope(int start, vec3 r)
{
    ivec3 cell;
    vec3 t = on_lattice(start, r, cell);
    vec3 w = t * t * t * (t * (t * 6.0 - 15.0) + 10.0), rate = 30.0 * t * t * (t - 1.0) * (t - 1.0);
    uint key = keyed(cell, uint(int(relief_layers[start + 3].w)));
    const uint X = 0x8DA6B343u, Y = 0xD8163841u, Z = 0xCB1AB31Fu;
    float a = number(key), b = number(key + X), c = number(key + Y), d = number(key + X + Y);
    float e = number(key + Z), f = number(key + X + Z), g = number(key + Y + Z), h = number(key + X + Y + Z);
    // Differences along x, y and z, each linear along the other two.
    float along_x = mix(mix(b - a, d - c, w.y), mix(f - e, h - g, w.y), w.z);
    float along_y = mix(mix(c - a, d - b, w.x), mix(g - e, h - f, w.x), w.z);
    float along_z = mix(mix(e - a, f - b, w.x), mix(g - c, h - d, w.x), w.y);
    return to_body(start, rate * vec3(along_x, along_y, along_z));
}

float crater_rate(float t)
{
    const float OUTSIDE = REACH * REACH - 1.0;
    float v = clamp((t - 1.0) / OUTSIDE, 0.0, 1.0);
    return t < 1.0 ? (1.0 + RIM) * 6.0 * t * (1.0 - t) : -RIM * 6.0 * v * (1.0 - v) / OUTSIDE;
}

float boulder_rate(float t) { return -2.0 * max(1.0 - t, 0.0); }

// The vector from a feature's middle in its radii, as body coordinates; zero where there is none.
vec3 feature_aside(int start, vec3 r, float reach, out float t)
{
    vec4 values = relief_layers[start + 4];
    ivec3 cell;
    vec3 place = on_lattice(start, r, cell);
    uint key = hashed(keyed(cell, uint(int(relief_layers[start + 3].w))));
    uint own = hashed(key + 1u);
    vec4 byte = vec4(ivec4(own & 255u, (own >> 8) & 255u, (own >> 16) & 255u, own >> 24)) / 255.0;
    float radius = values.w * (0.5 + 0.5 * byte.w);
    vec3 aside = (place - 0.5 - (2.0 * byte.xyz - 1.0) * (0.5 - radius * reach)) / radius;
    t = float(int(key >> 8)) * 5.9604644775390625e-8 < values.z ? dot(aside, aside) : 1e6;
    vec3 row = relief_layers[start].xyz;
    return to_body(start, aside) * inversesqrt(dot(row, row));
}

// Gradient of the height at a point, for the footprint of a pixel there [m].
vec3 relief_slope(vec3 r, float footprint)
{
    vec3 slope = vec3(0.0);
    int layer = 0;
    float t;
    for (; layer < relief_noise; layer++)
        slope += weight_of(5 * layer, footprint) * noise_slope(5 * layer, r);
    for (; layer < relief_noise + relief_craters; layer++) {
        vec3 aside = feature_aside(5 * layer, r, REACH, t);
        slope += weight_of(5 * layer, footprint) * 2.0 * crater_rate(t) * aside;
    }
    for (; layer < relief_noise + relief_craters + relief_boulders; layer++) {
        vec3 aside = feature_aside(5 * layer, r, 1.0, t);
        slope += weight_of(5 * layer, footprint) * 2.0 * boulder_rate(t) * aside;
    }
    return slope;
}

// A facet's normal tilted by the slope; turned back where it would face away from the camera.
vec3 relief_normal(vec3 normal, vec3 r, float footprint, vec3 to_camera)
{
    vec3 slope = relief_slope(r, footprint);
    vec3 tilted = normalize(normal - slope + dot(slope, normal) * normal);
    float excess = 1e-3 - dot(tilted, to_camera);
    return excess > 0.0 ? normalize(tilted + excess * to_camera) : tilted;
}
