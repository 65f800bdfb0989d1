//! A workstation for tests, and a user's input to it.

use eframe::egui::{self, Key, Modifiers, PointerButton, Pos2, Rect, vec2};
use egui_kittest::Harness;
use egui_kittest::kittest::Queryable;
use incise::cpu;
use incise::engine::Backend;
use incise::gui::gizmos::{Gizmo, Handle, kind_of};
use incise::gui::state::action::Action;
use incise::gui::state::files::FilePurpose;
use incise::gui::state::log::LogLevel;
use incise::gui::{Options, Workstation};
use incise::picture::Picture;
use incise::prepare::Prepared;
use incise::scene::Scene;
use std::path::Path;
use std::time::{Duration, Instant};
use tempfile::TempDir;

/// Renders nothing: the default renderer retains every texture of the run until a picture is
/// requested.
struct NoPictures;

impl egui_kittest::TestRenderer for NoPictures {
    fn handle_delta(&mut self, _delta: &mut egui::TexturesDelta) {}
}

/// A workstation in a virtual window of 1280 x 800.
pub(super) struct Bench {
    pub(super) harness: Harness<'static, Workstation>,
    pub(super) folder: TempDir,
}

/// A window at 30 frames per second with its settings in a folder.
pub(super) fn workstation(
    folder: &Path,
    file: Option<&Path>,
    backend: Backend,
) -> Harness<'static, Workstation> {
    let options = Options {
        file: file.map(Path::to_owned),
        folder: Some(folder.to_owned()),
        backend: Some(backend),
    };
    Harness::builder()
        .with_size(vec2(1280.0, 800.0))
        .with_step_dt(1.0 / 30.0)
        .renderer(NoPictures)
        .build_eframe(|cc| Workstation::new(&cc.egui_ctx, options))
}

impl Bench {
    pub(super) fn empty() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let harness = workstation(&folder.path().join("home"), None, Backend::Cpu);
        Self { harness, folder }
    }

    pub(super) fn open(file: &str) -> Self {
        let folder = tempfile::tempdir().unwrap();
        Self::open_in(folder, Path::new(file))
    }

    pub(super) fn open_in(folder: TempDir, file: &Path) -> Self {
        let harness = workstation(&folder.path().join("home"), Some(file), Backend::Cpu);
        let mut bench = Self { harness, folder };
        bench.settle();
        assert!(
            bench.app().doc.is_some(),
            "{} did not open: {}",
            file.display(),
            bench.app().log.text()
        );
        bench
    }

    pub(super) fn app(&mut self) -> &mut Workstation {
        self.harness.state_mut()
    }

    pub(super) fn scene(&mut self) -> Scene {
        self.app().doc.as_ref().unwrap().scene.clone()
    }

    pub(super) fn ctx(&self) -> egui::Context {
        self.harness.ctx.clone()
    }

    pub(super) fn step(&mut self) {
        self.harness.step();
    }

    /// Runs frames until no work is in progress.
    pub(super) fn settle(&mut self) {
        let start = Instant::now();
        for n in 0.. {
            self.step();
            if n > 3 && !self.app().is_busy() {
                break;
            }
            assert!(
                start.elapsed() < Duration::from_secs(90),
                "still busy: {}",
                self.app().log.text()
            );
            std::thread::sleep(Duration::from_millis(3));
        }
        self.step();
    }

    pub(super) fn until(&mut self, what: &str, done: impl Fn(&mut Workstation) -> bool) {
        let start = Instant::now();
        while !done(self.app()) {
            self.step();
            std::thread::sleep(Duration::from_millis(3));
            assert!(
                start.elapsed() < Duration::from_secs(90),
                "{what}: {}",
                self.app().log.text()
            );
        }
    }

    pub(super) fn click(&mut self, label: &str) {
        self.harness.get_by_label(label).click();
        self.step();
        self.step();
    }

    pub(super) fn key(&mut self, modifiers: Modifiers, key: Key) {
        self.harness.key_press_modifiers(modifiers, key);
        self.step();
        self.step();
    }

    pub(super) fn perform(&mut self, action: Action) {
        let ctx = self.ctx();
        self.app().perform(&ctx, action);
        self.step();
    }

    pub(super) fn chosen(&mut self, path: &Path, purpose: FilePurpose) {
        let ctx = self.ctx();
        self.app().chosen(&ctx, path, purpose);
        self.settle();
    }

    pub(super) fn rect(&self, label: &str) -> Rect {
        self.harness.get_by_label(label).rect()
    }

    /// Presses at the first place, moves through the others and releases.
    pub(super) fn drag(&mut self, button: PointerButton, modifiers: Modifiers, places: &[Pos2]) {
        let press = |pos, pressed| egui::Event::PointerButton {
            pos,
            button,
            pressed,
            modifiers,
        };
        let mut events = vec![
            egui::Event::ModifiersChanged(modifiers),
            egui::Event::PointerMoved(places[0]),
            press(places[0], true),
        ];
        for pair in places.windows(2) {
            events.extend(
                (1..=4).map(|n| egui::Event::PointerMoved(pair[0] + (pair[1] - pair[0]) * (n as f32 / 4.0))),
            );
        }
        events.extend([
            press(places[places.len() - 1], false),
            egui::Event::ModifiersChanged(Modifiers::NONE),
        ]);
        for event in events {
            self.harness.event(event);
            self.step();
        }
        self.step();
    }

    pub(super) fn click_at(&mut self, pos: Pos2) {
        self.drag(PointerButton::Primary, Modifiers::NONE, &[pos]);
    }

    /// The scene as the view shows it, rendered at a small size by the library.
    pub(super) fn picture(&mut self) -> Picture {
        let mut scene = self.app().scene_of_view().unwrap();
        let [w, h] = scene.render.size;
        scene.render.size = [w / 4, h / 4];
        let assets = self.app().doc.as_ref().unwrap().assets.clone();
        cpu::render(&Prepared::new(&scene, &assets).unwrap()).picture
    }

    pub(super) fn has_error(&mut self, text: &str) -> bool {
        self.app()
            .log
            .entries()
            .iter()
            .any(|e| e.level == LogLevel::Error && e.text.contains(text))
    }

    pub(super) fn no_errors(&mut self) {
        let text = self.app().log.text();
        assert!(
            !self
                .app()
                .log
                .entries()
                .iter()
                .any(|e| e.level == LogLevel::Error),
            "{text}"
        );
    }

    /// The screen position of a handle of the selected deformation.
    pub(super) fn handle(&mut self, wanted: Handle) -> Pos2 {
        let app = self.app();
        let projector = app.projector().unwrap();
        let doc = app.doc.as_ref().unwrap();
        let d = &doc.scene.deformation[doc.deformation_index().unwrap()];
        let gizmo = Gizmo {
            projector,
            kind: kind_of(d).unwrap(),
            deformation: d,
            scene_box: doc.bounds(),
            mode: app.view.gizmo,
        };
        let at = gizmo.handles().into_iter().find(|(h, _)| *h == wanted).unwrap().1;
        projector.screen(at).unwrap()
    }
}
