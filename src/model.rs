//! The mathematics shared by all parts of the program: spaces, formulas, conventions.
//!
//! This module holds no code. CPU code, shaders, readers and tests follow it. Where two papers
//! disagree, the choice made here applies.
//!
//! | | |
//! |---|---|
//! | \[DDM06\] | Correa, Silver, Chen, *Discontinuous Displacement Mapping for Volume Graphics*, Volume Graphics 2006 |
//! | \[DS07\] | Correa, Silver, *Programmable Shaders for Deformation Rendering*, Graphics Hardware 2007 |
//! | \[GG42\] | d'Eon, *Deformers*, GPU Gems chapter 42, 2004 |
//! | \[RVD01\] | Westermann, Rezk-Salama, *Real-Time Volume Deformations*, Eurographics 2001 |
//!
//! # Spaces
//!
//! | space | unit | |
//! |---|---|---|
//! | voxel | index (i, j, k), centres at integers | i varies fastest in memory |
//! | world | millimetres, patient LPS | whatever the file uses; NIfTI's RAS is flipped in x and y on reading and writing |
//! | texture | the unit cube over a volume's grid, texel centres at (i + 1/2)/n | within the renderers only |
//! | map | the unit cube of one displacement map, grid points at i/(n-1), so on its faces | where D and alpha are defined |
//! | local | millimetres from the centre of a deformation's box, along its axes | where kinds are defined |
//! | view, clip | wgpu's conventions | camera |
//!
//! A volume carries an affine `world_from_voxel`: spacing, direction and origin. Anisotropic and
//! oblique grids are supported throughout. A placement `world_from_map` places a map in the world;
//! A is its linear part. Transforms are named `target_from_source`.
//!
//! # Displacement maps
//!
//! A map is a 3D grid of four numbers over its unit cube: the *inverse* displacement D and the
//! alpha mask ([`DisplacementMap`](crate::deform::DisplacementMap)). An axis of one grid point does
//! not vary. The map gives the source point p of the sample at a deformed point p':
//!
//! ```text
//! p = p' + A D(world_from_map⁻¹ p')     inside the map's cube
//! p = p'                                outside it                        [DDM06 eq 3], [DS07 eq 2]
//! ```
//!
//! - D is in map units. It is stored divided by its largest component, so in \[-1, 1\], with one
//!   scale per map: as 16-bit floats by default, or as 16-bit or 8-bit steps, or as 32-bit floats
//!   (fields from files). Quantisation to eight bits is visible (\[DDM06\] section 8).
//! - alpha = 1: the point is present. alpha = 0: it is cut away. A sample with alpha below 1/2 is
//!   discarded (\[DDM06\] 4.2).
//! - D is continuous wherever a sample can be retained, also across a cut: the *pseudo-inverse* of
//!   \[DDM06\] 4.1. The discontinuity lies in alpha alone, so that interpolation never mixes values
//!   from both sides. Between texels that are all cut away D may jump: no sample there is retained,
//!   nor is one whose differences reach them.
//! - The mask is a ramp of the signed distance d to the nearest cut, in millimetres, positive on
//!   the retained side. \[DDM06\] section 5 blurs a binary mask instead, which moves the contour
//!   where a cut bends.
//!
//! ```text
//! alpha = clamp(1/2 + d / 2w)      w = max(2 texels, 1.2 times the reach of the blend of normals)
//! ```
//!
//! - D should vanish on the faces of the cube. A kind lists the faces on which it does not
//!   ([`nonzero_faces`](crate::deform::kinds::Kind::nonzero_faces)): there the box should end in
//!   empty space. Where it does not, the tear is reported with the face and its width
//!   ([`Tear`](crate::prepare::Tear)), and `fade` lets D fall to zero towards the faces.
//! - A field from a registration, a saved map and a composite are ordinary maps. A field's
//!   outermost vectors extend to the faces of their voxels, half a voxel beyond the cube.
//!
//! Whatever made it (a formula, a brush, a file, an inverse), a map is placed, mapped, faded, kept
//! from labels, added and stacked in the same way.
//!
//! **Cylindrical coordinates** (\[DS07\] 3.2) are part of a map's placement and evaluated at every
//! sample ([`mapping`](crate::deform::mapping)). With x' = M⁻¹ p' and ρ half the shorter of the box's
//! extents along x and y, in millimetres:
//!
//! ```text
//! u = C(x') = (fract(θ / 2π), height, r / ρ)        θ = atan2(x, y)        v = u + D(u)
//! p = M C⁻¹(v)        J_G = A · J_{C⁻¹}(v) · (I + J_D(u)) · J_C(x') · A⁻¹
//! ```
//!
//! so that the map's x runs around the box's z axis, its y along it, its z outwards. Inside is
//! 0 <= u.y <= 1, u.z <= 1. The first and the last grid plane along x are the same, and differences
//! wrap; a map for which they are not tears at its seam. Derivatives take r as at least half a texel.
//!
//! # Composition
//!
//! Maps form an ordered stack. A sample walks from the last applied to the first
//! ([`Stack::source_and_alpha`](crate::deform::Stack::source_and_alpha)). With G_k(p) = p + A_k
//! D_k(M_k⁻¹ p):
//!
//! ```text
//! p = G_1(G_2(... G_n(p')))        alpha = min over k of alpha_k, each at the point where map k is evaluated
//!                                                                               [DDM06 eq 9]
//! ```
//!
//! The walk ends where a mask is below 1/2. The masks combine by their minimum, not their product:
//! where smoothed masks overlap, a product moves the contour (0.6 · 0.6 < 0.5). The order of the
//! maps matters.
//!
//! A map may be *added* to the one before it (\[DS07\] section 4). Both are evaluated at the same
//! point and their displacements add.
//!
//! On the fly, every sample walks all maps. With an error bound, a single composite map replaces
//! the stack wherever its error is within the bound; cells where it is not are marked, and there
//! the maps are walked ([`compose`](crate::deform::compose)).
//!
//! Removals at the end of the stack are not maps but shapes with a signed distance of Lipschitz
//! constant 1 ([`cut`](crate::deform::cut)). The retained part of each ray step is found exactly,
//! and the step is weighted by its length.
//!
//! # Normals
//!
//! ```text
//! J_G   = I + A J_D A⁻¹ = A (I + J_D) A⁻¹                      one map          d_source_d_deformed
//! J     = J_1(p_1) J_2(p_2) ··· J_n(p_n)                       the stack, p_k where map k is evaluated
//! g'    = Jᵀ g                                                 gradient         [DDM06 eq 6, 10], [DS07 eq 5]
//! n'    = normalise(ω c n + (1 - ω) n_cut)                     near a cut       [DDM06 eq 7]
//! ```
//!
//! J_D is taken by central differences over one texel to each side, shortened at the cube's faces;
//! or it is interpolated between the same differences stored for each texel (`render.jacobian`,
//! \[DDM06\] 4.3), which inside a map is the same function ([`MapFilter`](crate::deform::MapFilter)).
//! g is the scan's gradient in world millimetres: the gradient per voxel times the transposed
//! inverse of the voxel axes. n is Jᵀ g normalised, pointing out of the visible material. n_cut is
//! the outward unit normal of the nearest cut.
//!
//! - ω rises from 0 to 1 (smoothstep) with the distance from the cut, between s and 2.5 s, where s
//!   is the step or the reference length, whichever is longer. The paper blends over the mask's
//!   value, which depends on a map's resolution.
//! - c is the surface confidence: 0 where the change of the transfer function's coordinate over one
//!   reference length is below 0.004, 1 above 0.04. A uniform region has no surface.
//! - The cut's normal is blended in only where the ray comes out of the cut, and where the material
//!   behind the cut's face is at least half as dense. The six faces of the volume's box are treated
//!   as cuts as well.
//!
//! For a linear map D(x) = Lx the rule is exact.
//!
//! **Forward deformers** of meshes (\[GG42\]) move a vertex to f(x); J = df/dx. Its normal is the
//! direction of J⁻ᵀ n, or of J t × J b for a tangent t and binormal b. Check value: the radial wave
//! f = (x, y + sin(2 √(x² + z²)), z) at (3, 0, 4) with n = (0, 1, 0), t = (-1, 0, 1), b = (1, 0, 1)
//! gives
//!
//! ```text
//! J t × J b = (2.01377, 2, 2.68503)        n' = (0.515426, 0.511902, 0.687235)
//! ```
//!
//! # Light
//!
//! A directional key light and an even sky, Blinn-Phong, in deformed space. With base colour C, half
//! vector h between the light and the eye, and the weights of the scene's `[light]`:
//!
//! ```text
//! sky  = V ambient sky_color,  key = S diffuse key_color
//! even = C (sky + 0.6 key)
//! lit  = C (sky + key max(n·l, 0)) + S key_color specular max(n·h, 0)^shininess      highlight only if n·l > 0
//! out  = even + (lit - even) c
//! ```
//!
//! The result is clamped to 0..1. Two-sided light turns n towards the eye. Surfaces have c = 1 and
//! their own highlight. MIP, MinIP and average are unlit.
//!
//! **Shadow** S is the transmittance towards the light through the deformed, cut scene, averaged over
//! the light's disc. **Occlusion** is that of the sky: with V_raw, the mean transmittance over all
//! directions within a reach R (local occlusion; Hernell, Ljung and Ynnerman 2010),
//!
//! ```text
//! V = min(1, (1 + c') V_raw)
//! ```
//!
//! A flat open surface sees half of the sphere and is as bright as without occlusion. c' is c or, if
//! that is larger, the opacity of the sample over the distance at which its light is read: a dense
//! sample is seen from outside, hence is a surface. The light is read 1.5 cells of the light volume
//! in front of the sample: along n as far as there is a normal, otherwise towards the eye. Without
//! shadows and occlusion S = V = 1; with either, n is turned towards the eye.
//!
//! # Opacity and compositing
//!
//! Opacity is stated for one reference length Δ₀, the smallest voxel spacing. The table holds
//! optical depth τ = -log₂(1 - a₀). With opacity correction, a sample that represents a length ℓ
//! has the opacity
//!
//! ```text
//! a = 1 - 2^(-τ ℓ/Δ₀) = 1 - (1 - a₀)^(ℓ/Δ₀)
//! ```
//!
//! With a pre-integrated transfer function (Engel, Kraus, Ertl 2001), τ and colour are those of the
//! segment between two samples.
//!
//! Slices and rays are two algorithms. They share what a sample is (look-up, normal, light) and
//! nothing else. In both, samples are anchored at the eye, so their positions do not depend on the
//! box; in an orthographic view the two sets of samples coincide, and the pictures agree to
//! rounding. In perspective they approximate the same integral, and their difference falls with the
//! step.
//!
//! A sample is interpolated between voxels, or it is the value of a function at its source point
//! ([`volume::function`](crate::volume::function)): then nothing is resampled at all. The bounds of
//! empty space follow by interval arithmetic.
//!
//! **Rays** have samples at t = (i + 1/2) Δ from the eye, composited front to back. A ray ends when
//! less than 1/512 of the light passes (early ray termination).
//!
//! **Slices** are the sections of view-aligned planes at depths (i + 1/2) Δ with the proxy geometry:
//! one polygon a slice, drawn back to front and composited "over", premultiplied (\[DDM06\] section
//! 4), by the blend unit of a GPU or the CPU's own rasteriser. A ray at the angle θ to the view
//! direction meets them at ℓ = Δ / cos θ. The proxy is the box of the occupied cells, or a closed
//! mesh, whose sections are filled contours (\[RVD01\] section 2). Options, each held to the plain
//! slices by a test: `slab` (slices composited inside a fragment), `slice_order` (front to back, with
//! an early end), `blend_format` (16 bits).
//!
//! - Where a ray enters a surface, the point is found by bisection between two samples, and colour
//!   and shading are evaluated there.
//! - An iso-surface (`render.iso`) is the first sample at or above the value, refined by bisection.
//!   It is lit by the transformed gradient, or by the difference of the deformed volume towards the
//!   light (\[RVD01\] 3.3).
//! - Next to a cut, a sample represents only the part of its length on its own side, so that a
//!   planar cut is exact wherever the samples fall.
//!
//! # Surfaces
//!
//! f is a signed distance in millimetres, **positive inside** (\[DS07\] section 3). It comes from a
//! mesh or from labels (a grid), from a value of a volume, from formulas, or from depth maps. A ray
//! through deformed space carries every sample back through the stack; the first change of sign is
//! a hit, refined by bisection. The cut function is A = 1/2 - alpha, positive in a cut.
//!
//! | cut model | |
//! |---|---|
//! | hollow | a hit in a cut is skipped; both sides of the shell show |
//! | solid | a hit in a cut is skipped; the face of the cut (A = 0) is a hit where f > 0 |
//! | thick | solid, of f̂ = τ - f where f > τ/2, else f, τ being the thickness (\[DS07\] eq 7) |
//!
//! Both changes of sign within a step are handled in their order along the ray. On a face the
//! normal is the cut's; elsewhere it is Jᵀ ∇f, pointing out of the solid. A point is inside a mesh
//! where the generalised winding number is above 1/2.
//!
//! | steps | δt |
//! |---|---|
//! | uniform | δs |
//! | threshold | δs/4 near the surface, else δs |
//! | jacobian | δs / \|J v\| at the sample, within δs/8 .. 8 δs (\[DS07\] eq 4) |
//! | jacobian-bound | δs / b, b a bound on \|J v\| over the cell |
//! | sphere | 0.9 \|f\| / b, at least δs / (4 max(1, b)); uniform steps through depth maps and within cuts |
//!
//! A ray is walked in pieces: intervals of δs or 8 δs from the eye, or single cells where a bound of
//! the cell is used. Pieces that touch no occupied cell are skipped, the others are walked from end
//! to end, hence skipping loses no change of sign. Between two samples of one sign, sphere steps
//! look for a surface wherever their distances allow one.
//!
//! A depth map's f is the depth below a face minus the map's; a cube of six maps is ρ min \|f_i\|,
//! ρ = 1 where all are positive, else -1 (\[DS07\] 6.1). It is not a distance, so rays take uniform
//! steps through it. In *two stages* (\[DS07\] section 3) triangles outside the deformations' boxes
//! are rasterised and rays are cast inside the boxes; the two are blended over a seam.
//!
//! # Kinds of deformation
//!
//! Each kind is a function in local space, with parameters in millimetres and degrees. For a
//! deformed point it returns the source point and the signed distance to the nearest cut. Progress
//! 0 is the identity.
//!
//! | kind | inverse |
//! |---|---|
//! | `pull` (\[DDM06\] eq 8), `spline-pull` (\[RVD01\] 3.2), `wave`, `planar-wave`, `bulge` | exact, or one monotone equation |
//! | `twist`, `bend`, `taper`, `shear` | exact; a twist's inverse is the twist by the opposite angle |
//! | `peel`, `slab`, `explode`, `seam`, `book`, `knife`, `retractor` | exact, with a mask where they cut |
//! | `box`, `sphere`, `cylinder`, `wedge`, `half-space`, `view-sphere`, `view-cone`, `lasso` | no displacement, mask alone |
//! | `lattice`, `elastic`, `points`, `brush` | numeric, or an interpolation of given values |
//! | `strip`, `lift`, `offset`, `surface-peel`, `explode-labels` | along a distance field |
//! | `field`, `map` | as stored in the file |
//!
//! Pull, with z measured from the box's lower face, H its height, `amount` and σ lengths:
//!
//! ```text
//! source = (x, y, z (1 - (amount / H) exp(-(x² + y²) / σ²)))
//! ```
//!
//! Peel, in its (x, z) plane: a layer z0 to z0 + h is rolled from the hinge x_h on into an arc of
//! outer radius R about c = (x_h, z0 + R), its outer side inwards. With ρ = \|p' - c\| and θ =
//! atan2(x' - x_h, z0 + R - z'):
//!
//! ```text
//! in the roll (R - h <= ρ <= R, 0 <= θ <= length / R):   source = (x_h + R θ, z0 + R - ρ)
//! where the layer was and no roll is:                    cut away
//! elsewhere:                                             source = p'
//! ```
//!
//! Progress moves the hinge. Where the roll overlaps undisplaced tissue, the roll takes precedence,
//! and a thin band around it is cut away, in which D blends from one to the other. For
//! `surface-peel`, z is the height above a surface.
//!
//! Forward fields are inverted by a fixed-point iteration (Chen et al. 2008), finished by Newton's
//! method ([`invert`](crate::deform::invert)). A point that does not converge, or converges where
//! det J <= 0, lies in a fold and is cut away.
//!
//! # Empty space
//!
//! A coarse grid of macrocells covers the deformed scene. A cell's box C is propagated backwards
//! through the stack by interval arithmetic:
//!
//! ```text
//! B_n = C      B_(k-1) = B_k + [least, greatest displacement of map k over B_k]      alpha_max = min over k
//! ```
//!
//! The bounds of D come from a min/max pyramid of the map's texels: a trilinear sample lies between
//! the texels that it interpolates. A second bound, from the differences of neighbouring texels
//! (the mean value form), is intersected with it. A box partly inside a cube is split in two, up to
//! a few times. Outside every cube a box does not move.
//!
//! B_0 lies in the source. The volume's min/max pyramid bounds its values, and a range-maximum
//! table of the transfer function bounds their opacity. The cell is empty if alpha_max < 1/2 or
//! that opacity is 0. Every bound is conservative: skipping changes no picture. Where a sample also
//! depends on the point one step before it, cells are grown by one step. A similar walk bounds |J
//! v| for Jacobian and sphere steps ([`lipschitz`](crate::deform::lipschitz)).
//!
//! # Accuracy
//!
//! Maps and points are in single precision on both sides; geometry read from files is in double.
//! Tests check the accuracy against closed forms: transmittance of a uniform ball, normals under
//! linear maps and a twist, the path through a cut slab, a translated volume against a translation
//! map, a deformed sphere as an ellipsoid.
