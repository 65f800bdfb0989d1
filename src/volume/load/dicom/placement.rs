//! The placement of slices in space: the grid that fits them best, and their distance from it.

use super::frame::Frame;
use super::increments::SliceDistance;
use super::object::Object;
use super::series::{MAX_NAMED_POSITIONS, has_locations, normal, same_place};
use glam::{DAffine3, DMat3, DVec3};

/// Steps that differ by more than this fraction of the usual one are uneven.
const UNEVEN: f64 = 0.01;
/// Positions rounded to this many mm are not uneven, up to twice that fraction.
const ROUNDED: f64 = 0.01;
/// Maximum number of slices of a segmentation with omitted empty slices.
const MAX_EMPTY_SLICES: f64 = 10_000.0;

/// Largest difference from a step that is not uneven, mm.
fn tolerance(step: f64) -> f64 {
    (UNEVEN * step).max(ROUNDED.min(2.0 * UNEVEN * step))
}

/// A length in mm for messages, with enough digits at every scale.
pub fn length(mm: f64) -> String {
    match mm.abs() {
        0.0 => "0".into(),
        0.1.. => format!("{mm:.2}"),
        v => {
            let digits = (2 - v.log10().floor() as i32).clamp(2, 15) as usize;
            format!("{mm:.digits$}")
        }
    }
}

/// Maximum factor by which resampling may increase the number of slices.
const MAX_RESAMPLING_FACTOR: f64 = 16.0;

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

impl SlicePlacement {
    /// The number of slices after resampling onto an even grid of the usual (median) gap.
    pub fn resampled_count(&self) -> usize {
        let last = self.at.len().saturating_sub(1) as f64;
        let mut gaps: Vec<f64> = self.at.windows(2).map(|w| w[1] - w[0]).collect();
        gaps.sort_by(f64::total_cmp);
        let usual = gaps.get(gaps.len() / 2).copied().unwrap_or(1.0);
        let step = usual.max(last / (MAX_RESAMPLING_FACTOR * self.at.len() as f64));
        (last / step).round() as usize + 1
    }
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
            .any(|g| (g - self.mean).abs() > tolerance(self.mean))
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
                "{count} {} missing at {} mm along the normal (spacing {} mm){}",
                if count == 1.0 { "slice is" } else { "slices are" },
                named_gaps(frames, &missing),
                length(usual),
                if resample {
                    ""
                } else {
                    "; the slices that are there are spread evenly over the gap"
                }
            );
        }
        let odd: Vec<usize> = (0..gaps.len())
            .filter(|&k| (gaps[k] - usual).abs() > tolerance(usual))
            .collect();
        let (mean, deviation) = (self.mean, self.deviation);
        let instead = format!(
            "; the mean spacing of {} mm is used, which misplaces slices by up to {} mm",
            length(mean),
            length(deviation)
        );
        format!(
            "slice spacing varies from {} to {} mm (it differs from the usual {} mm at {} mm along the normal){}",
            length(by_size[0]),
            length(by_size[by_size.len() - 1]),
            length(usual),
            named_gaps(frames, &odd),
            if resample { "" } else { &instead }
        )
    }
}

/// The positions before and after some gaps, for messages.
fn named_gaps(frames: &[&Frame], gaps: &[usize]) -> String {
    let unit = normal(frames[0]);
    let place = |k: usize| length(frames[k].position.map_or(0.0, |p| p.dot(unit)));
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

/// Warns of geometry that the frames do not state.
fn warn_of_unstated(frames: &[&Frame], object: &Object, warnings: &mut Vec<String>) {
    let frame = frames[0];
    if frame.spacing[0] == 0.0 {
        warnings.push(if frame.aspect == 1.0 {
            "does not state its pixel spacing; 1 mm is assumed (use --spacing to set it)".into()
        } else {
            format!(
                "does not state its pixel spacing; 1 mm is assumed, with its aspect ratio of {} to 1 (use --spacing to set it)",
                frame.aspect
            )
        });
    }
    if frame.at_detector {
        warnings.push(
            "states its pixel spacing at the detector only, where the patient appears magnified; it is used uncorrected (use --spacing to set it)".into(),
        );
    }
    if !frame.stated[1] && frame.stated[0] {
        warnings.push(
            "does not state its image orientation; its axes are assumed to be left and posterior".into(),
        );
    }
    if frames.iter().any(|f| !f.stated[0]) {
        let order = match frames {
            [_] => "",
            _ if frame.position.is_some() => "slices are in the order of the file, and ",
            _ if located(frames).is_some() => "slices are ordered by their slice location, and ",
            [first, rest @ ..] if rest.iter().any(|f| f.instance != first.instance) => {
                "slices are ordered by instance number, and "
            }
            _ => "slices are in the order of the numbers in their names, and ",
        };
        warnings.push(format!(
            "does not state its slice positions; {order}its axes are assumed to be left, posterior, superior"
        ));
    }
    if let Some(warning) = unstated_distance(frames, object) {
        warnings.push(warning);
    }
}

/// The warning about a distance between slices that follows neither from positions nor from a
/// stated distance.
fn unstated_distance(frames: &[&Frame], object: &Object) -> Option<String> {
    if frames.len() > 1 && (frames.iter().all(|f| f.placed) || located(frames).is_some()) {
        return None;
    }
    match (object.slice_distance, frames.len()) {
        (SliceDistance::Stated(_), _) | (SliceDistance::Thickness(_), 1) => None,
        (SliceDistance::Thickness(mm), _) => Some(format!(
            "does not state the distance between its slices; their thickness of {} mm is used (use --spacing to set it)",
            length(mm)
        )),
        (SliceDistance::Unstated, 1) => Some(
            "does not state the thickness of its slice; 1 mm is assumed (use --spacing to set it)".into(),
        ),
        (SliceDistance::Unstated, _) => Some(
            "does not state the distance between its slices; 1 mm is assumed (use --spacing to set it)"
                .into(),
        ),
    }
}

/// Slice locations of frames without positions, if they can be used.
fn located(frames: &[&Frame]) -> Option<Vec<f64>> {
    let frames: Vec<Frame> = frames.iter().map(|f| (*f).clone()).collect();
    if frames.iter().any(|f| f.position.is_some()) || !has_locations(&frames) {
        return None;
    }
    Some(frames.iter().filter_map(|f| f.location).collect())
}

/// Vector from one slice of the even grid to the next, mm.
fn slice_step(frames: &[&Frame], along: &[f64], object: &Object) -> DVec3 {
    let (first, last) = (frames[0], frames[frames.len() - 1]);
    let n = frames.len();
    let unit = normal(first);
    let distance = object.slice_distance.mm();
    let extent = along[n - 1] - along[0];
    let step = match (first.position, last.position) {
        (Some(a), Some(b)) if n > 1 && extent > same_place(along) => (b - a) / (n - 1) as f64,
        (None, None) if n > 1 && extent > 0.0 => unit * (extent / (n - 1) as f64),
        _ => unit * distance,
    };
    if !object.segmentation || n < 2 {
        return step;
    }
    // Writers of segmentations omit empty slices: their distance is stated, or the smallest one.
    let at: Vec<f64> = along.iter().map(|a| a - along[0]).collect();
    let least = at.windows(2).map(|w| w[1] - w[0]).fold(f64::INFINITY, f64::min);
    let stated = match object.slice_distance {
        SliceDistance::Stated(mm) => Some(mm.abs()),
        _ => None,
    };
    for spacing in stated.into_iter().chain([least]) {
        let count = at.last().map_or(0.0, |last| last / spacing);
        let whole = |a: &f64| (a / spacing - (a / spacing).round()).abs() < 0.05;
        if spacing > 0.0 && (1.0..MAX_EMPTY_SLICES).contains(&count.round()) && at.iter().all(whole) {
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
    warn_of_unstated(frames, object, warnings);
    let [columns, rows] = match first.spacing {
        [0.0, _] => [1.0, first.aspect],
        stated => stated,
    };
    let start = first.position.unwrap_or(DVec3::ZERO);
    let unit = normal(first);
    let along: Vec<f64> = match located(frames) {
        Some(locations) => locations.iter().map(|l| l - locations[0]).collect(),
        None => frames
            .iter()
            .map(|f| f.position.map_or(0.0, |p| (p - start).dot(unit)))
            .collect(),
    };
    let step = slice_step(frames, &along, object);
    let mm = step.dot(unit);
    let placed = along[along.len() - 1] > 0.0;
    let along: Vec<f64> = (0..frames.len())
        .map(|k| if placed { along[k] / mm } else { k as f64 })
        .collect();
    let spacing = SliceSpacing::new(&along, mm);
    let off_grid = |a: &f64| (a - a.round()).abs() > 0.05;
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
