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

// Displacement, mm, and mask of map k.
fn displacement(k: u32, p: vec3<f32>) -> vec4<f32> {
    let x = transform_point(maps[k].map_from_world, p);
    if is_outside(k, x) {
        return vec4<f32>(0.0, 0.0, 0.0, 1.0);
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

// The change of map k along one of its axes, per map unit: a difference over one texel to each
// side, shortened at the cube's faces.
fn difference(k: u32, x: vec3<f32>, axis: vec3<f32>) -> vec4<f32> {
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
            let dx = difference(k, x, vec3<f32>(1.0, 0.0, 0.0));
            let dy = difference(k, x, vec3<f32>(0.0, 1.0, 0.0));
            let dz = difference(k, x, vec3<f32>(0.0, 0.0, 1.0));
            let slope = vec3<f32>(dx.w, dy.w, dz.w);
            let inverse = linear_part(maps[k].map_from_world);
            j.cut = nearer_of(j.cut, moved.w - 0.5, transpose(d_here) * (transpose(inverse) * slope));
            // J_G = I + A J_D / A.
            let j_d = linear_part(maps[k].world_from_stored) * mat3x3<f32>(dx.xyz, dy.xyz, dz.xyz) * inverse;
            j.d_source_d_deformed = j.d_source_d_deformed + j_d * d_here;
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
