//! Carries out actions and tools.

use super::state::action::Action;
use super::state::document::{Document, Selection};
use super::state::files::{ClipForm, ClipMotion, Dialog, NextStep};
use super::state::layout::Panel;
use super::state::log::LogLevel;
use super::state::tool::{Tool, dropped, words};
use super::state::{Gesture, PickedPoint, Workstation};
use crate::cpu::pick::Pick;
use crate::deform::kinds::Kind;
use crate::deform::kinds::brush::{Lasso, Stroke, StrokeTool};
use crate::deform::quality::CheckedField;
use crate::deform::{Argument, PlacedMap};
use crate::prepare::Deformed;
use crate::scene::measure::{Measure, MeasureKind};
use crate::scene::{Mode, Projection, VisibleObject};
use eframe::egui::{self, Context};
use glam::{Vec2, Vec3};

/// Change of progress by `[` and `]`.
const PROGRESS_STEP: f32 = 0.05;
/// Minimum distance between points of a stroke, as a fraction of its radius.
const STROKE_STEP: f32 = 0.25;
/// Maximum number of points in a stroke.
const MAX_STROKE_POINTS: usize = 400;

impl Workstation {
    /// Carries out an action; one that does not apply at the moment has no effect.
    pub fn perform(&mut self, ctx: &Context, action: Action) {
        match action {
            Action::Open => self.choose_file_to_open(),
            Action::OpenFolder => self.choose_folder_to_open(),
            Action::OpenHead => self.open_bundled(ctx, "colin27-head-t1.nii.gz"),
            Action::Quit => self.after(ctx, NextStep::Quit),
            Action::Palette => {
                self.palette = if self.palette.is_some() {
                    None
                } else {
                    Some(Default::default())
                }
            }
            Action::Keys => {
                self.key_list = if self.key_list.is_some() {
                    None
                } else {
                    Some(Default::default())
                }
            }
            Action::Log => self.show_panel(Panel::Log),
            Action::Layout(layout) => {
                self.layout = layout;
                self.dock = layout.dock();
                self.view.forget();
            }
            Action::ToggleTheme => {
                let light = !self.session.settings.light;
                self.session.settings.light = light;
                ctx.set_theme(if light {
                    egui::Theme::Light
                } else {
                    egui::Theme::Dark
                });
            }
            Action::ScaleUp | Action::ScaleDown => {
                let by = if action == Action::ScaleUp { 1.1 } else { 1.0 / 1.1 };
                self.session.settings.scale = (self.session.settings.scale * by).clamp(0.6, 2.5);
                ctx.set_zoom_factor(self.session.settings.scale);
            }
            Action::Navigation => {
                let blender = !self.session.settings.blender;
                self.session.settings.blender = blender;
                self.report(
                    LogLevel::Info,
                    if blender {
                        "Blender navigation: orbit with the middle button"
                    } else {
                        "3D Slicer navigation: orbit with the left button"
                    },
                );
            }
            Action::ResetGpu => {
                self.worker.lose_device();
                self.view.forget();
            }
            Action::CancelTasks => {
                self.tasks.iter().for_each(super::state::tasks::Task::cancel);
                if let Some(loading) = &self.loading {
                    loading.cancel();
                }
            }
            // A scene that is about to be replaced is not edited.
            _ if self.loading.as_ref().is_some_and(|l| !l.same) => {}
            _ if self.doc.is_some() => self.perform_on_scene(ctx, action),
            _ => {}
        }
    }

    fn perform_on_scene(&mut self, ctx: &Context, action: Action) {
        match action {
            Action::Close => self.after(ctx, NextStep::Close),
            Action::Save => self.save(ctx, None),
            Action::SaveAs => self.choose_save_file(None),
            Action::ExportPicture => self.dialog = Some(Dialog::Picture(self.picture_form())),
            Action::ExportClip => self.dialog = Some(Dialog::Clip(self.clip_form())),
            Action::ExportVolume => self.choose_bake_file(false),
            Action::ExportField => self.choose_bake_file(true),
            Action::ExportReport => self.choose_report_folder(),
            Action::ExportMeasures => self.choose_measures_file(),
            Action::ExportTransfer => self.choose_transfer_export(),
            Action::ImportTransfer => self.choose_transfer_import(),
            Action::CopyCommand => self.copy_command(ctx),
            Action::Arm(tool) => self.arm(tool),
            Action::Deselect => self.escape(),
            Action::View(name) => self.look_from(name),
            Action::ResetCamera => self.reset_camera(),
            Action::FrameSelection => self.frame_selection(),
            Action::Compare => {
                self.layout = super::state::layout::LayoutPreset::Compare;
                self.dock = self.layout.dock();
                self.view.forget();
            }
            Action::BeforeAfter => self.before = !self.before,
            Action::StackToMap => {
                self.dialog = Some(Dialog::SaveMap {
                    name: "stack".into(),
                    stack: true,
                })
            }
            Action::SaveMap => {
                if let Some(d) = self.doc.as_mut().and_then(Document::deformation) {
                    let name = d.name.clone().unwrap_or_else(|| words(&d.kind));
                    self.dialog = Some(Dialog::SaveMap { name, stack: false });
                }
            }
            Action::CheckField => self.check_field(ctx),
            _ => self.perform_edit(action),
        }
    }

    /// Carries out an action that changes the scene.
    fn perform_edit(&mut self, action: Action) {
        let Some(doc) = &mut self.doc else { return };
        match action {
            Action::Undo => {
                self.history.undo(&mut doc.scene);
                doc.check_selection();
            }
            Action::Redo => {
                self.history.redo(&mut doc.scene);
                doc.check_selection();
            }
            Action::Opposite => {
                let view = &mut doc.scene.camera.view;
                let azimuth = view.azimuth_deg + 180.0;
                view.azimuth_deg = (azimuth + 180.0).rem_euclid(360.0) - 180.0;
                view.elevation_deg = -view.elevation_deg;
            }
            Action::CameraBack => {
                self.cameras.back(&mut doc.scene.camera);
            }
            Action::CameraForward => {
                self.cameras.forward(&mut doc.scene.camera);
            }
            Action::ToggleProjection => {
                let projection = &mut doc.scene.camera.projection;
                *projection = if *projection == Projection::Perspective {
                    Projection::Orthographic
                } else {
                    Projection::Perspective
                };
            }
            Action::NextMode => {
                doc.scene.render.mode = match doc.scene.render.mode {
                    Mode::Raycast => Mode::Slice,
                    Mode::Slice if !doc.scene.mesh.is_empty() || doc.scene.volume.is_some() => Mode::Surface,
                    _ if doc.scene.volume.is_some() => Mode::Raycast,
                    same => same,
                };
            }
            Action::SetMode(mode) => doc.scene.render.mode = mode,
            Action::Preset(name) => self.transfer.choose(&mut doc.scene.transfer, name),
            Action::ResetWindow => {
                doc.scene.transfer.window = None;
                doc.scene.transfer.level = None;
                self.slice_window = None;
            }
            Action::NewMap => {
                doc.add(crate::scene::Deformation::new("brush"));
                self.tool = Tool::BrushPush;
                self.show_panel(Panel::MapEditor);
            }
            _ => edit_selection(doc, action),
        }
    }

    /// Opens one of the bundled files.
    pub fn open_bundled(&mut self, ctx: &Context, name: &str) {
        match self.session.bundled(name) {
            Ok(path) => self.open(ctx, &path),
            Err(error) => self.report_error(&error),
        }
    }

    /// Arms a tool, or disarms it if it is already armed.
    pub fn arm(&mut self, tool: Tool) {
        self.pending_points.clear();
        self.tool = if self.tool == tool { Tool::Navigate } else { tool };
        if tool.brush().is_some() && self.tool == tool {
            self.before = false;
        }
    }

    /// Esc: cancels a drag, disarms a tool, deselects.
    pub(super) fn escape(&mut self) {
        if self.gesture.is_some() || self.stroke_before.is_some() {
            let gesture = self.gesture.take();
            self.view.lasso.clear();
            self.end_stroke();
            if let Some(doc) = &mut self.doc {
                self.history.revert(&mut doc.scene);
                if matches!(
                    gesture,
                    Some(Gesture::Orbit | Gesture::Pan | Gesture::Zoom | Gesture::Roll)
                ) && let Some(rest) = self.cameras.rest()
                {
                    doc.scene.camera = rest.clone();
                }
            }
        } else if !self.pending_points.is_empty() {
            self.pending_points.clear();
        } else if self.dialog.is_some() {
            self.dialog = None;
        } else if self.tool != Tool::Navigate {
            self.tool = Tool::Navigate;
        } else {
            self.select(Selection::Nothing);
        }
    }

    fn frame_selection(&mut self) {
        let Some(doc) = &self.doc else { return };
        let bounds = match doc.selected {
            Selection::Deformation(n) => doc.scene.deformation.get(n).and_then(|d| {
                let kind = super::gizmos::kind_of(d)?;
                Some(super::gizmos::BoxPlacement::of(d, kind, &doc.bounds()).bounds())
            }),
            Selection::Volume if doc.assets.has_volume => Some(doc.assets.volume.bounds_in_world()),
            Selection::Mesh(_) if !doc.assets.mesh_box.is_empty() => Some(doc.assets.mesh_box),
            _ => None,
        };
        let bounds = bounds.unwrap_or_else(|| doc.bounds());
        self.frame_box(&bounds);
    }

    /// The form for a clip: the selected deformation opening, or an orbit.
    fn clip_form(&self) -> ClipForm {
        let [w, h] = self.view.size();
        // Even edges, which video formats require.
        let size = [w.min(1920) & !1, h.min(1080) & !1];
        let travel = match self.selected_deformation() {
            Some(n) => ClipMotion::Progress(n),
            None => ClipMotion::Orbit,
        };
        let back = travel != ClipMotion::Orbit;
        ClipForm {
            travel,
            range: [0.0, 1.0],
            back,
            frames: 48,
            rate: 24.0,
            size,
        }
    }

    /// Applies the armed tool at a picked point.
    pub(super) fn use_tool(&mut self, ctx: &Context, pick: Option<Pick>) {
        match self.tool {
            Tool::Probe | Tool::Measure(_) => match pick {
                Some(p) => self.take_point(p.deformed, p.source),
                None => self.report(LogLevel::Info, "Nothing is visible at that point"),
            },
            Tool::Navigate => {
                // Adds a control point on the surface.
                if let Some(p) = pick {
                    self.add_control_point(ctx, p.deformed);
                }
            }
            _ => {}
        }
    }

    /// Adds a control point to the selected deformation at a visible point, without changing the
    /// deformation until the point is dragged.
    fn add_control_point(&mut self, ctx: &Context, seen: Vec3) {
        let Some(doc) = &self.doc else { return };
        let Some(n) = doc
            .deformation_index()
            .filter(|n| doc.scene.deformation[*n].kind == "points")
        else {
            return;
        };
        let (assets, scene) = (doc.assets.clone(), doc.scene.clone());
        self.start(ctx, "Adding a control point", move |_| {
            let part = |range: std::ops::Range<usize>| {
                let mut scene = scene.clone();
                scene.deformation = scene.deformation[range].to_vec();
                Deformed::new(&scene, &assets)
            };
            // `to` is the point before all later deformations; `from` is where this deformation's
            // own map takes it.
            let to = part(n + 1..scene.deformation.len())?
                .stack
                .source_and_alpha_unclipped(seen)
                .0;
            let from = part(n..n + 1)?.stack.source_and_alpha_unclipped(to).0;
            let pair = [super::state::tool::tidy(from), super::state::tool::tidy(to)].concat();
            let deformation = scene.deformation[n].clone();
            Ok(Box::new(move |app: &mut Workstation, _: &Context| {
                if let Some(d) = app
                    .doc
                    .as_mut()
                    .and_then(|doc| doc.scene.deformation.get_mut(n))
                    .filter(|d| **d == deformation)
                {
                    let mut pairs = d.parameters.numbers("pairs").ok().flatten().unwrap_or_default();
                    pairs.extend(pair);
                    d.parameters.insert("pairs", Argument::Numbers(pairs));
                }
            }))
        });
    }

    /// Places a deformation on what is visible, at a point or in the middle of the view, and
    /// selects it.
    pub fn place(&mut self, kind: &'static Kind, at: Option<Vec3>, object: Option<VisibleObject>) {
        let Some(doc) = &mut self.doc else { return };
        let object = object.unwrap_or_else(|| VisibleObject::of_box(&doc.bounds()));
        let object = match at {
            Some(point) => object.about(point),
            None => object,
        };
        let deformation = dropped(kind, &doc.bounds(), &object);
        if let Some(point) = at {
            // Moves the slices to the placed deformation.
            self.slices.cursor = Some(point.clamp(doc.bounds().min, doc.bounds().max));
        }
        doc.add(deformation);
        self.tool = Tool::Navigate;
        self.before = false;
        self.show_panel_if_hidden(Panel::Inspector);
    }

    fn show_panel_if_hidden(&mut self, panel: Panel) {
        self.panels_to_show.push((panel, false));
    }

    /// Adds a point to the current measurement.
    pub fn take_point(&mut self, deformed: Vec3, source: Vec3) {
        let kind = match self.tool {
            Tool::Probe => MeasureKind::Probe,
            Tool::Measure(kind) => kind,
            _ => return,
        };
        self.pending_points.push(PickedPoint { deformed, source });
        if self.pending_points.len() < kind.points() {
            return;
        }
        let points = self
            .pending_points
            .drain(..)
            .map(|p| super::state::tool::tidy(p.source))
            .collect();
        let Some(doc) = &mut self.doc else { return };
        let name = Some(format!(
            "{} {}",
            kind.name(),
            1 + doc.scene.measure.iter().filter(|m| m.kind == kind).count()
        ));
        doc.scene.measure.push(Measure {
            kind,
            name,
            points,
            label: None,
            before_resampling: false,
        });
        doc.selected = Selection::Measure(doc.scene.measure.len() - 1);
        self.show_panel_if_hidden(Panel::Measure);
    }

    /// Cuts out an outline, or restores it.
    pub fn lasso(
        &mut self,
        restores: bool,
        eye_mm: f32,
        origin: Vec3,
        right: Vec3,
        up: Vec3,
        outline: Vec<Vec2>,
    ) {
        let Some(doc) = &mut self.doc else { return };
        let rounded = |v: Vec3| Vec3::from(super::state::tool::tidy(v));
        let outline = outline.into_iter().map(|p| (p * 100.0).round() / 100.0).collect();
        doc.stroke(&Stroke::Lasso(Lasso {
            restores,
            eye_mm,
            origin: rounded(origin),
            right,
            up,
            outline,
        }));
        let n = doc.scene.deformation.len() - 1;
        if doc.strokes(n).len() == 1 && doc.scene.deformation[n].name.is_none() {
            doc.scene.deformation[n].name = Some("Lasso".into());
        }
    }

    /// Begins a stroke of the brush.
    pub(super) fn begin_stroke(&mut self) {
        let Some(doc) = &mut self.doc else { return };
        self.stroke_points.clear();
        let n = doc.painted();
        self.stroke_before = Some(doc.strokes(n));
        self.stroke_scene = self.view.picture().map(|p| p.of.scene.clone());
    }

    /// Adds a point to the stroke.
    pub(super) fn extend_stroke(&mut self, at: Vec3) {
        let Some(before) = self.stroke_before.clone() else {
            return;
        };
        let Some(tool) = self.tool.brush() else { return };
        let radius = self.brush.radius;
        let far = self
            .stroke_points
            .last()
            .is_none_or(|l| l.distance(at) >= STROKE_STEP * radius);
        if !far || self.stroke_points.len() >= MAX_STROKE_POINTS {
            return;
        }
        self.stroke_points.push(Vec3::from(super::state::tool::tidy(at)));
        let Some(tool) = StrokeTool::ALL.into_iter().find(|t| t.name() == tool) else {
            return;
        };
        if tool == StrokeTool::Push && self.stroke_points.len() < 2 {
            return;
        }
        let stroke = Stroke::Line {
            tool,
            radius_mm: radius,
            strength: self.brush.strength,
            points: self.stroke_points.clone(),
        };
        let Some(doc) = &mut self.doc else { return };
        let Some(n) = doc.scene.deformation.len().checked_sub(1) else {
            return;
        };
        let mut strokes = before;
        strokes.push(stroke.to_string());
        doc.set_strokes(n, &strokes);
    }

    /// Ends the stroke.
    pub(super) fn end_stroke(&mut self) {
        self.stroke_points.clear();
        self.stroke_before = None;
        self.stroke_scene = None;
    }

    /// Changes window and level of the slices by a drag: horizontally the window, vertically the
    /// level.
    pub(super) fn drag_window(&mut self, dx: f32, dy: f32) {
        let Some(doc) = &self.doc else { return };
        let range = doc.assets.volume.range;
        let [low, high] = self.slice_window.unwrap_or_else(|| {
            doc.assets
                .volume
                .window(doc.scene.transfer.window, doc.scene.transfer.level)
        });
        let per_point = (range[1] - range[0]).max(1e-9) / 600.0;
        let width = (high - low + f64::from(dx) * per_point).max((range[1] - range[0]).max(1e-9) * 1e-3);
        let level = 0.5 * (low + high) + f64::from(dy) * per_point;
        self.slice_window = Some([level - 0.5 * width, level + 0.5 * width]);
    }

    /// Changes window and level of the transfer function by a drag in the 3D view.
    pub(super) fn drag_transfer(&mut self, dx: f32, dy: f32) {
        let Some(doc) = &mut self.doc else { return };
        let volume = &doc.assets.volume;
        let Ok(function) = doc
            .scene
            .transfer
            .resolve(volume, doc.scene.default_preset(volume))
        else {
            return;
        };
        let [low, high] = function.domain();
        let per_point = (volume.range[1] - volume.range[0]).max(1e-9) / 600.0;
        let width = (high - low + f64::from(dx) * per_point)
            .max((volume.range[1] - volume.range[0]).max(1e-9) * 1e-3);
        let level = 0.5 * (low + high) + f64::from(dy) * per_point;
        doc.scene.transfer.window = Some(width);
        doc.scene.transfer.level = Some(level);
    }

    /// Checks the selected deformation, or all of them, for folds.
    fn check_field(&mut self, ctx: &Context) {
        let Some(doc) = &self.doc else { return };
        let (assets, mut scene) = (doc.assets.clone(), doc.shown(false));
        if let Some(n) = doc.deformation_index() {
            scene.deformation = vec![doc.scene.deformation[n].clone()];
        }
        self.start(ctx, "Checking the field", move |watch| {
            let exact = Deformed::exact(&scene, &assets, false, &crate::Watch::NONE)?;
            let maps: &[PlacedMap] = exact.stack.maps();
            let mut report = Vec::new();
            for (n, map) in maps.iter().enumerate() {
                watch.check()?;
                let health = CheckedField::of_map(map).health(false);
                report.push(super::panels::inspector::health_words(&health));
                (watch.progress)((n + 1) as f32 / maps.len() as f32);
            }
            let (level, text) = match report.len() {
                0 => (LogLevel::Info, "There is no field to check".to_owned()),
                _ => (
                    if report.iter().any(|r| r.0) {
                        LogLevel::Warning
                    } else {
                        LogLevel::Info
                    },
                    report.into_iter().map(|r| r.1).collect::<Vec<_>>().join("; "),
                ),
            };
            Ok(Box::new(move |app: &mut Workstation, _: &Context| {
                app.inspector.health = Some(text.clone());
                app.report(level, text);
            }))
        });
    }
}

/// Changes the selected object, or which one is selected.
fn edit_selection(doc: &mut Document, action: Action) {
    match action {
        Action::Delete => {
            doc.delete();
        }
        Action::Duplicate => {
            doc.duplicate();
        }
        Action::Mute => match doc.selected {
            Selection::Mesh(n) => {
                if let Some(mesh) = doc.scene.mesh.get_mut(n) {
                    mesh.hidden = !mesh.hidden;
                }
            }
            _ => {
                if let Some(d) = doc.deformation() {
                    d.enabled = !d.enabled;
                }
            }
        },
        Action::Solo => {
            if let Some(n) = doc.deformation_index() {
                doc.solo = if doc.solo == Some(n) { None } else { Some(n) };
            }
        }
        Action::MoveUp | Action::MoveDown => {
            if let Some(n) = doc.deformation_index() {
                let to = if action == Action::MoveUp {
                    n.checked_sub(1)
                } else {
                    Some(n + 1)
                };
                to.map(|to| doc.reorder(n, to));
            }
        }
        Action::Less | Action::More => {
            if let Some(d) = doc.deformation() {
                let by = if action == Action::More {
                    PROGRESS_STEP
                } else {
                    -PROGRESS_STEP
                };
                let to = d.progress.unwrap_or(1.0) + by;
                d.progress = Some(((to * 100.0).round() / 100.0).clamp(0.0, 1.0));
            }
        }
        Action::SelectNext => {
            let count = doc.scene.deformation.len();
            if count > 0 {
                doc.selected = Selection::Deformation(doc.deformation_index().map_or(0, |n| (n + 1) % count));
            }
        }
        _ => {}
    }
}
