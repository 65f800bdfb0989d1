//! The kinds of deformation as types: the command-line form `peel:size=80,progress=0.7` is
//! `Peel::new().size(80.0).progress(0.7)` here. Lengths are in millimetres, angles in degrees,
//! positions in world coordinates (patient LPS). Unset values have the kind's defaults
//! ([`crate::deform::kinds`]).

use super::{DefaultPlacement, Deformation, Size};
use crate::deform::Argument;

macro_rules! kinds {
    ($($(#[$about:meta])* $kind:ident = $name:literal {
        numbers { $($(#[$number_about:meta])* $number:ident = $number_name:literal,)* }
        settings { $($(#[$setting_about:meta])* $setting:ident = $setting_name:literal,)* }
    })*) => {
        $(
            $(#[$about])*
            #[derive(Clone, Debug, PartialEq)]
            pub struct $kind(Deformation);

            impl Default for $kind {
                fn default() -> Self {
                    Self(Deformation::new($name))
                }
            }

            impl From<$kind> for Deformation {
                fn from(kind: $kind) -> Self {
                    kind.0
                }
            }

            impl $kind {
                /// With all its defaults.
                pub fn new() -> Self {
                    Self::default()
                }

                $(
                    $(#[$number_about])*
                    #[must_use]
                    pub fn $number(mut self, value: f32) -> Self {
                        self.0.parameters.insert($number_name, value);
                        self
                    }
                )*

                $(
                    $(#[$setting_about])*
                    #[must_use]
                    pub fn $setting(mut self, value: impl Into<Argument>) -> Self {
                        self.0.parameters.insert($setting_name, value);
                        self
                    }
                )*

                /// Where its box lies if its centre or size is left out.
                #[must_use]
                pub fn placement(mut self, placement: DefaultPlacement) -> Self {
                    self.0.placement = placement;
                    self
                }

                /// Centre of its box, mm; on the visible surface by default.
                #[must_use]
                pub fn center(mut self, center: impl Into<[f32; 3]>) -> Self {
                    self.0.center = Some(center.into());
                    self
                }

                /// Extent of its box, mm: one length, or one along each of x, y, z.
                #[must_use]
                pub fn size(mut self, size: impl Into<Size>) -> Self {
                    self.0.size = Some(size.into());
                    self
                }

                /// Rotation about x, then y, then z, degrees.
                #[must_use]
                pub fn rotate(mut self, degrees: impl Into<[f32; 3]>) -> Self {
                    self.0.rotate = Some(degrees.into());
                    self
                }

                /// Progress from none (0) to full (1).
                #[must_use]
                pub fn progress(mut self, progress: f32) -> Self {
                    self.0.progress = Some(progress);
                    self
                }
            }
        )*

        /// Every type's kind name, with the names of its numbers and its settings.
        #[cfg(test)]
        const ALL: &[(&str, &[&str], &[&str])] = &[$(($name, &[$($number_name),*], &[$($setting_name),*])),*];
    };
}

impl From<f32> for Size {
    fn from(edge: f32) -> Self {
        Self::Cube(edge)
    }
}

impl From<[f32; 3]> for Size {
    fn from(edges: [f32; 3]) -> Self {
        Self::Box(edges)
    }
}

kinds! {
    /// Pulls material out along the box's z axis in a Gaussian bump.
    Pull = "pull" {
        numbers {
            /// Displacement at the upper face, on the axis, mm.
            amount = "amount",
            /// Width of the Gaussian, mm.
            sigma = "sigma",
        }
        settings {
        }
    }
    /// Pulls material up along the box's z axis, compressing what lies above.
    SplinePull = "spline-pull" {
        numbers {
            /// Displacement at the peak, mm.
            amount = "amount",
        }
        settings {
        }
    }
    /// A circular wave along the box's z axis.
    RadialWave = "wave" {
        numbers {
            /// Amplitude, mm.
            amplitude = "amplitude",
            /// Wavelength, mm.
            wavelength = "wavelength",
            /// Phase on the axis, degrees.
            phase = "phase",
        }
        settings {
        }
    }
    /// A wave along the box's z axis that propagates along its x.
    PlanarWave = "planar-wave" {
        numbers {
            /// Amplitude, mm.
            amplitude = "amplitude",
            /// Wavelength, mm.
            wavelength = "wavelength",
            /// Phase on the axis, degrees.
            phase = "phase",
        }
        settings {
        }
    }
    /// Rotates the upper end of the box relative to the lower end.
    Twist = "twist" {
        numbers {
            /// Rotation of the upper face, degrees.
            angle = "angle",
            /// Fraction of the radius over which the rotation fades.
            falloff = "falloff",
        }
        settings {
        }
    }
    /// Bends the box's z axis towards its +x; the lower face stays in place.
    Bend = "bend" {
        numbers {
            /// Rotation of the upper face, degrees.
            angle = "angle",
        }
        settings {
        }
    }
    /// Narrows or widens the box towards its upper face.
    Taper = "taper" {
        numbers {
            /// Scale factor of the upper face; 1 is unchanged.
            factor = "factor",
        }
        settings {
        }
    }
    /// Slides the box's upper face along x and y; the lower face stays in place.
    Shear = "shear" {
        numbers {
            /// Shear angle of the box's edges along x, degrees.
            angle = "angle",
            /// Shear angle of the box's edges along y, degrees.
            angle_y = "angle-y",
        }
        settings {
        }
    }
    /// Magnifies the centre of the box like a lens.
    Bulge = "bulge" {
        numbers {
            /// The magnification at the centre is 1 / (1 - amount).
            amount = "amount",
        }
        settings {
        }
    }
    /// Cuts a flap free and rolls it back about a hinge, towards the box's -x.
    Peel = "peel" {
        numbers {
            /// Thickness of the layer, mm.
            depth = "depth",
            /// Outer radius of the roll; at least 1.2 times the depth is used, mm.
            radius = "radius",
        }
        settings {
        }
    }
    /// Cuts into slabs across the box's z axis and spreads them apart.
    Slab = "slab" {
        numbers {
            /// Thickness of one slab, mm.
            thickness = "thickness",
            /// Gap between two slabs, mm.
            gap = "gap",
            /// Height that stays in place: 0 is the lower face, 1 the upper.
            anchor = "anchor",
        }
        settings {
        }
    }
    /// Cuts into pieces along the axes and moves them apart.
    Explode = "explode" {
        numbers {
            /// Gap between two pieces, mm.
            gap = "gap",
            /// Pieces along x (whole number).
            pieces_x = "pieces-x",
            /// Pieces along y.
            pieces_y = "pieces-y",
            /// Pieces along z.
            pieces_z = "pieces-z",
        }
        settings {
        }
    }
    /// Splits along a seam (the box's y axis) and swings the halves open.
    Seam = "seam" {
        numbers {
            /// Swing of each half, degrees.
            angle = "angle",
        }
        settings {
        }
    }
    /// Splits along the plane x = 0 and opens the halves like a book, spine below.
    Book = "book" {
        numbers {
            /// Swing of each half, degrees.
            angle = "angle",
            /// Height of the spine in the box: 0 is the lower face, 1 the upper.
            spine = "spine",
        }
        settings {
        }
    }
    /// An incision along the box's y axis, held open.
    Knife = "knife" {
        numbers {
            /// Length of the cut, mm.
            length = "length",
            /// Depth of the cut below the box's upper face, mm.
            depth = "depth",
            /// Opening between the lips at the widest point, mm.
            opening = "opening",
        }
        settings {
        }
    }
    /// An incision along the box's x axis held open to an ellipse.
    Retractor = "retractor" {
        numbers {
            /// Length of the incision, mm.
            length = "length",
            /// Opening between the lips at the widest point, mm.
            opening = "opening",
            /// Depth of the incision below the box's upper face, mm.
            depth = "depth",
        }
        settings {
        }
    }
    /// Removes a box.
    RemoveBox = "box" {
        numbers {
        }
        settings {
        }
    }
    /// Removes a sphere (an ellipsoid if the box's sides are unequal).
    RemoveSphere = "sphere" {
        numbers {
        }
        settings {
        }
    }
    /// Removes a cylinder along the box's z axis.
    RemoveCylinder = "cylinder" {
        numbers {
        }
        settings {
        }
    }
    /// Removes a wedge about the box's z axis.
    RemoveWedge = "wedge" {
        numbers {
            /// Angle of the wedge, centred on +x, degrees.
            angle = "angle",
        }
        settings {
        }
    }
    /// Removes everything above the plane through the box's centre, perpendicular to its z axis.
    RemoveHalfSpace = "half-space" {
        numbers {
        }
        settings {
        }
    }
    /// Removes a sphere whose box is aligned with the camera.
    RemoveViewSphere = "view-sphere" {
        numbers {
        }
        settings {
        }
    }
    /// Removes a cone that opens from the box's centre towards the viewer.
    RemoveViewCone = "view-cone" {
        numbers {
            /// Opening angle of the cone, degrees.
            angle = "angle",
        }
        settings {
        }
    }
    /// Removes everything behind a closed outline, along the view direction.
    Lasso = "lasso" {
        numbers {
            /// Distance of the eye from the box's centre, for an outline drawn in perspective; 0
            /// for an orthographic one, mm.
            eye = "eye",
        }
        settings {
            /// Points x,y of the outline in the box's plane through its centre, mm (x right, y up
            /// in the view).
            points = "points",
            /// True removes everything outside the outline instead.
            invert = "invert",
        }
    }
    /// Deforms by a lattice of control points.
    Lattice = "lattice" {
        numbers {
        }
        settings {
            /// Control points along x, y, z; 4,4,4 by default.
            lattice = "lattice",
            /// `bernstein` or `b-spline`.
            basis = "basis",
            /// Rows i,j,k,dx,dy,dz (indices from 0, mm), one per point; or a .csv file of six
            /// columns.
            offsets = "offsets",
        }
    }
    /// Moves given points to given targets, and interpolates smoothly between them.
    ControlPoints = "points" {
        numbers {
            /// Fraction of the way to the box's faces over which the displacement fades.
            fade = "fade",
            /// Width of the Gaussians; 0 uses the distance between points, mm.
            width = "width",
        }
        settings {
            /// Rows of source x,y,z and target x,y,z in mm, one per pair; or a .csv file of six
            /// columns.
            pairs = "pairs",
            /// File of the source points (.mrk.json, .fcsv, .csv), in the order of the targets.
            from_file = "from",
            /// File of the target points.
            to_file = "to",
            /// `tps` (thin-plate spline), `rbf` (Gaussians) or `idw` (inverse distance weighting).
            method = "method",
        }
    }
    /// Drags regions of an elastic lattice, with cuts; plausible rather than physically accurate.
    Elastic = "elastic" {
        numbers {
            /// Nodes along the box's longest axis (whole number).
            nodes = "nodes",
        }
        settings {
            /// Rows x,y,z,radius,dx,dy,dz in mm: a ball to drag, and its displacement; repeat for
            /// more.
            grab = "grab",
            /// Rows x,y,z,radius: regions held fixed, in addition to the box's faces.
            fixed = "fixed",
            /// Rows x,y,z,nx,ny,nz,radius: a circular cut and its normal.
            incision = "incision",
            /// Rows label,stiffness: relative to 1, by the labels of `labels`.
            stiffness = "stiffness",
        }
    }
    /// Removes everything down to a depth below a surface, within the box.
    StripSurface = "strip" {
        numbers {
            /// Depth below the surface, mm.
            depth = "depth",
        }
        settings {
            /// Labels whose surface is followed.
            labels = "label",
            /// A file whose voxels above 0 are inside.
            mask = "mask",
            /// Threshold of the body's surface; automatic by default.
            iso = "iso",
        }
    }
    /// Lifts off the layer between a surface and a depth below it, along the surface normals.
    LiftSurface = "lift" {
        numbers {
            /// Depth below the surface, mm.
            depth = "depth",
            /// Height by which the layer is lifted, mm.
            height = "height",
        }
        settings {
            /// Labels whose surface is followed.
            labels = "label",
            /// A file whose voxels above 0 are inside.
            mask = "mask",
            /// Threshold of the body's surface; automatic by default.
            iso = "iso",
        }
    }
    /// Moves a surface and its neighbourhood outwards or inwards.
    OffsetSurface = "offset" {
        numbers {
            /// Distance outwards, mm; negative is inwards.
            amount = "amount",
            /// Width of the band on either side of the surface that moves with it, mm; at least 2.5
            /// times the amount is used.
            band = "band",
        }
        settings {
            /// Labels whose surface is followed.
            labels = "label",
            /// A file whose voxels above 0 are inside.
            mask = "mask",
            /// Threshold of the body's surface; automatic by default.
            iso = "iso",
        }
    }
    /// Cuts a flap at a depth below a surface and rolls it back, towards the box's -x.
    SurfacePeel = "surface-peel" {
        numbers {
            /// Depth below the surface, mm.
            depth = "depth",
            /// Outer radius of the roll; at least 1.2 times the depth is used, mm.
            radius = "radius",
        }
        settings {
            /// Labels whose surface is followed.
            labels = "label",
            /// A file whose voxels above 0 are inside.
            mask = "mask",
            /// Threshold of the body's surface; automatic by default.
            iso = "iso",
        }
    }
    /// Moves labels apart; voxels without one of the labels are hidden, or stay.
    ExplodeLabels = "explode-labels" {
        numbers {
            /// Displacement of the outermost label, mm.
            gap = "gap",
        }
        settings {
            /// The labels.
            labels = "label",
            /// Whether to hide or keep voxels without one of the labels.
            rest = "rest",
        }
    }
    /// A painted deformation made of strokes: push, smooth, cut, restore, and outlines cut out or
    /// restored.
    Brush = "brush" {
        numbers {
        }
        settings {
            /// One string per stroke: push, smooth, cut or restore with RADIUS STRENGTH x y z ...,
            /// lasso-cut or lasso-restore with EYE, a point, right, up and x y ...; mm.
            strokes = "strokes",
        }
    }
    /// A registration's transform or displacement field.
    ExternalField = "field" {
        numbers {
        }
        settings {
            /// File, or files that are applied to a deformed point in order.
            path = "path",
            /// The image that is deformed, for FSL files.
            moving = "moving",
            /// The image to which it was registered, for FSL files.
            reference = "reference",
            /// Convention of the vectors: lps, ras, fsl or fsl-absolute, if the file does not state
            /// it.
            convention = "convention",
            /// True uses the inverse.
            invert = "invert",
        }
    }
    /// A displacement map made by incise map; its placement is replaced if center, size or rotate
    /// are given.
    SavedMap = "map" {
        numbers {
        }
        settings {
            /// File.
            path = "path",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::deform::file_kinds::FILE_KINDS;
    use crate::deform::kinds;

    /// Every kind has a type, with exactly its parameters and settings.
    #[test]
    fn every_kind_has_its_type() {
        let formulas = kinds::list().map(|k| {
            let settings = k.own_settings().iter().map(|s| s.name).collect::<Vec<_>>();
            (
                k.name,
                k.parameters.iter().map(|p| p.name).collect::<Vec<_>>(),
                settings,
            )
        });
        let files = FILE_KINDS.iter().map(|k| {
            (
                k.name,
                Vec::new(),
                k.own_settings.iter().map(|s| s.name).collect(),
            )
        });
        let expected: Vec<_> = formulas.chain(files).collect();
        let typed: Vec<_> = ALL
            .iter()
            .map(|(kind, numbers, settings)| (*kind, numbers.to_vec(), settings.to_vec()))
            .collect();
        assert_eq!(typed, expected);
    }

    #[test]
    fn a_typed_kind_is_what_is_typed() {
        let typed: Deformation = Peel::new()
            .center([1.0, 2.0, 3.0])
            .size(80.0)
            .progress(0.7)
            .radius(9.0)
            .into();
        let mut stated = Deformation {
            center: Some([1.0, 2.0, 3.0]),
            size: Some(Size::Cube(80.0)),
            progress: Some(0.7),
            ..Deformation::new("peel")
        };
        stated.parameters.insert("radius", 9.0);
        assert_eq!(typed, stated);
    }
}
