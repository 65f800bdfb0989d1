// Bounds on a box of a map's texels: stored (D, alpha), and what stored D changes by per map unit along each axis.
struct NodeBounds {
    low: vec4<f32>,
    high: vec4<f32>,
    slope_low: array<vec4<f32>, 3>,
    slope_high: array<vec4<f32>, 3>,
}
