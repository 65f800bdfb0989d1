//! Runs of one scene side by side: how they were made, and how much their pictures differ.

use super::metrics::{Difference, difference};
use super::run::Run;
use crate::{Error, Result};
use std::collections::HashSet;

/// The version of the program.
pub(super) const VERSION: &str = env!("CARGO_PKG_VERSION");
/// Differences are amplified by this factor: 1/8 of the range reaches the brightest colour.
const AMPLIFY: f32 = 8.0;

/// Two runs and the difference of their pictures.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RunPair {
    /// Index of the first run.
    pub a: usize,
    /// Index of the second run.
    pub b: usize,
    /// Their difference.
    pub difference: Difference,
}

/// How the runs of a report were made.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Protocol {
    /// The processor, for display.
    pub cpu: String,
    /// The graphics adapter, for display, if one was used.
    pub gpu: Option<String>,
    /// How often each run was timed.
    pub repeat: usize,
    /// Step of the references, voxels, if there are references.
    pub reference_step: Option<f32>,
    /// Stages of preparing the scene for the first time, as for the first picture after loading,
    /// with their milliseconds. The runs themselves use the data that is cached from the second
    /// picture on.
    pub first_preparation: Vec<(String, f64)>,
    /// Notices for the reader, one sentence each.
    pub notices: Vec<String>,
}

/// Runs of one scene, and how they differ.
#[derive(Clone, Debug)]
pub struct Report {
    /// Heading of the page.
    pub title: String,
    /// The scene that all runs show, as TOML.
    pub scene_toml: String,
    /// The runs.
    pub runs: Vec<Run>,
    /// Pairs of runs, in order.
    pub pairs: Vec<RunPair>,
    /// Background of the pictures: red, green, blue, alpha in 0..1, not premultiplied. The metrics
    /// do not depend on it.
    pub background: [f32; 4],
    /// Amplification of the difference pictures.
    pub amplify: f32,
    /// How the runs were made, if all were made the same way.
    pub protocol: Option<Protocol>,
}

/// A picture encoded for writing.
pub(super) struct Encoded {
    pub(super) file: String,
    pub(super) png: Vec<u8>,
}

impl Report {
    /// Compares every run with every other.
    ///
    /// # Errors
    /// No runs, two runs of one name, pictures of different sizes or with values that are not
    /// finite.
    pub fn new(
        title: impl Into<String>,
        scene_toml: impl Into<String>,
        background: [f32; 4],
        runs: Vec<Run>,
    ) -> Result<Self> {
        let all = (0..runs.len())
            .flat_map(|a| (a + 1..runs.len()).map(move |b| [a, b]))
            .collect();
        Self::of_pairs(title, scene_toml, background, runs, all)
    }

    /// Compares runs by pairs of their indices.
    ///
    /// # Errors
    /// As [`Self::new`]; a pair with an index out of range.
    pub fn of_pairs(
        title: impl Into<String>,
        scene_toml: impl Into<String>,
        background: [f32; 4],
        runs: Vec<Run>,
        pairs: Vec<[usize; 2]>,
    ) -> Result<Self> {
        if runs.is_empty() {
            return Err(Error::value(
                "runs",
                "there are none; a comparison needs at least one picture",
            ));
        }
        let mut names = HashSet::new();
        if let Some(twice) = runs.iter().find(|run| !names.insert(&run.name)) {
            return Err(Error::value(
                "runs",
                format!("two are called \"{}\"; give each a name of its own", twice.name),
            ));
        }
        let compared = |[a, b]: [usize; 2]| match (runs.get(a), runs.get(b)) {
            (Some(first), Some(second)) => Ok(RunPair {
                a,
                b,
                difference: difference(&first.picture, &second.picture)?,
            }),
            _ => Err(Error::value(
                "pairs",
                format!("runs {a} and {b} do not both exist; there are {}", runs.len()),
            )),
        };
        let pairs = pairs.into_iter().map(compared).collect::<Result<_>>()?;
        Ok(Self {
            title: title.into(),
            scene_toml: scene_toml.into(),
            runs,
            pairs,
            background,
            amplify: AMPLIFY,
            protocol: None,
        })
    }

    /// The common size of all pictures; none if they differ.
    pub(super) fn size(&self) -> Option<[u32; 2]> {
        let size = |run: &Run| [run.picture.width, run.picture.height];
        let first = size(self.runs.first()?);
        self.runs.iter().all(|run| size(run) == first).then_some(first)
    }

    /// Names of all stages of all runs, in order of appearance.
    pub(super) fn stage_names(&self) -> Vec<&str> {
        let mut seen = HashSet::new();
        self.runs
            .iter()
            .flat_map(|run| &run.stages)
            .map(|(name, _)| name.as_str())
            .filter(|name| seen.insert(*name))
            .collect()
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::compare::run::{Memory, Times, ViewKey};
    use crate::picture::{Picture, RenderStats};
    use crate::scene::Mode;

    /// A run of one colour.
    pub fn run(name: &str, color: [f32; 4]) -> Run {
        Run {
            name: name.to_owned(),
            picture: Picture {
                width: 4,
                height: 3,
                pixels: vec![color; 12],
            },
            milliseconds: Times {
                median: 12.5,
                min: 12.0,
                max: 14.0,
            },
            rendering: Times {
                median: 10.0,
                min: 9.0,
                max: 11.0,
            },
            repetitions: 3,
            warm_up: None,
            shown: ViewKey {
                camera: "anterior".to_owned(),
                size: [4, 3],
                surface: false,
            },
            mode: Mode::Slice,
            memory: Memory {
                volume_bytes: 64,
                gradient_bytes: 0,
                map_bytes: 0,
                surface_bytes: 0,
                peak_bytes: None,
            },
            error: None,
            is_reference: false,
            stages: vec![("maps".to_owned(), 2.0), ("render".to_owned(), 10.0)],
            stats: Some(RenderStats {
                samples_taken: 1_234_567,
                samples_skipped: 2,
                samples_terminated: 3,
            }),
            backend: "cpu".to_owned(),
            method: Default::default(),
            step: 0.5,
            notices: Vec::new(),
        }
    }

    #[test]
    fn what_is_no_comparison_is_an_error() {
        assert!(Report::new("", "", [0.0; 4], Vec::new()).is_err());
        assert!(Report::new("", "", [0.0; 4], vec![run("a", [0.0; 4]), run("a", [0.0; 4])]).is_err());
        let mut larger = run("b", [0.0; 4]);
        larger.picture = Picture {
            width: 4,
            height: 4,
            pixels: vec![[0.0; 4]; 16],
        };
        assert!(Report::new("", "", [0.0; 4], vec![run("a", [0.0; 4]), larger]).is_err());
    }
}
