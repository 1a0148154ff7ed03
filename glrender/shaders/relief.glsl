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

// A layer's size as far as pixels of a footprint [m] resolve it, and as far as it rises [m] by more than least [m].
float weight_of(int start, float footprint, float rise, float least)
{
    vec4 values = relief_layers[start + 4];
    float weight = values.x * smoothstep(2.0, 4.0, values.y / footprint);
    return least > 0.0 ? weight * smoothstep(1.0, 2.0, rise / least) : weight;
}

vec4 noise(int start, vec3 r, float footprint, float least)
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
    float height = mix(mix(a, c, w.y), mix(e, g, w.y), w.z) + w.x * along_x;
    return weight_of(start, footprint, relief_layers[start + 4].x, least)
        * vec4(to_body(start, rate * vec3(along_x, along_y, along_z)), height);
}

// Height of a crater over its radius, and rate, by the square of the distance from its middle over its radius.
vec2 crater(float t)
{
    const float OUTSIDE = REACH * REACH - 1.0;
    float v = clamp((t - 1.0) / OUTSIDE, 0.0, 1.0);
    return t < 1.0 ? vec2((1.0 + RIM) * t * t * (3.0 - 2.0 * t) - 1.0, (1.0 + RIM) * 6.0 * t * (1.0 - t))
                   : RIM * vec2(1.0 - v * v * (3.0 - 2.0 * v), -6.0 * v * (1.0 - v) / OUTSIDE);
}

vec2 boulder(float t)
{
    float u = max(1.0 - t, 0.0);
    return vec2(u * u, -2.0 * u);
}

vec4 feature(int start, vec3 r, float footprint, float least, const bool is_crater)
{
    vec4 values = relief_layers[start + 4];
    ivec3 cell;
    vec3 place = on_lattice(start, r, cell);
    uint key = hashed(keyed(cell, uint(int(relief_layers[start + 3].w))));
    uint own = hashed(key + 1u);
    vec4 byte = vec4(ivec4(own & 255u, (own >> 8) & 255u, (own >> 16) & 255u, own >> 24)) / 255.0;
    float radius = values.w * (0.5 + 0.5 * byte.w), reach = is_crater ? REACH * radius : radius;
    vec3 aside = (place - 0.5 - (2.0 * byte.xyz - 1.0) * (0.5 - reach)) / radius;
    float t = float(int(key >> 8)) * 5.9604644775390625e-8 < values.z ? dot(aside, aside) : 1e6;
    vec2 form = is_crater ? crater(t) : boulder(t);
    vec3 row = relief_layers[start].xyz;
    float cell_m = inversesqrt(dot(row, row));
    return weight_of(start, footprint, values.x * values.w * cell_m, least)
        * vec4(2.0 * form.y * cell_m * to_body(start, aside), form.x * radius * cell_m);
}

// Slope and height of the first layers of each kind, for the footprint of a pixel [m].
vec4 relief(vec3 r, float footprint, float least, int n_noise, int n_craters, int n_boulders)
{
    vec4 sum = vec4(0.0);
    for (int k = 0; k < n_noise; k++)
        sum += noise(5 * k, r, footprint, least);
    for (int k = relief_noise; k < relief_noise + n_craters; k++)
        sum += feature(5 * k, r, footprint, least, true);
    for (int k = relief_noise + relief_craters; k < relief_noise + relief_craters + n_boulders; k++)
        sum += feature(5 * k, r, footprint, least, false);
    return sum;
}

// A facet's normal as the ground tilts it where a line of sight meets it.
vec3 relief_normal(vec3 normal, vec3 r, float footprint, vec3 to_camera)
{
    float cosine = dot(normal, to_camera), height = 0.0;
    vec3 per_height = (to_camera - cosine * normal) / max(cosine, 0.2);
    for (int k = 0; k < 2; k++)
        height = relief(r + per_height * height, footprint, 0.125 * footprint, high_noise, high_craters, high_boulders).w;
    vec3 slope = relief(r + per_height * height, footprint, 0.0, relief_noise, relief_craters, relief_boulders).xyz;
    vec3 tilted = normalize(normal - slope + dot(slope, normal) * normal);
    float excess = 1e-3 - dot(tilted, to_camera);
    return excess > 0.0 ? normalize(tilted + excess * to_camera) : tilted;
}
