// Counterpart of src/deform/stack.rs and of the derivatives in src/deform/map/derivatives.rs.

struct NearestCut {
    // mm, positive where the volume is retained.
    distance_mm: f32,
    // Unit vector pointing out of the retained part.
    normal: vec3<f32>,
}

const NO_CUT = NearestCut(1e30, vec3<f32>(0.0));

struct Jet {
    source: vec3<f32>,
    alpha: f32,
    d_source_d_deformed: mat3x3<f32>,
    cut: NearestCut,
}

fn nearer_of(cut: NearestCut, value: f32, gradient: vec3<f32>) -> NearestCut {
    let slope = length(gradient);
    if slope < 1e-12 || value >= cut.distance_mm * slope {
        return cut;
    }
    return NearestCut(value / slope, gradient / -slope);
}

fn is_outside(k: u32, x: vec3<f32>) -> bool {
    return any(x < -maps[k].reach) || any(x > 1.0 + maps[k].reach);
}

// A point of a cube in polar coordinates about its z axis (src/deform/mapping.rs).
struct Polar {
    // From the axis, mm.
    radius_mm: f32,
    // Unit vector away from the axis, (sin, cos) of the angle.
    away: vec2<f32>,
    // Map coordinates: turn, height, radius.
    u: vec3<f32>,
}

const TURN: f32 = 6.2831853;

fn polar(k: u32, x: vec3<f32>) -> Polar {
    let q = (x.xy - 0.5) * maps[k].box_mm.xy;
    let radius_mm = length(q);
    let away = select(vec2<f32>(0.0, 1.0), q / max(radius_mm, 1e-30), radius_mm > 0.0);
    return Polar(radius_mm, away, vec3<f32>(turn_of(away), x.z, radius_mm / maps[k].radius_mm));
}

// In 0..1, from a vector away from the axis.
fn turn_of(away: vec2<f32>) -> f32 {
    let turn = atan2(away.x, away.y) / TURN;
    return select(turn, min(turn + 1.0, 0.9999999), turn < 0.0);
}

fn cylinder_holds(u: vec3<f32>) -> bool {
    return u.y >= 0.0 && u.y <= 1.0 && u.z <= 1.0;
}

// From millimetres along the axes of a cube to world millimetres.
fn world_from_local(k: u32) -> mat3x3<f32> {
    let m = linear_part(maps[k].world_from_stored);
    let per = 1.0 / (maps[k].box_mm * maps[k].scale);
    return mat3x3<f32>(m[0] * per.x, m[1] * per.y, m[2] * per.z);
}

// The direction in which the angle grows.
fn along_circle(away: vec2<f32>) -> vec2<f32> {
    return vec2<f32>(away.y, -away.x);
}

// A direction turned further by d map units.
fn turned(away: vec2<f32>, d: f32) -> vec2<f32> {
    let sine = sin(d * TURN);
    let cosine = cos(d * TURN);
    return vec2<f32>(away.x * cosine + away.y * sine, away.y * cosine - away.x * sine);
}

// Displacement along the axes of the cube, mm, of a point that the map displaces by d.
fn moved_in_cylinder(k: u32, at: Polar, d: vec3<f32>) -> vec3<f32> {
    if all(d == vec3<f32>(0.0)) {
        // Free of the rounding of the conversion.
        return vec3<f32>(0.0);
    }
    let radius_mm = max(at.radius_mm + d.z * maps[k].radius_mm, 0.0);
    return vec3<f32>(turned(at.away, d.x) * radius_mm - at.away * at.radius_mm, d.y * maps[k].box_mm.z);
}

// Displacement, mm, and mask of map k.
fn displacement(k: u32, p: vec3<f32>) -> vec4<f32> {
    let x = transform_point(maps[k].map_from_world, p);
    if is_outside(k, x) {
        return vec4<f32>(0.0, 0.0, 0.0, 1.0);
    }
    if maps[k].radius_mm > 0.0 {
        let at = polar(k, x);
        if !cylinder_holds(at.u) {
            return vec4<f32>(0.0, 0.0, 0.0, 1.0);
        }
        let t = fetch(k, at.u);
        return vec4<f32>(world_from_local(k) * moved_in_cylinder(k, at, t.xyz * maps[k].scale), t.w);
    }
    let t = fetch(k, x);
    return vec4<f32>(linear_part(maps[k].world_from_stored) * t.xyz, t.w);
}

// A sample whose mask is at least MIN_MARKED_ALPHA includes a marked texel; a mask that changes by
// more than MIN_MARKED_SLOPE over a map has marked texels nearby.
const MIN_MARKED_ALPHA: f32 = 2.0;
const MIN_MARKED_SLOPE: f32 = 4096.0;

// xyz: the source point; w: the smallest mask along the way. The walk ends where a mask cuts (below
// 1/2).
fn source_and_alpha(deformed: vec3<f32>) -> vec4<f32> {
    if PRECOMPOSED != 0u {
        let d = displacement(MAPS, deformed);
        if d.w < MIN_MARKED_ALPHA {
            return vec4<f32>(deformed + d.xyz, d.w);
        }
    }
    var p = vec4<f32>(deformed, 1.0);
    // The point at which maps that are added to each other are all evaluated.
    var here = deformed;
    for (var n = MAPS; n > 0u; n -= 1u) {
        let d = displacement(n - 1u, here);
        p.w = min(p.w, d.w);
        if d.w < 0.5 {
            break;
        }
        p = vec4<f32>(p.xyz + d.xyz, p.w);
        if maps[n - 1u].added < 0.5 {
            here = p.xyz;
        }
    }
    return p;
}

// As source_and_alpha, but through every map whatever the masks are.
fn source_and_alpha_unclipped(deformed: vec3<f32>) -> vec4<f32> {
    var p = vec4<f32>(deformed, 1.0);
    var here = deformed;
    for (var n = MAPS; n > 0u; n -= 1u) {
        let d = displacement(n - 1u, here);
        p = vec4<f32>(p.xyz + d.xyz, min(p.w, d.w));
        if maps[n - 1u].added < 0.5 {
            here = p.xyz;
        }
    }
    return p;
}

// The jet outside all maps.
fn identity_jet(deformed: vec3<f32>) -> Jet {
    return Jet(deformed, 1.0, mat3x3<f32>(1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0), NO_CUT);
}

// The change of map k along one of its axes, per map unit: stored, or a difference over one texel to each
// side, shortened at the cube's faces.
fn difference(k: u32, x: vec3<f32>, axis: vec3<f32>) -> vec4<f32> {
    if maps[k].slopes_scale > 0.0 {
        return fetch_slopes(k, x, axis.y + 2.0 * axis.z);
    }
    let points = dot(maps[k].size, axis);
    if points < 1.5 {
        return vec4<f32>(0.0);
    }
    let step = 1.0 / (points - 1.0);
    let at = dot(x, axis);
    let low = clamp(at - step, 0.0, 1.0 - step);
    let high = clamp(at + step, step, 1.0);
    let across = x * (1.0 - axis);
    return (fetch(k, across + axis * high) - fetch(k, across + axis * low)) * (1.0 / (high - low));
}

// As difference along x, where the last grid plane is the first one.
fn wrapped_difference(k: u32, u: vec3<f32>) -> vec4<f32> {
    if maps[k].slopes_scale > 0.0 {
        return fetch_slopes(k, u, 0.0);
    }
    if maps[k].size.x < 1.5 {
        return vec4<f32>(0.0);
    }
    let step = 1.0 / (maps[k].size.x - 1.0);
    let low = vec3<f32>(fract(u.x - step), u.yz);
    let high = vec3<f32>(fract(u.x + step), u.yz);
    return (fetch(k, high) - fetch(k, low)) * (0.5 / step);
}

// J_G - I of a map, and its mask's gradient per mm in the world.
struct MapSlopes {
    j: mat3x3<f32>,
    mask: vec3<f32>,
}

fn map_slopes(k: u32, x: vec3<f32>) -> MapSlopes {
    let dy = vec3<f32>(0.0, 1.0, 0.0);
    let dz = vec3<f32>(0.0, 0.0, 1.0);
    let inverse = linear_part(maps[k].map_from_world);
    if maps[k].radius_mm <= 0.0 {
        let a = difference(k, x, vec3<f32>(1.0, 0.0, 0.0));
        let b = difference(k, x, dy);
        let c = difference(k, x, dz);
        return MapSlopes(
            linear_part(maps[k].world_from_stored) * mat3x3<f32>(a.xyz, b.xyz, c.xyz) * inverse,
            transpose(inverse) * vec3<f32>(a.w, b.w, c.w),
        );
    }
    let none = mat3x3<f32>(vec3<f32>(0.0), vec3<f32>(0.0), vec3<f32>(0.0));
    let at = polar(k, x);
    if !cylinder_holds(at.u) {
        return MapSlopes(none, vec3<f32>(0.0));
    }
    let scale = maps[k].scale;
    let d = fetch(k, at.u).xyz * scale;
    let a = wrapped_difference(k, at.u);
    let b = difference(k, at.u, dy);
    let c = difference(k, at.u, dz);
    let box = maps[k].box_mm;
    let clamped = max(at.radius_mm, maps[k].min_radius_mm);
    // Rows of J_C.
    let d_map_d_local = transpose(mat3x3<f32>(
        vec3<f32>(along_circle(at.away) / (TURN * clamped), 0.0),
        vec3<f32>(0.0, 0.0, 1.0 / box.z),
        vec3<f32>(at.away / maps[k].radius_mm, 0.0),
    ));
    let away = turned(at.away, d.x);
    let radius_mm = max(clamped + d.z * maps[k].radius_mm, 0.0);
    let d_local_d_map = mat3x3<f32>(
        vec3<f32>(along_circle(away) * (TURN * radius_mm), 0.0),
        vec3<f32>(0.0, 0.0, box.z),
        vec3<f32>(away * maps[k].radius_mm, 0.0),
    );
    let one = mat3x3<f32>(1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0);
    let j = d_local_d_map * (one + mat3x3<f32>(a.xyz, b.xyz, c.xyz) * scale) * d_map_d_local - one;
    let linear = world_from_local(k);
    let local_from_world = mat3x3<f32>(inverse[0] * box, inverse[1] * box, inverse[2] * box);
    return MapSlopes(
        linear * j * local_from_world,
        transpose(local_from_world) * (transpose(d_map_d_local) * vec3<f32>(a.w, b.w, c.w)),
    );
}

// The jet of the precomposed map; its alpha is MIN_MARKED_ALPHA where the map is not valid.
fn jet_of_precomposed(deformed: vec3<f32>) -> Jet {
    var j = identity_jet(deformed);
    let x = transform_point(maps[MAPS].map_from_world, deformed);
    if is_outside(MAPS, x) {
        return j;
    }
    let moved = displacement(MAPS, deformed);
    let dx = difference(MAPS, x, vec3<f32>(1.0, 0.0, 0.0));
    let dy = difference(MAPS, x, vec3<f32>(0.0, 1.0, 0.0));
    let dz = difference(MAPS, x, vec3<f32>(0.0, 0.0, 1.0));
    let slope = vec3<f32>(dx.w, dy.w, dz.w);
    j.alpha = select(moved.w, MIN_MARKED_ALPHA, any(abs(slope) >= vec3<f32>(MIN_MARKED_SLOPE)));
    let inverse = linear_part(maps[MAPS].map_from_world);
    j.cut = nearer_of(j.cut, moved.w - 0.5, transpose(inverse) * slope);
    j.d_source_d_deformed = j.d_source_d_deformed
        + linear_part(maps[MAPS].world_from_stored) * mat3x3<f32>(dx.xyz, dy.xyz, dz.xyz) * inverse;
    j.source += moved.xyz;
    return j;
}

fn jet(deformed: vec3<f32>) -> Jet {
    if PRECOMPOSED != 0u {
        let j = jet_of_precomposed(deformed);
        if j.alpha < MIN_MARKED_ALPHA {
            return j;
        }
    }
    var j = identity_jet(deformed);
    var here = deformed;
    var d_here = j.d_source_d_deformed;
    for (var n = MAPS; n > 0u; n -= 1u) {
        let k = n - 1u;
        let moved = displacement(k, here);
        let x = transform_point(maps[k].map_from_world, here);
        if !is_outside(k, x) {
            let slopes = map_slopes(k, x);
            j.cut = nearer_of(j.cut, moved.w - 0.5, transpose(d_here) * slopes.mask);
            // J_G = I + A J_D / A.
            j.d_source_d_deformed = j.d_source_d_deformed + slopes.j * d_here;
        }
        j.alpha = min(j.alpha, moved.w);
        j.source += moved.xyz;
        if maps[k].added < 0.5 {
            here = j.source;
            d_here = j.d_source_d_deformed;
        }
    }
    return j;
}
