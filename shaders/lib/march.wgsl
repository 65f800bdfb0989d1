// Rays and empty blocks.

struct Ray {
    origin: vec3<f32>,
    direction: vec3<f32>,
}

// The ray through a position on the picture, in 0 .. picture, y pointing down, or through the same
// position of every pixel.
fn pixel_ray(position: vec2<f32>) -> Ray {
    let at = position + frame.sample_offset;
    let u = at.x / frame.picture.x * 2.0 - 1.0;
    let v = 1.0 - at.y / frame.picture.y * 2.0;
    let across = frame.right * u + frame.up * v;
    if frame.perspective > 0.5 {
        return Ray(frame.eye, normalize(frame.forward + across));
    }
    return Ray(frame.eye + across, frame.forward);
}

fn first_sample_after(t: f32, step: f32) -> i32 {
    return i32(max(ceil(t / step - 0.5), 0.0));
}

// The block of cells of one kind around a point.
struct MacrocellBlock {
    // Nothing in it is visible.
    empty: bool,
    // Something may be visible, but no mask varies and no shape is near.
    cut_free: bool,
    // Parameter at which the ray leaves the block, if either flag is set.
    until: f32,
}

const CUT_FREE_FLAG: u32 = 128u;

// The cell of a point; the nearest one for a point outside the grid.
fn cell_of(p: vec3<f32>) -> vec3<f32> {
    return clamp(floor((p - frame.cells_origin) / frame.cell_mm), vec3<f32>(0.0), vec3<f32>(frame.cells) - 1.0);
}

fn block_around(p: vec3<f32>, origin: vec3<f32>, inverse_direction: vec3<f32>) -> MacrocellBlock {
    let cell = cell_of(p);
    let d = cell_block(vec3<i32>(cell));
    let reach = f32(d & (CUT_FREE_FLAG - 1u));
    let low = frame.cells_origin + (cell - (reach - 1.0)) * frame.cell_mm;
    let high = frame.cells_origin + (cell + reach) * frame.cell_mm;
    let cut_free = d >= CUT_FREE_FLAG;
    return MacrocellBlock(d > 0u && !cut_free, cut_free, leaves_box(low, high, origin, inverse_direction));
}
