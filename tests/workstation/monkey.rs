//! Random actions and input.

use super::bench::Bench;
use eframe::egui::{self, Key, Modifiers, PointerButton, Rect, pos2, vec2};
use incise::engine::Backend;
use incise::gui::state::action::{Action, ActionEntry};
use incise::gui::state::files::{Dialog, NextStep};
use incise::prepare::Assets;
use proptest::prelude::Rng as _;
use proptest::test_runner::{RngAlgorithm, TestRng};
use std::path::Path;
use std::sync::{Arc, Weak};
use std::time::{Duration, Instant};

fn resident_mib() -> f64 {
    let text = std::fs::read_to_string("/proc/self/statm").unwrap_or_default();
    let pages: f64 = text
        .split_whitespace()
        .nth(1)
        .and_then(|p| p.parse().ok())
        .unwrap_or(0.0);
    pages * 4096.0 / (1 << 20) as f64
}

/// A random number below `n`.
fn below(random: &mut TestRng, n: usize) -> usize {
    random.next_u32() as usize % n
}

/// A user who acts at random.
struct Monkey {
    bench: Bench,
    random: TestRng,
    /// Rectangle of the 3D view when the window opened.
    view: Rect,
    /// Descriptions of the last actions.
    recent: Vec<String>,
    /// Assets of the scenes that were open since memory was last measured.
    assets: Vec<Weak<Assets>>,
}

impl Monkey {
    /// Performs a random action of the menu and adds its label to the recent ones. Returns whether
    /// it did.
    fn perform_any_action(&mut self) -> bool {
        let entries = &self.bench.app().entries;
        let entry: &ActionEntry = &entries[below(&mut self.random, entries.len())];
        let (action, label) = (entry.action, entry.label.clone());
        self.recent.push(label);
        // Actions that close the window or open a file dialog are tried rarely, and then dismissed.
        let leaves = matches!(
            action,
            Action::Quit | Action::OpenFolder | Action::OpenHead | Action::Close | Action::CopyCommand
        );
        let asks = matches!(
            action,
            Action::Open
                | Action::Save
                | Action::SaveAs
                | Action::ExportVolume
                | Action::ExportField
                | Action::ExportReport
                | Action::ExportMeasures
                | Action::ExportTransfer
                | Action::ImportTransfer
        );
        if leaves || (asks && below(&mut self.random, 20) != 0) {
            return false;
        }
        let ctx = self.bench.ctx();
        self.bench.app().perform(&ctx, action);
        if asks {
            self.bench.step();
            self.bench.key(Modifiers::NONE, Key::Escape);
            self.bench.app().cancel_files();
        }
        true
    }

    /// Sends random input: a drag, a click in the 3D view, a key, or numbers as the inspector sets
    /// them. `what`, from 62 to 99, selects which.
    fn send_any_input(&mut self, what: usize) {
        if what < 74 {
            let modifiers =
                [Modifiers::NONE, Modifiers::SHIFT, Modifiers::COMMAND][below(&mut self.random, 3)];
            let button = [
                PointerButton::Primary,
                PointerButton::Middle,
                PointerButton::Secondary,
            ][below(&mut self.random, 3)];
            let mut place = || {
                pos2(
                    below(&mut self.random, 1280) as f32,
                    34.0 + below(&mut self.random, 740) as f32,
                )
            };
            let places = [place(), place()];
            self.recent
                .push(format!("drag {button:?} {modifiers:?} {places:?}"));
            let press = |pos, pressed| egui::Event::PointerButton {
                pos,
                button,
                pressed,
                modifiers,
            };
            for event in [
                egui::Event::PointerMoved(places[0]),
                press(places[0], true),
                egui::Event::PointerMoved(places[1]),
                press(places[1], false),
            ] {
                self.bench.harness.event(event);
            }
        } else if what < 84 {
            let pos = self.view.min
                + vec2(
                    below(&mut self.random, self.view.width() as usize) as f32,
                    below(&mut self.random, self.view.height() as usize) as f32,
                );
            self.recent.push(format!("click {pos:?}"));
            for pressed in [true, false] {
                self.bench.harness.event(egui::Event::PointerMoved(pos));
                self.bench.harness.event(egui::Event::PointerButton {
                    pos,
                    button: PointerButton::Primary,
                    pressed,
                    modifiers: Modifiers::NONE,
                });
            }
        } else if what < 96 {
            let key = Key::ALL[below(&mut self.random, Key::ALL.len())];
            let modifiers = [Modifiers::NONE, Modifiers::SHIFT][below(&mut self.random, 2)];
            self.recent.push(format!("key {modifiers:?} {key:?}"));
            self.bench.harness.key_press_modifiers(modifiers, key);
        } else {
            // Numbers, as the inspector sets them.
            self.recent.push("numbers".into());
            let value = [0.0, 0.3, 1.0, 5.0, -1.0][below(&mut self.random, 5)];
            if let Some(d) = self.bench.app().doc.as_mut().and_then(|d| d.deformation()) {
                d.progress = Some(value);
                d.center = Some([value * 10.0, -value, value * 3.0]);
            }
        }
    }

    /// Remembers the scene's assets, to see whether they are let go.
    fn note_assets(&mut self) {
        let Some(doc) = &self.bench.app().doc else { return };
        let assets = Arc::downgrade(&doc.assets);
        if !self.assets.last().is_some_and(|last| last.ptr_eq(&assets)) {
            self.assets.push(assets);
        }
    }

    /// Closes the scene, whose caches may hold several hundred MiB, and the GPU, whose software
    /// driver keeps what it compiles in this process; returns what remains.
    fn resident_without_scene(&mut self) -> f64 {
        let ctx = self.bench.ctx();
        // A click may have selected a GPU. It is closed when the CPU renders.
        self.bench.app().set_backend(Backend::Cpu);
        self.bench.settle();
        self.bench.app().proceed(&ctx, NextStep::Close);
        self.bench.settle();
        let assets = std::mem::take(&mut self.assets);
        self.bench.until("a closed scene is kept", |_| {
            assets.iter().all(|a| a.strong_count() == 0)
        });
        // The last owner may still be freeing it.
        let mut resident = resident_mib();
        loop {
            std::thread::sleep(Duration::from_millis(100));
            let before = std::mem::replace(&mut resident, resident_mib());
            if resident > before - 1.0 {
                return resident;
            }
        }
    }

    /// Limits the number of deformations, surfaces and measures, since memory grows with them.
    fn limit_scene(&mut self) {
        if let Some(doc) = self.bench.app().doc.as_mut() {
            if doc.scene.deformation.len() > 4 {
                doc.scene.deformation.truncate(1);
            }
            if doc.scene.mesh.len() > 1 || doc.scene.measure.len() > 6 {
                doc.scene.mesh.clear();
                doc.scene.measure.clear();
            }
            if doc.scene.deformation.iter().any(|d| {
                d.parameters
                    .0
                    .get("strokes")
                    .is_some_and(|s| format!("{s:?}").len() > 4000)
            }) {
                doc.scene.deformation.clear();
            }
        }
    }
}

pub fn a_monkey_does_no_harm() {
    let count: usize = std::env::var("INCISE_MONKEY_ACTIONS")
        .ok()
        .and_then(|n| n.parse().ok())
        .unwrap_or(20_000);
    let bench = Bench::open("phantom:head-ct:size=24");
    let random = TestRng::from_seed(RngAlgorithm::ChaCha, &[42; 32]);
    let ctx = bench.ctx();
    let view = bench.rect("3D view");
    let mut monkey = Monkey {
        bench,
        random,
        view,
        recent: Vec::new(),
        assets: Vec::new(),
    };
    let start = Instant::now();
    let mut resident = Vec::new();
    for n in 0..count {
        if n % (count / 8).max(1) == 0 {
            resident.push(monkey.resident_without_scene());
            monkey
                .bench
                .app()
                .open(&ctx, Path::new("phantom:head-ct:size=24"));
            monkey.bench.until("not opened again", |app| app.doc.is_some());
        }
        let what = below(&mut monkey.random, 100);
        if what < 62 {
            if !monkey.perform_any_action() {
                continue;
            }
        } else {
            monkey.send_any_input(what);
        }
        monkey.limit_scene();
        monkey.note_assets();
        let Monkey { bench, recent, .. } = &mut monkey;
        if recent.len() > 12 {
            recent.remove(0);
        }
        let caught = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| bench.step()));
        assert!(caught.is_ok(), "action {n} after {recent:#?}");
        assert!(
            !bench.app().log.text().contains("fault of the program"),
            "action {n} after {recent:#?}\n{}",
            bench.app().log.text()
        );
        if bench.app().doc.is_none() && bench.app().loading.is_none() {
            bench.app().dialog = None;
            bench.app().open(&ctx, Path::new("phantom:head-ct:size=24"));
            bench.until("not opened again", |app| app.doc.is_some());
        }
        if let Some(Dialog::Unsaved(_) | Dialog::Recover(_)) = bench.app().dialog {
            bench.app().dialog = None;
        }
    }
    resident.push(monkey.resident_without_scene());
    let most = |part: &[f64]| part.iter().copied().fold(0.0, f64::max);
    // What outlives every scene, such as fonts and a driver's libraries, is loaded in the first half.
    let (warm, end) = (most(&resident[..resident.len() / 2 + 1]), most(&resident));
    println!(
        "{count} actions in {:.0} s; resident MiB at each eighth: {resident:.0?}",
        start.elapsed().as_secs_f64()
    );
    assert!(end < 1.1 * warm + 32.0, "memory grew from {warm} to {end} MiB");
}
