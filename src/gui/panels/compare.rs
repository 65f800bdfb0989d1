//! Two renderers of the same scene from the same camera: side by side, with a wipe, or as their
//! difference; with metrics.

use crate::compare::{difference, difference_picture};
use crate::engine::Quality;
use crate::gui::state::action::Action;
use crate::gui::state::comparison::*;
use crate::gui::state::worker::{JobKind, JobTarget, RenderedView};
use crate::gui::state::{Gesture, Workstation};
use crate::gui::text::number;
use crate::gui::theme;
use crate::gui::views::shown;
use crate::gui::views::text;
use crate::prepare::Assets;
use crate::scene::{Mode, Scene};
use eframe::egui::{self, Align2, Color32, ColorImage, Context, PointerButton, Rect, Sense, Slider, Stroke, TextureOptions, Ui, pos2, vec2};
use std::sync::Arc;
use std::time::Instant;

/// Pictures are requested after this time without a change, seconds.
const REST: f64 = 0.2;

/// Amplification of the displayed difference.
const AMPLIFY: f32 = 8.0;

impl Workstation {
    pub(in crate::gui) fn compare_arrived(&mut self, ctx: &Context, side: usize, serial: u64, ms: f64, shown: RenderedView) {
        let panel = &mut self.compare;
        if panel.serials.get(side) != Some(&serial) {
            return;
        }
        let result = &mut panel.results[side];
        match &mut result.texture {
            Some(texture) => texture.set(shown.image, TextureOptions::LINEAR),
            None => result.texture = Some(ctx.load_texture(format!("compare {side}"), shown.image, TextureOptions::LINEAR)),
        }
        result.picture = shown.picture.map(Arc::new);
        result.side = panel.requested_sides[side];
        result.delay.note(true);
        (result.stats, result.ms, result.backend, result.serial) = (shown.stats, ms, shown.device.name, serial);
        self.compare_numbers(ctx);
    }

    /// Computes the difference of the pair on another thread: it takes about as long as a frame.
    fn compare_numbers(&mut self, ctx: &Context) {
        let panel = &mut self.compare;
        let pair = (panel.results[0].serial, panel.results[1].serial);
        let current = (0..2).all(|n| panel.results[n].serial == panel.serials[n]);
        let (Some(a), Some(b)) = (panel.results[0].picture.clone(), panel.results[1].picture.clone()) else { return };
        if panel.difference_open || pair == panel.difference_of || !current || (a.width, a.height) != (b.width, b.height) {
            return;
        }
        panel.difference_open = true;
        self.start(ctx, "Comparing", move |_| {
            let found = difference(&a, &b).and_then(|numbers| Ok((numbers, difference_picture(&a, &b, AMPLIFY)?)));
            Ok(Box::new(move |app: &mut Workstation, ctx: &Context| {
                let panel = &mut app.compare;
                panel.difference_open = false;
                panel.difference_of = pair;
                match found {
                    Ok((numbers, picture)) => {
                        let size = [picture.width as usize, picture.height as usize];
                        let image = ColorImage::from_rgba_unmultiplied(size, &picture.over([0.0, 0.0, 0.0, 1.0]));
                        panel.difference = Some(numbers);
                        panel.difference_texture = Some(ctx.load_texture("difference", image, TextureOptions::LINEAR));
                    }
                    Err(error) => {
                        panel.difference = None;
                        app.report_error(&error);
                    }
                }
                app.compare_numbers(ctx);
            }))
        });
    }

    /// Requests the pair once the scene is at rest.
    pub(in crate::gui) fn refresh_compare(&mut self) {
        if !std::mem::take(&mut self.compare.was_drawn) || self.compare.pane[0] < 16 {
            return;
        }
        let Some(doc) = &self.doc else { return };
        let assets: Arc<Assets> = doc.assets.clone();
        let mut scene = doc.shown(self.shows_undeformed());
        scene.render.size = self.compare.pane;
        scene.measure.clear();
        let panel = &mut self.compare;
        let same_assets = panel.assets.as_ref().is_some_and(|a| Arc::ptr_eq(a, &assets));
        let wanted: [Scene; 2] = std::array::from_fn(|n| panel.sides[n].scene(&scene));
        let changed = (0..2).any(|n| !same_assets || panel.requested[n].as_deref().is_none_or(|a| *a != wanted[n]));
        panel.behind = changed;
        if !changed {
            return;
        }
        let pending: Vec<usize> = (0..2).filter(|n| !same_assets || panel.requested[*n].as_deref().is_none_or(|a| *a != wanted[*n])).collect();
        // During a drag the last pair is kept.
        if self.gesture.is_some() {
            self.compare.changed_at = Instant::now();
            return;
        }
        if self.compare.changed_at.elapsed().as_secs_f64() < REST {
            return;
        }
        self.compare.assets = Some(assets.clone());
        self.compare.behind = false;
        for n in pending {
            let shared = Arc::new(wanted[n].clone());
            self.compare.requested[n] = Some(shared.clone());
            let serial = self.submit(
                JobTarget::Compare(n),
                shared,
                assets.clone(),
                JobKind::Picture { counting: true, with_pixels: true, quality: Quality::Full },
            );
            let panel = &mut self.compare;
            (panel.serials[n], panel.requested_sides[n], panel.results[n].delay.failure) = (serial, Some(panel.sides[n]), None);
        }
    }

    /// The panel.
    pub(in crate::gui) fn show_compare(&mut self, ui: &mut Ui) {
        self.compare.was_drawn = true;
        let ctx = ui.ctx().clone();
        let export = self.show_compare_settings(ui);
        let (rect, response) = ui.allocate_exact_size(ui.available_size().max(vec2(32.0, 32.0)), Sense::click_and_drag());
        response.widget_info(|| egui::WidgetInfo::labeled(egui::WidgetType::Other, true, "Comparison view"));
        let painter = ui.painter_at(rect);
        painter.rect_filled(rect, 0.0, theme::CANVAS);
        let panel = &mut self.compare;
        let pane = panel.place_panes(rect, ctx.pixels_per_point());
        panel.note_delays();
        match panel.arrangement {
            Arrangement::Split => panel.draw_split(&painter, pane),
            Arrangement::Swipe => panel.draw_swipe(&painter, rect),
            Arrangement::Difference => panel.draw_difference(&painter, rect),
        }
        let failed = panel.results.iter().any(|r| r.delay.failure.is_some());
        if !panel.is_done() && !failed {
            text(&painter, pos2(rect.center().x, rect.bottom() - 10.0), Align2::CENTER_BOTTOM, "Rendering…", 13.0, theme::ON_CANVAS);
        }
        self.handle_compare_input(ui, &response, rect);
        if export {
            self.perform(&ctx, Action::ExportReport);
        }
        if !self.compare.is_done() && !failed {
            ctx.request_repaint_after_secs(REST as f32);
        }
    }

    /// Shows both sides' settings, the arrangement and the metrics; returns whether to export the
    /// report.
    fn show_compare_settings(&mut self, ui: &mut Ui) -> bool {
        let mut export = false;
        egui::Frame::NONE.inner_margin(egui::Margin::symmetric(8, 4)).show(ui, |ui| {
            ui.horizontal_wrapped(|ui| {
                for (n, label) in ["A", "B"].into_iter().enumerate() {
                    show_side_settings(ui, n, label, &mut self.compare.sides[n]);
                }
                ui.separator();
                for (a, w) in [(Arrangement::Split, "Split"), (Arrangement::Swipe, "Swipe"), (Arrangement::Difference, "Difference")] {
                    ui.selectable_value(&mut self.compare.arrangement, a, w);
                }
                ui.separator();
                export = ui.button("Export report…").clicked();
            });
            self.show_numbers(ui);
        });
        export
    }

    fn handle_compare_input(&mut self, ui: &Ui, response: &egui::Response, rect: Rect) {
        let delta = response.drag_delta();
        let modifiers = ui.input(|i| i.modifiers);
        if response.drag_started() {
            let line = rect.left() + self.compare.swipe * rect.width();
            let origin = ui.input(|i| i.pointer.press_origin()).unwrap_or_default();
            self.compare.wiping = self.compare.arrangement == Arrangement::Swipe && (origin.x - line).abs() < 14.0;
            self.gesture = Some(Gesture::Orbit);
        }
        if response.dragged() {
            if self.compare.wiping {
                if let Some(pos) = response.interact_pointer_pos() {
                    self.compare.swipe = ((pos.x - rect.left()) / rect.width()).clamp(0.02, 0.98);
                }
            } else if response.dragged_by(PointerButton::Secondary) {
                self.zoom((-delta.y * 0.01).exp());
            } else if response.dragged_by(PointerButton::Middle) || modifiers.shift {
                self.pan(delta.x, delta.y, rect);
            } else {
                self.orbit(delta.x, delta.y);
            }
        }
        if response.drag_stopped() {
            self.gesture = None;
            self.compare.wiping = false;
        }
        if response.hovered() {
            let scroll = ui.input(|i| i.smooth_scroll_delta.y);
            if scroll != 0.0 {
                self.zoom((scroll * 0.0025).exp());
            }
        }
    }

    fn show_numbers(&self, ui: &mut Ui) {
        let panel = &self.compare;
        ui.horizontal_wrapped(|ui| {
            for (n, label) in ["A", "B"].into_iter().enumerate() {
                let r = &panel.results[n];
                let samples = r.stats.map_or_else(
                    || "–".into(),
                    |s| format!("{:.2} M samples, {:.2} M skipped", s.samples_taken as f64 / 1e6, s.samples_skipped as f64 / 1e6),
                );
                ui.label(format!("{label} {:.0} ms, {samples}", r.ms));
                ui.separator();
            }
            match &panel.difference {
                Some(d) => {
                    let psnr = if d.psnr_db.is_finite() { format!("{:.1} dB", d.psnr_db) } else { "equal".into() };
                    ui.label(format!("mean {} / 255, max {} / 255, PSNR {psnr}, SSIM {:.4}", number(d.mean, ""), number(d.max, ""), d.ssim));
                }
                None => {
                    ui.label("…");
                }
            }
        });
    }
}

/// The renderer and the step of one side.
fn show_side_settings(ui: &mut Ui, n: usize, label: &str, side: &mut ComparisonSide) {
    let combo = egui::ComboBox::from_id_salt(("side", n)).selected_text(format!("{label}: {}", word(side.mode))).width(104.0).show_ui(ui, |ui| {
        for mode in [Mode::Slice, Mode::Raycast, Mode::Surface] {
            ui.selectable_value(&mut side.mode, mode, word(mode));
        }
    });
    combo.response.widget_info(|| egui::WidgetInfo::labeled(egui::WidgetType::ComboBox, true, format!("Renderer {label}")));
    ui.spacing_mut().slider_width = 84.0;
    let slider = ui
        .add(Slider::new(&mut side.step, 0.1..=4.0).clamping(egui::SliderClamping::Edits).logarithmic(true).max_decimals(2))
        .on_hover_text("Step, voxels");
    slider.widget_info(|| egui::WidgetInfo::slider(true, f64::from(side.step), format!("Step {label}")));
}

impl ComparePanel {
    /// Records the position and the required size of the pictures; returns the rectangle of the
    /// first.
    fn place_panes(&mut self, rect: Rect, pixels_per_point: f32) -> Rect {
        let pane = if self.arrangement == Arrangement::Split {
            Rect::from_min_size(rect.min, vec2((rect.width() / 2.0 - 1.0).max(16.0), rect.height()))
        } else {
            rect
        };
        let size = [(pane.width() * pixels_per_point) as u32, (pane.height() * pixels_per_point) as u32].map(|n| n.clamp(16, 4096));
        if size != self.pane {
            self.pane = size;
            self.changed_at = Instant::now();
        }
        self.rect = rect;
        pane
    }

    /// Updates which pictures are out of date.
    fn note_delays(&mut self) {
        for n in 0..2 {
            let current = self.is_current(n) && self.results[n].delay.failure.is_none();
            self.results[n].delay.note(current);
        }
    }

    /// Draws one side's picture. Title and dimming are those of the displayed picture.
    fn draw_side(&self, n: usize, painter: &egui::Painter, place: Rect, at: egui::Pos2, align: Align2) {
        let result = &self.results[n];
        let there = result.texture.as_ref().zip(result.side);
        if let Some((texture, _)) = there {
            shown::image(painter, texture, place);
        }
        result.delay.draw(painter, painter.clip_rect().intersect(place), there.is_some());
        if let Some((_, side)) = there {
            text(painter, at, align, format!("{} · {}", ["A", "B"][n], side.words()), 13.0, theme::ON_CANVAS);
        }
    }

    /// Draws the pictures side by side.
    fn draw_split(&self, painter: &egui::Painter, pane: Rect) {
        for n in 0..2 {
            let place = pane.translate(vec2(n as f32 * (pane.width() + 2.0), 0.0));
            self.draw_side(n, painter, place, place.min + vec2(8.0, 6.0), Align2::LEFT_TOP);
        }
    }

    /// Draws one picture left of the wipe line, the other right of it.
    fn draw_swipe(&self, painter: &egui::Painter, rect: Rect) {
        let x = rect.left() + self.swipe * rect.width();
        let left = painter.with_clip_rect(Rect::from_min_max(rect.min, pos2(x, rect.bottom())));
        let right = painter.with_clip_rect(Rect::from_min_max(pos2(x, rect.top()), rect.max));
        self.draw_side(0, &left, rect, rect.min + vec2(8.0, 6.0), Align2::LEFT_TOP);
        self.draw_side(1, &right, rect, pos2(rect.right() - 8.0, rect.top() + 6.0), Align2::RIGHT_TOP);
        painter.vline(x, rect.y_range(), Stroke::new(2.0, theme::SELECTED));
        painter.circle(pos2(x, rect.center().y), 7.0, theme::SELECTED, Stroke::new(2.0, Color32::from_black_alpha(200)));
    }

    /// Draws the amplified difference, dimmed if a side failed or is out of date.
    fn draw_difference(&self, painter: &egui::Painter, rect: Rect) {
        if let Some(texture) = &self.difference_texture {
            shown::image(painter, texture, rect);
            text(painter, rect.min + vec2(8.0, 6.0), Align2::LEFT_TOP, format!("Difference × {AMPLIFY}"), 13.0, theme::ON_CANVAS);
        }
        if let Some(result) =
            self.results.iter().find(|r| r.delay.failure.is_some()).or_else(|| self.results.iter().find(|r| r.delay.words(true).is_some()))
        {
            result.delay.draw(painter, rect, self.difference_texture.is_some());
        }
    }
}
