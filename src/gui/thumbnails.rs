//! Thumbnails of presets and kinds, rendered while the view is at rest.

use super::state::Workstation;
use super::state::worker::{JobKind, JobTarget};
use crate::deform::kinds;
use crate::engine::Quality;
use crate::scene::{Scene, example};
use crate::transfer::{TransferSettings, list as presets};
use std::sync::Arc;

/// Edge of a thumbnail, pixels.
const THUMBNAIL: u32 = 112;

impl Workstation {
    /// Requests thumbnails once the view is at rest.
    pub(super) fn refresh_thumbnails(&mut self) {
        let Some(doc) = &self.doc else { return };
        if !self.view.is_fine || !doc.assets.has_volume {
            return;
        }
        let key = (
            Arc::as_ptr(&doc.assets) as usize,
            doc.scene.volume_name().to_owned(),
        );
        if self.thumbnails.requested_key.as_ref() != Some(&key) {
            let (presets, kinds) = (self.thumbnails.shows_presets, self.thumbnails.shows_kinds);
            self.thumbnails.forget();
            self.thumbnails.requested_key = Some(key);
            (self.thumbnails.shows_presets, self.thumbnails.shows_kinds) = (presets, kinds);
        }
        let mut jobs = Vec::new();
        let assets = doc.assets.clone();
        let mut plain = Scene {
            deformation: Vec::new(),
            mesh: Vec::new(),
            measure: Vec::new(),
            ..doc.scene.clone()
        };
        plain.render = crate::scene::RenderSettings {
            size: [THUMBNAIL; 2],
            step: 2.0,
            ..Default::default()
        };
        plain.camera = crate::scene::Camera {
            view: "35,20".parse().unwrap_or(plain.camera.view),
            ..Default::default()
        };
        if self.thumbnails.shows_presets {
            for (n, preset) in presets().enumerate() {
                if self.thumbnails.presets.contains_key(&n)
                    || self.thumbnails.open.contains(&JobTarget::Preset(n))
                {
                    continue;
                }
                let mut scene = plain.clone();
                scene.transfer = TransferSettings {
                    preset: Some(preset.name.into()),
                    ..Default::default()
                };
                jobs.push((JobTarget::Preset(n), scene));
            }
        }
        if self.thumbnails.shows_kinds {
            let bounds = assets.volume.bounds_in_world();
            for (n, kind) in kinds::list().enumerate() {
                if self.thumbnails.kinds.contains_key(&n)
                    || self.thumbnails.open.contains(&JobTarget::Kind(n))
                {
                    continue;
                }
                let mut scene = plain.clone();
                let shown = example::of_kind(kind, scene.volume_name(), THUMBNAIL, &bounds);
                scene.deformation = shown.deformation;
                scene.camera = shown.camera;
                scene.transfer = doc.scene.transfer.clone();
                jobs.push((JobTarget::Kind(n), scene));
            }
        }
        for (target, scene) in jobs {
            self.thumbnails.open.push(target);
            self.submit(
                target,
                Arc::new(scene),
                assets.clone(),
                JobKind::Picture {
                    counting: false,
                    with_pixels: false,
                    quality: Quality::Full,
                },
            );
        }
    }
}
