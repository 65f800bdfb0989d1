// What a fragment of a slice shows of one surface: an opaque hit between this slice and the one in
// front of it. Counterpart of add_surfaces in src/cpu/slices.rs.

// The first hit on the part of a ray, `step` long, that ends at `t`.
fn hit_in_slice(ray: Ray, t: f32, step: f32) -> SurfaceEvent {
    var event = SurfaceEvent(-1.0, OUTSIDE);
    let here = ray.origin + ray.direction * t;
    let cell = object_cell(here);
    let reach = textureLoad(object_cells, vec3<i32>(cell), 0).r;
    let low = object.cells_origin + (cell - (reach - 1.0)) * object.cell_mm;
    let high = object.cells_origin + (cell + reach) * object.cell_mm;
    let start = max(t - step, 0.0);
    let before = ray.origin + ray.direction * start;
    // Nothing shows between two points of one block of empty cells.
    let is_empty = reach > 0.5 && all(before >= low) && all(before <= high) && all(here >= low) && all(here <= high);
    if !is_empty {
        let a = surface_sample(ray, start);
        let b = surface_sample(ray, t);
        if changes(a, b) {
            event = first_event(ray, a, b);
        }
    }
    return event;
}

// Premultiplied colour, and the distance along the pixel's ray; negative: nothing shows.
struct SliceHit {
    color: vec4<f32>,
    t: f32,
}

fn slice_hit(slice: Slice) -> SliceHit {
    let ray = pixel_ray(slice.position.xy);
    let step = frame.step_mm / dot(ray.direction, frame.forward);
    let t = (f32(slice.first) + 0.5) * step;
    let shift = pixel_shift(vec2<u32>(slice.position.xy)) * step;
    var hit = SliceHit(vec4<f32>(0.0), -1.0);
    var until = FAR_AWAY;
    if BEHIND != 0u {
        until = textureLoad(behind_t, vec2<i32>(slice.position.xy), 0).r - shift;
    }
    // A hit lies between this slice and the one in front of it.
    if t - step < until {
        count(slice.position.xy, vec3<u32>(2u, 0u, 0u));
        let event = hit_in_slice(ray, t + shift, step);
        if event.t >= 0.0 && event.t - shift < until {
            let p = ray.origin + ray.direction * event.t;
            let own = select(
                select(object.inside, object.color, event.side == OUTSIDE), object.cut, event.side == CUT_FACE
            );
            let color = surface_light(surface_normal(p, event.side), p, ray.direction, own);
            hit = SliceHit(vec4<f32>(color, 1.0), event.t);
        }
    }
    return hit;
}

struct ShownSlice {
    @location(0) color: vec4<f32>,
    // Between surfaces that are hit in one slice the device's depth test decides.
    @builtin(frag_depth) depth: f32,
}

// Back to front.
@fragment
fn fragment(slice: Slice) -> ShownSlice {
    let hit = slice_hit(slice);
    if hit.t < 0.0 {
        discard;
    }
    return ShownSlice(hit.color, depth_of(hit.t));
}

// Front to back, under what is there.
@fragment
fn fragment_under(slice: Slice) -> @location(0) vec4<f32> {
    let hit = slice_hit(slice);
    if hit.t < 0.0 {
        discard;
    }
    return hit.color;
}
