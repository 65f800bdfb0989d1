//! Requests to the worker: pictures of the 3D view and of the slices, and what lies under a
//! position.

use super::projector::Projector;
use super::state::shown::PictureRequest;
use super::state::slice_paint::SliceStyle;
use super::state::slices::SliceRequest;
use super::state::tool::Tool;
use super::state::view::COARSE_MS;
use super::state::worker::{Job, JobKind, JobTarget, ProbePurpose, ProbeRequest};
use super::state::{Workstation, history};
use crate::cpu::section::SectionPlane;
use crate::engine::Quality;
use crate::scene::Scene;
use eframe::egui;
use glam::Vec3;
use std::sync::Arc;
use std::time::Instant;

/// A fine picture is requested after this time without a change, seconds.
const REST: f64 = 0.12;

impl Workstation {
    /// The scene as the 3D view shows it, at the view's size.
    pub fn scene_of_view(&self) -> Option<Scene> {
        let doc = self.doc.as_ref()?;
        let mut scene = doc.shown(self.shows_undeformed());
        scene.render.size = self.view.size();
        Some(scene)
    }

    /// The projector for the displayed picture's camera.
    pub fn projector(&self) -> Option<Projector> {
        self.view.projector()
    }

    /// Requests new pictures after a change.
    pub fn refresh_view(&mut self, ctx: &egui::Context) {
        let Some(doc) = &self.doc else { return };
        if self.view.rect.width() < 8.0 || self.view.rect.height() < 8.0 {
            return;
        }
        let assets = doc.assets.clone();
        let Some(wanted) = self.wanted_picture() else {
            return;
        };
        let wanted = match &self.view.requested {
            Some(requested) if requested.is(&wanted) => requested.clone(),
            _ => {
                self.changed(&wanted);
                wanted
            }
        };
        let current = self.view.is_current();
        self.view.delay.note(current && self.view.delay.failure.is_none());
        let waits =
            !self.view.is_fine && self.view.fine_serial.is_none() && self.view.delay.failure.is_none();
        let rested = self.view.changed_at.elapsed().as_secs_f64() >= REST;
        let at_once = self.view.fine_ms <= COARSE_MS;
        let held = ctx.input(|i| i.pointer.any_down()) && !at_once;
        if waits && !held && (at_once || (rested && !self.view.coarse_open)) {
            let serial = self.submit(
                JobTarget::Fine,
                wanted.scene.clone(),
                assets,
                JobKind::Picture {
                    counting: false,
                    with_pixels: false,
                    quality: Quality::Full,
                },
            );
            self.view.fine_serial = Some(serial);
            self.view.open.push((serial, wanted));
        } else if waits {
            ctx.request_repaint_after_secs(REST as f32);
        }
    }

    /// What the 3D view should show.
    fn wanted_picture(&self) -> Option<PictureRequest> {
        Some(PictureRequest {
            scene: Arc::new(self.scene_of_view()?),
            assets: self.doc.as_ref()?.assets.clone(),
            undeformed: self.shows_undeformed(),
        })
    }

    /// Handles a failed job of the 3D view. The scene may have been mended since it was requested.
    pub(super) fn picture_failed(&mut self, target: JobTarget, serial: u64, problem: &str) {
        self.view.failed(target, serial, problem);
        let is_wanted = self
            .wanted_picture()
            .zip(self.view.requested.as_ref())
            .is_some_and(|(wanted, requested)| wanted.is(requested));
        if !is_wanted {
            self.view.delay.failure = None;
        }
    }

    /// Handles a change of the picture to show.
    pub(super) fn changed(&mut self, wanted: &PictureRequest) {
        self.view.requested = Some(wanted.clone());
        self.view.delay.failure = None;
        self.view.changed_at = Instant::now();
        self.view.is_fine = false;
        self.view.fine_serial = None;
        self.worker.drop_jobs(|t| t == JobTarget::Fine);
        // If fine pictures are fast enough, coarse ones are not needed.
        if self.view.fine_ms > COARSE_MS {
            let quality = Quality::Draft {
                scale: self.view.scale,
            };
            self.view.coarse_open = true;
            let serial = self.submit(
                JobTarget::Coarse,
                wanted.scene.clone(),
                wanted.assets.clone(),
                JobKind::Picture {
                    counting: false,
                    with_pixels: false,
                    quality,
                },
            );
            self.view.open.push((serial, wanted.clone()));
        }
    }

    /// Submits a job to the worker; returns its number.
    pub fn submit(
        &mut self,
        target: JobTarget,
        scene: Arc<Scene>,
        assets: Arc<crate::prepare::Assets>,
        what: JobKind,
    ) -> u64 {
        self.serial += 1;
        self.worker.submit(Job {
            target,
            serial: self.serial,
            scene,
            assets,
            what,
        });
        self.serial
    }

    /// Requests the point under a position of the view.
    pub fn probe(&mut self, at: [f32; 2], purpose: ProbePurpose) {
        let Some(picture) = &self.view.picture else { return };
        let PictureRequest { scene, assets, .. } = picture.of.clone();
        // A stroke is drawn on the scene as it was when the stroke began.
        let scene = match (&purpose, &self.stroke_scene) {
            (ProbePurpose::Brush { .. }, Some(frozen)) if frozen.camera == scene.camera => frozen.clone(),
            (ProbePurpose::Brush { .. }, Some(frozen)) => Arc::new(Scene {
                camera: scene.camera.clone(),
                ..(**frozen).clone()
            }),
            _ => scene,
        };
        self.prober.ask(ProbeRequest {
            scene,
            assets,
            at,
            purpose,
        });
    }

    pub(super) fn request_slice(&mut self, pane: usize, plane: SectionPlane, style: SliceStyle) {
        let Some(doc) = &self.doc else { return };
        let assets = doc.assets.clone();
        let scene = sliced(&doc.shown(self.shows_undeformed()));
        let shared = match &self.slices.scene {
            Some(cached) if **cached == scene => cached.clone(),
            _ => {
                let shared = Arc::new(scene);
                self.slices.scene = Some(shared.clone());
                shared
            }
        };
        let requested = SliceRequest {
            scene: shared.clone(),
            assets: assets.clone(),
            plane,
            style,
        };
        if self.slices.panes[pane]
            .requested
            .as_ref()
            .is_none_or(|a| !a.is(&requested))
        {
            let serial = self.submit(
                JobTarget::Slice(pane),
                shared,
                assets,
                JobKind::Slice(plane, style),
            );
            let state = &mut self.slices.panes[pane];
            state.open.push((serial, requested.clone()));
            state.requested = Some(requested);
            state.delay.failure = None;
        }
    }

    pub(super) fn click_slice(&mut self, at: Vec3, n: usize, source: bool) {
        let from = if source {
            Some(at)
        } else {
            self.slices.source_of(n, at)
        };
        match self.tool {
            Tool::Measure(_) | Tool::Probe => {
                if let Some(from) = from {
                    self.take_point(at, from);
                }
            }
            Tool::Place(kind) if !source => self.place(kind.0, Some(at), None),
            _ if self.tool.brush().is_some() && !source => {
                self.begin_stroke();
                self.extend_stroke(at);
                self.end_stroke();
            }
            _ if !source => self.slices.cursor = Some(self.clamped(at)),
            _ => {}
        }
    }

    pub(super) fn clamped(&self, p: Vec3) -> Vec3 {
        self.doc
            .as_ref()
            .map_or(p, |d| p.clamp(d.bounds().min, d.bounds().max))
    }
}

/// The scene reduced to what slices depend on; in particular without the camera.
fn sliced(scene: &Scene) -> Scene {
    let mut plain = history::without_camera(scene);
    // Deformations locked to the view depend on the camera.
    if scene
        .deformation
        .iter()
        .any(|d| crate::deform::kinds::kind(&d.kind).is_ok_and(|k| k.locked_to_view))
    {
        plain.camera = scene.camera.clone();
    }
    plain.render = crate::scene::RenderSettings {
        step: 1.0,
        exact_cuts: scene.render.exact_cuts,
        precompose: scene.render.precompose,
        ..Default::default()
    };
    plain.transfer = Default::default();
    plain.light = Default::default();
    plain.measure.clear();
    plain
}
