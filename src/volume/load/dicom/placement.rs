//! The placement of slices in space: the grid that fits them best, and their distance from it.

use super::frames::Frame;
use super::scan::Object;
use super::series::{MAX_NAMED_POSITIONS, SAME_PLACE, normal};
use glam::{DAffine3, DMat3, DVec3};

/// Steps that differ by more than this, in mm or as a fraction of the step, are uneven.
const UNEVEN: [f64; 2] = [0.01, 0.01];
/// Maximum number of slices of a segmentation with omitted empty slices.
const MAX_EMPTY_SLICES: f64 = 10_000.0;

/// The placement of a volume's slices.
pub struct SlicePlacement {
    pub world_from_voxel: DAffine3,
    /// Position of every slice, in slices from the first one; integers if they are even.
    pub at: Vec<f64>,
    pub even: bool,
    /// Largest deviation of a slice from the even grid, along the normal and perpendicular to it,
    /// mm.
    pub deviation_mm: [f64; 2],
}

/// The spacing of slices along their normal, mm.
struct SliceSpacing {
    /// From each slice to the next.
    gaps: Vec<f64>,
    /// Mean spacing, which is that of the even grid.
    mean: f64,
    /// Largest deviation of a slice from the even grid.
    deviation: f64,
}

impl SliceSpacing {
    /// `along` holds the slices' positions along the normal, in steps of `mean` from the first
    /// slice.
    fn new(along: &[f64], mean: f64) -> Self {
        let gaps = along.windows(2).map(|w| (w[1] - w[0]) * mean).collect();
        let deviation = along
            .iter()
            .enumerate()
            .map(|(k, a)| (a - k as f64).abs() * mean)
            .fold(0.0, f64::max);
        Self {
            gaps,
            mean,
            deviation,
        }
    }

    /// Whether any gap differs from the mean.
    fn is_uneven(&self) -> bool {
        self.gaps
            .iter()
            .any(|g| (g - self.mean).abs() > UNEVEN[0].max(UNEVEN[1] * self.mean))
    }

    /// The warning about uneven spacing: missing slices if all gaps are multiples of the usual one,
    /// else the range of the spacing.
    fn warning(&self, frames: &[&Frame], resample: bool) -> String {
        let gaps = &self.gaps;
        let mut by_size = gaps.clone();
        by_size.sort_by(f64::total_cmp);
        let usual = by_size[by_size.len() / 2];
        // Gaps of an integer number of steps are missing slices, if all other gaps are even.
        let missing: Vec<usize> = (0..gaps.len()).filter(|&k| gaps[k] > 1.5 * usual).collect();
        let whole = |g: f64| (g / usual - (g / usual).round()).abs() < 0.05;
        if !missing.is_empty() && gaps.iter().all(|g| whole(*g)) {
            let count: f64 = missing.iter().map(|&k| (gaps[k] / usual).round() - 1.0).sum();
            return format!(
                "{count} {} missing at {} mm along the normal (spacing {usual:.2} mm){}",
                if count == 1.0 { "slice is" } else { "slices are" },
                named_gaps(frames, &missing),
                if resample {
                    ""
                } else {
                    "; the slices that are there are spread evenly over the gap"
                }
            );
        }
        let odd: Vec<usize> = (0..gaps.len())
            .filter(|&k| (gaps[k] - usual).abs() > UNEVEN[0].max(UNEVEN[1] * usual))
            .collect();
        let (mean, deviation) = (self.mean, self.deviation);
        let instead = format!(
            "; the mean spacing of {mean:.2} mm is used, which misplaces slices by up to {deviation:.2} mm"
        );
        format!(
            "slice spacing varies from {:.2} to {:.2} mm (it differs from the usual {usual:.2} mm at {} mm along the normal){}",
            by_size[0],
            by_size[by_size.len() - 1],
            named_gaps(frames, &odd),
            if resample { "" } else { &instead }
        )
    }
}

/// The positions before and after some gaps, for messages.
fn named_gaps(frames: &[&Frame], gaps: &[usize]) -> String {
    let unit = normal(frames[0]);
    let place = |k: usize| format!("{:.2}", frames[k].position.map_or(0.0, |p| p.dot(unit)));
    let some: Vec<String> = gaps
        .iter()
        .take(MAX_NAMED_POSITIONS)
        .map(|&k| format!("{} to {}", place(k), place(k + 1)))
        .collect();
    if gaps.len() > MAX_NAMED_POSITIONS {
        format!(
            "{} and {} more",
            some.join(", "),
            gaps.len() - MAX_NAMED_POSITIONS
        )
    } else {
        some.join(", ")
    }
}

/// Warns of geometry that a frame does not state.
fn warn_of_unstated(frame: &Frame, warnings: &mut Vec<String>) {
    if frame.spacing[0] == 0.0 {
        warnings.push("does not state its pixel spacing; 1 mm is assumed (use --spacing to set it)".into());
    }
    if !frame.stated[1] && frame.stated[0] {
        warnings.push(
            "does not state its image orientation; its axes are assumed to be left and posterior".into(),
        );
    }
    if !frame.stated[0] {
        warnings.push(
            "does not state its slice positions; slices are ordered by instance number, and their axes are assumed to be left, posterior, superior"
                .into(),
        );
    }
}

/// Vector from one slice of the even grid to the next, mm.
fn slice_step(frames: &[&Frame], object: &Object) -> DVec3 {
    let (first, last) = (frames[0], frames[frames.len() - 1]);
    let n = frames.len();
    let unit = normal(first);
    let step = match (first.position, last.position) {
        (Some(a), Some(b)) if n > 1 && (b - a).dot(unit).abs() > SAME_PLACE => (b - a) / (n - 1) as f64,
        _ => unit * object.slice_spacing.unwrap_or(1.0),
    };
    // Writers of segmentations omit empty slices.
    if object.segmentation && n > 1 {
        let start = first.position.unwrap_or(DVec3::ZERO);
        let at: Vec<f64> = frames
            .iter()
            .filter_map(|f| f.position)
            .map(|p| (p - start).dot(unit))
            .collect();
        let least = at.windows(2).map(|w| w[1] - w[0]).fold(f64::INFINITY, f64::min);
        let count = at.last().map_or(0.0, |last| last / least);
        let whole = |a: &f64| (a / least - (a / least).round()).abs() < 0.05;
        if at.len() == n && least > SAME_PLACE && count < MAX_EMPTY_SLICES && at.iter().all(whole) {
            return step * (n - 1) as f64 / count.round();
        }
    }
    step
}

/// The placement of sorted slices, one frame each. Warns of geometry that is unstated or uneven.
pub fn placement(
    frames: &[&Frame],
    object: &Object,
    resample: bool,
    warnings: &mut Vec<String>,
) -> SlicePlacement {
    let first = frames[0];
    warn_of_unstated(first, warnings);
    let [columns, rows] = first.spacing.map(|s| if s > 0.0 { s } else { 1.0 });
    let start = first.position.unwrap_or(DVec3::ZERO);
    let unit = normal(first);
    let step = slice_step(frames, object);
    let mm = step.dot(unit);
    let along: Vec<f64> = frames
        .iter()
        .enumerate()
        .map(|(k, f)| f.position.map_or(k as f64, |p| (p - start).dot(unit) / mm))
        .collect();
    let spacing = SliceSpacing::new(&along, mm);
    let off_grid = |a: &f64| (a - a.round()).abs() * mm > UNEVEN[0].max(0.05 * mm);
    let uneven = if object.segmentation {
        along.iter().any(off_grid)
    } else {
        spacing.is_uneven()
    };
    if uneven {
        warnings.push(spacing.warning(frames, resample));
    }
    // Slices that do not lie on one line.
    let aside = frames
        .iter()
        .zip(&along)
        .filter_map(|(f, a)| Some((f.position? - start - step * *a).length()))
        .fold(0.0, f64::max);
    let is_aside = aside > 0.5 * columns.min(rows);
    if is_aside {
        warnings.push(format!(
            "its slices are not aligned along one axis; they are offset by up to {aside:.2} mm"
        ));
    }
    let matrix3 = DMat3::from_cols(first.along[0] * columns, first.along[1] * rows, step);
    let deviation_mm = [
        if uneven { spacing.deviation } else { 0.0 },
        if is_aside { aside } else { 0.0 },
    ];
    SlicePlacement {
        world_from_voxel: DAffine3 {
            matrix3,
            translation: start,
        },
        at: along,
        even: !uneven,
        deviation_mm,
    }
}
