//! Everything drawn over a picture belongs to that picture, also while pictures are slow, fail, or
//! still show another scene.
//!
//! The pixels on the screen are those that the window passes to its renderer. At random they are
//! rendered again from the scene that the view reports; everything else is read from the shapes of
//! the frame and compared with the camera of that scene.

use super::*;
use egui::epaint::{ClippedShape, ColorImage, ImageData, Shape, TextureId};
use incise::engine::DRAFT_SLAB;
use incise::gui::state::shown::DisplayedPicture;
use incise::gui::views::letters;
use incise::prepare::{Assets, Deformed};
use incise::scene::measure::Measure;
use incise::scene::{Antialias, Projection, Size, SliceOrder, VolumeFilter};
use std::collections::HashMap;
use std::sync::{Arc, Mutex};

/// Retains the newest pixels of every texture that is set as a whole.
#[derive(Clone, Default)]
struct Screen(Arc<Mutex<HashMap<TextureId, Arc<ColorImage>>>>);

impl egui_kittest::TestRenderer for Screen {
    fn handle_delta(&mut self, delta: &mut egui::TexturesDelta) {
        let mut images = self.0.lock().unwrap();
        for (id, changes) in std::mem::take(&mut delta.set) {
            for change in changes.into_iter().filter(|c| c.pos.is_none()) {
                let ImageData::Color(image) = change.image;
                images.insert(id, image);
            }
        }
        for id in std::mem::take(&mut delta.free) {
            images.remove(&id);
        }
    }
}

/// Shapes of the last frame, flattened.
fn shapes(all: &[ClippedShape]) -> Vec<&Shape> {
    fn flat<'a>(shape: &'a Shape, into: &mut Vec<&'a Shape>) {
        match shape {
            Shape::Vec(more) => more.iter().for_each(|s| flat(s, into)),
            other => into.push(other),
        }
    }
    let mut flattened = Vec::new();
    all.iter().for_each(|c| flat(&c.shape, &mut flattened));
    flattened
}

/// Everything that a frame draws into a view.
struct Drawn {
    texts: Vec<(String, Rect)>,
    lines: Vec<[Pos2; 2]>,
    /// Centres of circles and diamonds.
    marks: Vec<Pos2>,
    pictures: Vec<(TextureId, Rect)>,
}

impl Drawn {
    fn of(output: &egui::FullOutput, view: Rect) -> Self {
        let mut drawn = Self {
            texts: Vec::new(),
            lines: Vec::new(),
            marks: Vec::new(),
            pictures: Vec::new(),
        };
        for shape in shapes(&output.shapes) {
            match shape {
                Shape::Text(text) if view.contains(text.pos) => {
                    drawn.texts.push((
                        text.galley.text().to_owned(),
                        Rect::from_min_size(text.pos, text.galley.size()),
                    ));
                }
                Shape::LineSegment { points, .. } => drawn.lines.push(*points),
                Shape::Circle(circle) => drawn.marks.push(circle.center),
                Shape::Path(path) if path.closed && path.points.len() == 4 => {
                    drawn.marks.push(Rect::from_points(&path.points).center())
                }
                Shape::Mesh(mesh) if mesh.texture_id != TextureId::default() => {
                    drawn.pictures.push((mesh.texture_id, mesh.calc_bounds()))
                }
                Shape::Rect(rect) if rect.fill_texture_id() != TextureId::default() => {
                    drawn.pictures.push((rect.fill_texture_id(), rect.rect))
                }
                _ => {}
            }
        }
        drawn
    }

    fn text_at(&self, holds: impl Fn(&Rect) -> bool) -> Option<&str> {
        let of_patient = |t: &str| !t.is_empty() && t.len() <= 2 && t.chars().all(|c| "LRAPSI".contains(c));
        self.texts
            .iter()
            .find(|(t, r)| of_patient(t) && holds(r))
            .map(|(t, _)| t.as_str())
    }
}

/// Counts of the checks performed.
#[derive(Default, Debug)]
struct Seen {
    checked: usize,
    outdated: usize,
    failed: usize,
    empty: usize,
    rendered: usize,
    handles: usize,
    measures: usize,
}

/// Compares the overlays of a frame in the 3D view with its picture; `failed` states whether
/// rendering had failed before that frame.
fn check(
    harness: &Harness<'static, Workstation>,
    screen: &Screen,
    exact: bool,
    failed: bool,
    seen: &mut Seen,
) -> Result<(), String> {
    let app = harness.state();
    let is_there = harness.query_by_label("3D view").is_some();
    let Some(doc) = app.doc.as_ref().filter(|_| is_there) else {
        return Ok(());
    };
    let view = app.view.rect;
    let drawn = Drawn::of(harness.output(), view);
    let Some(picture) = app.view.picture() else {
        let over = drawn.text_at(|_| true);
        seen.empty += 1;
        return if over.is_none() {
            Ok(())
        } else {
            Err(format!("{over:?} is drawn over no picture"))
        };
    };
    seen.checked += 1;
    let id = picture.texture.id();
    let Some((_, place)) = drawn.pictures.iter().find(|(t, _)| *t == id) else {
        return Err("the view's own picture is not drawn".into());
    };
    // The camera of the displayed scene, computed independently.
    let pixels = screen.0.lock().unwrap()[&id].clone();
    let DisplayedPicture { of, .. } = picture;
    let camera = of
        .scene
        .camera
        .frame(
            &of.assets.scene_box(),
            [pixels.size[0] as u32, pixels.size[1] as u32],
        )
        .map_err(|e| e.to_string())?;
    let projector = incise::gui::projector::Projector {
        frame: camera,
        rect: *place,
    };
    if picture.frame != camera {
        return Err("the picture's camera is not that of its scene".into());
    }
    let shape =
        (place.width() / place.height()) / (of.scene.render.size[0] as f32 / of.scene.render.size[1] as f32);
    if (shape - 1.0).abs() > 0.02 {
        return Err(format!("the picture is stretched by {shape}"));
    }
    if exact {
        let found = rendered(picture, &app.view.facts, pixels.size);
        if found.pixels != pixels.pixels {
            let apart = found
                .pixels
                .iter()
                .zip(&pixels.pixels)
                .filter(|(a, b)| a != b)
                .count();
            return Err(format!(
                "{apart} of {} pixels are not those of the scene that the view says it shows",
                pixels.pixels.len()
            ));
        }
        seen.rendered += 1;
    }
    let (right, up) = (camera.right.normalize(), camera.up.normalize());
    let middle = view.center();
    for (name, direction, letters_there) in [
        (
            "right",
            right,
            drawn.text_at(|r| {
                (r.right() - (view.right() - 8.0)).abs() < 1.0 && (r.center().y - middle.y).abs() < 2.0
            }),
        ),
        (
            "left",
            -right,
            drawn.text_at(|r| {
                (r.left() - (view.left() + 8.0)).abs() < 1.0 && (r.center().y - middle.y).abs() < 2.0
            }),
        ),
        (
            "top",
            up,
            drawn.text_at(|r| {
                (r.top() - (view.top() + 8.0)).abs() < 1.0 && (r.center().x - middle.x).abs() < 2.0
            }),
        ),
        (
            "bottom",
            -up,
            drawn.text_at(|r| {
                (r.bottom() - (view.bottom() - 8.0)).abs() < 1.0 && (r.center().x - middle.x).abs() < 2.0
            }),
        ),
    ] {
        let expected = letters(direction);
        if letters_there.unwrap_or_default() != expected {
            return Err(format!(
                "{name}: the letters are {letters_there:?}, the picture shows {expected}"
            ));
        }
    }
    // The cube's letters are on the faces visible to the picture's camera.
    let cube = Rect::from_center_size(pos2(view.right() - 46.0, view.top() + 46.0), vec2(70.0, 70.0));
    for (letter, normal) in [
        ("L", glam::Vec3::X),
        ("R", -glam::Vec3::X),
        ("P", glam::Vec3::Y),
        ("A", -glam::Vec3::Y),
        ("S", glam::Vec3::Z),
        ("I", -glam::Vec3::Z),
    ] {
        let faces = -normal.dot(camera.forward);
        let at = cube.center() + vec2(normal.dot(right), -normal.dot(up)) * 21.0;
        let there = drawn
            .texts
            .iter()
            .any(|(t, r)| t == letter && r.center().distance(at) < 3.0);
        if (faces > 0.26 && !there) || (faces < 0.24 && there) {
            return Err(format!(
                "cube: {letter} faces the viewer by {faces}, drawn: {there}"
            ));
        }
    }
    // The scale bar has the length it states.
    let target = of
        .scene
        .camera
        .target
        .map_or_else(|| of.assets.scene_box().center(), glam::Vec3::from);
    if let Some(mm) = drawn.texts.iter().find_map(|(t, r)| {
        (r.bottom() - (view.bottom() - 20.0))
            .abs()
            .lt(&2.0)
            .then(|| t.strip_suffix(" mm")?.parse::<f32>().ok())?
    }) {
        let end = pos2(view.right() - 14.0, view.bottom() - 14.0);
        let bar = drawn
            .lines
            .iter()
            .find(|l| l[1].distance(end) < 0.5 && l[0].y == l[1].y);
        let length = bar.map_or(0.0, |l| l[1].x - l[0].x) * projector.mm_per_point(target);
        if (length / mm - 1.0).abs() > 0.02 {
            return Err(format!("the bar says {mm} mm and is {length} mm long"));
        }
    }
    // Handles are those of the deformation in the displayed picture.
    if let Some(n) = doc
        .deformation_index()
        .filter(|_| !app.shows_undeformed() && app.tool == Tool::Navigate)
    {
        let kinds = |scene: &Scene| {
            scene
                .deformation
                .iter()
                .map(|d| d.kind.clone())
                .collect::<Vec<_>>()
        };
        let d = of
            .scene
            .deformation
            .get(n)
            .filter(|_| kinds(&of.scene) == kinds(&doc.scene));
        if let Some((d, kind)) =
            d.and_then(|d| Some((d, kind_of(d).filter(|k| !k.locked_to_view && k.name != "brush")?)))
        {
            let gizmo = Gizmo {
                projector,
                kind,
                deformation: d,
                scene_box: of.assets.scene_box(),
                mode: app.view.gizmo,
            };
            for (handle, at) in gizmo
                .handles()
                .into_iter()
                .filter(|(h, _)| matches!(h, Handle::Center | Handle::Progress))
            {
                let Some(at) = projector.screen(at).filter(|p| view.contains(*p)) else {
                    continue;
                };
                if !drawn.marks.iter().any(|c| c.distance(at) < 0.6) {
                    return Err(format!("{handle:?} is not where the picture has it ({at})"));
                }
                seen.handles += 1;
            }
        }
    }
    // Measurements are displayed at the positions given by the picture's own deformation.
    if exact && !of.scene.measure.is_empty() {
        let deformed = Deformed::new(&of.scene, &of.assets).map_err(|e| e.to_string())?;
        for point in of.scene.measure.iter().flat_map(|m| &m.points) {
            let at = deformed
                .forward((*point).into())
                .and_then(|p| projector.screen(p))
                .filter(|p| view.contains(*p));
            let Some(at) = at else { continue };
            if !drawn.marks.iter().any(|c| c.distance(at) < 1.0) {
                return Err(format!("a measured point is not where the picture has it ({at})"));
            }
            seen.measures += 1;
        }
    }
    let says = drawn
        .texts
        .iter()
        .any(|(t, _)| t.starts_with("This picture is out of date"));
    let fails = app.view.failure().is_some();
    seen.failed += usize::from(fails);
    seen.outdated += usize::from(!app.view.is_current());
    // A frame that repairs the scene has already drawn the old picture.
    if (failed && fails && !says) || (!failed && says && app.view.is_current()) {
        return Err(format!(
            "fails: {failed}, then {fails}; said over the picture: {says}"
        ));
    }
    Ok(())
}

/// The picture that the view reports, rendered by the library.
fn rendered(
    picture: &DisplayedPicture,
    facts: &incise::gui::state::view::Facts,
    size: [usize; 2],
) -> ColorImage {
    let mut scene: Scene = (*picture.of.scene).clone();
    (scene.render.size, scene.render.step) = (size.map(|n| n as u32), facts.step);
    if facts.is_draft {
        scene.render.antialias = Antialias::OFF;
        scene.render.filter = VolumeFilter::Linear;
        scene.render.preintegrated = scene.render.preintegrated.or(Some(false));
        if scene.render.mode == Mode::Slice {
            scene.render.slab = scene.render.slab.max(DRAFT_SLAB);
            scene.render.slice_order = SliceOrder::FrontToBack;
        }
    }
    let prepared = Prepared::new(&scene, &picture.of.assets).unwrap();
    let bytes = cpu::render(&prepared).picture.over(prepared.settings.background);
    ColorImage::from_rgba_unmultiplied(size, &bytes)
}

pub fn what_is_drawn_over_a_picture_belongs_to_it() {
    let count: usize = std::env::var("INCISE_PICTURE_ACTIONS")
        .ok()
        .and_then(|n| n.parse().ok())
        .unwrap_or(5_000);
    let folder = tempfile::tempdir().unwrap();
    let screen = Screen::default();
    let options = Options {
        file: Some("phantom:head-ct:size=24".into()),
        folder: Some(folder.path().join("home")),
        backend: Some(Backend::Cpu),
    };
    let mut harness = Harness::builder()
        .with_size(vec2(1000.0, 640.0))
        .with_step_dt(1.0 / 30.0)
        .renderer(screen.clone())
        .build_eframe(|cc| Workstation::new(&cc.egui_ctx, options));
    let mut random = TestRng::from_seed(RngAlgorithm::ChaCha, &[23; 32]);
    let mut below = move |n: usize| random.next_u32() as usize % n;
    let ctx = harness.ctx.clone();
    let start = Instant::now();
    let mut seen = Seen::default();
    let mut recent: Vec<String> = Vec::new();
    let mut last_picture = 0;
    for n in 0..count {
        let app = harness.state_mut();
        let size = (app.view.rect.width(), app.view.rect.height());
        let what = act(app, &ctx, &mut below, size);
        recent.push(what);
        if recent.len() > 14 {
            recent.remove(0);
        }
        if below(60) == 0 {
            harness.set_size(vec2(820.0 + below(300) as f32, 560.0 + below(160) as f32));
        }
        let fails = |harness: &Harness<'static, Workstation>| harness.state().view.failure().is_some();
        let mut failed = fails(&harness);
        harness.step();
        // Some actions follow each other at once; some wait for their picture, or for its failure.
        let frames = [0, 0, 1, 2, 12][below(5)];
        for _ in 0..frames {
            if harness.state().view.is_current() || fails(&harness) {
                break;
            }
            std::thread::sleep(Duration::from_millis(below(10) as u64));
            failed = fails(&harness);
            harness.step();
        }
        // New pictures are checked exactly, at random.
        let serial = harness.state().view.picture().map_or(0, |p| p.serial);
        let exact = serial != last_picture && below(4) == 0;
        last_picture = serial;
        check(&harness, &screen, exact, failed, &mut seen)
            .unwrap_or_else(|e| panic!("action {n}: {e}; after {recent:#?}"));
    }
    println!(
        "{count} actions in {:.0} s: {seen:?}",
        start.elapsed().as_secs_f64()
    );
    assert!(
        seen.checked > count / 2 && seen.outdated > count / 20 && seen.failed > count / 50,
        "{seen:?}"
    );
    // The numbers depend on how fast pictures arrive.
    assert!(
        seen.rendered > count / 100 && seen.handles > count / 100 && seen.measures > 0,
        "{seen:?}"
    );
}

/// Performs a random action.
fn act(
    app: &mut Workstation,
    ctx: &egui::Context,
    below: &mut impl FnMut(usize) -> usize,
    size: (f32, f32),
) -> String {
    if app.doc.is_none() || app.dialog.is_some() {
        app.dialog = None;
        return "waits".into();
    }
    let part = |n: usize| (n as f32 - 500.0) / 500.0;
    match below(24) {
        0..=4 => {
            let view = ["anterior", "posterior", "left", "right", "superior", "inferior"][below(6)];
            app.look_from(view);
            format!("look from {view}")
        }
        5..=7 => {
            app.orbit(part(below(1000)) * 300.0, part(below(1000)) * 200.0);
            "orbit".into()
        }
        8 => {
            app.zoom(0.6 + below(100) as f32 / 100.0);
            "zoom".into()
        }
        9 => {
            let rect = Rect::from_min_size(Pos2::ZERO, vec2(size.0, size.1));
            app.pan(part(below(1000)) * 60.0, part(below(1000)) * 60.0, rect);
            "pan".into()
        }
        10 => {
            app.perform(ctx, Action::BeforeAfter);
            "before and after".into()
        }
        11 => {
            app.perform(ctx, Action::ResetCamera);
            "reset the camera".into()
        }
        12 => {
            app.perform(ctx, [Action::Undo, Action::Redo][below(2)]);
            "undo or redo".into()
        }
        13 => {
            let files = [
                "phantom:head-ct:size=24",
                "phantom:ball:size=16",
                "phantom:head-ct:size=20",
            ];
            // Opening a scene takes a while.
            if below(4) == 0 {
                app.doc.as_mut().unwrap().saved = Some(app.doc.as_ref().unwrap().scene.clone());
                app.open(ctx, Path::new(files[below(3)]));
                return "open another scene".into();
            }
            "nothing".into()
        }
        n => {
            let doc = app.doc.as_mut().unwrap();
            edit(doc, n, below)
        }
    }
}

/// Edits the scene at random, also into scenes that cannot be rendered or that are slow.
fn edit(
    doc: &mut incise::gui::state::document::Document,
    n: usize,
    below: &mut impl FnMut(usize) -> usize,
) -> String {
    let scene = &mut doc.scene;
    match n {
        14 if scene.deformation.len() < 4 => {
            let kind = ["peel", "box", "twist", "pull", "explode"][below(5)];
            let mut d = Deformation::new(kind);
            d.progress = Some(0.5);
            d.size = Some(Size::Cube(60.0));
            doc.add(d);
            format!("add {kind}")
        }
        14 | 15 => {
            doc.delete();
            "delete".into()
        }
        16 => {
            let at = below(scene.deformation.len() + 1);
            doc.selected = if at < scene.deformation.len() {
                Selection::Deformation(at)
            } else {
                Selection::Nothing
            };
            "select".into()
        }
        17 => {
            if let Some(d) = scene.deformation.last_mut() {
                d.progress = Some(below(100) as f32 / 100.0);
                d.center = Some([
                    below(40) as f32 - 20.0,
                    below(40) as f32 - 20.0,
                    below(40) as f32 - 20.0,
                ]);
            }
            "move".into()
        }
        18 | 19 => {
            // Invalid settings, as a scene file may contain them.
            match scene.deformation.last_mut() {
                Some(d) if d.parameters.0.contains_key("spare") => {
                    d.parameters.0.remove("spare");
                    "mend".into()
                }
                Some(d) if below(2) == 0 => {
                    d.parameters.insert("spare", "labels.nii.gz");
                    "break: spare".into()
                }
                Some(_) => "nothing".into(),
                None => {
                    scene.render.step = if scene.render.step > 0.0 { -1.0 } else { 1.0 };
                    "break or mend: step".into()
                }
            }
        }
        20 => {
            scene.render.step = [1.0, 0.1, 1.0, 2.0][below(4)];
            format!("step {}", scene.render.step)
        }
        21 => {
            let bounds = doc.assets.scene_box();
            let at = |n: usize| (bounds.center() + bounds.size() * 0.12 * (n as f32 - 1.5)).into();
            if scene.measure.len() > 2 {
                scene.measure.clear();
            }
            scene.measure.push(Measure {
                kind: MeasureKind::Distance,
                name: None,
                points: vec![at(below(4)), at(below(4))],
                label: None,
                before_resampling: false,
            });
            "measure".into()
        }
        22 => {
            scene.camera.projection = [Projection::Perspective, Projection::Orthographic][below(2)];
            scene.camera.roll = [0.0, 30.0, 180.0][below(3)];
            "projection".into()
        }
        _ => {
            scene.render.mode = [Mode::Raycast, Mode::Slice][below(2)];
            "mode".into()
        }
    }
}

/// An invalid setting, then another view direction: the picture and its letters stay, and it is
/// marked as out of date.
pub fn a_picture_that_fails_keeps_its_letters() {
    let mut bench = Bench::open(HEAD);
    let mut peel = Deformation::new("peel");
    peel.progress = Some(0.5);
    bench.app().doc.as_mut().unwrap().add(peel);
    bench.app().look_from("superior");
    bench.settle();
    let letters_of = |bench: &mut Bench| {
        let view = bench.app().view.rect;
        let drawn = Drawn::of(bench.harness.output(), view);
        drawn
            .text_at(|r| {
                (r.top() - (view.top() + 8.0)).abs() < 1.0 && (r.center().x - view.center().x).abs() < 2.0
            })
            .map(str::to_owned)
    };
    assert_eq!(letters_of(&mut bench).as_deref(), Some("A"));
    bench.app().doc.as_mut().unwrap().scene.deformation[0]
        .parameters
        .insert("spare", "labels.nii.gz");
    bench.step();
    bench.key(Modifiers::NONE, Key::Num1);
    bench.settle();
    assert_eq!(
        bench.scene().camera.view.elevation_deg,
        0.0,
        "the camera looks from the front"
    );
    assert_eq!(
        letters_of(&mut bench).as_deref(),
        Some("A"),
        "the picture is still the one from above"
    );
    let failure = |bench: &mut Bench| bench.app().view.failure().map(str::to_owned);
    let problem = failure(&mut bench).unwrap();
    assert!(problem.contains("spare"), "{problem}");
    for _ in 0..300 {
        bench.step();
    }
    let view = bench.app().view.rect;
    let words = Drawn::of(bench.harness.output(), view).texts;
    assert!(
        words
            .iter()
            .any(|(t, _)| t.contains("out of date") && t.contains("spare")),
        "it is not said any more: {words:?}"
    );
    bench.app().doc.as_mut().unwrap().scene.deformation[0]
        .parameters
        .0
        .remove("spare");
    bench.settle();
    assert_eq!(letters_of(&mut bench).as_deref(), Some("S"));
    assert_eq!(failure(&mut bench), None);
}

/// Without a deformation the source position equals the displayed one exactly, in every view.
pub fn where_matter_came_from_is_exact() {
    let mut bench = Bench::open("phantom:head-ct:size=48");
    bench.until("no slices", |app| app.slices.are_there());
    let view = bench.rect("Axial view");
    for n in 0..40u32 {
        let at = view.center() + vec2((n * 37 % 101) as f32 - 50.0, (n * 53 % 89) as f32 - 44.0) * 0.7;
        bench.harness.event(egui::Event::PointerMoved(at));
        bench.step();
        let hover = bench.app().hover.clone().unwrap();
        assert_eq!(hover.deformed, Some(hover.source));
        assert!(!hover.words().contains("source"), "{}", hover.words());
    }
    let mut twist = Deformation::new("twist");
    twist.parameters.insert("angle", 60.0);
    bench.app().doc.as_mut().unwrap().add(twist);
    bench.settle();
    let (scene, assets): (Scene, Arc<Assets>) =
        (bench.scene(), bench.app().doc.as_ref().unwrap().assets.clone());
    let deformed = Deformed::new(&scene, &assets).unwrap();
    for n in 0..40u32 {
        let at = view.center() + vec2((n * 37 % 101) as f32 - 50.0, (n * 53 % 89) as f32 - 44.0) * 0.7;
        bench.harness.event(egui::Event::PointerMoved(at));
        bench.step();
        let hover = bench.app().hover.clone().unwrap();
        assert_eq!(
            hover.source,
            deformed.stack.source_and_alpha(hover.deformed.unwrap()).0
        );
    }
}
