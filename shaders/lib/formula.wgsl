// Counterpart of src/mesh/formula.rs.

const GYROID_SLOPE: f32 = 1.75;

fn to_box(p: vec3<f32>, half: vec3<f32>) -> f32 {
    let d = abs(p) - half;
    return length(max(d, vec3<f32>(0.0))) + min(max(d.x, max(d.y, d.z)), 0.0);
}

fn solid_distance(k: u32, p: vec3<f32>) -> f32 {
    let n = solids[k].numbers;
    switch solids[k].solid {
        case SOLID_SPHERE: { return n.x - length(p); }
        case SOLID_BOX: { return -to_box(p, n.xyz); }
        case SOLID_TORUS: { return n.y - length(vec2<f32>(length(p.xy) - n.x, p.z)); }
        case SOLID_CYLINDER: {
            let d = vec2<f32>(length(p.xy) - n.x, abs(p.z) - n.y);
            return -(length(max(d, vec2<f32>(0.0))) + min(max(d.x, d.y), 0.0));
        }
        default: {
            let k_mm = 6.2831855 / solids[k].period;
            let q = p * k_mm;
            let g = sin(q.x) * cos(q.y) + sin(q.y) * cos(q.z) + sin(q.z) * cos(q.x);
            return min(0.5 * solids[k].wall - abs(g) / (GYROID_SLOPE * k_mm), -to_box(p, n.xyz));
        }
    }
}

fn formula_distance(world: vec3<f32>) -> f32 {
    var all = -1e30;
    for (var k = 0u; k < object.solids; k += 1u) {
        let d = solid_distance(k, transform_point(solids[k].local_from_world, world));
        switch solids[k].join {
            case JOIN_UNION: { all = max(all, d); }
            case JOIN_INTERSECT: { all = min(all, d); }
            default: { all = min(all, -d); }
        }
    }
    return all;
}
