//! Actions in the views and panels, one task after the other.

use super::*;
use egui::accesskit::Role;

pub fn slices_show_deformed_and_source() {
    let mut bench = Bench::open(HEAD);
    bench.until("no slices", |app| app.slices.are_there());
    let plain = bench.app().slices.picture(0).unwrap().section.values.clone();
    let mut cut = Deformation::new("box");
    cut.size = Some(incise::scene::Size::Cube(60.0));
    cut.placement = incise::scene::DefaultPlacement::Volume;
    bench.app().doc.as_mut().unwrap().add(cut);
    bench.settle();
    let holes = |values: &[f32]| values.iter().filter(|v| v.is_nan()).count();
    let cut = bench.app().slices.picture(0).unwrap();
    // The hole has the size of the box, in pixels.
    let mm = cut.plane.mm_per_pixel;
    let expected = (60.0 / mm).powi(2);
    let lost = (holes(&cut.section.values) - holes(&plain)) as f32;
    assert!(
        (lost / expected - 1.0).abs() < 0.05,
        "{lost} pixels, {expected} expected"
    );
    bench.app().slices.space = Space::Source;
    bench.settle();
    let source = bench.app().slices.picture(3).unwrap().section.values.clone();
    assert_eq!(holes(&source), holes(&plain));
    // Linked: the crosshair in the source is at the corresponding point.
    let mut twist = Deformation::new("twist");
    twist.parameters.insert("angle", 60.0);
    let doc = bench.app().doc.as_mut().unwrap();
    doc.scene.deformation.clear();
    doc.add(twist);
    bench.app().slices.space = Space::Linked;
    let cursor = bench.app().doc.as_ref().unwrap().bounds().center() + glam::Vec3::new(20.0, 5.0, 30.0);
    bench.app().slices.cursor = Some(cursor);
    bench.settle();
    bench.settle();
    let found = bench.app().slices.source_cursor().unwrap();
    let (scene, assets) = (bench.scene(), bench.app().doc.as_ref().unwrap().assets.clone());
    let expected = incise::prepare::Deformed::new(&scene, &assets)
        .unwrap()
        .stack
        .source_and_alpha(cursor)
        .0;
    assert!(
        found.distance(expected) < 1.5 * mm && found.distance(cursor) > 5.0,
        "{found} {expected}"
    );
    for overlay in [
        Overlay::Grid,
        Overlay::Glyphs,
        Overlay::Mask,
        Overlay::Jacobian,
        Overlay::Labels,
    ] {
        bench.app().slices.overlay = overlay;
        bench.settle();
    }
    // A drag in a slice moves the crosshair; with W held it changes window and level.
    bench.app().slices.space = Space::Deformed;
    bench.settle();
    let axial = bench.rect("Axial view");
    bench.drag(
        PointerButton::Primary,
        Modifiers::NONE,
        &[axial.center(), axial.center() + vec2(20.0, 10.0)],
    );
    assert!(bench.app().slices.cursor.unwrap().distance(cursor) > 1.0);
    bench.settle();
    let before = bench.app().slices.picture(0).unwrap().style.window;
    bench.harness.key_down(Key::W);
    bench.step();
    bench.drag(
        PointerButton::Primary,
        Modifiers::NONE,
        &[axial.center(), axial.center() + vec2(30.0, 0.0)],
    );
    bench.harness.key_up(Key::W);
    bench.settle();
    let after = bench.app().slices.picture(0).unwrap().style.window;
    assert!(
        after[1] - after[0] > before[1] - before[0],
        "{before:?} {after:?}"
    );
    assert_eq!(bench.app().tool, Tool::Navigate);
    bench.no_errors();
}

pub fn a_brush_paints_and_a_map_is_used_again() {
    let mut bench = Bench::open(HEAD);
    bench.perform(Action::Arm(Tool::BrushPush));
    let axial = bench.rect("Axial view");
    bench.drag(
        PointerButton::Primary,
        Modifiers::NONE,
        &[
            axial.center(),
            axial.center() + vec2(24.0, 0.0),
            axial.center() + vec2(48.0, 6.0),
        ],
    );
    bench.settle();
    let scene = bench.scene();
    assert_eq!(
        scene.deformation.last().map(|d| d.kind.as_str()),
        Some("brush"),
        "{}",
        bench.app().log.text()
    );
    let strokes = |scene: &Scene| {
        scene.deformation[0]
            .parameters
            .texts("strokes")
            .unwrap()
            .unwrap_or_default()
    };
    assert!(strokes(&scene).len() == 1 && strokes(&scene)[0].starts_with("push "));
    // The volume moved along: towards the patient's left on an axial slice.
    let assets = bench.app().doc.as_ref().unwrap().assets.clone();
    let deformed = incise::prepare::Deformed::new(&scene, &assets).unwrap();
    let numbers: Vec<f32> = strokes(&scene)[0]
        .split_whitespace()
        .skip(1)
        .map(|w| w.parse().unwrap())
        .collect();
    let end = glam::Vec3::from_slice(&numbers[numbers.len() - 3..]);
    let moved = end - deformed.stack.source_and_alpha(end).0;
    assert!(
        moved.x > 5.0 && moved.x > 2.0 * moved.y.abs() && moved.z.abs() < 0.5,
        "{moved}"
    );
    // One stroke is one undo step.
    bench.perform(Action::Arm(Tool::BrushCut));
    bench.drag(
        PointerButton::Primary,
        Modifiers::NONE,
        &[
            axial.center() - vec2(30.0, 0.0),
            axial.center() - vec2(30.0, 30.0),
        ],
    );
    bench.settle();
    assert_eq!(strokes(&bench.scene()).len(), 2);
    bench.key(Modifiers::COMMAND, Key::Z);
    assert_eq!(strokes(&bench.scene()).len(), 1);
    bench.key(Modifiers::COMMAND | Modifiers::SHIFT, Key::Z);
    assert_eq!(strokes(&bench.scene()).len(), 2);
    bench.key(Modifiers::NONE, Key::Escape);
    // Into the library, and onto another volume.
    bench.perform(Action::SaveMap);
    bench.step();
    bench.click("Save to library");
    bench.settle();
    let maps = bench.app().session.maps();
    assert_eq!(maps.len(), 1, "{}", bench.app().log.text());
    let ctx = bench.ctx();
    bench
        .app()
        .proceed(&ctx, NextStep::Open("phantom:ball:size=32".into()));
    bench.settle();
    bench.app().use_map(&ctx, &maps[0]);
    bench.settle();
    let scene = bench.scene();
    assert_eq!(scene.deformation[0].kind, "map");
    let assets = bench.app().doc.as_ref().unwrap().assets.clone();
    let (other, bounds) = (
        incise::prepare::Deformed::new(&scene, &assets).unwrap(),
        assets.scene_box(),
    );
    let points = (0..32_768).map(|n| {
        bounds.min
            + bounds.size() * glam::Vec3::new((n % 32) as f32, (n / 32 % 32) as f32, (n / 1024) as f32) / 31.0
    });
    let largest = points
        .map(|p| p.distance(other.stack.source_and_alpha(p).0))
        .fold(0.0, f32::max);
    assert!(largest > 2.0, "the map moves the other volume by {largest} mm");
    // A whole stack becomes one map.
    bench.app().doc.as_mut().unwrap().add(Deformation::new("twist"));
    bench.app().save_map(&ctx, "both", true);
    bench.settle();
    assert_eq!(bench.app().session.maps().len(), 2, "{}", bench.app().log.text());
    bench.no_errors();
}

pub fn the_transfer_function_is_edited() {
    let mut bench = Bench::open(HEAD);
    let curve = bench.rect("Transfer function curve");
    // A double-click adds a point, a drag moves it, undo reverts it.
    let at = curve.left_top() + vec2(curve.width() * 0.2, curve.height() * 0.3);
    for _ in 0..2 {
        bench.click_at(at);
    }
    bench.settle();
    let added = bench.scene().transfer;
    assert!(!added.points.is_empty(), "no point was added");
    bench.drag(
        PointerButton::Primary,
        Modifiers::NONE,
        &[at, at + vec2(12.0, 20.0)],
    );
    bench.settle();
    let dragged = bench.scene().transfer;
    assert_eq!(dragged.points.len(), added.points.len());
    assert_ne!(dragged.points, added.points);
    let file = bench.folder.path().join("mine.toml");
    bench.chosen(&file, FilePurpose::ExportTransfer);
    bench.key(Modifiers::COMMAND, Key::Z);
    assert_eq!(bench.scene().transfer, added);
    bench.click("Reset");
    assert!(bench.scene().transfer.points.is_empty());
    bench.chosen(&file, FilePurpose::ImportTransfer);
    assert_eq!(bench.scene().transfer, dragged);
    std::fs::write(&file, "[transfer]\npreset = \"nonsense\"\n").unwrap();
    bench.chosen(&file, FilePurpose::ImportTransfer);
    assert!(bench.has_error("nonsense") && bench.scene().transfer == dragged);
}

pub fn measures_ride_along() {
    let mut bench = Bench::open(HEAD);
    bench.key(Modifiers::NONE, Key::M);
    assert_eq!(bench.app().tool, Tool::Measure(MeasureKind::Distance));
    let view = bench.rect("3D view");
    bench.click_at(view.center() - vec2(40.0, 60.0));
    bench.settle();
    bench.click_at(view.center() + vec2(40.0, -60.0));
    bench.settle();
    bench.key(Modifiers::NONE, Key::Escape);
    let scene = bench.scene();
    assert_eq!(scene.measure.len(), 1, "{}", bench.app().log.text());
    bench.settle();
    let [a, b] = [scene.measure[0].points[0], scene.measure[0].points[1]].map(glam::Vec3::from);
    let quantity = |bench: &mut Bench, n: usize| {
        bench.app().measured[0].quantities.as_ref().unwrap()[n]
            .value
            .unwrap()
    };
    assert!((quantity(&mut bench, 0) - f64::from(a.distance(b))).abs() < 0.01);
    // After a taper, the distance in the patient is unchanged and that in the picture is not.
    let mut taper = Deformation::new("taper");
    taper.parameters.insert("factor", 0.5);
    bench.app().doc.as_mut().unwrap().add(taper);
    bench.settle();
    let (patient, picture) = (quantity(&mut bench, 0), quantity(&mut bench, 1));
    println!("{patient:.2} mm in the patient, {picture:.2} mm in the picture");
    assert!((patient - f64::from(a.distance(b))).abs() < 0.01 && (picture - patient).abs() > 0.05);
    let file = bench.folder.path().join("m.csv");
    bench.chosen(&file, FilePurpose::Measures);
    let text = std::fs::read_to_string(&file).unwrap();
    assert!(
        text.lines().count() == 3 && text.contains("Distance 1") && text.contains("mm"),
        "{text}"
    );
    bench.no_errors();
}

pub fn exports_are_written() {
    let mut bench = Bench::open(HEAD);
    let mut twist = Deformation::new("twist");
    twist.progress = Some(0.5);
    bench.app().doc.as_mut().unwrap().add(twist);
    bench.settle();
    let folder = bench.folder.path().to_owned();
    let form = PictureForm {
        size: [96, 64],
        antialias: incise::scene::Antialias::Grid(2),
        step: 1.0,
        transparent: true,
    };
    bench.chosen(&folder.join("figure.png"), FilePurpose::Picture(form));
    let picture = image::open(folder.join("figure.png")).unwrap().to_rgba8();
    assert_eq!(picture.dimensions(), (96, 64));
    assert!(
        picture.pixels().any(|p| p[3] == 0) && picture.pixels().any(|p| p[3] == 255),
        "the background is not transparent"
    );
    let form = ClipForm {
        travel: ClipMotion::Progress(0),
        range: [0.0, 1.0],
        back: false,
        frames: 4,
        rate: 10.0,
        size: [48, 32],
    };
    for name in ["clip.gif", "clip.png"] {
        bench.chosen(&folder.join(name), FilePurpose::Clip(form.clone()));
        assert!(
            folder.join(name).metadata().is_ok_and(|m| m.len() > 500),
            "{}",
            bench.app().log.text()
        );
    }
    bench.chosen(&folder.join("frames"), FilePurpose::Clip(form));
    assert_eq!(std::fs::read_dir(folder.join("frames")).unwrap().count(), 4);
    bench.chosen(&folder.join("baked.nii.gz"), FilePurpose::Bake { field: false });
    let baked: Volume = incise::volume::load::volume(
        &folder.join("baked.nii.gz"),
        &Default::default(),
        &incise::Watch::NONE,
    )
    .unwrap();
    assert_eq!(baked.size, bench.app().doc.as_ref().unwrap().assets.volume.size);
    bench.chosen(&folder.join("field.nrrd"), FilePurpose::Bake { field: true });
    assert!(folder.join("field.nrrd").exists());
    // The command line of a saved scene refers to it.
    let file = folder.join("scene.toml");
    bench.chosen(&file, FilePurpose::Save(None));
    bench.perform(Action::CopyCommand);
    let commands = bench.harness.output().platform_output.commands.clone();
    let copied = commands.iter().find_map(|c| {
        if let egui::OutputCommand::CopyText(t) = c {
            Some(t.clone())
        } else {
            None
        }
    });
    assert!(
        copied.is_some_and(|t| t.starts_with("incise render ") && t.contains("scene.toml")),
        "{commands:?}"
    );
    // No input is overwritten.
    bench.chosen(&file, FilePurpose::Bake { field: false });
    assert!(
        bench.has_error("scene.toml") || bench.has_error("output"),
        "{}",
        bench.app().log.text()
    );
    assert!(Scene::load(&file).is_ok());
}

pub fn unsaved_work_is_asked_about() {
    let mut bench = Bench::open(HEAD);
    bench.app().doc.as_mut().unwrap().add(Deformation::new("twist"));
    bench.settle();
    let ctx = bench.ctx();
    bench.app().open(&ctx, Path::new("phantom:ball:size=16"));
    bench.step();
    bench.step();
    bench.harness.get_by_label("Unsaved changes");
    bench.click("Cancel");
    assert_eq!(bench.scene().deformation.len(), 1);
    bench.app().open(&ctx, Path::new("phantom:ball:size=16"));
    bench.step();
    bench.step();
    bench.click("Discard");
    bench.settle();
    assert_eq!(bench.scene().volume_name(), "phantom:ball:size=16");
    // Turning the camera does not count as a change.
    bench.app().orbit(30.0, 0.0);
    bench.step();
    assert!(!bench.app().doc.as_ref().unwrap().is_changed());
}

pub fn a_missing_file_is_located() {
    let folder = tempfile::tempdir().unwrap();
    let there = folder.path().join("elsewhere");
    std::fs::create_dir_all(&there).unwrap();
    let volume = large_volume(&there, 16);
    let scene = folder.path().join("scene.toml");
    std::fs::write(&scene, "incise = 1\n[volume]\npath = \"large.nrrd\"\n").unwrap();
    let mut bench = Bench {
        harness: workstation(&folder.path().join("home"), Some(&scene), Backend::Cpu),
        folder,
    };
    bench.step();
    bench.step();
    bench.harness.get_by_label("A file is missing");
    let Some(dialog @ Dialog::Locate { .. }) = bench.app().dialog.clone() else {
        panic!("no question")
    };
    bench.app().dialog = None;
    bench.chosen(&volume, FilePurpose::Locate(Box::new(dialog)));
    let doc = bench.app().doc.as_ref().unwrap();
    assert_eq!(doc.assets.volume.size, [16; 3]);
    assert!(doc.is_changed(), "the new place is to be saved");
}

pub fn the_palette_finds_commands() {
    let mut bench = Bench::open(HEAD);
    bench.key(Modifiers::COMMAND, Key::K);
    bench.step();
    for c in "posterior".chars() {
        bench.harness.event(egui::Event::Text(c.to_string()));
    }
    bench.step();
    bench.step();
    bench.harness.get_by_label("Command: View from posterior");
    bench.key(Modifiers::NONE, Key::Enter);
    bench.settle();
    assert_eq!(bench.scene().camera.view.azimuth_deg, 180.0);
    // Every command is listed with its key.
    bench.key(Modifiers::COMMAND, Key::K);
    bench.step();
    let shown = bench.harness.query_all_by_label_contains("Command: ").count();
    let all = bench.app().entries.len();
    assert!(shown >= all / 2, "{shown} of {all}");
    bench.key(Modifiers::NONE, Key::Escape);
    // A key can be changed, and the new one is shown from then on.
    bench.perform(Action::Keys);
    bench.step();
    bench.step();
    bench.harness.get_by_label("Key of Reset camera").scroll_to_me();
    for _ in 0..20 {
        bench.step();
    }
    bench.click("Key of Reset camera");
    bench.key(Modifiers::SHIFT, Key::J);
    let key = bench
        .app()
        .entries
        .iter()
        .find(|e| e.label == "Reset camera")
        .unwrap()
        .key;
    assert_eq!(key, Some(egui::KeyboardShortcut::new(Modifiers::SHIFT, Key::J)));
}

pub fn views_turn_pan_and_zoom() {
    let mut bench = Bench::open(HEAD);
    let view = bench.rect("3D view");
    let from = view.center() + vec2(200.0, 100.0);
    let camera = |bench: &mut Bench| bench.scene().camera;
    bench.drag(
        PointerButton::Primary,
        Modifiers::NONE,
        &[from, from + vec2(50.0, 0.0)],
    );
    let turned = camera(&mut bench).view.azimuth_deg;
    assert!(
        (turned + 20.0).abs() < 4.0,
        "what is dragged to the right is seen from the patient's right: {turned}"
    );
    bench.drag(
        PointerButton::Middle,
        Modifiers::NONE,
        &[from, from + vec2(0.0, 40.0)],
    );
    assert!(camera(&mut bench).target.is_some());
    let zoom = camera(&mut bench).zoom;
    bench.drag(
        PointerButton::Secondary,
        Modifiers::NONE,
        &[from, from - vec2(0.0, 50.0)],
    );
    assert!(camera(&mut bench).zoom > 1.2 * zoom);
    bench.drag(
        PointerButton::Primary,
        Modifiers::COMMAND,
        &[view.center() + vec2(100.0, 0.0), view.center() + vec2(0.0, 100.0)],
    );
    assert!(
        camera(&mut bench).roll.abs() > 40.0,
        "{}",
        camera(&mut bench).roll
    );
    bench.key(Modifiers::NONE, Key::R);
    assert_eq!(camera(&mut bench), Default::default());
    bench.key(Modifiers::ALT, Key::ArrowLeft);
    assert!(camera(&mut bench).roll.abs() > 40.0, "the camera's own way back");
    bench.key(Modifiers::ALT, Key::ArrowRight);
    assert_eq!(camera(&mut bench), Default::default());
    // A double-click centres the point under the pointer; a click on the cube selects that view.
    bench.settle();
    for _ in 0..2 {
        bench.click_at(view.center() - vec2(30.0, 40.0));
    }
    bench.settle();
    let target = glam::Vec3::from(camera(&mut bench).target.unwrap());
    let at = bench.app().projector().unwrap().screen(target).unwrap();
    assert!(at.distance(view.center()) < 1.0, "{at:?}");
    // The point under the pointer is shown in deformed and source coordinates.
    bench.app().doc.as_mut().unwrap().add(Deformation::new("twist"));
    bench.app().select(Selection::Nothing);
    bench.settle();
    bench
        .harness
        .event(egui::Event::PointerMoved(view.center() + vec2(14.0, 3.0)));
    bench.step();
    bench.until("nothing under the pointer", |app| {
        app.prober_is_idle() && app.hover.is_some()
    });
    let hover = bench.app().hover.clone().unwrap();
    let (scene, assets) = (bench.scene(), bench.app().doc.as_ref().unwrap().assets.clone());
    let expected = incise::prepare::Deformed::new(&scene, &assets)
        .unwrap()
        .stack
        .source_and_alpha(hover.deformed.unwrap())
        .0;
    assert!(
        hover.source.distance(expected) < 0.1 && hover.value.is_some(),
        "{hover:?}: {expected}"
    );
    // Space, while held, shows the undeformed scene.
    bench.harness.key_down(Key::Space);
    bench.step();
    assert!(bench.app().shows_undeformed() && bench.app().scene_of_view().unwrap().deformation.is_empty());
    bench.harness.key_up(Key::Space);
    bench.step();
    assert!(!bench.app().shows_undeformed());
    // Modes and handles.
    bench.key(Modifiers::NONE, Key::V);
    assert_eq!(bench.scene().render.mode, Mode::Slice);
    bench.app().select(Selection::Deformation(0));
    bench.step();
    for mode in ["Move", "Rotate", "Scale", "Shape"] {
        bench.click(mode);
    }
    assert_eq!(bench.app().view.gizmo, GizmoMode::Shape);
    let center = bench.handle(Handle::Center);
    bench.drag(
        PointerButton::Primary,
        Modifiers::NONE,
        &[center, center + vec2(30.0, 10.0)],
    );
    let moved = bench.handle(Handle::Center);
    assert!(
        moved.distance(center + vec2(30.0, 10.0)) < 2.0,
        "the handle is not under the pointer: {moved:?}"
    );
    // Esc cancels a drag.
    let place = bench.scene().deformation[0].center;
    let press = |pos, pressed| egui::Event::PointerButton {
        pos,
        button: PointerButton::Primary,
        pressed,
        modifiers: Modifiers::NONE,
    };
    for event in [
        egui::Event::PointerMoved(moved),
        press(moved, true),
        egui::Event::PointerMoved(moved + vec2(40.0, 0.0)),
    ] {
        bench.harness.event(event);
        bench.step();
    }
    assert_ne!(bench.scene().deformation[0].center, place);
    bench.key(Modifiers::NONE, Key::Escape);
    bench.harness.event(press(moved + vec2(40.0, 0.0), false));
    bench.step();
    assert_eq!(bench.scene().deformation[0].center, place);
    bench.no_errors();
}

/// Slices at positions other than the true ones: a permanent bar reports it, and its button
/// resamples them; earlier measurements are marked.
pub fn uneven_slices_are_told_and_mended() {
    let folder = tempfile::tempdir().unwrap();
    let series = folder.path().join("series");
    let size = [16, 14, 12];
    let grid = incise::volume::GridGeometry {
        size,
        world_from_voxel: glam::DAffine3::from_scale(glam::DVec3::new(2.0, 2.0, 3.0)),
    };
    let values: Vec<i16> = (0..16 * 14 * 12).map(|n: i32| (n % 97 * 10) as i16).collect();
    crate::readers::dicom::write(&series, &grid, &values);
    // Two slices in the middle are missing.
    for k in [5, 6] {
        std::fs::remove_file(series.join(format!("{}.dcm", 12 - k))).unwrap();
    }
    let mut bench = Bench::open_in(folder, &series);
    let depth = |bench: &mut Bench| bench.app().doc.as_ref().unwrap().assets.volume.size[2];
    assert_eq!(depth(&mut bench), 10);
    let bar = |bench: &Bench| {
        bench
            .harness
            .query_by_label_contains("Slice spacing is uneven")
            .is_some()
    };
    for _ in 0..400 {
        bench.step();
    }
    assert!(bar(&bench), "the bar is gone");
    let text = bench.app().log.text();
    assert!(!text.contains("--resample"), "a window has no options: {text}");
    let measure = incise::scene::measure::Measure {
        kind: MeasureKind::Distance,
        name: Some("across the gap".into()),
        points: vec![[10.0, 10.0, 3.0], [10.0, 10.0, 27.0]],
        label: None,
        before_resampling: false,
    };
    bench.app().doc.as_mut().unwrap().scene.measure.push(measure);
    bench.app().show_panel(incise::gui::state::layout::Panel::Measure);
    bench.settle();
    assert!(
        bench
            .harness
            .query_by_label_contains("not shown at their acquired positions")
            .is_some()
    );
    bench.click("Resample");
    bench.until("not resampled", |app| {
        app.doc.as_ref().unwrap().assets.volume.size[2] == 12
    });
    bench.settle();
    assert!(
        !bar(&bench)
            && bench
                .harness
                .query_by_label_contains("made before resampling")
                .is_some()
    );
    // The mark is saved, and also appears in an exported table of the measurements.
    let file = bench.folder.path().join("m.csv");
    bench.chosen(&file, FilePurpose::Measures);
    assert!(
        std::fs::read_to_string(&file)
            .unwrap()
            .contains("made before resampling")
    );
    bench.key(Modifiers::COMMAND, Key::Z);
    bench.until("not undone", |app| {
        app.doc.as_ref().unwrap().assets.volume.size[2] == 10
    });
    assert!(!bench.scene().measure[0].before_resampling);
    bench.settle();
    bench.key(Modifiers::COMMAND | Modifiers::SHIFT, Key::Z);
    bench.until("not done again", |app| {
        app.doc.as_ref().unwrap().assets.volume.size[2] == 12
    });
    bench.settle();
    let file = bench.folder.path().join("scene.toml");
    bench.chosen(&file, FilePurpose::Save(None));
    assert!(Scene::load(&file).unwrap().measure[0].before_resampling);
    bench.no_errors();
}

/// A field rejects invalid input, shows the reason next to it, and changes nothing.
pub fn a_field_refuses_what_it_cannot_use() {
    let mut bench = Bench::open(HEAD);
    let mut lift = Deformation::new("lift");
    lift.progress = Some(0.5);
    bench.app().doc.as_mut().unwrap().add(lift);
    bench.settle();
    let shown = bench.picture();
    let before = bench.scene();
    for (field, text, word) in [
        ("Label", "labels.nii.gz", "file name"),
        ("Mask", "no-such-mask.nii", "file not found"),
        ("Iso", "high", "is not a number"),
    ] {
        bench
            .harness
            .get_by_role_and_label(Role::TextInput, field)
            .scroll_to_me();
        bench.settle();
        bench
            .harness
            .get_by_role_and_label(Role::TextInput, field)
            .focus();
        bench.step();
        for c in text.chars() {
            bench.harness.event(egui::Event::Text(c.to_string()));
        }
        bench.step();
        bench.key(Modifiers::NONE, Key::Enter);
        bench.settle();
        assert!(
            bench.harness.query_by_label_contains(word).is_some(),
            "{field}: nothing is said of \"{text}\""
        );
        assert_eq!(bench.scene(), before, "{field}");
    }
    assert_eq!(bench.picture(), shown);
    bench.no_errors();
}
