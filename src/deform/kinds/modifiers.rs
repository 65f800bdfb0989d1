//! Modifiers available to every kind: spared labels and cylindrical coordinates.

use super::{Backward, Field, FieldContext, FieldInputs, Setting, SettingFormat, forward_numerically};
use crate::deform::Arguments;
use crate::math::DistanceGrid;
use crate::math::smoothstep;
use crate::{Error, Result};
use glam::{Affine3A, Vec3, Vec3Swizzles};
use std::f32::consts::TAU;
use std::sync::Arc;

/// Settings common to every kind.
pub(super) const SETTINGS: &[Setting] = &[
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
    ["spare", "mapping", "fade"]
        .iter()
        .any(|name| settings.0.contains_key(*name))
}

/// The field with the modifiers requested by the settings.
pub(super) fn apply(
    field: Box<dyn Field>,
    context: &FieldContext,
    inputs: &FieldInputs,
) -> Result<Box<dyn Field>> {
    let mut field = field;
    if inputs.settings.choice("mapping", &["none", "cylindrical"])? == "cylindrical" {
        field = Box::new(Cylindrical {
            inner: field,
            size_mm: context.size_mm,
            radius: context.half().x.min(context.half().y),
        });
    }
    if let Some(fade_mm) = inputs.settings.number("fade")? {
        let half = context.half() * context.cube_scale;
        if !(0.0..=half.max_element()).contains(&fade_mm) {
            return Err(Error::value(
                "fade",
                format!(
                    "{fade_mm} is outside 0 to {} mm, half the box",
                    half.max_element()
                ),
            ));
        }
        if fade_mm > 0.0 {
            field = Box::new(Faded {
                inner: field,
                half,
                fade_mm,
            });
        }
    }
    if let Some(labels) = inputs.settings.whole("spare")? {
        let distance = inputs.library.label_distance(inputs.settings, "spare", &labels)?;
        let fade_mm = 3.0 * context.texel_mm;
        field = Box::new(Spared {
            inner: field,
            distance,
            world_from_local: inputs.world_from_local,
            fade_mm,
        });
    }
    Ok(field)
}

/// Cylindrical coordinate mapping (\[DS07\] section 3.2): the inner field's box is unrolled around
/// the axis. A displacement along its x becomes a rotation about the axis, one along its z becomes
/// radial, and its flat cuts become round.
///
/// \[DS07\] stores the unrolled map and converts coordinates at every sample; here the map is
/// sampled in Cartesian coordinates, so that renderers need no special case.
struct Cylindrical {
    inner: Box<dyn Field>,
    size_mm: Vec3,
    radius: f32,
}

impl Cylindrical {
    fn unrolled(&self, q: Vec3) -> Vec3 {
        let r = q.xy().length();
        let angle = if r > 0.0 { q.x.atan2(q.y) } else { 0.0 };
        Vec3::new(
            angle / TAU * self.size_mm.x,
            q.z / self.size_mm.z * self.size_mm.y,
            (r / self.radius - 0.5) * self.size_mm.z,
        )
    }

    fn rolled(&self, u: Vec3) -> Vec3 {
        let angle = u.x / self.size_mm.x * TAU;
        let r = ((u.z / self.size_mm.z + 0.5) * self.radius).max(0.0);
        Vec3::new(
            r * angle.sin(),
            r * angle.cos(),
            u.y / self.size_mm.y * self.size_mm.z,
        )
    }

    /// Smallest ratio of a length in the world to the unrolled length.
    fn shrinks(&self, q: Vec3) -> f32 {
        let around = TAU * q.xy().length() / self.size_mm.x;
        (self.radius / self.size_mm.z)
            .min(self.size_mm.z / self.size_mm.y)
            .min(around)
            .min(1.0)
    }
}

impl Field for Cylindrical {
    fn backward(&self, q: Vec3) -> Backward {
        let u = self.unrolled(q);
        let inner = self.inner.backward(u);
        // Where nothing moves, the point itself avoids the rounding of the conversion.
        let source = if inner.source == u {
            q
        } else {
            self.rolled(inner.source)
        };
        Backward {
            source,
            cut_distance_mm: inner.cut_distance_mm * self.shrinks(q).max(0.05),
        }
    }

    fn forward(&self, q: Vec3) -> Option<Vec3> {
        self.inner.forward(self.unrolled(q)).map(|u| self.rolled(u))
    }
}

/// A displacement that fades towards the faces of its box, so that it tears nothing there.
struct Faded {
    inner: Box<dyn Field>,
    /// Half the extent of the map's cube, mm.
    half: Vec3,
    fade_mm: f32,
}

impl Field for Faded {
    fn backward(&self, q: Vec3) -> Backward {
        let inner = self.inner.backward(q);
        let inside = self.half - q.abs();
        let weight: f32 = (0..3)
            .map(|axis| smoothstep(0.0, self.fade_mm.min(self.half[axis]), inside[axis]))
            .product();
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
    /// Width over which the displacement fades towards a spared label.
    fade_mm: f32,
}

impl Field for Spared {
    fn backward(&self, q: Vec3) -> Backward {
        let inner = self.inner.backward(q);
        let inside = |p: Vec3| self.distance.sample(self.world_from_local.transform_point3(p));
        let here = inside(q);
        let source = q + (inner.source - q) * smoothstep(0.0, self.fade_mm, -here);
        let mut cut_distance_mm = inner.cut_distance_mm;
        if (source - q).length_squared() > 0.01 * self.fade_mm * self.fade_mm {
            cut_distance_mm = cut_distance_mm.min(-inside(source));
        }
        Backward {
            source,
            cut_distance_mm: cut_distance_mm.max(here),
        }
    }

    fn forward(&self, q: Vec3) -> Option<Vec3> {
        let spared = self.distance.sample(self.world_from_local.transform_point3(q)) >= 0.0;
        if spared {
            return Some(q);
        }
        // Near a spared label the displacement fades, and the kind's own forward map does not hold.
        self.inner
            .forward(q)
            .filter(|to| self.backward(*to).source.distance_squared(q) < 1e-6)
    }
}
