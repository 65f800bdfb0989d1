//! Renders a scene and judges the result.

#[cfg(feature = "gpu")]
use crate::metrics::{STEP, difference};
#[cfg(feature = "gpu")]
use incise::Watch;
use incise::picture::{Picture, Rendered};
#[cfg(feature = "gpu")]
use incise::prepare::PrepareOptions;
use incise::prepare::{Assets, Prepared};
use incise::scene::Scene;
use incise::{Result, cpu};
use std::path::Path;

/// The outcome of a scene.
pub(super) enum Outcome {
    Picture {
        assets: Box<Assets>,
        scene: Box<Scene>,
        rendered: Rendered,
    },
    Refused(String),
}

/// Renders a scene on the CPU.
pub(super) fn run(text: &str, folder: &Path) -> Outcome {
    let attempt = || -> Result<Outcome> {
        let mut scene = Scene::from_toml(text).map_err(|problem| incise::Error::value("scene", problem))?;
        scene.folder = folder.to_owned();
        let assets = Assets::load(&scene)?;
        let prepared = Prepared::new(&scene, &assets)?;
        let rendered = cpu::render(&prepared);
        drop(prepared);
        Ok(Outcome::Picture {
            assets: Box::new(assets),
            scene: Box::new(scene),
            rendered,
        })
    };
    attempt().unwrap_or_else(|error| Outcome::Refused(error.printable().to_string()))
}

/// What is wrong with an outcome; none if nothing is.
pub(super) fn complaint(outcome: &Outcome) -> Option<String> {
    match outcome {
        Outcome::Refused(message) if message.trim().is_empty() || message.trim().lines().count() != 1 => {
            Some(format!("the message is {message:?}"))
        }
        Outcome::Refused(message)
            if message.contains("Texts(") || message.contains("Number(") || message.contains("Some(") =>
        {
            Some(format!("the message speaks of the program's insides: {message}"))
        }
        Outcome::Refused(_) => None,
        Outcome::Picture { rendered, .. } => {
            let picture: &Picture = &rendered.picture;
            if let Some(bad) = picture
                .pixels
                .iter()
                .find(|p| !p.iter().all(|v| v.is_finite() && (-0.01..=1.01).contains(v)))
            {
                return Some(format!("a pixel is {bad:?}"));
            }
            (picture.is_blank() && rendered.notices.is_empty())
                .then(|| "the picture is empty, and nothing is said".to_owned())
        }
    }
}

/// Compares the GPU's picture with the CPU's; none without a GPU.
#[cfg(feature = "gpu")]
pub(super) fn on_a_gpu(
    scene: &Scene,
    assets: &Assets,
    picture: &Picture,
) -> Option<std::result::Result<(), String>> {
    if !crate::parity::has_renderer() {
        return None;
    }
    let rendered = crate::parity::with_renderer(|renderer| {
        let prepared = Prepared::with(scene, assets, &PrepareOptions::on(renderer))?;
        renderer.render(&prepared, false, &Watch::NONE)
    });
    let rendered = match rendered {
        Ok(rendered) => rendered,
        Err(error) => return Some(Err(format!("the GPU says: {error}"))),
    };
    let difference = match difference(picture, &rendered.picture) {
        Ok(difference) => difference,
        // Both are empty.
        Err(_) if picture.is_blank() && rendered.picture.is_blank() => return Some(Ok(())),
        Err(problem) => return Some(Err(problem)),
    };
    let agrees = difference.mean <= STEP && difference.within_4 >= 0.99;
    Some(if agrees {
        Ok(())
    } else {
        Err(format!(
            "the GPU's picture differs: mean {:.2}/255, {:.2} % within 4/255",
            difference.mean / STEP,
            100.0 * difference.within_4
        ))
    })
}

#[cfg(not(feature = "gpu"))]
pub(super) fn on_a_gpu(_: &Scene, _: &Assets, _: &Picture) -> Option<std::result::Result<(), String>> {
    None
}
