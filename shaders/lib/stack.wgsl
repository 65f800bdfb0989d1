// Counterpart of src/deform/stack.rs and of the derivatives in src/deform/map.rs.

struct Cut {
    // mm, positive where matter is.
    distance_mm: f32,
    // Unit, out of the matter.
    normal: vec3<f32>,
}

const NO_CUT = Cut(1e30, vec3<f32>(0.0));

struct Jet {
    source: vec3<f32>,
    alpha: f32,
    d_source_d_deformed: mat3x3<f32>,
    cut: Cut,
}

fn or_nearer(cut: Cut, value: f32, gradient: vec3<f32>) -> Cut {
    let slope = length(gradient);
    if slope < 1e-12 || value >= cut.distance_mm * slope {
        return cut;
    }
    return Cut(value / slope, gradient / -slope);
}

fn outside(x: vec3<f32>) -> bool {
    return any(x < vec3<f32>(0.0)) || any(x > vec3<f32>(1.0));
}

// The point before map k was applied, and the mask.
fn backward(k: u32, p: vec3<f32>) -> vec4<f32> {
    let x = transform_point(maps[k].map_from_world, p);
    if outside(x) {
        return vec4<f32>(p, 1.0);
    }
    let t = fetch(k, x);
    return vec4<f32>(p + linear_part(maps[k].world_from_stored) * t.xyz, t.w);
}

// xyz: the source point; w: the smallest mask value on the way. The walk ends where a mask cuts (below 1/2).
fn walk(deformed: vec3<f32>) -> vec4<f32> {
    var p = vec4<f32>(deformed, 1.0);
    for (var n = MAPS; n > 0u; n -= 1u) {
        let before = backward(n - 1u, p.xyz);
        p.w = min(p.w, before.w);
        if before.w < 0.5 {
            break;
        }
        p = vec4<f32>(before.xyz, p.w);
    }
    return p;
}

fn jet(deformed: vec3<f32>) -> Jet {
    var j = Jet(deformed, 1.0, mat3x3<f32>(1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0), NO_CUT);
    for (var n = MAPS; n > 0u; n -= 1u) {
        let k = n - 1u;
        let p = j.source;
        let before = backward(k, p);
        let x = transform_point(maps[k].map_from_world, p);
        if !outside(x) {
            // Differences over one texel to each side, shortened at the cube's faces; columns are d stored / d map axis.
            let size = maps[k].size;
            var columns = array<vec3<f32>, 3>(vec3<f32>(0.0), vec3<f32>(0.0), vec3<f32>(0.0));
            var slope = vec3<f32>(0.0);
            for (var axis = 0; axis < 3; axis += 1) {
                if size[axis] < 1.5 {
                    continue;
                }
                let step = 1.0 / (size[axis] - 1.0);
                var low = x;
                var high = x;
                low[axis] = max(x[axis] - step, 0.0);
                high[axis] = min(x[axis] + step, 1.0);
                let d = (fetch(k, high) - fetch(k, low)) / (high[axis] - low[axis]);
                columns[axis] = d.xyz;
                slope[axis] = d.w;
            }
            let inverse = linear_part(maps[k].map_from_world);
            j.cut = or_nearer(j.cut, before.w - 0.5, transpose(j.d_source_d_deformed) * (transpose(inverse) * slope));
            // J_G = I + A J_D / A.
            let moved = linear_part(maps[k].world_from_stored) * mat3x3<f32>(columns[0], columns[1], columns[2]) * inverse;
            j.d_source_d_deformed = j.d_source_d_deformed + moved * j.d_source_d_deformed;
        }
        j.alpha = min(j.alpha, before.w);
        j.source = before.xyz;
    }
    return j;
}
