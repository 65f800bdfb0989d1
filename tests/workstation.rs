//! User-level tests of the workstation: widgets are found by their labels, views by their
//! rectangles, and results are checked in the scene, in files and in pictures.

use eframe::egui::{self, Key, Modifiers, PointerButton, Pos2, Rect, pos2, vec2};
use egui_kittest::Harness;
use egui_kittest::kittest::Queryable;
use incise::cpu;
use incise::engine::Backend;
use incise::gui::gizmos::{Gizmo, Handle, Mode as GizmoMode, kind_of};
use incise::gui::state::action::Action;
use incise::gui::state::document::Selection;
use incise::gui::state::files::{ClipForm, ClipMotion, Dialog, FilePurpose, NextStep, PictureForm};
use incise::gui::state::slice_paint::Overlay;
use incise::gui::state::slices::Space;
use incise::gui::state::tool::Tool;
use incise::gui::{Options, Workstation};
use incise::picture::Picture;
use incise::prepare::Prepared;
use incise::scene::measure::MeasureKind;
use incise::scene::{Deformation, Mode, Scene};
use incise::volume::Volume;
use proptest::prelude::Rng as _;
use proptest::test_runner::{RngAlgorithm, TestRng};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

mod bench;
mod crash;
mod monkey;
mod pictures;
mod tools;

use bench::{Bench, workstation};
pub use crash::*;
pub use monkey::*;
pub use pictures::*;
pub use tools::*;

/// A head that loads quickly.
const HEAD: &str = "phantom:head-ct:size=48";

fn mean_difference(a: &Picture, b: &Picture) -> f64 {
    assert_eq!((a.width, a.height), (b.width, b.height));
    let sum: f64 = a
        .pixels
        .iter()
        .zip(&b.pixels)
        .flat_map(|(p, q)| (0..4).map(|c| f64::from((p[c] - q[c]).abs())))
        .sum();
    255.0 * sum / (4 * a.pixels.len()) as f64
}

fn opaque(picture: &Picture) -> usize {
    picture.pixels.iter().filter(|p| p[3] > 0.5).count()
}

pub fn every_panel_is_there() {
    let mut bench = Bench::empty();
    bench.step();
    for label in [
        "Open",
        "Open a file",
        "Open a folder",
        "Open the bundled head",
        "A quadrant removed",
        "Split into slabs",
    ] {
        bench.harness.get_by_label(label);
    }
    let mut bench = Bench::open(HEAD);
    for label in [
        "Menu",
        "Open",
        "Save",
        "Orbit",
        "Probe",
        "Measure",
        "Plane",
        "Box",
        "Knife",
        "Wedge",
        "Lasso",
        "Peel",
        "Pull",
        "Twist",
        "More deformations",
        "Undo",
        "Redo",
        "Slice",
        "Ray",
        "Surface",
        "Compare",
        "3D view",
        "Axial view",
        "Coronal view",
        "Sagittal view",
        "Picture and light",
        "Backend",
        "Slice display",
        "Transfer function curve",
    ] {
        assert!(
            bench.harness.query_all_by_label(label).next().is_some(),
            "no \"{label}\""
        );
    }
    // All views are inside the window and large enough: at least two thirds of it show anatomy.
    let anatomy: f32 = ["3D view", "Axial view", "Coronal view", "Sagittal view"]
        .iter()
        .map(|l| bench.rect(l))
        .map(|r| r.area())
        .sum();
    println!(
        "{:.0} % of the window is anatomy",
        100.0 * anatomy / (1280.0 * 800.0)
    );
    assert!(anatomy / (1280.0 * 800.0) > 0.57);
    for (tab, inside) in [
        ("Maps", "New painted map"),
        ("Measure", "Distance"),
        ("Log", "Copy all"),
        ("Inspector", "Toggle perspective/orthographic"),
    ] {
        let app = bench.app();
        let panel = incise::gui::state::layout::Panel::ALL
            .into_iter()
            .find(|p| p.title() == tab)
            .unwrap();
        app.show_panel(panel);
        bench.step();
        bench.step();
        if tab != "Inspector" {
            assert!(
                bench.harness.query_all_by_label(inside).next().is_some(),
                "no \"{inside}\" in {tab}"
            );
        }
    }
    for layout in ["Layout: 3D only", "Layout: compare", "Layout: four-up"] {
        let action = bench
            .app()
            .entries
            .iter()
            .find(|e| e.label == layout)
            .unwrap()
            .action;
        bench.perform(action);
        bench.settle();
    }
    bench.perform(Action::ToggleTheme);
    bench.settle();
    bench.no_errors();
}

pub fn a_peel_is_placed_undone_saved_and_opened_again() {
    let mut bench = Bench::open(HEAD);
    let before = bench.picture();
    // A preset, selected by its picture.
    bench.app().select(Selection::Volume);
    let preset = bench.harness.get_by_label("ct-skin");
    preset.scroll_to_me();
    bench.settle();
    bench.click("ct-skin");
    bench.settle();
    assert_eq!(bench.scene().transfer.preset.as_deref(), Some("ct-skin"));
    // P, then a click on the head.
    bench.key(Modifiers::NONE, Key::P);
    assert!(matches!(bench.app().tool, Tool::Place(_)));
    let view = bench.rect("3D view");
    bench.click_at(view.center() - vec2(10.0, 60.0));
    bench.settle();
    let scene = bench.scene();
    assert_eq!(scene.deformation.len(), 1, "{}", bench.app().log.text());
    let peel = &scene.deformation[0];
    assert_eq!(
        (peel.kind.as_str(), bench.app().tool, peel.progress),
        ("peel", Tool::Navigate, Some(0.5))
    );
    // Its axis points out of the surface, towards the viewer.
    let turn = incise::gui::state::tool::matrix_of(peel.rotate.unwrap().into());
    let forward = bench.app().projector().unwrap().frame.forward;
    assert!((turn * glam::Vec3::Z).dot(forward) < -0.3, "{turn}");
    // Dragging the handle opens it.
    let at = bench.handle(Handle::Progress);
    let fully = {
        let mut scene = bench.scene();
        scene.deformation[0].progress = Some(0.9);
        let app = bench.app();
        app.doc.as_mut().unwrap().scene = scene;
        let to = bench.handle(Handle::Progress);
        bench.app().doc.as_mut().unwrap().scene.deformation[0].progress = Some(0.5);
        to
    };
    bench.step();
    bench.drag(
        PointerButton::Primary,
        Modifiers::NONE,
        &[at, at.lerp(fully, 0.5), fully],
    );
    bench.settle();
    let opened = bench.scene().deformation[0].progress.unwrap();
    assert!((opened - 0.9).abs() < 0.06, "{opened}");
    let shown = bench.picture();
    assert!(mean_difference(&before, &shown) > 1.0);
    // Three undo steps, then redo.
    for expected in [Some(0.5), None, None] {
        bench.key(Modifiers::COMMAND, Key::Z);
        assert_eq!(
            bench.scene().deformation.first().and_then(|d| d.progress),
            expected
        );
    }
    assert_eq!(bench.scene().transfer.preset, None);
    for _ in 0..3 {
        bench.key(Modifiers::COMMAND | Modifiers::SHIFT, Key::Z);
    }
    assert_eq!(bench.scene().deformation[0].progress, Some(opened));
    assert_eq!(bench.picture(), shown);
    // Saved through the file dialog's result, and opened in another window.
    let file = bench.folder.path().join("work.toml");
    bench.chosen(&file, FilePurpose::Save(None));
    assert!(!bench.app().doc.as_ref().unwrap().is_changed());
    bench.no_errors();
    let mut again = Bench::open_in(tempfile::tempdir().unwrap(), &file);
    assert_eq!(again.scene().deformation, bench.scene().deformation);
    assert_eq!(again.picture(), shown, "the same picture");
}

pub fn lasso_cuts_and_restores() {
    let mut bench = Bench::open(HEAD);
    let before = bench.picture();
    let view = bench.rect("3D view");
    let c = view.center() - vec2(0.0, 40.0);
    let outline: Vec<Pos2> = [
        (-60.0, -50.0),
        (60.0, -50.0),
        (60.0, 50.0),
        (-60.0, 50.0),
        (-60.0, -40.0),
    ]
    .iter()
    .map(|d| c + vec2(d.0, d.1))
    .collect();
    bench.key(Modifiers::NONE, Key::L);
    bench.drag(PointerButton::Primary, Modifiers::NONE, &outline);
    bench.settle();
    assert_eq!(bench.scene().deformation.len(), 1, "{}", bench.app().log.text());
    let cut = bench.picture();
    // The hole has the size of the outline, in pixels of a quarter of the view's resolution.
    let lost = opaque(&before) as f32 - opaque(&cut) as f32;
    assert!(
        (lost / (120.0 * 100.0 / 16.0) - 1.0).abs() < 0.15,
        "{lost} pixels of {}",
        120.0 * 100.0 / 16.0
    );
    // The inside of the outline is removed: its centre is transparent.
    let (x, y) = (
        (c.x - view.left()) / view.width(),
        (c.y - view.top()) / view.height(),
    );
    let pixel =
        cut.pixels[(y * cut.height as f32) as usize * cut.width as usize + (x * cut.width as f32) as usize];
    assert_eq!(pixel[3], 0.0);
    // The cut stays in place as the camera turns.
    let stroke = bench.scene().deformation[0].clone();
    bench.app().orbit(80.0, 0.0);
    bench.settle();
    assert_eq!(bench.scene().deformation[0], stroke);
    bench.app().orbit(-80.0, 0.0);
    bench.settle();
    bench.key(Modifiers::SHIFT, Key::L);
    let wider: Vec<Pos2> = outline.iter().map(|p| c + (*p - c) * 1.2).collect();
    bench.drag(PointerButton::Primary, Modifiers::NONE, &wider);
    bench.settle();
    assert_eq!(bench.scene().deformation.len(), 1, "both strokes are in one map");
    let restored = bench.picture();
    let (apart, gone) = (
        mean_difference(&before, &restored),
        mean_difference(&before, &cut),
    );
    println!("cut: {gone:.2}/255 from the whole; restored: {apart:.3}/255");
    assert!(apart < 0.02 * gone, "{apart} of {gone}");
    bench.key(Modifiers::NONE, Key::Escape);
    assert_eq!(bench.app().tool, Tool::Navigate);
    bench.no_errors();
}

pub fn renderers_are_compared_and_reported() {
    let mut bench = Bench::open(HEAD);
    bench.perform(Action::Arm(Tool::Navigate));
    let mut wedge = Deformation::new("wedge");
    wedge.rotate = Some([0.0, 0.0, -55.0]);
    bench.app().doc.as_mut().unwrap().add(wedge);
    bench.key(Modifiers::SHIFT, Key::V);
    bench.until("no comparison", |app| app.compare.is_done());
    let difference = bench.app().compare.difference.unwrap();
    println!(
        "slicing against rays: mean {:.3}, max {:.1}, PSNR {:.1} dB, SSIM {:.4}",
        difference.mean, difference.max, difference.psnr_db, difference.ssim
    );
    assert!(
        difference.mean > 0.0 && difference.psnr_db > 25.0 && difference.ssim > 0.9 && difference.ssim < 1.0
    );
    // The same renderer on both sides gives the same picture.
    bench.app().compare.sides[1] = bench.app().compare.sides[0];
    bench.step();
    bench.until("no second comparison", |app| {
        app.compare.is_done() && app.compare.difference.as_ref().is_some_and(|d| d.max == 0.0)
    });
    bench.app().compare.sides[1].mode = Mode::Raycast;
    for label in ["Swipe", "Difference", "Split"] {
        bench.click(label);
    }
    let folder = bench.folder.path().join("report");
    bench.chosen(&folder, FilePurpose::Report);
    let report: serde_json::Value =
        serde_json::from_slice(&std::fs::read(folder.join("report.json")).unwrap()).unwrap();
    assert_eq!(report["runs"].as_array().unwrap().len(), 2, "{report:#}");
    let page = std::fs::read_to_string(folder.join("index.html")).unwrap();
    assert!(
        page.contains("slicing step 1")
            && page.contains("raycast step 1")
            && page.contains("data:image/png;base64,")
    );
    bench.no_errors();
}

#[derive(Debug)]
struct Dropped(PathBuf);

impl egui::DroppedFile for Dropped {
    fn path(&self) -> &Path {
        &self.0
    }

    fn bytes(&self) -> Result<Vec<u8>, String> {
        std::fs::read(&self.0).map_err(|e| e.to_string())
    }
}

pub fn broken_files_are_told() {
    let mut bench = Bench::empty();
    let broken = bench.folder.path().join("broken.nii.gz");
    std::fs::write(&broken, b"\x1f\x8b no gzip at all").unwrap();
    let drop = |bench: &mut Bench, path: &Path| {
        bench
            .harness
            .input_mut()
            .dropped_files
            .push(std::sync::Arc::new(Dropped(path.to_owned())));
        bench.step();
        bench.settle();
    };
    drop(&mut bench, &broken);
    assert!(
        bench.app().doc.is_none() && bench.has_error("broken.nii.gz"),
        "{}",
        bench.app().log.text()
    );
    let scene = bench.folder.path().join("broken.toml");
    std::fs::write(&scene, "incise = 1\n[volume]\npath = \"phantom:ball\"\n[camra]\n").unwrap();
    drop(&mut bench, &scene);
    assert!(
        bench.has_error("did you mean \"camera\""),
        "{}",
        bench.app().log.text()
    );
    // If opening fails, the open scene stays, and a valid file still opens.
    let ctx = bench.ctx();
    bench.app().open(&ctx, Path::new(HEAD));
    bench.settle();
    let before = bench.scene();
    drop(&mut bench, &scene);
    assert_eq!(bench.scene(), before);
    // The full text of a message is in the log.
    bench.app().show_panel(incise::gui::state::layout::Panel::Log);
    bench.step();
    bench.step();
    assert!(
        bench
            .harness
            .query_all_by_label_contains("did you mean")
            .next()
            .is_some()
    );
    // A failing deformation is reported once, and the scene stays usable.
    let mut bad = Deformation::new("field");
    bad.parameters.insert("path", "no-such-field.nii.gz");
    bench.app().doc.as_mut().unwrap().add(bad);
    bench.until("the fault is not told", |app| {
        app.log.entries().iter().any(|e| e.text.contains("no-such-field"))
    });
    bench.key(Modifiers::COMMAND, Key::Z);
    bench.settle();
    assert!(bench.scene().deformation.is_empty());
}

/// A volume of n³ bytes that takes a while to read.
fn large_volume(folder: &Path, n: usize) -> PathBuf {
    use std::io::Write;
    let path = folder.join("large.nrrd");
    let mut file = std::io::BufWriter::new(std::fs::File::create(&path).unwrap());
    write!(
        file,
        "NRRD0004\ntype: uint8\ndimension: 3\nsizes: {n} {n} {n}\nspacings: 1 1 1\nencoding: gzip\n\n"
    )
    .unwrap();
    let mut zip = flate2::write::GzEncoder::new(file, flate2::Compression::fast());
    let row: Vec<u8> = (0..n).map(|i| (i * 7 % 251) as u8).collect();
    for _ in 0..n * n {
        zip.write_all(&row).unwrap();
    }
    zip.finish().unwrap().flush().unwrap();
    path
}

pub fn loading_is_cancelled() {
    let mut bench = Bench::empty();
    let path = large_volume(bench.folder.path(), 640);
    let ctx = bench.ctx();
    let start = Instant::now();
    bench.app().open(&ctx, &path);
    bench.until("no progress", |app| {
        app.loading.as_ref().is_none_or(|l| l.stage().1 > 0.02)
    });
    assert!(
        bench.app().loading.is_some(),
        "loaded before it could be cancelled"
    );
    bench.step();
    bench.click("Cancel");
    bench.until("not cancelled", |app| app.loading.is_none());
    println!("cancelled after {:.2} s", start.elapsed().as_secs_f64());
    assert!(bench.app().doc.is_none() && bench.app().log.text().contains("Cancelled"));
    // The window stays responsive.
    bench.app().open(&ctx, Path::new(HEAD));
    bench.settle();
    assert!(bench.app().doc.is_some());
}

pub fn dragging_never_waits() {
    // 256 voxels along every axis, rendered by the CPU on all cores but one.
    let mut bench = Bench::open("phantom:head-ct:size=256");
    let mut peel = Deformation::new("peel");
    peel.progress = Some(0.7);
    bench.app().doc.as_mut().unwrap().add(peel);
    bench.settle();
    bench.app().frame_ms.clear();
    let pictures = bench.app().view.pictures;
    let center = bench.rect("3D view").center() + vec2(150.0, 120.0);
    let press = |pressed, pos| egui::Event::PointerButton {
        pos,
        button: PointerButton::Primary,
        pressed,
        modifiers: Modifiers::NONE,
    };
    bench.harness.event(egui::Event::PointerMoved(center));
    bench.step();
    bench.harness.event(press(true, center));
    bench.step();
    let mut longest = 0.0f32;
    for n in 0..150 {
        let angle = n as f32 * 0.08;
        bench.harness.event(egui::Event::PointerMoved(
            center + vec2(60.0 * angle.sin(), 40.0 * angle.cos()),
        ));
        let start = Instant::now();
        bench.step();
        longest = longest.max(start.elapsed().as_secs_f32() * 1e3);
        std::thread::sleep(Duration::from_millis(12));
    }
    bench.harness.event(press(false, center));
    bench.step();
    let app = bench.app();
    let (mut frames, pictures): (Vec<f32>, u64) = (
        app.frame_ms.iter().copied().collect(),
        app.view.pictures - pictures,
    );
    frames.sort_by(f32::total_cmp);
    let (median, worst) = (frames[frames.len() / 2], frames[frames.len() - 1]);
    println!(
        "{} frames while dragging: median {median:.1} ms, longest {worst:.1} ms ({longest:.1} ms with accessibility and input); {pictures} pictures arrived",
        frames.len()
    );
    assert!(worst < 50.0, "a frame took {worst} ms");
    assert!(pictures >= 5, "only {pictures} pictures arrived during the drag");
}

/// With an adapter: a lost device is reopened, and the scene stays usable.
fn a_lost_device_is_recovered() {
    let folder = tempfile::tempdir().unwrap();
    let harness = workstation(&folder.path().join("home"), Some(Path::new(HEAD)), Backend::Gpu);
    let mut bench = Bench { harness, folder };
    bench.settle();
    assert!(
        bench.app().view.facts.device.as_ref().is_none_or(|d| d.is_gpu),
        "{:?}",
        bench.app().view.facts.device
    );
    let pictures = bench.app().view.pictures;
    bench.perform(Action::ResetGpu);
    bench.settle();
    bench.until("no picture after the loss", |app| {
        app.view.pictures > pictures && app.view.is_fine
    });
    assert!(
        bench.app().log.text().contains("incise reconnected"),
        "{}",
        bench.app().log.text()
    );
    assert!(
        bench.app().view.facts.device.as_ref().is_none_or(|d| d.is_gpu),
        "{:?}",
        bench.app().view.facts.device
    );
    bench.no_errors();
}

/// Tests that need an adapter, ignored without one.
pub fn on_a_gpu() -> Vec<libtest_mimic::Trial> {
    let missing = incise::gpu::Device::open(incise::gpu::AdapterPreference::Any).is_err();
    let test = || {
        a_lost_device_is_recovered();
        Ok(())
    };
    vec![crate::trial("workstation::a_lost_device_is_recovered", test).with_ignored_flag(missing)]
}
