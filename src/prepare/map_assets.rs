//! What can be done with every map alike, whatever made it: a formula, a painted map, a saved map, a
//! field from a file, an inverse. Placement and progress are applied where a map is made; here it is
//! wrapped around an axis, faded towards the faces of its box, and kept from spared labels.

use super::stack_inputs::StackInputs;
use crate::deform::kinds;
use crate::deform::mapping::Cylinder;
use crate::deform::{DisplacementMap, PlacedMap, TexelSample};
use crate::math::{DistanceGrid, smoothstep};
use crate::scene::Deformation;
use crate::{Error, Result};
use glam::{Mat3, Vec3};
use std::sync::Arc;

/// Settings of every deformation, handled here for maps from files.
const MAPPINGS: [&str; 2] = ["none", "cylindrical"];

/// Whether a deformation's map is wrapped around an axis.
pub(super) fn is_cylindrical(deformation: &Deformation) -> Result<bool> {
    Ok(deformation.parameters.choice("mapping", &MAPPINGS)? == "cylindrical")
}

/// Checks that the settings of every deformation act on this one.
pub(super) fn check_modifiers(deformation: &Deformation) -> Result<()> {
    let settings = &deformation.parameters;
    let kind = kinds::kind(&deformation.kind).ok();
    let refuse = |name: &str, problem: &str| {
        let name = format!("{}: {name}", deformation.kind);
        Err(Error::value(name, problem))
    };
    // The settings that name labels of that file.
    let names_labels = ["spare", "label", "stiffness"]
        .iter()
        .any(|name| settings.0.contains_key(*name));
    if settings.0.contains_key("labels") && !names_labels {
        return refuse(
            "labels",
            "is the file of the labels that another setting names (spare, for example); add that setting, or remove labels",
        );
    }
    let fades = settings
        .number("fade")
        .is_ok_and(|mm| mm.is_some_and(|mm| mm > 0.0));
    let has_own_fade = kind.is_some_and(|k| k.parameters.iter().any(|p| p.name == "fade"));
    if fades && !has_own_fade && kind.is_some_and(|k| k.shape.is_some()) {
        return refuse(
            "fade",
            "reduces a displacement, and a cut displaces nothing; remove it",
        );
    }
    Ok(())
}

/// A map from a file with the deformation's mapping, fade and spared labels. Fading and sparing
/// resample nothing: they change the map's own texels.
pub(super) fn finished(map: PlacedMap, deformation: &Deformation, inputs: &StackInputs) -> Result<PlacedMap> {
    let cylindrical = is_cylindrical(deformation)?;
    let mut placed = if cylindrical {
        map.mapped_cylindrically()
    } else {
        map
    };
    let fade_mm = kinds::fade_mm(&deformation.parameters, 0.5 * placed.placement.size_mm())?;
    let spared = spared(deformation, inputs)?;
    if fade_mm > 0.0 && !placed.map.has_displacement() {
        return Err(Error::value(
            "fade",
            "reduces a displacement, and the map displaces nothing; remove it",
        ));
    }
    if fade_mm > 0.0 || spared.is_some() {
        // Maps from files are read anew: known by what they hold.
        let key = format!(
            "{:x} {:?} {} {:?} {:?} {}",
            placed.map.digest(),
            placed.map.storage,
            cylindrical,
            placed.placement,
            deformation.parameters,
            inputs.min_ramp_mm
        );
        let changed = inputs.library.map(key, || {
            Ok(changed(&placed, fade_mm, spared.as_deref(), inputs.min_ramp_mm).into())
        })?;
        placed = with_map(&placed, changed);
    }
    Ok(placed)
}

/// The same placement with another map.
fn with_map(placed: &PlacedMap, map: Arc<DisplacementMap>) -> PlacedMap {
    let mut new = PlacedMap::new(map, placed.placement);
    (new.added, new.reach) = (placed.added, placed.reach);
    if placed.cylinder.is_some() {
        new = new.mapped_cylindrically();
    }
    new
}

/// The distance to the spared labels, if there are any.
fn spared(deformation: &Deformation, inputs: &StackInputs) -> Result<Option<Arc<DistanceGrid>>> {
    let settings = &deformation.parameters;
    settings
        .whole("spare")?
        .map(|labels| inputs.library.label_distance(settings, "spare", &labels))
        .transpose()
}

/// The map with its displacement faded towards the faces of its box, and spared labels neither moved
/// nor cut.
fn changed(
    placed: &PlacedMap,
    fade_mm: f32,
    spared: Option<&DistanceGrid>,
    min_ramp_mm: f32,
) -> DisplacementMap {
    let map = &placed.map;
    let box_mm = placed.placement.size_mm();
    let texel_mm = box_mm / Vec3::from(map.size.map(|n| (n.max(2) - 1) as f32));
    let texel_mm = texel_mm.max_element();
    let linear = Mat3::from(placed.placement.world_from_map.matrix3);
    let world = |u: Vec3| {
        let x = placed
            .cylinder
            .as_ref()
            .map_or(u, |c: &Cylinder| c.cube_from_map(u));
        placed.placement.world_from_map.transform_point3(x)
    };
    let weight = |u: Vec3| -> f32 {
        if fade_mm == 0.0 {
            return 1.0;
        }
        let inside = u.min(1.0 - u) * box_mm;
        match placed.cylinder {
            // Round an axis, the angle has no faces, and the radius has one.
            Some(c) => {
                smoothstep(0.0, fade_mm.min(0.5 * box_mm.z), inside.y * box_mm.z / box_mm.y)
                    * smoothstep(0.0, fade_mm.min(c.radius_mm), (1.0 - u.z) * c.radius_mm)
            }
            None => (0..3)
                .map(|axis| smoothstep(0.0, fade_mm.min(0.5 * box_mm[axis]), inside[axis]))
                .product(),
        }
    };
    let (ramp_mm, spare_fade_mm) = (min_ramp_mm.max(2.0 * texel_mm), 3.0 * texel_mm);
    DisplacementMap::from_fn(map.size, map.storage, |u| {
        let own = map.sample(u);
        let mut displacement = own.displacement * weight(u);
        let mut alpha = own.alpha;
        if let Some(spared) = spared {
            let here = spared.sample(world(u));
            displacement *= smoothstep(0.0, spare_fade_mm, -here);
            let source = match placed.cylinder {
                Some(_) => world(u + displacement),
                None => world(u) + linear * displacement,
            };
            if displacement != Vec3::ZERO {
                alpha = alpha.min(0.5 - 0.5 * spared.sample(source) / ramp_mm);
            }
            alpha = alpha.max(0.5 + 0.5 * here / ramp_mm).clamp(0.0, 1.0);
        }
        TexelSample { displacement, alpha }
    })
}
