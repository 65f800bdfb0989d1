//! A scene's deformations as a stack of maps.

use super::map_assets::{check_modifiers, finished, is_cylindrical};
use super::stack_inputs::{INSIDE, StackInputs};
use crate::deform::compose::{self, PrecomposeError};
use crate::deform::cut::{CutShape, CutShapes, MAX_CUTS};
use crate::deform::file_kinds::FILE_KINDS;
use crate::deform::kinds::{self, DefaultSize, FieldInputs, Kind, RoundMap, Sampling};
use crate::deform::mapping::Cylinder;
use crate::deform::{Arguments, DisplacementMap, PlacedMap, Placement, Stack, Storage, saved};
use crate::error::suggestion;
use crate::scene::Deformation;
use crate::{Error, Result, Watch};
use glam::{Affine3A, Mat3, Vec3};
use std::sync::Arc;

/// The outcome of composing, for reports.
#[derive(Clone, Copy, Debug)]
pub struct Composition {
    /// The requested bound, mm.
    pub bound_mm: f32,
    /// Number of maps in the stack.
    pub maps: usize,
    /// Whether one map replaces all of them where it is accurate enough.
    pub composed: bool,
    /// Largest error found inside the volume, mm; within the bound.
    pub worst_mm: f32,
    /// 99th percentile of the error, mm.
    pub p99_mm: f32,
    /// Fraction of the occupied space in which the maps themselves are walked.
    pub fallback_share: f32,
}

impl Composition {
    /// A notice for the user if composing did not help.
    pub fn notice(&self) -> Option<String> {
        let Self {
            bound_mm,
            maps,
            composed,
            fallback_share,
            ..
        } = self;
        (!composed).then(|| {
            format!(
                "the {maps} deformations were not precomposed: in {:.0} % of the space one map would be off by more than {bound_mm} mm (tears, cuts, or too small a bound); they are evaluated one by one, which is exact but slower",
                100.0 * fallback_share
            )
        })
    }
}

/// Maps in order of application, and the cuts after them.
#[derive(Default)]
pub struct NamedStack {
    /// The maps.
    pub stack: Stack,
    /// The deformation that each map belongs to, by its name or kind.
    pub names: Vec<String>,
    /// The cuts.
    pub cuts: CutShapes,
}

/// The stack of a scene's deformations, with other maps applied before and after them, and the cuts
/// after all of them.
///
/// # Errors
/// Any invalid parameter, by name.
pub fn stack(
    deformations: &[Deformation],
    inputs: &StackInputs,
    first: Vec<PlacedMap>,
    more: Vec<PlacedMap>,
) -> Result<NamedStack> {
    let enabled: Vec<&Deformation> = deformations.iter().filter(|d| d.enabled).collect();
    enabled.iter().try_for_each(|d| check_modifiers(d))?;
    let mut first_cut = enabled.len();
    if inputs.exact_cuts && more.is_empty() {
        while first_cut > 0 && enabled.len() - first_cut < MAX_CUTS && is_exact(enabled[first_cut - 1]) {
            first_cut -= 1;
        }
    }
    let mut maps = first;
    let mut names = vec![INSIDE.to_owned(); maps.len()];
    let all = enabled[..first_cut].len().max(1) as f32;
    for (n, d) in enabled[..first_cut].iter().enumerate() {
        // Each deformation is an equal fraction of the whole.
        let progress = |share: f32| (inputs.watch.progress)((n as f32 + share) / all);
        let watch = Watch {
            progress: &progress,
            cancel: inputs.watch.cancel,
        };
        watch.check()?;
        let inputs = &StackInputs {
            watch: &watch,
            ..*inputs
        };
        if let Some(name) = CUT_ONLY.iter().find(|n| {
            kinds::kind(&d.kind).is_ok_and(|k| k.shape.is_some()) && d.parameters.0.contains_key(**n)
        }) {
            let problem = if !inputs.exact_cuts {
                "needs exact cuts, which are not available here (render.exact_cuts is false, or a map is being made)".to_owned()
            } else if is_exact(d) {
                format!(
                    "needs the cut to come after every deformation that moves material, and at most {MAX_CUTS} cuts in all; move it to the end"
                )
            } else {
                "cannot be combined with matrix, add, spare, mapping or fade".to_owned()
            };
            return Err(Error::value(format!("{}: {name}", d.kind), problem));
        }
        maps.extend(place(d, inputs)?);
        names.resize(maps.len(), d.name.clone().unwrap_or_else(|| d.kind.clone()));
    }
    maps.extend(more);
    names.resize(maps.len(), "map".to_owned());
    Ok(NamedStack {
        stack: Stack::new(maps),
        names,
        cuts: cuts(&enabled[first_cut..], inputs)?,
    })
}

/// Settings that only an analytic shape supports: a mask ends with its box.
const CUT_ONLY: [&str; 3] = ["invert", "group", "combine"];

/// Whether a deformation is an analytic removal.
fn is_exact(deformation: &Deformation) -> bool {
    kinds::kind(&deformation.kind).is_ok_and(|k| k.shape.is_some())
        && !deformation.add
        && deformation.matrix.is_none()
        && !deformation.parameters.0.contains_key("spare")
        && matches!(is_cylindrical(deformation), Ok(false))
        && matches!(deformation.parameters.number("fade"), Ok(None | Some(0.0)))
}

/// Removals as shapes, with the members of each group consecutive.
fn cuts(deformations: &[&Deformation], inputs: &StackInputs) -> Result<CutShapes> {
    let mut named: Vec<(Option<String>, CutShape)> = Vec::new();
    // Members at progress 0: empty shapes, which make an intersection empty.
    let mut vanished: Vec<(String, bool)> = Vec::new();
    for d in deformations {
        let kind = kinds::kind(&d.kind)?;
        let (group, intersects, primitive) = primitive(d, kind, inputs).map_err(|e| in_kind(e, kind.name))?;
        let Some(primitive) = primitive else {
            vanished.extend(group.map(|g| (g, intersects)));
            continue;
        };
        // After the last member of its group, if it has one.
        let at = named
            .iter()
            .rposition(|(g, _)| g.is_some() && *g == group)
            .map_or(named.len(), |n| n + 1);
        named.insert(at, (group, primitive));
    }
    let says_and = |g: &str| {
        vanished.iter().any(|(v, a)| v == g && *a)
            || named.iter().any(|(n, p)| n.as_deref() == Some(g) && p.intersects)
    };
    let gone: Vec<String> = vanished
        .iter()
        .map(|(g, _)| g.clone())
        .filter(|g| says_and(g))
        .collect();
    named.retain(|(g, _)| g.as_ref().is_none_or(|g| !gone.contains(g)));
    for n in 1..named.len() {
        named[n].1.joins_previous = named[n].0.is_some() && named[n].0 == named[n - 1].0;
    }
    // A group is an intersection if any member requests it.
    for n in 0..named.len() {
        let intersects = named
            .iter()
            .any(|(g, p)| g.is_some() && *g == named[n].0 && p.intersects);
        named[n].1.intersects = intersects;
    }
    Ok(CutShapes::new(named.into_iter().map(|(_, p)| p).collect()))
}

/// A removal's group, whether that is an intersection, and its shape; no shape if its progress is
/// 0.
fn primitive(
    d: &Deformation,
    kind: &Kind,
    inputs: &StackInputs,
) -> Result<(Option<String>, bool, Option<CutShape>)> {
    let placement = kind_placement(d, kind, inputs)?;
    let size_mm = placement.size_mm();
    let progress = progress(d)?;
    let (values, settings) = kind.resolve(&d.parameters, size_mm)?;
    let group = settings.text("group")?.map(str::to_owned);
    let intersects = settings.choice("combine", &["or", "and"])? == "and";
    let inverted = settings.flag("invert")?;
    let shape = kinds::shape_of(kind, &values, progress, size_mm).map(|(shape, half, half_angle)| {
        let local_from_map = Affine3A::from_scale(size_mm) * Affine3A::from_translation(Vec3::splat(-0.5));
        CutShape {
            shape,
            local_from_world: local_from_map * placement.map_from_world,
            half,
            half_angle,
            inverted,
            joins_previous: false,
            intersects,
        }
    });
    Ok((group, intersects, shape))
}

/// The placement of a kind's box.
fn kind_placement(d: &Deformation, kind: &Kind, inputs: &StackInputs) -> Result<Placement> {
    if matches!(kind.size, DefaultSize::Across(_)) && d.size.is_some() {
        return Err(Error::value(
            "size",
            "this kind affects the whole scene and has no size; give center and rotate",
        ));
    }
    stated_placement(
        d,
        inputs,
        || kind.default_size(&inputs.scene_box),
        kind.locked_to_view,
    )
}

/// A stack with a precomposed map within an error bound, if one is requested.
///
/// # Errors
/// A placement that is not invertible; any error of the device.
pub fn composed(
    stack: Stack,
    inputs: &StackInputs,
    bound_mm: Option<f32>,
) -> Result<(Stack, Option<Composition>)> {
    let Some(bound_mm) = bound_mm.filter(|_| stack.maps().len() > 1) else {
        return Ok((stack, None));
    };
    let evaluate = |stack: &Stack, points: &[Vec3]| inputs.accelerator.evaluate(stack, points);
    let (precomposed, precompose_error) =
        inputs
            .library
            .precomposed(&stack, &inputs.scene_box, bound_mm, || {
                compose::precompose(&stack, &inputs.scene_box, bound_mm, &evaluate, inputs.watch)
            })?;
    let PrecomposeError {
        worst_mm,
        p99_mm,
        fallback_share,
    } = precompose_error;
    let composition = Composition {
        bound_mm,
        maps: stack.maps().len(),
        composed: precomposed.is_some(),
        worst_mm,
        p99_mm,
        fallback_share,
    };
    Ok((
        match precomposed {
            Some(precomposed) => stack.with_precomposed(precomposed),
            None => stack,
        },
        Some(composition),
    ))
}

/// An error about a deformation of a kind, which names the kind once.
fn in_kind(error: Error, kind: &str) -> Error {
    match &error {
        Error::Value { name, .. } if !name.starts_with(kind) => error.within(kind),
        _ => error,
    }
}

/// Samples one deformation into a map and places it in the world; a chain of transforms becomes
/// several maps.
fn place(deformation: &Deformation, inputs: &StackInputs) -> Result<Vec<PlacedMap>> {
    let named = |e: Error| in_kind(e, &deformation.kind);
    let mut placed = match deformation.kind.as_str() {
        "field" => place_field(deformation, inputs),
        "map" => place_map(deformation, inputs).map(|m| vec![m]),
        _ => place_kind(deformation, inputs).map(|m| vec![m]),
    }
    .map_err(named)?;
    if matches!(deformation.kind.as_str(), "field" | "map") {
        placed = finish_all(placed, deformation, inputs).map_err(named)?;
    }
    if deformation.add {
        if placed.len() > 1 {
            return Err(named(Error::value(
                "add",
                "a chain of transforms cannot be added; merge it into one field first (incise bake --field)",
            )));
        }
        placed.iter_mut().for_each(|m| m.added = true);
    }
    Ok(placed)
}

/// Applies what every map can have to those of a file.
fn finish_all(
    placed: Vec<PlacedMap>,
    deformation: &Deformation,
    inputs: &StackInputs,
) -> Result<Vec<PlacedMap>> {
    let common = ["mapping", "fade", "spare"];
    let stated = common.iter().find(|n| deformation.parameters.0.contains_key(**n));
    match (stated, placed.len()) {
        (Some(name), 2..) => Err(Error::value(
            *name,
            "a chain of transforms becomes several maps; merge it into one field first (incise bake --field)",
        )),
        _ => placed
            .into_iter()
            .map(|map| finished(map, deformation, inputs))
            .collect(),
    }
}

fn progress(deformation: &Deformation) -> Result<f32> {
    let progress = deformation.progress.unwrap_or(1.0);
    if (0.0..=1.0).contains(&progress) {
        Ok(progress)
    } else {
        Err(Error::value("progress", format!("{progress} is outside 0 to 1")))
    }
}

/// The placement given by a deformation, if it gives any part of one.
fn stated_placement(
    deformation: &Deformation,
    inputs: &StackInputs,
    default_size: impl Fn() -> Vec3,
    locked: bool,
) -> Result<Placement> {
    if let Some(rows) = deformation.matrix {
        let column = |c: usize| Vec3::new(rows[0][c], rows[1][c], rows[2][c]);
        return Placement::from_affine(Affine3A::from_mat3_translation(
            Mat3::from_cols(column(0), column(1), column(2)),
            column(3),
        ));
    }
    let center = deformation
        .center
        .map_or_else(|| inputs.scene_box.center(), Vec3::from);
    let size = deformation.size.map_or_else(default_size, |s| s.xyz());
    let placement = Placement::new(center, size, deformation.rotate.map_or(Vec3::ZERO, Vec3::from))?;
    if !locked {
        return Ok(placement);
    }
    // x right, y up, z towards the viewer; a rotation is applied within these axes.
    let view = inputs.view;
    let (right, up, back) = (
        view.right.normalize_or_zero(),
        view.up.normalize_or_zero(),
        -view.forward,
    );
    let turned = Mat3::from_cols(right, up, back) * Mat3::from(placement.world_from_map.matrix3);
    Placement::from_affine(Affine3A::from_mat3_translation(
        turned,
        center - turned * Vec3::splat(0.5),
    ))
}

fn place_kind(deformation: &Deformation, inputs: &StackInputs) -> Result<PlacedMap> {
    let kind = kinds::kind(&deformation.kind)?;
    let placement = kind_placement(deformation, kind, inputs)?;
    let size_mm = match (deformation.matrix, deformation.size) {
        (Some(_), _) => placement.size_mm(),
        // As given: lengths of rotated axes differ from it in their last digits.
        (None, Some(size)) => size.xyz(),
        (None, None) => kind.default_size(&inputs.scene_box),
    };
    let progress = progress(deformation)?;
    // At most 2^24 texels: 128 MiB in half precision.
    let varies_all = kind.varies == [true; 3] || kinds::vary_everywhere(&deformation.parameters);
    let finest = if varies_all { 256 } else { 512 };
    if let Some(n) = deformation.resolution.filter(|n| !(8..=finest).contains(n)) {
        return Err(Error::value(
            "resolution",
            format!("{n} is outside 8 to {finest} texels"),
        ));
    }
    let (values, settings) = kind.resolve(&deformation.parameters, size_mm)?;
    let storage = inputs.storage.or(deformation.storage).unwrap_or_default();
    let cube = placement.scaled(Vec3::splat(kind.cube_scale))?;
    let cylindrical = is_cylindrical(deformation)?;
    // Wrapped around an axis, the map's lengths across its cuts become shorter.
    let shrinks = if cylindrical {
        let round = Cylinder::new(&cube, 2);
        (size_mm.z / round.radius_mm).max(size_mm.y / size_mm.z).max(1.0)
    } else {
        1.0
    };
    let sampling = Sampling {
        resolution: deformation.resolution,
        storage,
        min_ramp_mm: inputs.min_ramp_mm * shrinks,
    };
    // The box's local millimetres: from its centre, along its axes.
    let world_from_local = placement.world_from_map
        * Affine3A::from_translation(Vec3::splat(0.5))
        * Affine3A::from_scale(size_mm.recip());
    let kind_inputs = FieldInputs {
        settings: &settings,
        world_from_local,
        cylinder: cylindrical.then(|| RoundMap {
            cylinder: Cylinder::new(&cube, 2),
            world_from_cube: cube.world_from_map,
        }),
        library: inputs.library,
    };
    // A formula has the same map wherever its box lies: moving or rotating the box neither samples
    // nor uploads it again.
    let lies = (!kind.is_the_same_anywhere(&deformation.parameters)).then_some(world_from_local);
    let key = format!(
        "{} {:?} {progress} {size_mm:?} {sampling:?} {lies:?}",
        kind.name, deformation.parameters
    );
    let map = inputs.library.map(key, || {
        inputs.accelerator.map(
            kind.definition(&values, progress, size_mm, &sampling, &kind_inputs)?,
            inputs.watch,
        )
    })?;
    let placed = PlacedMap::new(map, cube);
    Ok(if cylindrical {
        placed.mapped_cylindrically()
    } else {
        placed
    })
}

/// Only the settings of a file kind are allowed.
fn check_settings(arguments: &Arguments, kind: &str) -> Result<()> {
    let valid_names: Vec<&str> = FILE_KINDS
        .iter()
        .filter(|k| k.name == kind)
        .flat_map(|k| k.settings().map(|s| s.name))
        .collect();
    match arguments
        .0
        .keys()
        .find(|name| !valid_names.contains(&name.as_str()))
    {
        Some(name) => Err(Error::value(
            name,
            format!(
                "there is no such parameter; {}",
                suggestion(name, valid_names.iter().copied())
            ),
        )),
        None => Ok(()),
    }
}

/// The maps of a registration's field, where its file places them or where the deformation does.
fn place_field(deformation: &Deformation, inputs: &StackInputs) -> Result<Vec<PlacedMap>> {
    let own = field_maps(deformation, inputs)?;
    if !is_placed(deformation) {
        return Ok(own);
    }
    let [map] = <[PlacedMap; 1]>::try_from(own).map_err(|_| {
        Error::value(
            "center, size, rotate, matrix",
            "a chain of transforms becomes several maps; merge it into one field first (incise bake --field)",
        )
    })?;
    Ok(vec![placed_again(map, deformation, inputs)?])
}

/// Whether a deformation states a placement.
fn is_placed(deformation: &Deformation) -> bool {
    deformation.center.is_some()
        || deformation.size.is_some()
        || deformation.rotate.is_some()
        || deformation.matrix.is_some()
}

fn field_maps(deformation: &Deformation, inputs: &StackInputs) -> Result<Vec<PlacedMap>> {
    check_settings(&deformation.parameters, "field")?;
    if let Some(n) = deformation.resolution.filter(|n| !(8..=512).contains(n)) {
        return Err(Error::value(
            "resolution",
            format!("{n} is outside 8 to 512 texels"),
        ));
    }
    let settings = &deformation.parameters;
    let transform = inputs.library.transform(settings)?;
    for warning in &transform.warnings {
        inputs.library.notice(format!("field: {warning}"));
    }
    let storage = inputs.storage.or(deformation.storage).unwrap_or(Storage::F32);
    let progress = progress(deformation)?;
    if !settings.flag("invert")? {
        return compose::transform_maps(
            &transform,
            &inputs.scene_box,
            progress,
            deformation.resolution,
            storage,
        );
    }
    match transform.affine_inverse() {
        Some(inverse) => compose::transform_maps(
            &inverse,
            &inputs.scene_box,
            progress,
            deformation.resolution,
            storage,
        ),
        None => {
            let inverse =
                crate::deform::invert::transform(&transform, &inputs.scene_box, deformation.resolution)?;
            let r = inverse.report;
            inputs.library.notice(format!(
                "field: inverted; residual 99th percentile {:.4} mm, largest {:.4} mm; {} of {} points have no source and are cut away",
                r.p99_mm, r.max_mm, r.not_found, r.points
            ));
            inverse.placed(storage, progress).map(|m| vec![m])
        }
    }
}

fn place_map(deformation: &Deformation, inputs: &StackInputs) -> Result<PlacedMap> {
    check_settings(&deformation.parameters, "map")?;
    if deformation.resolution.is_some() {
        return Err(Error::value(
            "resolution",
            "a saved map has its own resolution; leave this out",
        ));
    }
    let path = deformation
        .parameters
        .text("path")?
        .ok_or_else(|| Error::value("path", "is missing; name a file"))?;
    let storage = inputs.storage.or(deformation.storage).unwrap_or_default();
    let saved = saved::read(&inputs.library.path(path), storage, progress(deformation)?)?;
    if is_placed(deformation) {
        placed_again(saved, deformation, inputs)
    } else {
        Ok(saved)
    }
}

/// A map from a file where the deformation places it; what it leaves out is the file's.
fn placed_again(saved: PlacedMap, deformation: &Deformation, inputs: &StackInputs) -> Result<PlacedMap> {
    let (own_center, own_size) = (
        saved.placement.world_from_map.transform_point3(Vec3::splat(0.5)),
        saved.placement.size_mm(),
    );
    let mut stated = deformation.clone();
    stated.center.get_or_insert(own_center.into());
    if stated.size.is_none() && stated.rotate.is_none() && stated.matrix.is_none() {
        // Moved only: it keeps its own axes.
        let shift = Affine3A::from_translation(Vec3::from(stated.center.unwrap_or_default()) - own_center);
        return Ok(PlacedMap::new(
            saved.map.clone(),
            Placement::from_affine(shift * saved.placement.world_from_map)?,
        ));
    }
    let placement = stated_placement(&stated, inputs, || own_size, false)?;
    let map: Arc<DisplacementMap> = saved.map.clone();
    Ok(PlacedMap::new(map, placement))
}
