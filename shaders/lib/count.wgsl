// Sample counts, spread over many counters to avoid contention and 32-bit overflow.

@group(1) @binding(0) var<storage, read_write> counts: array<atomic<u32>, 3072>;

// taken, skipped, terminated
fn count(pixel: vec2<f32>, n: vec3<u32>) {
    let slot = 3u * ((u32(pixel.x) * 31u + u32(pixel.y) * 17u) % 1024u);
    atomicAdd(&counts[slot], n.x);
    atomicAdd(&counts[slot + 1u], n.y);
    atomicAdd(&counts[slot + 2u], n.z);
}
