// Counterpart of src/mesh/deformer.rs: [GG42] in a vertex shader.

struct DeformedVertex {
    p: vec3<f32>,
    j: mat3x3<f32>,
}

fn bernstein(t: f32) -> vec4<f32> {
    let s = 1.0 - t;
    return vec4<f32>(s * s * s, 3.0 * s * s * t, 3.0 * s * t * t, t * t * t);
}

fn bernstein_slope(t: f32) -> vec4<f32> {
    let s = 1.0 - t;
    return vec4<f32>(-3.0 * s * s, 3.0 * s * s - 6.0 * s * t, 6.0 * s * t - 3.0 * t * t, 3.0 * t * t);
}

fn deformer_local(k: u32, p: vec3<f32>) -> DeformedVertex {
    let top = deformers[k].half.z;
    let n = deformers[k].numbers;
    let h = clamp(p.z, -top, top);
    let dh = select(0.0, 1.0, abs(p.z) <= top);
    let x_axis = vec3<f32>(1.0, 0.0, 0.0);
    let y_axis = vec3<f32>(0.0, 1.0, 0.0);
    let z_axis = vec3<f32>(0.0, 0.0, 1.0);
    switch deformers[k].kind {
        case DEFORMER_TWIST: {
            let s = sin(n.x * h);
            let c = cos(n.x * h);
            let q = vec3<f32>(c * p.x - s * p.y, s * p.x + c * p.y, p.z);
            return DeformedVertex(
                q,
                mat3x3<f32>(
                    vec3<f32>(c, s, 0.0),
                    vec3<f32>(-s, c, 0.0),
                    vec3<f32>(-q.y * n.x * dh, q.x * n.x * dh, 1.0),
                ),
            );
        }
        case DEFORMER_BEND: {
            if abs(n.x) < 1e-9 {
                return DeformedVertex(p, mat3x3<f32>(x_axis, y_axis, z_axis));
            }
            let s = sin(n.x * h);
            let c = cos(n.x * h);
            let beyond = p.z - h;
            let r = 1.0 / n.x - p.x;
            let q = vec3<f32>(1.0 / n.x - r * c + beyond * s, p.y, r * s + beyond * c);
            let along = vec3<f32>(r * n.x * s * dh + s * (1.0 - dh), 0.0, r * n.x * c * dh + c * (1.0 - dh));
            return DeformedVertex(q, mat3x3<f32>(vec3<f32>(c, 0.0, -s), y_axis, along));
        }
        case DEFORMER_TAPER: {
            let slope = (n.x - 1.0) / (2.0 * top);
            let scale = 1.0 + slope * (h + top);
            let last = vec3<f32>(slope * dh * p.xy, 1.0);
            return DeformedVertex(
                vec3<f32>(scale * p.xy, p.z), mat3x3<f32>(x_axis * scale, y_axis * scale, last)
            );
        }
        case DEFORMER_SHEAR: {
            return DeformedVertex(
                vec3<f32>(p.x + n.x * h, p.yz), mat3x3<f32>(x_axis, y_axis, vec3<f32>(n.x * dh, 0.0, 1.0))
            );
        }
        case DEFORMER_BULGE: {
            let g = n.x * exp(-(p.z / n.y) * (p.z / n.y));
            let scale = 1.0 + g;
            let last = vec3<f32>(-2.0 * p.z / (n.y * n.y) * g * p.xy, 1.0);
            return DeformedVertex(
                vec3<f32>(scale * p.xy, p.z), mat3x3<f32>(x_axis * scale, y_axis * scale, last)
            );
        }
        case DEFORMER_WAVE: {
            let r = length(p.xy);
            let angle = n.y * r + n.z;
            let slope = select(0.0, n.x * n.y * cos(angle) / max(r, 1e-12), r > 1e-12);
            let q = vec3<f32>(p.xy, p.z + n.x * sin(angle));
            return DeformedVertex(
                q, mat3x3<f32>(vec3<f32>(1.0, 0.0, slope * p.x), vec3<f32>(0.0, 1.0, slope * p.y), z_axis)
            );
        }
        default: {
            let half = deformers[k].half;
            let t = clamp((p / half + 1.0) * 0.5, vec3<f32>(0.0), vec3<f32>(1.0));
            let scale = select(vec3<f32>(0.0), 0.5 / half, abs(p) <= half);
            let bx = bernstein(t.x);
            let by = bernstein(t.y);
            let bz = bernstein(t.z);
            let dx = bernstein_slope(t.x);
            let dy = bernstein_slope(t.y);
            let dz = bernstein_slope(t.z);
            var moved = vec3<f32>(0.0);
            var jx = vec3<f32>(0.0);
            var jy = vec3<f32>(0.0);
            var jz = vec3<f32>(0.0);
            for (var i = 0u; i < 64u; i += 1u) {
                let o = deformers[k].offsets[i].xyz;
                let a = i % 4u;
                let b = i / 4u % 4u;
                let c = i / 16u;
                moved += o * (bx[a] * by[b] * bz[c]);
                jx += o * (dx[a] * by[b] * bz[c]);
                jy += o * (bx[a] * dy[b] * bz[c]);
                jz += o * (bx[a] * by[b] * dz[c]);
            }
            return DeformedVertex(
                p + moved, mat3x3<f32>(x_axis + jx * scale.x, y_axis + jy * scale.y, z_axis + jz * scale.z)
            );
        }
    }
}

fn apply_all(world: vec3<f32>) -> DeformedVertex {
    var all = DeformedVertex(world, mat3x3<f32>(1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0));
    for (var k = 0u; k < object.deformers; k += 1u) {
        let m = deformers[k].local_from_world;
        let own = deformer_local(k, transform_point(m, all.p));
        let linear = linear_part(m);
        // The transform is rigid, hence the inverse of its linear part is its transpose.
        let back = transpose(linear);
        all = DeformedVertex(back * (own.p - m[3].xyz), back * own.j * linear * all.j);
    }
    return all;
}

// Position and normal of a vertex.
fn deform_vertex(world: vec3<f32>, normal: vec3<f32>) -> array<vec3<f32>, 2> {
    let d = apply_all(world);
    let a = cross(normal, vec3<f32>(0.0, 0.0, 1.0));
    let b = cross(normal, vec3<f32>(0.0, 1.0, 0.0));
    let tangent = normalize_or(select(b, a, dot(a, a) >= dot(b, b)), vec3<f32>(1.0, 0.0, 0.0));
    let binormal = cross(normal, tangent);
    var turned = vec3<f32>(0.0);
    switch object.normal_method {
        case NORMAL_METHOD_INVERSE_TRANSPOSE: {
            turned = mat3x3<f32>(
                cross(d.j[1], d.j[2]), cross(d.j[2], d.j[0]), cross(d.j[0], d.j[1])
            ) * normal;
        }
        case NORMAL_METHOD_TANGENT: { turned = cross(d.j * tangent, d.j * binormal); }
        default: {
            let h = object.vertex_offset_mm;
            turned = cross(apply_all(world + tangent * h).p - d.p, apply_all(world + binormal * h).p - d.p);
        }
    }
    return array<vec3<f32>, 2>(d.p, normalize_or(turned, normal));
}
