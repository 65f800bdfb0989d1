//! Shader tests without a GPU: every program parses and validates, and the Rust mirrors of its
//! structs have its layout.

use incise::gpu::shaders::Program;
use incise::render::uniforms::{
    ClassificationUniform, CutShapeUniform, DeformerUniform, FrameUniform, LevelUniform,
    MapDefinitionUniform, NodeBounds, PlacedMapUniform, PlacedSolidUniform, SurfaceObjectUniform,
};

fn module(program: Program, counting: bool) -> naga::Module {
    let source = program.source(incise::render::constants::wgsl_constants(), counting, None);
    naga::front::wgsl::parse_str(&source)
        .unwrap_or_else(|e| panic!("{program:?}: {}", e.emit_to_string(&source)))
}

pub fn every_program_is_valid() {
    for program in Program::ALL {
        for counting in [false, true] {
            let module = module(program, counting);
            assert!(!module.entry_points.is_empty());
            let mut validator = naga::valid::Validator::new(
                naga::valid::ValidationFlags::all(),
                naga::valid::Capabilities::default(),
            );
            validator
                .validate(&module)
                .unwrap_or_else(|e| panic!("{program:?}: {e:?}"));
        }
    }
}

/// Members of a WGSL struct with their offsets; and its size.
fn layout(module: &naga::Module, name: &str) -> (Vec<(String, u32)>, u32) {
    module
        .types
        .iter()
        .find_map(|(_, t)| match &t.inner {
            naga::TypeInner::Struct { members, span } if t.name.as_deref() == Some(name) => Some((
                members
                    .iter()
                    .map(|m| (m.name.clone().unwrap(), m.offset))
                    .collect(),
                *span,
            )),
            _ => None,
        })
        .unwrap_or_else(|| panic!("no struct {name}"))
}

macro_rules! same_layout {
    ($module:expr, $wgsl:literal, $rust:ty: $($field:ident),* $(,)?) => {{
        let (members, size) = layout($module, $wgsl);
        let rust: Vec<(String, u32)> = vec![$((stringify!($field).to_owned(), std::mem::offset_of!($rust, $field) as u32)),*];
        assert_eq!(members, rust);
        assert_eq!(size as usize, size_of::<$rust>());
    }};
}

pub fn uniforms_match_their_structs() {
    let m = module(Program::Raycast, false);
    same_layout!(&m, "Frame", FrameUniform: clip_from_world, voxel_from_world, eye, perspective, forward, step_mm, right, reference_mm, up,
        blend_near_mm, to_light, blend_far_mm, proxy_min, ambient, proxy_max, diffuse, grid_size, specular, cells_origin, shininess, cell_mm,
        value_scale, cells, value_offset, picture, table_scale, table_offset, gradient_top, two_sided, has_holes, early_termination, grey_low, grey_high, iso, jitter, texture_size, gradient_scale, face,
        stored_offset, per_texture_size, thin_depth, sample_offset, more_padding,
        key_color, key_padding, sky_color, sky_padding,
        light_origin, light_offset_mm, light_per_size, light_padding);
    same_layout!(&m, "CutShape", CutShapeUniform: local_from_world, half, shape, half_angle, sense, joins_previous, intersects_group);
    let s = module(Program::Surface, false);
    same_layout!(&s, "SurfaceObject", SurfaceObjectUniform: grid_from_world, world_from_grid, size, kind, cells_origin, resolution_mm, cell_mm, step_mm,
        cells, thickness_mm, occupied_min, solid, occupied_max, steps, color, highlight, inside, shininess, cut, threshold_mm, low, solids, high, face,
        seam_mm, rigid, both, deformers, normal_method, vertex_offset_mm, padding);
    same_layout!(&s, "PlacedSolid", PlacedSolidUniform: local_from_world, numbers, solid, join, period, wall);
    same_layout!(&s, "Deformer", DeformerUniform: local_from_world, numbers, half, kind, offsets);
    same_layout!(&m, "PlacedMap", PlacedMapUniform: map_from_world, world_from_stored, size, added, reach, scale, origin, single, per_atlas, radius_mm, box_mm, min_radius_mm, slopes_origin, slopes_scale);
    let c = module(Program::Classify, false);
    same_layout!(&c, "Classification", ClassificationUniform: voxel_from_world, origin, lookback_mm, cell_mm, cut_lookback_mm, size, cut_margin_mm, voxel_low,
        margin_mm, voxel_high, iso, table_scale, table_offset, has_iso, grey_faces, composite, stack_has_cuts, value_shift, value_levels, value_size, precompose_error_mm,
        values, maps, levels);
    same_layout!(&c, "NodeBounds", NodeBounds: low, high, slope_low, slope_high);
    same_layout!(&module(Program::Sample, false), "MapDefinition", MapDefinitionUniform: cube_mm, ramp_mm, size, kind, numbers);
    same_layout!(&module(Program::Bounds, false), "Level", LevelUniform: size, first, below_size, below_first);
}

/// A shader's constants equal the CPU's.
pub fn counterparts_exist() {
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR"));
    let read = |p: &str| std::fs::read_to_string(folder.join(p)).unwrap();
    for (shader, rust, pairs) in [
        (
            "shaders/lib/shading.wgsl",
            "src/cpu/shading.rs",
            &[
                ("ISOTROPIC_DIFFUSE: f32 = 0.6", "ISOTROPIC_DIFFUSE: f32 = 0.6"),
                ("CUT_LOOKBACK_SHARE: f32 = 0.9", "CUT_LOOKBACK_SHARE: f32 = 0.9"),
                ("MAX_CUT_LOOKBACK: f32 = 4.0", "MAX_CUT_LOOKBACK: f32 = 4.0"),
                ("CUT_LOOKBACK_STEPS: i32 = 4", "CUT_LOOKBACK_STEPS: u32 = 4"),
                ("FACE_STEPS: i32 = 10", "FACE_STEPS: u32 = 10"),
                (
                    "SURFACE_GRADIENT_LOW: f32 = 0.004",
                    "SURFACE_GRADIENT: [f32; 2] = [0.004, 0.04]",
                ),
                (
                    "SURFACE_GRADIENT_HIGH: f32 = 0.04",
                    "SURFACE_GRADIENT: [f32; 2] = [0.004, 0.04]",
                ),
            ][..],
        ),
        (
            "shaders/lib/edges.wgsl",
            "src/cpu/edges.rs",
            &[
                ("EDGE_RATIO: f32 = 0.65", "EDGE_RATIO: f32 = 0.65"),
                ("EDGE_STEPS: i32 = 4", "EDGE_STEPS: u32 = 4"),
                ("THIN_LAYER_SAMPLES: i32 = 8", "THIN_LAYER_SAMPLES: usize = LANES"),
                ("OPAQUE_DEPTH: f32 = 9.0", "OPAQUE_DEPTH: f32 = 9.0"),
            ][..],
        ),
        (
            "shaders/lib/surface.wgsl",
            "src/cpu/surface.rs",
            &[
                ("BISECTION_STEPS: i32 = 14", "BISECTION_STEPS: u32 = 14"),
                ("MIN_SPHERE_STEP: f32 = 0.25", "MIN_SPHERE_STEP: f32 = 0.25"),
                ("THRESHOLD_STEP: f32 = 0.25", "THRESHOLD_STEP: f32 = 0.25"),
                ("MAX_JACOBIAN_STEP: f32 = 8.0", "MAX_JACOBIAN_STEP: f32 = 8.0"),
                (
                    "MIN_BLIND_STEP: f32 = 1.0 / 64.0",
                    "MIN_BLIND_STEP: f32 = 1.0 / 64.0",
                ),
                ("SLOPE_MARGIN: f32 = 1.1", "SLOPE_MARGIN: f32 = 1.1"),
                ("MIN_ADVANCE: f32 = 1e-6", "MIN_ADVANCE: f32 = 1e-6"),
                ("MIN_CELL_ADVANCE: f32 = 2e-4", "MIN_CELL_ADVANCE: f32 = 2e-4"),
                ("MIN_STEP: f32 = 1.0 / 65536.0", "MIN_STEP: f32 = 1.0 / 65_536.0"),
                ("MAX_SAMPLES: u32 = 100000u", "MAX_SAMPLES: u32 = 100_000"),
            ][..],
        ),
        (
            "shaders/lib/stack.wgsl",
            "src/deform/texel.rs",
            &[
                ("MIN_MARKED_ALPHA: f32 = 2.0", "MIN_MARKED_ALPHA: f32 = 2.0"),
                ("MIN_MARKED_SLOPE: f32 = 4096.0", "MIN_MARKED_SLOPE: f32 = 4096.0"),
            ][..],
        ),
        (
            "shaders/lib/formula.wgsl",
            "src/mesh/formula.rs",
            &[("GYROID_SLOPE: f32 = 1.75", "GYROID_SLOPE: f32 = 1.75")][..],
        ),
        (
            "shaders/classify.wgsl",
            "src/deform/bounds.rs",
            &[("FLAT_DISPLACEMENT: f32 = 0.25", "FLAT_DISPLACEMENT: f32 = 0.25")][..],
        ),
        (
            "shaders/classify.wgsl",
            "src/transfer/table.rs",
            &[("LAST_ENTRY: f32 = 4095.0", "TABLE_ENTRIES: usize = 4096")][..],
        ),
        (
            "shaders/bounds.wgsl",
            "src/render/sample_map.rs",
            &[("CELLS: u32 = 4u", "CELLS_PER_NODE: usize = 4")][..],
        ),
        (
            "shaders/lib/found.wgsl",
            "src/cpu/mod.rs",
            &[(
                "MIN_TRANSMITTANCE: f32 = 1.0 / 512.0",
                "MIN_TRANSMITTANCE: f32 = 1.0 / 512.0",
            )][..],
        ),
        (
            "shaders/lib/march.wgsl",
            "src/prepare/macrocells.rs",
            &[("CUT_FREE_FLAG: u32 = 128u", "CUT_FREE_FLAG: u8 = 128")][..],
        ),
        (
            "shaders/lib/transfer.wgsl",
            "src/transfer/table.rs",
            &[
                ("TABLE_ENTRIES: i32 = 4096", "TABLE_ENTRIES: usize = 4096"),
                ("GRADIENT_ENTRIES: i32 = 256", "GRADIENT_ENTRIES: usize = 256"),
                ("SLOPE_STEP: f32 = 0.02", "SLOPE_STEP: f32 = 0.02"),
            ][..],
        ),
    ] {
        for (in_shader, in_rust) in pairs {
            assert!(read(shader).contains(in_shader), "{shader}: {in_shader}");
            assert!(read(rust).contains(in_rust), "{rust}: {in_rust}");
        }
    }
}

/// Most textures that a program may sample, leaving room below the sixteen that WebGL2 and OpenGL
/// allow.
const MAX_SAMPLED_TEXTURES: usize = 14;

pub fn sampled_textures_leave_room() {
    let mut most = 0;
    for program in Program::ALL {
        let module = module(program, true);
        let sampled = module
            .global_variables
            .iter()
            .filter(|(_, v)| match module.types[v.ty].inner {
                naga::TypeInner::Image { class, .. } => !matches!(class, naga::ImageClass::Storage { .. }),
                _ => false,
            });
        let count = sampled.count();
        assert!(
            count <= MAX_SAMPLED_TEXTURES,
            "{program:?} declares {count} sampled textures"
        );
        most = most.max(count);
    }
    println!("at most {most} sampled textures in a program");
    assert!(most >= 8, "{most}");
}

/// Equivalent functions of Rust and WGSL, in the order in which both files define them; `a=b` if
/// WGSL, which has one namespace, prefixes a method's name with its type.
const PAIRS: &[(&str, &str, &str)] = &[
    (
        "src/cpu/shading.rs",
        "shaders/lib/shading.wgsl",
        "cut_in_front own_color shade_point world_from_voxel_covector nearest_cut nearer_cut_shape is_cut grey_face \
         light_cosine_by_derivative iso_surface shaded_normal light",
    ),
    (
        "src/cpu/edges.rs",
        "shaders/lib/edges.wgsl",
        "mean_depth_seen differs within_mask of_sample=represented may_hide_a_layer near_edge \
         extents=extent sees_behind",
    ),
    ("src/cpu/march.rs", "shaders/lib/march.wgsl", "first_sample_after"),
    (
        "src/cpu/found.rs",
        "shaders/lib/found.wgsl",
        "pixel_shift to_be_shaded shade_found=shaded_sample",
    ),
    (
        "src/cpu/slices.rs",
        "shaders/slice.wgsl",
        "fragment_sample fragment",
    ),
    (
        "src/cpu/surface.rs",
        "shaders/lib/surface.wgsl",
        "depth_in_boxes is_undeformed apply_cut_model sample=surface_sample trace changes may_hide_a_surface step_length first_event bisect normal=surface_normal",
    ),
    (
        "src/cpu/surface_shading.rs",
        "shaders/lib/surface.wgsl",
        "light=surface_light",
    ),
    ("src/cpu/mod.rs", "shaders/lib/volume.wgsl", "sample_scene"),
    (
        "src/cpu/mod.rs",
        "shaders/lib/projection.wgsl",
        "color=projection_color",
    ),
    ("src/volume/sampler.rs", "shaders/lib/volume.wgsl", "gradient"),
    (
        "src/deform/stack.rs",
        "shaders/lib/stack.wgsl",
        "nearer_of is_outside displacement source_and_alpha source_and_alpha_unclipped jet",
    ),
    (
        "src/deform/cut.rs",
        "shaders/lib/cut.wgsl",
        "signed_distance_mm=shape_signed_distance_mm signed_distance_mm=cuts_signed_distance_mm gradient=cuts_gradient",
    ),
    (
        "src/transfer/table.rs",
        "shaders/lib/transfer.wgsl",
        "lookup opacity_slope_sign gradient_factor",
    ),
    (
        "src/transfer/preintegrated.rs",
        "shaders/lib/transfer.wgsl",
        "depth=segment_depth lookup=lookup_segment",
    ),
    (
        "src/mesh/deformer.rs",
        "shaders/lib/deformer.wgsl",
        "bernstein local=deformer_local apply_all deform_vertex",
    ),
    (
        "src/mesh/formula.rs",
        "shaders/lib/formula.wgsl",
        "to_box distance=solid_distance distance=formula_distance",
    ),
    (
        "src/mesh/implicit.rs",
        "shaders/lib/implicit.wgsl",
        "value=implicit_value gradient=implicit_gradient",
    ),
    (
        "src/volume/function/evaluate.rs",
        "shaders/lib/noise.wgsl",
        "noise",
    ),
    (
        "src/math/light.rs",
        "shaders/lib/light.wgsl",
        "shine lit even=even_light",
    ),
    (
        "src/cpu/light.rs",
        "shaders/lib/light.wgsl",
        "facing_the_eye light_shares",
    ),
    ("src/math/mod.rs", "shaders/lib/math.wgsl", "normalize_or"),
    ("src/scene/camera.rs", "shaders/lib/march.wgsl", "ray=pixel_ray"),
];

/// Names of a file's functions in order, without those of its tests.
fn functions(path: &str) -> Vec<String> {
    let text = std::fs::read_to_string(std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join(path)).unwrap();
    let code = text.split("#[cfg(test)]").next().unwrap().to_owned();
    let name = |line: &str| {
        let rest = line
            .trim_start()
            .split_once("fn ")
            .filter(|(before, _)| before.is_empty() || before.starts_with("pub"))?
            .1;
        Some(
            rest.split(|c: char| !c.is_alphanumeric() && c != '_')
                .next()?
                .to_owned(),
        )
    };
    code.lines()
        .filter(|l| !l.trim_start().starts_with("//"))
        .filter_map(name)
        .collect()
}

/// Whether the names occur in the list in this order.
fn is_subsequence(names: &[&str], list: &[String]) -> bool {
    let mut rest = list.iter();
    names.iter().all(|name| rest.any(|other| other == name))
}

/// A function implemented on both the CPU and the GPU has the same name and position in both files,
/// so that they can be read side by side.
pub fn functions_are_paired() {
    for (rust, wgsl, pairs) in PAIRS {
        let (ours, theirs): (Vec<&str>, Vec<&str>) = pairs
            .split_whitespace()
            .map(|p| p.split_once('=').unwrap_or((p, p)))
            .unzip();
        for (file, names) in [(rust, ours), (wgsl, theirs)] {
            let list = functions(file);
            assert!(
                is_subsequence(&names, &list),
                "{file} has not, in this order: {names:?}; it has {list:?}"
            );
        }
    }
    // A name in both files of a pair must be listed in the table.
    for (rust, wgsl, _) in PAIRS {
        let listed = |name: &str| {
            PAIRS.iter().filter(|(_, w, _)| w == wgsl).any(|(_, _, pairs)| {
                pairs
                    .split_whitespace()
                    .any(|p| p.rsplit('=').next() == Some(name))
            })
        };
        let ours = functions(rust);
        for name in functions(wgsl).iter().filter(|n| ours.contains(n)) {
            assert!(
                listed(name),
                "{rust} and {wgsl} both have {name}, which is no pair"
            );
        }
    }
    // Every formula has a function of its name, in the order of the enum.
    let source = std::fs::read_to_string(
        std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("src/deform/formula.rs"),
    )
    .unwrap();
    let body = source
        .split("pub enum FormulaKind {")
        .nth(1)
        .unwrap()
        .split('}')
        .next()
        .unwrap();
    let snake = |variant: &str| {
        let mut name = String::new();
        for c in variant.chars() {
            if c.is_uppercase() && !name.is_empty() {
                name.push('_');
            }
            name.extend(c.to_lowercase());
        }
        name
    };
    let formulas: Vec<String> = body
        .lines()
        .filter_map(|l| l.trim().split_once(" = "))
        .map(|(variant, _)| snake(variant))
        .collect();
    assert!(formulas.len() >= 16, "{formulas:?}");
    let names: Vec<&str> = formulas.iter().map(String::as_str).collect();
    assert!(
        is_subsequence(&names, &functions("shaders/lib/kinds.wgsl")),
        "shaders/lib/kinds.wgsl has not, in this order: {names:?}"
    );
}
