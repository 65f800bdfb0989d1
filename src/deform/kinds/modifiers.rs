//! Modifiers available to every kind: spared labels and fading. (The mapping round an axis is part of
//! a map's placement, [`crate::deform::mapping`].)

use super::{
    Backward, Field, FieldContext, FieldInputs, RoundMap, Setting, SettingFormat, forward_numerically,
};
use crate::deform::Arguments;
use crate::math::DistanceGrid;
use crate::math::smoothstep;
use crate::{Error, Result};
use glam::{Affine3A, Vec2, Vec3};
use std::sync::Arc;

/// Settings common to every kind.
pub const COMMON_SETTINGS: &[Setting] = &[
    Setting {
        name: "spare",
        form: SettingFormat::Whole,
        about: "labels to protect from cutting and moving",
    },
    Setting {
        name: "labels",
        form: SettingFormat::File,
        about: "file of the label map; by default the volume itself",
    },
    Setting {
        name: "mapping",
        form: SettingFormat::Choice(&["none", "cylindrical"]),
        about: "none, or cylindrical: the kind's x runs around the box's z axis, its y along it, its z outwards",
    },
    Setting {
        name: "fade",
        form: SettingFormat::Number,
        about: "width over which the displacement fades towards the faces of the box, mm; 0 by default",
    },
];

/// Whether the settings make a map vary along all axes.
pub fn vary_everywhere(settings: &Arguments) -> bool {
    ["spare", "fade"]
        .iter()
        .any(|name| settings.0.contains_key(*name))
}

/// The width over which a displacement fades towards the faces of a box of half-edges `half_mm`, mm;
/// 0 if it does not.
///
/// # Errors
/// A width that is no number from 0 to half the longest edge.
pub fn fade_mm(settings: &Arguments, half_mm: Vec3) -> Result<f32> {
    let fade_mm = settings.number("fade")?.unwrap_or(0.0);
    let most = half_mm.max_element();
    if (0.0..=most).contains(&fade_mm) {
        return Ok(fade_mm);
    }
    let problem = format!("{fade_mm} is outside 0 to {most} mm (half the longest edge of the box)");
    Err(Error::value("fade", problem))
}

/// The field with the modifiers requested by the settings.
pub(super) fn apply(
    field: Box<dyn Field>,
    context: &FieldContext,
    inputs: &FieldInputs,
) -> Result<Box<dyn Field>> {
    let mut field = field;
    let half = context.half() * context.cube_scale;
    let fade_mm = fade_mm(inputs.settings, half)?;
    if fade_mm > 0.0 {
        field = Box::new(Faded {
            inner: field,
            half,
            fade_mm,
            cylinder_mm: inputs
                .cylinder
                .as_ref()
                .map(|c| Vec2::new(c.cylinder.box_mm.z, c.cylinder.radius_mm)),
        });
    }
    if let Some(labels) = inputs.settings.whole("spare")? {
        let distance = inputs.library.label_distance(inputs.settings, "spare", &labels)?;
        let fade_mm = 3.0 * context.texel_mm;
        field = Box::new(Spared {
            inner: field,
            distance,
            world_from_local: inputs.world_from_local,
            round: inputs
                .cylinder
                .map(|round| (round, context.size_mm * context.cube_scale)),
            fade_mm,
        });
    }
    Ok(field)
}

/// A displacement that fades towards the faces of its box, so that it tears nothing there.
struct Faded {
    inner: Box<dyn Field>,
    /// Half the extent of the map's cube, mm.
    half: Vec3,
    fade_mm: f32,
    /// Height and radius of the cylinder that the map is wrapped around, mm.
    cylinder_mm: Option<Vec2>,
}

impl Field for Faded {
    fn backward(&self, q: Vec3) -> Backward {
        let inner = self.inner.backward(q);
        let inside = self.half - q.abs();
        let weight: f32 = match self.cylinder_mm {
            // Round an axis, the angle has no faces, and the radius has one.
            Some(cylinder_mm) => {
                let outward = (self.half.z - q.z) / (2.0 * self.half.z) * cylinder_mm.y;
                let upward = inside.y / (2.0 * self.half.y) * cylinder_mm.x;
                smoothstep(0.0, self.fade_mm.min(0.5 * cylinder_mm.x), upward)
                    * smoothstep(0.0, self.fade_mm.min(cylinder_mm.y), outward)
            }
            None => (0..3)
                .map(|axis| smoothstep(0.0, self.fade_mm.min(self.half[axis]), inside[axis]))
                .product(),
        };
        Backward {
            source: q + (inner.source - q) * weight,
            ..inner
        }
    }

    fn forward(&self, q: Vec3) -> Option<Vec3> {
        forward_numerically(self, q)
    }
}

/// Labels left alone: neither cut nor moved, and not shown a second time at a displaced position.
struct Spared {
    inner: Box<dyn Field>,
    distance: Arc<DistanceGrid>,
    world_from_local: Affine3A,
    /// The cylinder that the map is wrapped around, and the extent of the map's cube, mm.
    round: Option<(RoundMap, Vec3)>,
    /// Width over which the displacement fades towards a spared label.
    fade_mm: f32,
}

impl Spared {
    /// Signed distance to the spared labels, positive inside, mm.
    fn inside(&self, p: Vec3) -> f32 {
        let world = match &self.round {
            Some((round, cube_mm)) => round.world_from_map(p / *cube_mm + 0.5),
            None => self.world_from_local.transform_point3(p),
        };
        self.distance.sample(world)
    }
}

impl Field for Spared {
    fn backward(&self, q: Vec3) -> Backward {
        let inner = self.inner.backward(q);
        let here = self.inside(q);
        let source = q + (inner.source - q) * smoothstep(0.0, self.fade_mm, -here);
        let mut cut_distance_mm = inner.cut_distance_mm;
        if (source - q).length_squared() > 0.01 * self.fade_mm * self.fade_mm {
            cut_distance_mm = cut_distance_mm.min(-self.inside(source));
        }
        Backward {
            source,
            cut_distance_mm: cut_distance_mm.max(here),
        }
    }

    fn forward(&self, q: Vec3) -> Option<Vec3> {
        if self.inside(q) >= 0.0 {
            return Some(q);
        }
        // Near a spared label the displacement fades, and the kind's own forward map does not hold.
        self.inner
            .forward(q)
            .filter(|to| self.backward(*to).source.distance_squared(q) < 1e-6)
    }
}
