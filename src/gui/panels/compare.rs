//! Two renderers of the same scene from the same camera: side by side, with a wipe, or as their
//! difference; with metrics.

use crate::gui::state::Gesture;
use crate::gui::state::action::Action;
use crate::gui::state::comparison::*;
use crate::gui::state::request::{Request, Requests};
use crate::gui::text::number;
use crate::gui::theme;
use crate::gui::views::shown;
use crate::gui::views::text;
use crate::scene::Mode;
use eframe::egui::{self, Align2, Color32, PointerButton, Rect, Sense, Slider, Stroke, Ui, pos2, vec2};
use std::time::Instant;

/// The renderer and the step of one side.
fn show_side_settings(ui: &mut Ui, n: usize, label: &str, side: &mut ComparisonSide) {
    let combo = egui::ComboBox::from_id_salt(("side", n))
        .selected_text(format!("{label}: {}", word(side.mode)))
        .width(104.0)
        .show_ui(ui, |ui| {
            for mode in [Mode::Slice, Mode::Raycast, Mode::Surface] {
                ui.selectable_value(&mut side.mode, mode, word(mode));
            }
        });
    combo.response.widget_info(|| {
        egui::WidgetInfo::labeled(egui::WidgetType::ComboBox, true, format!("Renderer {label}"))
    });
    ui.spacing_mut().slider_width = 84.0;
    let slider = ui
        .add(
            Slider::new(&mut side.step, 0.1..=4.0)
                .clamping(egui::SliderClamping::Edits)
                .logarithmic(true)
                .max_decimals(2),
        )
        .on_hover_text("Step, voxels");
    slider.widget_info(|| egui::WidgetInfo::slider(true, f64::from(side.step), format!("Step {label}")));
}

impl ComparePanel {
    /// Draws the panel.
    pub(in crate::gui) fn ui(&mut self, ui: &mut Ui) -> Requests {
        self.was_drawn = true;
        let mut requests = Requests::default();
        self.show_settings(ui, &mut requests);
        let (rect, response) =
            ui.allocate_exact_size(ui.available_size().max(vec2(32.0, 32.0)), Sense::click_and_drag());
        response.widget_info(|| egui::WidgetInfo::labeled(egui::WidgetType::Other, true, "Comparison view"));
        let painter = ui.painter_at(rect);
        painter.rect_filled(rect, 0.0, theme::CANVAS);
        let pane = self.place_panes(rect, ui.ctx().pixels_per_point());
        self.note_delays();
        match self.arrangement {
            Arrangement::Split => self.draw_split(&painter, pane),
            Arrangement::Swipe => self.draw_swipe(&painter, rect),
            Arrangement::Difference => self.draw_difference(&painter, rect),
        }
        let failed = self.results.iter().any(|r| r.delay.failure.is_some());
        if !self.is_done() && !failed {
            text(
                &painter,
                pos2(rect.center().x, rect.bottom() - 10.0),
                Align2::CENTER_BOTTOM,
                "Rendering…",
                13.0,
                theme::ON_CANVAS,
            );
        }
        self.handle_input(ui, &response, rect, &mut requests);
        if !self.is_done() && !failed {
            ui.ctx().request_repaint_after_secs(REST as f32);
        }
        requests
    }

    /// Both sides' settings, the arrangement and the metrics.
    fn show_settings(&mut self, ui: &mut Ui, requests: &mut Requests) {
        egui::Frame::NONE
            .inner_margin(egui::Margin::symmetric(8, 4))
            .show(ui, |ui| {
                ui.horizontal_wrapped(|ui| {
                    for (n, label) in ["A", "B"].into_iter().enumerate() {
                        show_side_settings(ui, n, label, &mut self.sides[n]);
                    }
                    ui.separator();
                    for (a, w) in [
                        (Arrangement::Split, "Split"),
                        (Arrangement::Swipe, "Swipe"),
                        (Arrangement::Difference, "Difference"),
                    ] {
                        ui.selectable_value(&mut self.arrangement, a, w);
                    }
                    ui.separator();
                    if ui.button("Export report…").clicked() {
                        requests.perform(Action::ExportReport);
                    }
                });
                self.show_numbers(ui);
            });
    }

    /// Turns the camera, or moves the wipe line.
    fn handle_input(&mut self, ui: &Ui, response: &egui::Response, rect: Rect, requests: &mut Requests) {
        let delta = response.drag_delta();
        let modifiers = ui.input(|i| i.modifiers);
        if response.drag_started() {
            let line = rect.left() + self.swipe * rect.width();
            let origin = ui.input(|i| i.pointer.press_origin()).unwrap_or_default();
            self.wiping = self.arrangement == Arrangement::Swipe && (origin.x - line).abs() < 14.0;
            requests.0.push(Request::SetGesture(Some(Gesture::Orbit)));
        }
        if response.dragged() {
            if self.wiping {
                if let Some(pos) = response.interact_pointer_pos() {
                    self.swipe = ((pos.x - rect.left()) / rect.width()).clamp(0.02, 0.98);
                }
            } else if response.dragged_by(PointerButton::Secondary) {
                requests.0.push(Request::Zoom((-delta.y * 0.01).exp()));
            } else if response.dragged_by(PointerButton::Middle) || modifiers.shift {
                requests.0.push(Request::Pan(delta, rect));
            } else {
                requests.0.push(Request::Orbit(delta));
            }
        }
        if response.drag_stopped() {
            requests.0.push(Request::SetGesture(None));
            self.wiping = false;
        }
        if response.hovered() {
            let scroll = ui.input(|i| i.smooth_scroll_delta.y);
            if scroll != 0.0 {
                requests.0.push(Request::Zoom((scroll * 0.0025).exp()));
            }
        }
    }

    fn show_numbers(&self, ui: &mut Ui) {
        let panel = self;
        ui.horizontal_wrapped(|ui| {
            for (n, label) in ["A", "B"].into_iter().enumerate() {
                let r = &panel.results[n];
                let samples = r.stats.map_or_else(
                    || "–".into(),
                    |s| {
                        format!(
                            "{:.2} M samples, {:.2} M skipped",
                            s.samples_taken as f64 / 1e6,
                            s.samples_skipped as f64 / 1e6
                        )
                    },
                );
                ui.label(format!("{label} {:.0} ms, {samples}", r.ms));
                ui.separator();
            }
            match &panel.difference {
                Some(d) => {
                    let psnr = if d.psnr_db.is_finite() {
                        format!("{:.1} dB", d.psnr_db)
                    } else {
                        "equal".into()
                    };
                    ui.label(format!(
                        "mean {} / 255, max {} / 255, PSNR {psnr}, SSIM {:.4}",
                        number(d.mean, ""),
                        number(d.max, ""),
                        d.ssim
                    ));
                }
                None => {
                    ui.label("…");
                }
            }
        });
    }

    /// Records the position and the required size of the pictures; returns the rectangle of the
    /// first.
    fn place_panes(&mut self, rect: Rect, pixels_per_point: f32) -> Rect {
        let pane = if self.arrangement == Arrangement::Split {
            Rect::from_min_size(
                rect.min,
                vec2((rect.width() / 2.0 - 1.0).max(16.0), rect.height()),
            )
        } else {
            rect
        };
        let size = [
            (pane.width() * pixels_per_point) as u32,
            (pane.height() * pixels_per_point) as u32,
        ]
        .map(|n| n.clamp(16, 4096));
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
        result
            .delay
            .draw(painter, painter.clip_rect().intersect(place), there.is_some());
        if let Some((_, side)) = there {
            text(
                painter,
                at,
                align,
                format!("{} · {}", ["A", "B"][n], side.words()),
                13.0,
                theme::ON_CANVAS,
            );
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
        self.draw_side(
            1,
            &right,
            rect,
            pos2(rect.right() - 8.0, rect.top() + 6.0),
            Align2::RIGHT_TOP,
        );
        painter.vline(x, rect.y_range(), Stroke::new(2.0, theme::SELECTED));
        painter.circle(
            pos2(x, rect.center().y),
            7.0,
            theme::SELECTED,
            Stroke::new(2.0, Color32::from_black_alpha(200)),
        );
    }

    /// Draws the amplified difference, dimmed if a side failed or is out of date.
    fn draw_difference(&self, painter: &egui::Painter, rect: Rect) {
        if let Some(texture) = &self.difference_texture {
            shown::image(painter, texture, rect);
            text(
                painter,
                rect.min + vec2(8.0, 6.0),
                Align2::LEFT_TOP,
                format!("Difference × {AMPLIFY}"),
                13.0,
                theme::ON_CANVAS,
            );
        }
        if let Some(result) = self
            .results
            .iter()
            .find(|r| r.delay.failure.is_some())
            .or_else(|| self.results.iter().find(|r| r.delay.words(true).is_some()))
        {
            result
                .delay
                .draw(painter, rect, self.difference_texture.is_some());
        }
    }
}
