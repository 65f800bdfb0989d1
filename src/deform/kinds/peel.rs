//! Peel: a layer of the box is cut free on three sides and rolled back about a hinge
//! ([`crate::model`], "Kinds of deformation"; \[DDM06\] fig 1).
//!
//! In local x, z: the layer z in [z0, z0+h], from the hinge x_h on, is rolled into an arc of outer
//! radius R about c = (x_h, z0+R), with its outer side facing inwards; `progress` moves the hinge
//! inwards from the flap's free end. The flap is narrower than the box, so that the whole cut lies
//! inside the map and D vanishes on every face.
//!
//! The mask is a distance. Retained are the *strip* (the roll, and the layer up to the hinge from
//! which it continues), and everything that is neither in the *slot* (the layer's original
//! position) nor within a thin band around the roll above the layer. The band separates the roll
//! from undisplaced material: between them D must run from the roll's value to zero, and that must
//! happen where nothing is visible.

use super::{
    Backward, BoxLength, DefaultSize, Field, FieldBuilder, FieldContext, Formula, FormulaKind, Kind,
    NO_CUT_DISTANCE_MM, Parameter,
};
use glam::{Vec2, Vec3};
use std::f32::consts::{FRAC_PI_2, TAU};

/// The layer's lower side above the box's lower face, as a fraction of the box.
const FLOOR: f32 = 0.1;
/// Distance from the flap's free end and sides to the box's faces, as a fraction of the box.
const MARGIN: f32 = 0.06;
/// Maximum turn of the roll, so that its end stays clear of the hinge.
const MAX_TURN_RAD: f32 = 4.8;

pub(super) const KIND: Kind = Kind {
    name: "peel",
    about: "cuts a flap free and rolls it back about a hinge, towards the box's -x",
    parameters: &[
        Parameter::mm(
            "depth",
            BoxLength::OfZ(0.25),
            [BoxLength::OfZ(0.01), BoxLength::OfZ(0.366)],
            "thickness of the layer",
        ),
        Parameter::mm(
            "radius",
            BoxLength::OfZ(0.38),
            [BoxLength::OfZ(0.05), BoxLength::OfZ(0.44)],
            "outer radius of the roll (at least 1.2 times the depth)",
        ),
    ],
    size: DefaultSize::Share([0.8, 0.6, 0.5]),
    cube_scale: 1.0,
    varies: [true; 3],
    resolution: 128,
    nonzero_faces: [false; 6],
    locked_to_view: false,
    shape: None,
    build: FieldBuilder::Formula(|c| Box::new(Peel::new(c))),
};

pub(super) struct Peel {
    /// z of the layer's lower side.
    floor: f32,
    /// Thickness of the layer.
    depth: f32,
    /// Outer radius of the roll.
    radius: f32,
    /// x of the hinge.
    hinge: f32,
    /// x of the flap's free end before it was rolled.
    end: f32,
    /// Length rolled.
    flap: f32,
    slot_half_y: f32,
    texel: f32,
    /// Width of the band around the roll.
    clearance: f32,
}

/// A point in the roll's coordinates: arc length from the hinge, height in the layer, and signed
/// distance to the roll.
struct Rolled {
    along: f32,
    height: f32,
    distance: f32,
}

impl Peel {
    /// The peel of a box; depth and radius are the first two values.
    pub(super) fn new(c: &FieldContext) -> Self {
        let half = c.half();
        let depth = c.value("depth");
        let radius = c.value("radius").max(1.2 * depth);
        let end = half.x - MARGIN * c.size_mm.x;
        // The roll must stay inside the box behind the hinge, and within its turn.
        let length = (end + half.x - radius - MARGIN * c.size_mm.x)
            .min(MAX_TURN_RAD * radius)
            .max(0.0);
        let flap = length * c.progress;
        Self {
            floor: -half.z + FLOOR * c.size_mm.z,
            depth,
            radius,
            hinge: end - flap,
            end,
            flap,
            slot_half_y: half.y - MARGIN * c.size_mm.y,
            texel: c.texel_mm,
            clearance: 4.0 * c.texel_mm,
        }
    }

    /// Bound on the displacement, mm.
    pub(super) fn reach(&self) -> f32 {
        2.0 * (self.radius + self.depth)
    }

    /// Edge of a texel, mm.
    pub(super) fn texel_mm(&self) -> f32 {
        self.texel
    }

    /// z of the layer's upper side.
    pub(super) fn top(&self) -> f32 {
        self.floor + self.depth
    }

    fn max_angle(&self) -> f32 {
        self.flap / self.radius
    }

    fn rolled(&self, q: Vec3) -> Rolled {
        let v = Vec2::new(q.x - self.hinge, self.floor + self.radius - q.z);
        let rho = v.length();
        let last = self.max_angle();
        let mut theta = v.x.atan2(v.y);
        if theta < 0.0 {
            theta += TAU;
        }
        // Angles beyond the roll are measured from the nearer of its ends.
        if theta > (last + TAU) / 2.0 {
            theta -= TAU;
        }
        let height = self.radius - rho;
        let side = |angle: f32| {
            if angle.abs() < FRAC_PI_2 {
                rho * angle.sin()
            } else {
                rho * angle.signum()
            }
        };
        let distance = height
            .min(self.depth - height)
            .min(side(theta))
            .min(side(last - theta));
        Rolled {
            along: (theta * self.radius).clamp(0.0, self.flap),
            height: height.clamp(0.0, self.depth),
            distance,
        }
    }

    /// Half width of the flap: narrower than its slot, so that the flap's sides do not touch the
    /// slot's walls.
    fn flap_half_y(&self) -> f32 {
        self.slot_half_y - 2.5 * self.texel
    }
}

impl Field for Peel {
    fn backward(&self, q: Vec3) -> Backward {
        if self.flap < self.texel {
            return Backward {
                source: q,
                cut_distance_mm: NO_CUT_DISTANCE_MM,
            };
        }
        let roll = self.rolled(q);
        let above_floor = q.z - self.floor;
        let inside_flap_y = self.flap_half_y() - q.y.abs();
        let in_roll = roll.distance.min(inside_flap_y);
        // The layer behind the hinge, from which the roll continues.
        let in_layer = if q.x <= self.hinge {
            above_floor.min(self.depth - above_floor)
        } else {
            -NO_CUT_DISTANCE_MM
        };
        let in_strip = in_roll.max(in_layer);
        let over_slot = (q.x - self.hinge)
            .min(self.end - q.x)
            .min(self.slot_half_y - q.y.abs())
            .min(above_floor);
        let in_slot = over_slot.min(self.depth - above_floor);
        // Over the slot the band extends down into it: if the two only touched, a thin sheet would
        // remain between them.
        let in_band = (in_roll + self.clearance).min(over_slot.max(above_floor - self.depth));
        let undisplaced = -in_slot.max(in_band);
        // D of the roll, continued; it fades to zero between the roll and the undisplaced part.
        let continued = Vec3::new(self.hinge + roll.along, q.y, self.floor + roll.height) - q;
        let (to_roll, to_undisplaced) = ((-in_roll).max(0.0), (-undisplaced).max(0.0));
        let between = to_roll + to_undisplaced;
        let weight = if in_roll >= 0.0 {
            1.0
        } else if undisplaced >= 0.0 {
            0.0
        } else {
            // A texel next to either side already affects the visible result: the fade stays away
            // from both.
            let margin = (self.texel * 1.5 / between).min(0.45);
            ((to_undisplaced / between - margin) / (1.0 - 2.0 * margin)).clamp(0.0, 1.0)
        };
        Backward {
            source: q + continued * weight,
            cut_distance_mm: in_strip.max(undisplaced),
        }
    }

    fn forward(&self, q: Vec3) -> Option<Vec3> {
        let height = q.z - self.floor;
        let along = q.x - self.hinge;
        if self.flap < self.texel
            || along <= 0.0
            || along > self.flap
            || !(0.0..=self.depth).contains(&height)
            || q.y.abs() > self.slot_half_y
        {
            let covered = self.flap >= self.texel
                && self.rolled(q).distance.min(self.flap_half_y() - q.y.abs()) > -self.clearance
                && height > self.depth;
            return (!covered).then_some(q);
        }
        if q.y.abs() > self.flap_half_y() {
            return None;
        }
        let theta = along / self.radius;
        let rho = self.radius - height;
        Some(Vec3::new(
            self.hinge + rho * theta.sin(),
            q.y,
            self.floor + self.radius - rho * theta.cos(),
        ))
    }

    fn formula(&self) -> Option<Formula> {
        Some(Formula::new(
            FormulaKind::Peel,
            &[
                self.floor,
                self.depth,
                self.radius,
                self.hinge,
                self.end,
                self.flap,
                self.slot_half_y,
                self.texel,
                self.clearance,
            ],
        ))
    }
}
