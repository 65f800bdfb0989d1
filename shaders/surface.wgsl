// Traces one object by rays and joins it with its triangles where those were drawn before.
// Counterpart of object_hit in src/cpu/surface_shading.rs; the device does the depth test between objects.

@vertex
fn vertex(@builtin(vertex_index) index: u32) -> @builtin(position) vec4<f32> {
    return vec4<f32>(f32(index & 1u) * 4.0 - 1.0, f32(index >> 1u) * 4.0 - 1.0, 0.5, 1.0);
}

@fragment
fn fragment(@builtin(position) position: vec4<f32>) -> Drawn {
    let ray = pixel_ray(sample_position(position.xy));
    var taken = 0u;
    let event = trace(ray, &taken);
    count(position.xy, vec3<u32>(taken, 0u, 0u));
    var color = vec3<f32>(0.0);
    if event.t >= 0.0 {
        let p = ray.origin + ray.direction * event.t;
        let own = select(
            select(object.inside, object.color, event.side == OUTSIDE), object.cut, event.side == CUT_FACE
        );
        color = surface_light(surface_normal(p, event.side), p, ray.direction, own);
    }
    var t = event.t;
    if object.both != 0u {
        let drawn_t = textureLoad(behind_t, vec2<i32>(position.xy), 0).r;
        let drawn = textureLoad(behind, vec2<i32>(position.xy), 0).rgb;
        if drawn_t < FAR_AWAY {
            if t < 0.0 {
                t = drawn_t;
                color = drawn;
            } else if abs(drawn_t - t) > 2.0 * object.resolution_mm {
                color = select(color, drawn, drawn_t < t);
                t = min(t, drawn_t);
            } else {
                let weight = smoothstep(
                    0.0, object.seam_mm, depth_in_boxes(ray.origin + ray.direction * drawn_t)
                );
                color = mix(drawn, color, weight);
                t = mix(drawn_t, t, weight);
            }
        }
    }
    if t < 0.0 {
        discard;
    }
    return Drawn(vec4<f32>(color, 1.0), t, depth_of(t));
}
