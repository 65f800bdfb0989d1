//! Checks of the render and light settings.

use super::{Antialias, Light, RenderSettings, Scene};
use crate::files::memory;
use crate::picture::{MAX_PICTURE_EDGE, MAX_PIXELS};
use crate::{Error, Result};

impl Scene {
    /// Checks every number of the scene against the limits, and the render settings for validity.
    ///
    /// # Errors
    /// The first invalid setting, by name.
    pub fn check(&self) -> Result<()> {
        self.check_limits()?;
        check_settings(&self.render, &self.light)
    }
}

/// Checks the size of a picture, alone and with its antialiasing, and the memory that it needs.
fn check_size(settings: &RenderSettings) -> Result<()> {
    let [width, height] = settings.size;
    if !settings.size.iter().all(|n| (1..=MAX_PICTURE_EDGE).contains(n)) {
        let problem =
            format!("{width} x {height} pixels is out of range; each edge must be 1 to {MAX_PICTURE_EDGE}");
        return Err(Error::value("size", problem));
    }
    let n = settings.antialias.grid();
    if !(1..=Antialias::MAX_GRID).contains(&n) {
        let problem = format!("{n} is outside 1 to {}", Antialias::MAX_GRID);
        return Err(Error::value("antialias", problem));
    }
    let samples = u64::from(width) * u64::from(height) * u64::from(n * n);
    if width.max(height) * n > MAX_PICTURE_EDGE || samples > MAX_PIXELS {
        let problem = format!(
            "{width} x {height} with antialias {n} needs {} x {} samples, which is too many ({MAX_PICTURE_EDGE} along an edge and {MAX_PIXELS} in all are possible); reduce size or antialias",
            width * n,
            height * n
        );
        return Err(Error::value("size", problem));
    }
    // Floating-point pixels, and bytes before and after encoding.
    let bytes = 16 * samples + 12 * u64::from(width) * u64::from(height);
    match memory::available_bytes() {
        Some(available) if bytes > available => {
            let mib = |b: u64| b >> 20;
            Err(Error::value(
                "size",
                format!(
                    "{width} x {height} needs {} MiB of memory, but only {} MiB are available; make the picture smaller",
                    mib(bytes),
                    mib(available)
                ),
            ))
        }
        _ => Ok(()),
    }
}

/// Most slices composited inside one fragment.
const MAX_SLAB: u32 = 64;
/// Bounds on the error of a precomposed map, mm.
const PRECOMPOSE_MM: std::ops::RangeInclusive<f32> = 0.001..=100.0;

fn check_settings(settings: &RenderSettings, light: &Light) -> Result<()> {
    check_size(settings)?;
    if !(settings.step.is_finite() && (0.01..=100.0).contains(&settings.step)) {
        return Err(Error::value(
            "step",
            format!("{} is outside 0.01 to 100 voxels", settings.step),
        ));
    }
    if !(1..=MAX_SLAB).contains(&settings.slab) {
        return Err(Error::value(
            "slab",
            format!("{} is outside 1 to {MAX_SLAB} slices", settings.slab),
        ));
    }
    if settings.iso.is_some_and(|v| !v.is_finite()) {
        return Err(Error::value("iso", "must be a finite value"));
    }
    if settings.precompose.is_some_and(|mm| !PRECOMPOSE_MM.contains(&mm)) {
        let [least, most] = [PRECOMPOSE_MM.start(), PRECOMPOSE_MM.end()];
        return Err(Error::value(
            "precompose",
            format!("must be an error bound in mm, from {least} to {most}"),
        ));
    }
    if !settings.background.iter().all(|c| (0.0..=1.0).contains(c)) {
        return Err(Error::value("background", "its components must lie within 0..1"));
    }
    light.check()
}
