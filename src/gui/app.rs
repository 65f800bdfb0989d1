//! Startup of the workstation, and the work of each of its frames.

use super::panels::{log, misplaced, start, status, toolbar};
use super::state::action;
use super::state::comparison::ComparePanel;
use super::state::document::Document;
use super::state::files::{Dialog, Files};
use super::state::history;
use super::state::history::{CameraHistory, History};
use super::state::layout::{LayoutPreset, Panel};
use super::state::log::{Log, LogLevel};
use super::state::panels::{
    Brush, Inspector, MapEditor, MeasurePanel, ScenePanel, Thumbnails, TransferPanel,
};
use super::state::session::Session;
use super::state::slices::Slices;
use super::state::tool::Tool;
use super::state::view::View3d;
use super::state::worker::{JobKind, JobOutput, JobTarget, ProbePurpose, ProbeResult, Prober, Worker};
use super::state::{Hover, Options, Workstation};
use super::text::wrapped;
use super::theme;
use crate::Error;
use crate::engine::Backend;
use crate::prepare::AssetKey;
use eframe::egui::{self, Context, Ui};
use egui_dock::{DockArea, DockState, TabViewer};
use std::collections::VecDeque;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// A frame of the interface that takes longer is reported in the log.
const SLOW_MS: f32 = 50.0;
/// Number of frames whose times are retained.
const FRAMES: usize = 2000;

impl Workstation {
    /// A workstation on an egui context.
    pub fn new(ctx: &Context, options: Options) -> Self {
        theme::install(ctx);
        // The workstation manages the interface scale itself.
        ctx.options_mut(|o| o.zoom_with_keyboard = false);
        let mut problems = Vec::new();
        let session = Session::open(options.folder, &mut problems);
        let backend = options.backend.unwrap_or(session.settings.backend);
        ctx.set_theme(if session.settings.light {
            egui::Theme::Light
        } else {
            egui::Theme::Dark
        });
        ctx.set_zoom_factor(session.settings.scale.clamp(0.5, 3.0));
        let layout = LayoutPreset::FourUp;
        let mut app = Self {
            doc: None,
            history: History::default(),
            cameras: CameraHistory::default(),
            worker: Worker::new(ctx, backend),
            prober: Prober::new(ctx),
            session,
            log: Log::default(),
            toasts: egui_notify::Toasts::default()
                .with_anchor(egui_notify::Anchor::BottomRight)
                .with_margin(egui::vec2(12.0, 40.0)),
            dock: layout.dock(),
            layout,
            panels_to_show: Vec::new(),
            tool: Tool::Navigate,
            gesture: None,
            view: View3d::default(),
            slices: Slices::default(),
            slice_window: None,
            transfer: TransferPanel::default(),
            compare: ComparePanel::default(),
            inspector: Inspector::default(),
            brush: Brush::default(),
            map_editor: MapEditor,
            scene_panel: ScenePanel,
            measure_panel: MeasurePanel::default(),
            thumbnails: Thumbnails::default(),
            measured: Vec::new(),
            measured_of: None,
            pending_points: Vec::new(),
            stroke_points: Vec::new(),
            stroke_before: None,
            stroke_scene: None,
            dropped: Vec::new(),
            hover: None,
            loading: None,
            tasks: Vec::new(),
            dialog: None,
            files: Files::new(),
            palette: None,
            key_list: None,
            entries: action::list(),
            before: false,
            space: false,
            serial: 0,
            edits: 0,
            last_scene: None,
            failed_assets: None,
            frame_ms: VecDeque::new(),
            quitting: false,
            failure: None,
            forced_backend: options.backend,
            title: String::new(),
        };
        app.apply_keys();
        for problem in problems {
            app.report(LogLevel::Warning, problem.to_string());
        }
        let left = app.session.left_behind();
        if let Some(file) = options.file {
            app.open(ctx, &file);
        }
        if !left.is_empty() && app.dialog.is_none() {
            app.dialog = Some(Dialog::Recover(left));
        }
        app
    }

    /// Reports a message: in the log, and as a toast if it is new.
    pub fn report(&mut self, level: LogLevel, text: impl Into<String>) {
        let text = text.into();
        if self.log.add(level, text.clone()) {
            let short: String = if text.chars().count() > 220 {
                text.chars().take(220).chain("… (see Log)".chars()).collect()
            } else {
                text
            };
            let wrapped = wrapped(&short, 58);
            let duration = Some(Duration::from_secs(if level == LogLevel::Info { 4 } else { 9 }));
            let toast = match level {
                LogLevel::Info => self.toasts.info(wrapped),
                LogLevel::Warning => self.toasts.warning(wrapped),
                LogLevel::Error => self.toasts.error(wrapped),
            };
            toast.duration(duration).closable(true);
        }
    }

    /// Reports an error; a cancelled task is reported as such.
    pub fn report_error(&mut self, error: &Error) {
        match error {
            Error::Cancelled => self.report(LogLevel::Info, "Cancelled"),
            other => self.report(LogLevel::Error, other.to_string()),
        }
    }

    /// Takes over the results of background threads.
    fn poll(&mut self, ctx: &Context) {
        self.poll_loading();
        self.poll_tasks(ctx);
        while let Some((level, text)) = self.worker.poll_message() {
            self.report(level, text);
        }
        while let Some(done) = self.worker.poll() {
            match done.outcome {
                Ok(output) => self.take(ctx, done.target, done.serial, done.ms, output),
                Err(error) => {
                    let text = error.to_string();
                    match done.target {
                        JobTarget::Coarse | JobTarget::Fine => {
                            self.picture_failed(done.target, done.serial, &text)
                        }
                        JobTarget::Slice(n) => self.slices.failed(n, done.serial, &text),
                        JobTarget::Compare(side) => self.compare.failed(side, done.serial, &text),
                        JobTarget::Preset(_) | JobTarget::Kind(_) | JobTarget::Measures => continue,
                    }
                    if self.failure.as_ref() != Some(&text) {
                        self.failure = Some(text.clone());
                        self.report(LogLevel::Error, text);
                    }
                }
            }
        }
        while let Some(answer) = self.prober.poll() {
            self.answered(ctx, answer);
        }
    }

    fn take(&mut self, ctx: &Context, target: JobTarget, serial: u64, ms: f64, output: JobOutput) {
        if matches!(target, JobTarget::Fine) {
            self.failure = None;
        }
        match (target, output) {
            (JobTarget::Coarse | JobTarget::Fine, JobOutput::Picture(shown)) => {
                self.view.arrived(ctx, target, serial, ms, *shown);
            }
            (JobTarget::Slice(n), JobOutput::Slice(picture)) => self.slices.arrived(ctx, n, serial, *picture),
            (JobTarget::Compare(side), JobOutput::Picture(shown)) => {
                self.compare_arrived(ctx, side, serial, ms, *shown)
            }
            (JobTarget::Preset(n), JobOutput::Picture(shown)) => {
                self.thumbnails.preset_arrived(ctx, n, shown.image)
            }
            (JobTarget::Kind(n), JobOutput::Picture(shown)) => {
                self.thumbnails.kind_arrived(ctx, n, shown.image)
            }
            (JobTarget::Measures, JobOutput::Measures(measured)) => self.measured = measured,
            _ => {}
        }
    }

    fn answered(&mut self, ctx: &Context, answer: ProbeResult) {
        if self
            .doc
            .as_ref()
            .is_none_or(|d| !Arc::ptr_eq(&d.assets, &answer.assets))
        {
            // The request was for a scene that has been closed.
            return;
        }
        // A failure has already been reported for the picture of the same scene.
        let pick = answer.pick.unwrap_or_default();
        match answer.purpose {
            ProbePurpose::Hover => {
                self.hover = pick.map(|p| Hover::new(&answer.assets, Some(p.deformed), p.source, p.value));
            }
            ProbePurpose::Center => {
                if let (Some(p), Some(doc)) = (pick, &mut self.doc) {
                    doc.scene.camera.target = Some(p.deformed.into());
                    self.slices.cursor = Some(p.deformed);
                }
            }
            ProbePurpose::Tool => self.use_tool(ctx, pick),
            ProbePurpose::Place => {
                if let Tool::Place(kind) = self.tool {
                    self.place(kind.0, pick.map(|p| p.deformed), answer.object);
                }
            }
            ProbePurpose::Brush { last } => {
                if let Some(p) = pick {
                    self.extend_stroke(p.deformed);
                }
                if last {
                    self.end_stroke();
                }
            }
        }
    }

    /// Opens files dropped onto the window.
    fn handle_drops(&mut self, ctx: &Context) {
        let dropped: Vec<PathBuf> =
            ctx.input(|i| i.raw.dropped_files.iter().map(|f| f.path().to_owned()).collect());
        self.dropped.extend(dropped);
        // The next file is opened when the scene of the previous one has loaded.
        if !self.dropped.is_empty() && self.loading.is_none() && self.dialog.is_none() {
            let path = self.dropped.remove(0);
            self.dropped(ctx, &path);
        }
        let hovering = ctx.input(|i| !i.raw.hovered_files.is_empty());
        if hovering {
            let painter =
                ctx.layer_painter(egui::LayerId::new(egui::Order::Foreground, egui::Id::new("drop")));
            let rect = ctx.content_rect();
            painter.rect_filled(rect, 0.0, egui::Color32::from_black_alpha(150));
            super::views::text(
                &painter,
                rect.center(),
                egui::Align2::CENTER_CENTER,
                "Drop to open",
                20.0,
                theme::ON_CANVAS,
            );
        }
    }

    /// Records changes once interaction rests: one undo step per gesture, cameras at rest, and what
    /// has to be reloaded or remeasured.
    fn settle(&mut self, ctx: &Context) {
        if let Err(error) = self.session.save_settings() {
            self.report_error(&error);
        }
        let Some(doc) = &mut self.doc else { return };
        doc.check_selection();
        // Typing a name is one step, as a drag is.
        let held = ctx.input(|i| i.pointer.any_down())
            || self.gesture.is_some()
            || self.stroke_before.is_some()
            || ctx.text_edit_focused();
        if !held {
            self.history.take_snapshot(&doc.scene);
            self.cameras.settle(&doc.scene.camera);
        }
        let scene_changed = self.last_scene.as_deref().is_none_or(|s| *s != doc.scene);
        if scene_changed {
            // Clicked points lie where the volume was displayed before the change.
            if self
                .last_scene
                .as_deref()
                .is_some_and(|s| s.deformation != doc.scene.deformation)
            {
                self.pending_points.clear();
            }
            self.edits += 1;
            self.last_scene = Some(Arc::new(doc.scene.clone()));
            self.failure = None;
        }
        let key = AssetKey::of(&doc.scene);
        if key != doc.loaded && self.loading.is_none() && self.failed_assets.as_ref() != Some(&key) && !held {
            self.reload(ctx);
        }
        self.measure_anew();
        if self.session.is_due() {
            self.autosave();
        }
    }

    /// Requests the values of the measurements if they or the deformation changed.
    fn measure_anew(&mut self) {
        let Some(doc) = &self.doc else { return };
        if doc.scene.measure.is_empty() {
            self.measured.clear();
            self.measured_of = None;
            return;
        }
        let mut plain = history::without_camera(&doc.scene);
        plain.transfer = Default::default();
        plain.light = Default::default();
        let measures = std::mem::take(&mut plain.measure);
        let assets = Arc::as_ptr(&doc.assets) as usize;
        let same = self
            .measured_of
            .as_ref()
            .is_some_and(|(m, s, a)| *m == measures && **s == plain && *a == assets);
        if !same {
            let (scene, loaded) = (Arc::new(plain), doc.assets.clone());
            self.measured_of = Some((measures.clone(), scene.clone(), assets));
            self.submit(JobTarget::Measures, scene, loaded, JobKind::Measures(measures));
        }
    }

    /// Writes an automatic save, from which the scene can be recovered after a crash.
    pub fn autosave(&mut self) {
        let Some(doc) = &self.doc else { return };
        let result = if doc.is_changed() {
            self.session.autosave(&doc.scene, doc.path.as_deref())
        } else {
            self.session.forget();
            Ok(())
        };
        if let Err(error) = result {
            self.report_error(&error);
        }
    }

    /// Shows the scene's name in the window title, with a mark if it has unsaved edits.
    fn update_title(&mut self, ctx: &Context) {
        let title = if self.doc.is_some() {
            format!("incise · {}", self.title())
        } else {
            "incise".to_owned()
        };
        if title != self.title {
            ctx.send_viewport_cmd(egui::ViewportCommand::Title(title.clone()));
            self.title = title;
        }
    }

    /// Handles a request to close the window: at once, or after a question.
    fn handle_close(&mut self, ctx: &Context) {
        if !ctx.input(|i| i.viewport().close_requested()) || self.quitting {
            return;
        }
        if !self.tasks.is_empty() {
            ctx.send_viewport_cmd(egui::ViewportCommand::CancelClose);
            self.dialog = Some(Dialog::Running);
        } else if self.doc.as_ref().is_some_and(Document::is_changed) {
            ctx.send_viewport_cmd(egui::ViewportCommand::CancelClose);
            self.dialog = Some(Dialog::Unsaved(super::state::files::NextStep::Quit));
        } else {
            self.session.forget();
        }
    }

    /// Closes the window without asking.
    pub(super) fn quit(&mut self, ctx: &Context) {
        self.quitting = true;
        self.session.forget();
        ctx.send_viewport_cmd(egui::ViewportCommand::Close);
    }

    /// One frame.
    pub fn frame(&mut self, ui: &mut Ui) {
        let start = Instant::now();
        let ctx = ui.ctx().clone();
        self.poll(&ctx);
        self.handle_close(&ctx);
        self.handle_drops(&ctx);
        self.handle_keys(&ctx);
        self.carry_out_all(&ctx, toolbar::ui(self, ui));
        self.carry_out_all(&ctx, status::ui(self, ui));
        let frame = egui::Frame::NONE.fill(ui.visuals().panel_fill);
        egui::CentralPanel::default().frame(frame).show(ui, |ui| {
            if self.doc.is_some() && self.loading.as_ref().is_none_or(|l| l.same) {
                self.carry_out_all(&ctx, misplaced::ui(self, ui));
                self.show_dock(ui);
            } else {
                self.carry_out_all(&ctx, start::ui(self, ui));
            }
        });
        self.arrange_panels();
        self.show_dialogs(&ctx);
        if let Some(mut palette) = self.palette.take() {
            let (requests, open) = palette.ui(self, &ctx);
            self.palette = open.then_some(palette);
            self.carry_out_all(&ctx, requests);
        }
        if let Some(mut keys) = self.key_list.take() {
            let (requests, open) = keys.ui(self, &ctx);
            self.key_list = open.then_some(keys);
            self.carry_out_all(&ctx, requests);
        }
        self.settle(&ctx);
        self.update_title(&ctx);
        self.refresh_view(&ctx);
        self.refresh_compare();
        self.refresh_thumbnails();
        self.toasts.show(&ctx);
        if self.loading.is_some() || !self.tasks.is_empty() {
            ctx.request_repaint_after_secs(0.1);
        } else if self.doc.is_some() {
            ctx.request_repaint_after(super::state::session::AUTOSAVE);
        }
        let ms = start.elapsed().as_secs_f32() * 1e3;
        if ms > SLOW_MS && self.frame_ms.len() > 30 {
            self.log
                .add(LogLevel::Info, format!("an interface frame took {ms:.0} ms"));
        }
        self.frame_ms.push_back(ms);
        if self.frame_ms.len() > FRAMES {
            self.frame_ms.pop_front();
        }
    }

    fn show_dock(&mut self, ui: &mut Ui) {
        let mut dock = std::mem::replace(&mut self.dock, DockState::new(Vec::new()));
        let mut style = egui_dock::Style::from_egui(ui.style());
        style.tab_bar.height = 26.0;
        style.tab_bar.bg_fill = ui.visuals().panel_fill;
        style.tab.tab_body.inner_margin = egui::Margin::same(0);
        style.tab.tab_body.stroke = egui::Stroke::NONE;
        style.separator.width = 3.0;
        style.separator.color_idle = ui.visuals().widgets.noninteractive.bg_stroke.color;
        DockArea::new(&mut dock)
            .style(style)
            .show_close_buttons(false)
            .show_leaf_close_all_buttons(false)
            .show_leaf_collapse_buttons(false)
            .show_inside(ui, &mut Tabs { app: self });
        // An arrangement chosen in the meantime is kept.
        if self.dock.iter_all_tabs().next().is_none() {
            self.dock = dock;
        }
    }

    /// Selects the backend.
    pub fn set_backend(&mut self, backend: Backend) {
        self.forced_backend = None;
        self.session.settings.backend = backend;
        self.worker.set_backend(backend);
        self.view.forget();
        self.compare.forget();
    }

    /// Brings a panel to the front, opening it if necessary.
    pub fn show_panel(&mut self, panel: Panel) {
        self.panels_to_show.push((panel, true));
    }

    /// Carries out the requests to [`Self::show_panel`], which are deferred because the dock is not
    /// accessible while panels are drawn.
    fn arrange_panels(&mut self) {
        for (panel, open) in std::mem::take(&mut self.panels_to_show) {
            match self.dock.find_tab(&panel) {
                Some(at) => {
                    let _there = self.dock.set_active_tab(at);
                }
                None if open => self.dock.push_to_first_leaf(panel),
                None => {}
            }
        }
    }
}

impl eframe::App for Workstation {
    fn ui(&mut self, ui: &mut Ui, _frame: &mut eframe::Frame) {
        self.frame(ui);
    }
}

struct Tabs<'a> {
    app: &'a mut Workstation,
}

impl TabViewer for Tabs<'_> {
    type Tab = Panel;

    fn id(&mut self, tab: &mut Panel) -> egui::Id {
        egui::Id::new(("panel", tab.title()))
    }

    fn title(&mut self, tab: &mut Panel) -> egui::WidgetText {
        tab.title().into()
    }

    fn scroll_bars(&self, _tab: &Panel) -> [bool; 2] {
        [false, false]
    }

    fn ui(&mut self, ui: &mut Ui, tab: &mut Panel) {
        match tab {
            Panel::View3d => self.app.draw(ui, |app| &mut app.view, View3d::ui),
            Panel::Axial => self.app.draw(
                ui,
                |app| &mut app.slices,
                |slices, state, ui| slices.ui(state, ui, 0),
            ),
            Panel::Coronal => self.app.draw(
                ui,
                |app| &mut app.slices,
                |slices, state, ui| slices.ui(state, ui, 1),
            ),
            Panel::Sagittal => self.app.draw(
                ui,
                |app| &mut app.slices,
                |slices, state, ui| slices.ui(state, ui, 2),
            ),
            Panel::Compare => self
                .app
                .draw(ui, |app| &mut app.compare, |panel, _, ui| panel.ui(ui)),
            side => {
                let side = *side;
                egui::Frame::NONE
                    .inner_margin(egui::Margin::symmetric(8, 6))
                    .show(ui, |ui| {
                        egui::ScrollArea::vertical()
                            .auto_shrink([false, false])
                            .show(ui, |ui| match side {
                                Panel::Scene => self.app.draw(ui, |app| &mut app.scene_panel, ScenePanel::ui),
                                Panel::Inspector => {
                                    self.app.draw(ui, |app| &mut app.inspector, Inspector::ui)
                                }
                                Panel::Transfer => {
                                    self.app.draw(ui, |app| &mut app.transfer, TransferPanel::ui)
                                }
                                Panel::Measure => {
                                    self.app.draw(ui, |app| &mut app.measure_panel, MeasurePanel::ui)
                                }
                                Panel::MapEditor => {
                                    self.app.draw(ui, |app| &mut app.map_editor, MapEditor::ui)
                                }
                                Panel::Log => {
                                    let requests = log::ui(self.app, ui);
                                    self.app.carry_out_all(&ui.ctx().clone(), requests);
                                }
                                // Shown without scrolling.
                                Panel::View3d
                                | Panel::Axial
                                | Panel::Coronal
                                | Panel::Sagittal
                                | Panel::Compare => {}
                            });
                    });
            }
        }
    }
}
