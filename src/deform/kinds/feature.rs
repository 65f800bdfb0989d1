//! Deformations that follow a surface instead of a box, which \[DDM06\] names as future work. The
//! surface is that of labels, of a mask, or of an iso-value of the scan, given by its distance
//! field (`deform::distance`); heights are distances from it.
//!
//! - `strip` removes everything down to a depth below the surface, within the box.
//! - `lift` lifts the layer above a depth off along the surface's normals, and leaves a gap.
//! - `offset` pushes the surface and its neighbourhood outwards or inwards.
//! - `surface-peel` is `peel` with the height above the surface as z: the flap is cut at a depth
//!   below a curved surface.
//!
//! Along a normal the distance field is linear, hence moving a point by h along it changes its
//! height by h: `lift` and `offset` are exact along the surface's normals. Where the field has no
//! gradient (on its medial axis) heights are continued smoothly; the layer does not extend that
//! far.

use super::peel::Peel;
use super::{
    Backward, BoxLength, DefaultSize, Field, FieldBuilder, FieldContext, FieldInputs, GapResolution, Kind,
    NO_CUT_DISTANCE_MM, Parameter, Setting, SettingFormat, forward_numerically,
};
use crate::Result;
use crate::deform::Argument;
use crate::math::DistanceGrid;
use crate::math::{Bounds, normalize_or, smoothstep};
use glam::{Affine3A, Mat3, Vec3};
use std::sync::Arc;

const SURFACE: &[Setting] = &[
    Setting {
        name: "label",
        form: SettingFormat::Whole,
        about: "labels whose surface is followed",
    },
    Setting {
        name: "mask",
        form: SettingFormat::File,
        about: "a file whose voxels above 0 are inside",
    },
    Setting {
        name: "iso",
        form: SettingFormat::Number,
        about: "threshold of the body's surface; automatic if not set",
    },
];

fn example(_: &Bounds) -> Vec<(&'static str, Argument)> {
    Vec::new()
}

const fn depth(default: f32) -> Parameter {
    Parameter::mm(
        "depth",
        BoxLength::Fixed(default),
        [BoxLength::Fixed(0.0), BoxLength::Fixed(500.0)],
        "depth below the surface",
    )
}

const fn kind(
    name: &'static str,
    about: &'static str,
    parameters: &'static [Parameter],
    build: fn(&FieldContext, &FieldInputs) -> Result<Box<dyn Field>>,
) -> Kind {
    Kind {
        name,
        about,
        parameters,
        size: DefaultSize::Share([1.3; 3]),
        cube_scale: 1.0,
        varies: [true; 3],
        resolution: 144,
        nonzero_faces: [false; 6],
        locked_to_view: false,
        shape: None,
        build: FieldBuilder::Sourced {
            settings: SURFACE,
            example,
            build,
        },
    }
}

pub(super) const STRIP: Kind = Kind {
    cube_scale: 1.1,
    ..kind(
        "strip",
        "removes everything shallower than a depth below a surface, within the box",
        &[depth(8.0)],
        |c, inputs| {
            Ok(Box::new(SurfaceStrip {
                surface: Surface::new(inputs)?,
                depth: c.value("depth") * c.progress,
                half: c.half(),
                acts: c.progress > 0.0,
            }))
        },
    )
};

pub(super) const LIFT: Kind = kind(
    "lift",
    "lifts a surface layer of a given depth off along its normals",
    &[
        depth(10.0),
        Parameter::mm(
            "height",
            BoxLength::OfRadius(0.2),
            [BoxLength::Fixed(0.0), BoxLength::OfRadius(0.45)],
            "height by which the layer is lifted",
        ),
    ],
    |c, inputs| {
        Ok(Box::new(Lift {
            surface: Surface::new(inputs)?,
            depth: c.value("depth"),
            height: c.value("height") * c.progress,
            half: c.half(),
            gaps: c.gaps(),
        }))
    },
);

pub(super) const OFFSET: Kind = Kind {
    resolution: 112,
    ..kind(
        "offset",
        "pushes a surface and the tissue near it outward or inward",
        &[
            Parameter::mm(
                "amount",
                BoxLength::OfRadius(0.06),
                [BoxLength::OfRadius(-0.25), BoxLength::OfRadius(0.25)],
                "outward displacement; negative is inward",
            ),
            Parameter::mm(
                "band",
                BoxLength::OfRadius(0.35),
                [BoxLength::OfRadius(0.02), BoxLength::OfRadius(1.0)],
                "thickness on each side that moves with the surface (at least 2.5 times the amount)",
            ),
        ],
        |c, inputs| {
            let amount = c.value("amount") * c.progress;
            Ok(Box::new(Offset {
                surface: Surface::new(inputs)?,
                amount,
                band: c.value("band").max(2.5 * amount.abs()),
                half: c.half(),
            }))
        },
    )
};

pub(super) const PEEL: Kind = Kind {
    size: DefaultSize::Share([0.75, 0.6, 1.1]),
    resolution: 160,
    nonzero_faces: [true; 6],
    ..kind(
        "surface-peel",
        "cuts a flap at a depth below a surface and rolls it back, towards the box's -x",
        &[
            depth(8.0),
            Parameter::mm(
                "radius",
                BoxLength::OfX(0.14),
                [BoxLength::OfX(0.02), BoxLength::OfX(0.4)],
                "outer radius of the roll (at least 1.2 times the depth)",
            ),
        ],
        |c, inputs| {
            let surface = Surface::new(inputs)?;
            // Where the box's axis leaves the body: the flap is on that side, and everything far
            // below it is unaffected.
            let top = surface.top(c.half().z);
            Ok(Box::new(SurfacePeel {
                peel: Peel::new(c),
                surface,
                lowest: top - 0.5 * c.size_mm.z,
                acts: c.progress > 0.0,
            }))
        },
    )
};

/// A surface in the box's local millimetres.
struct Surface {
    distance: Arc<DistanceGrid>,
    world_from_local: Affine3A,
    local_from_world: Mat3,
}

impl Surface {
    fn new(inputs: &FieldInputs) -> Result<Self> {
        let local_from_world = Mat3::from(inputs.world_from_local.matrix3).inverse();
        Ok(Self {
            distance: inputs.library.region(inputs.settings)?,
            world_from_local: inputs.world_from_local,
            local_from_world,
        })
    }

    /// Height above the surface, mm; negative inside.
    fn height(&self, q: Vec3) -> f32 {
        -self.distance.sample(self.world_from_local.transform_point3(q))
    }

    /// Unit normal pointing out of the body.
    fn outward(&self, q: Vec3) -> Vec3 {
        let g = self
            .distance
            .gradient(self.world_from_local.transform_point3(q), 1.0);
        normalize_or(self.local_from_world * -g, Vec3::Z)
    }

    /// The highest z on the box's axis that is inside the body; the box's centre if there is none.
    fn top(&self, half_z: f32) -> f32 {
        let steps = 512;
        let z = |n: usize| half_z * (1.0 - 2.0 * n as f32 / steps as f32);
        (0..=steps)
            .map(z)
            .find(|z| self.height(Vec3::new(0.0, 0.0, *z)) < 0.0)
            .unwrap_or(0.0)
    }

    /// The point above (x, y) at a height, searched along z within `reach` of a first guess, and
    /// its error in height. Where the surface is vertical, no point of the line has that height.
    fn at_height(&self, x: f32, y: f32, height: f32, guess: f32, reach: f32) -> (Vec3, f32) {
        let mut z = guess;
        let mut off = self.height(Vec3::new(x, y, z)) - height;
        for _ in 0..12 {
            if off.abs() < 1e-3 {
                break;
            }
            let slope = (self.height(Vec3::new(x, y, z + 0.5)) - self.height(Vec3::new(x, y, z - 0.5)))
                .clamp(0.3, 1.5);
            z = (z - off / slope).clamp(guess - reach, guess + reach);
            off = self.height(Vec3::new(x, y, z)) - height;
        }
        (Vec3::new(x, y, z), off.abs())
    }
}

/// Falls from 1 at the centre of the ellipsoid that fits the box to 0 at its rim.
fn lens(q: Vec3, half: Vec3) -> f32 {
    1.0 - smoothstep(0.55, 1.0, (q / half).length())
}

struct SurfaceStrip {
    surface: Surface,
    depth: f32,
    half: Vec3,
    acts: bool,
}

impl Field for SurfaceStrip {
    fn backward(&self, q: Vec3) -> Backward {
        if !self.acts {
            return Backward {
                source: q,
                cut_distance_mm: NO_CUT_DISTANCE_MM,
            };
        }
        let d = q.abs() - self.half;
        let outside = d.max(Vec3::ZERO).length() + d.max_element().min(0.0);
        Backward {
            source: q,
            cut_distance_mm: (-self.depth - self.surface.height(q)).max(outside),
        }
    }

    fn forward(&self, q: Vec3) -> Option<Vec3> {
        (self.backward(q).cut_distance_mm >= 0.0).then_some(q)
    }
}

struct Lift {
    surface: Surface,
    depth: f32,
    height: f32,
    half: Vec3,
    gaps: GapResolution,
}

impl Field for Lift {
    fn backward(&self, q: Vec3) -> Backward {
        let height = self.height * lens(q, self.half);
        let above_cut = self.surface.height(q) + self.depth;
        if height <= 0.0 || above_cut <= 0.0 {
            return Backward {
                source: q,
                cut_distance_mm: if height > 0.0 {
                    self.gaps.distance(-above_cut, height / 2.0)
                } else {
                    NO_CUT_DISTANCE_MM
                },
            };
        }
        // In the gap the source stays at the cut, so that D is continuous from one side to the
        // other.
        let down = above_cut.min(height);
        let cut = if above_cut < height {
            -above_cut.min(height - above_cut)
        } else {
            above_cut - height
        };
        Backward {
            source: q - self.surface.outward(q) * down,
            cut_distance_mm: self.gaps.distance(cut, height / 2.0),
        }
    }

    fn forward(&self, q: Vec3) -> Option<Vec3> {
        if self.surface.height(q) <= -self.depth {
            Some(q)
        } else {
            forward_numerically(self, q)
        }
    }
}

struct Offset {
    surface: Surface,
    amount: f32,
    band: f32,
    half: Vec3,
}

impl Field for Offset {
    fn backward(&self, q: Vec3) -> Backward {
        let strength = self.amount * lens(q, self.half);
        if strength == 0.0 {
            return Backward {
                source: q,
                cut_distance_mm: NO_CUT_DISTANCE_MM,
            };
        }
        // The band lies around the displaced surface.
        let fall = 1.0 - smoothstep(0.0, self.band, (self.surface.height(q) - strength).abs());
        Backward {
            source: q - self.surface.outward(q) * (strength * fall),
            cut_distance_mm: NO_CUT_DISTANCE_MM,
        }
    }

    fn forward(&self, q: Vec3) -> Option<Vec3> {
        forward_numerically(self, q)
    }
}

struct SurfacePeel {
    peel: Peel,
    surface: Surface,
    /// z below which nothing is changed.
    lowest: f32,
    acts: bool,
}

impl SurfacePeel {
    /// Coordinates of the peel: the upper side of its layer lies on the surface.
    fn flattened(&self, q: Vec3) -> Vec3 {
        Vec3::new(q.x, q.y, self.surface.height(q) + self.peel.top())
    }

    /// The point with given flattened coordinates, and its error in height.
    fn raised(&self, flat: Vec3, guess: f32) -> (Vec3, f32) {
        self.surface
            .at_height(flat.x, flat.y, flat.z - self.peel.top(), guess, self.peel.reach())
    }
}

impl Field for SurfacePeel {
    fn backward(&self, q: Vec3) -> Backward {
        if !self.acts || q.z < self.lowest {
            return Backward {
                source: q,
                cut_distance_mm: NO_CUT_DISTANCE_MM,
            };
        }
        let flat = self.flattened(q);
        let inner = self.peel.backward(flat);
        if inner.source == flat {
            return Backward {
                source: q,
                cut_distance_mm: inner.cut_distance_mm,
            };
        }
        let (mut source, off) = self.raised(inner.source, q.z + inner.source.z - flat.z);
        if inner.cut_distance_mm < 0.0 {
            // Emptied space meets what is not changed without a jump.
            source = q.lerp(
                source,
                smoothstep(0.0, 4.0 * self.peel.texel_mm(), q.z - self.lowest),
            );
        }
        Backward {
            source,
            cut_distance_mm: if off < 1.0 {
                inner.cut_distance_mm
            } else {
                -NO_CUT_DISTANCE_MM
            },
        }
    }

    fn forward(&self, q: Vec3) -> Option<Vec3> {
        if !self.acts || q.z < self.lowest {
            return Some(q);
        }
        let flat = self.flattened(q);
        let to = self.peel.forward(flat)?;
        let there = if to == flat {
            q
        } else {
            self.raised(to, q.z + to.z - flat.z).0
        };
        // Where the search along z did not reach the requested height, the surface has no such
        // point.
        (self.backward(there).source.distance_squared(q) < 1e-6).then_some(there)
    }
}
