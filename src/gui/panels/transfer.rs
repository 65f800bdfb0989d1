//! The transfer function under the histogram: points to drag, window and level, presets as pictures.

use super::{gallery_item, heading};
use crate::gui::state::Workstation;
use crate::gui::state::action::Action;
use crate::gui::theme;
use crate::transfer::{self, Blend, ControlPoint, TransferFunction, TransferSettings};
use eframe::egui::{self, Color32, DragValue, Pos2, Rect, Sense, Shape, Slider, Stroke, Ui, pos2, vec2};
use egui_phosphor::regular as icon;

const HEIGHT: f32 = 118.0;

/// The function written out as points: what is edited.
fn explicit(function: &TransferFunction, settings: &TransferSettings) -> TransferSettings {
    TransferSettings {
        preset: settings.preset.clone(),
        points: function.points.clone(),
        gradient_opacity: function.gradient_opacity.clone(),
        blend: Some(function.blend),
        own_colors: settings.own_colors,
        ..TransferSettings::default()
    }
}

/// Opacity is drawn with its square root: what is thin matters most.
fn lifted(opacity: f32) -> f32 {
    opacity.clamp(0.0, 1.0).sqrt()
}

impl Workstation {
    /// The panel.
    pub(in crate::gui) fn show_transfer(&mut self, ui: &mut Ui) {
        let ctx = ui.ctx().clone();
        let Some(doc) = &mut self.doc else { return };
        if !doc.assets.has_volume {
            ui.label("This scene has no volume");
            return;
        }
        let assets = doc.assets.clone();
        let volume = &assets.volume;
        let fallback = doc.scene.default_preset(volume);
        let function = match doc.scene.transfer.resolve(volume, fallback) {
            Ok(function) => function,
            Err(error) => {
                ui.label(error.to_string());
                if ui.button("Reset to default").clicked() {
                    doc.scene.transfer = TransferSettings::default();
                }
                return;
            }
        };
        let heights = self.transfer.heights(volume).to_vec();
        let mut settings = doc.scene.transfer.clone();
        let (rect, response) = ui.allocate_exact_size(vec2(ui.available_width().max(48.0), HEIGHT), Sense::click_and_drag());
        response.widget_info(|| egui::WidgetInfo::labeled(egui::WidgetType::Other, true, "Transfer function curve"));
        let plot = rect.shrink2(vec2(6.0, 6.0));
        let [low, high] = volume.range;
        let span = (high - low).max(1e-9);
        let x_of = |value: f64| plot.left() + ((value - low) / span) as f32 * plot.width();
        let value_of = |x: f32| low + f64::from((x - plot.left()) / plot.width()) * span;
        let y_of = |opacity: f32| plot.bottom() - lifted(opacity) * plot.height();
        let opacity_of = |y: f32| ((plot.bottom() - y) / plot.height()).clamp(0.0, 1.0).powi(2);
        draw_plot(ui, rect, plot, &heights, &function, x_of, y_of);
        let places: Vec<Pos2> = function.points.iter().map(|p| pos2(x_of(p.value), y_of(p.opacity)).clamp(plot.min, plot.max)).collect();
        let under = |pos: Pos2| {
            let near = places.iter().enumerate().map(|(n, p)| (n, p.distance(pos))).min_by(|a, b| a.1.total_cmp(&b.1));
            near.filter(|(_, d)| *d < 11.0).map(|(n, _)| n)
        };
        let pointer = response.interact_pointer_pos().or_else(|| response.hover_pos());
        if response.drag_started()
            && let Some(origin) = ui.input(|i| i.pointer.press_origin())
        {
            self.transfer.point = under(origin);
            self.transfer.dragging = self.transfer.point.is_some();
        }
        if self.transfer.dragging
            && response.dragged()
            && let (Some(n), Some(pos)) = (self.transfer.point.filter(|n| *n < function.points.len()), pointer)
        {
            let mut next = explicit(&function, &settings);
            let before = n.checked_sub(1).map_or(f64::NEG_INFINITY, |m| next.points[m].value);
            let after = next.points.get(n + 1).map_or(f64::INFINITY, |p| p.value);
            next.points[n].value = value_of(pos.x).clamp(before, after);
            next.points[n].opacity = (opacity_of(pos.y) * 1000.0).round() / 1000.0;
            settings = next;
        }
        if response.drag_stopped() {
            self.transfer.dragging = false;
        }
        if response.clicked()
            && let Some(pos) = pointer
        {
            self.transfer.point = under(pos);
        }
        if response.double_clicked()
            && let Some(pos) = pointer.filter(|p| under(*p).is_none())
        {
            let mut next = explicit(&function, &settings);
            let value = value_of(pos.x);
            let at = next.points.partition_point(|p| p.value <= value);
            let color = next.points.get(at).or(next.points.last()).map_or([1.0; 3], |p| p.color);
            next.points.insert(at, ControlPoint { value, color, opacity: opacity_of(pos.y) });
            self.transfer.point = Some(at);
            settings = next;
        }
        if response.secondary_clicked()
            && let Some(n) = pointer.and_then(under)
            && function.points.len() > 1
        {
            let mut next = explicit(&function, &settings);
            next.points.remove(n);
            self.transfer.point = None;
            settings = next;
        }
        for (n, at) in places.iter().enumerate() {
            let selected = self.transfer.point == Some(n);
            let [r, g, b] = function.points[n].color.map(|c| (c * 255.0) as u8);
            ui.painter().circle(
                *at,
                if selected { 6.5 } else { 5.0 },
                Color32::from_rgb(r, g, b),
                Stroke::new(1.8, if selected { theme::SELECTED } else { Color32::from_gray(20) }),
            );
            if !selected {
                ui.painter().circle_stroke(*at, 6.0, Stroke::new(1.0, Color32::from_gray(190)));
            }
        }
        if let Some(pos) = response.hover_pos() {
            response.clone().on_hover_text_at_pointer(format!("{:.1}\nDrag points; double-click to add, right-click to remove", value_of(pos.x)));
        }
        // The selected point, as numbers.
        if let Some(n) = self.transfer.point.filter(|n| *n < function.points.len()) {
            ui.horizontal(|ui| {
                let mut p = function.points[n];
                let mut changed = ui.color_edit_button_rgb(&mut p.color).changed();
                changed |= ui.add(DragValue::new(&mut p.value).speed(span / 500.0).max_decimals(2).prefix("at ")).changed();
                let mut percent = 100.0 * p.opacity;
                changed |= ui
                    .add(DragValue::new(&mut percent).range(0.0..=100.0).speed(0.5).suffix(" %").max_decimals(1))
                    .on_hover_text("Opacity of one voxel")
                    .changed();
                if changed {
                    let mut next = explicit(&function, &settings);
                    let before = n.checked_sub(1).map_or(f64::NEG_INFINITY, |m| next.points[m].value);
                    let after = next.points.get(n + 1).map_or(f64::INFINITY, |q| q.value);
                    next.points[n] = ControlPoint { value: p.value.clamp(before, after), opacity: percent / 100.0, ..p };
                    settings = next;
                }
            });
        }
        ui.horizontal(|ui| {
            let [a, b] = function.domain();
            let (mut width, mut level) = (settings.window.unwrap_or(b - a), settings.level.unwrap_or(0.5 * (a + b)));
            let speed = span / 500.0;
            ui.label("Window");
            if ui.add(DragValue::new(&mut width).speed(speed).range(span * 1e-4..=span * 20.0).max_decimals(1)).changed() {
                settings.window = Some(width);
            }
            ui.label("Level");
            if ui.add(DragValue::new(&mut level).speed(speed).max_decimals(1)).changed() {
                settings.level = Some(level);
            }
        });
        ui.horizontal(|ui| {
            ui.spacing_mut().slider_width = (ui.available_width() - 130.0).max(50.0);
            let mut density = settings.density.unwrap_or(1.0);
            if ui
                .add(Slider::new(&mut density, 0.02..=20.0).clamping(egui::SliderClamping::Edits).logarithmic(true).text("density").max_decimals(2))
                .changed()
            {
                settings.density = Some(density);
            }
        });
        ui.horizontal(|ui| {
            ui.label("Blend");
            let now = function.blend;
            for (blend, word) in [(Blend::Composite, "composite"), (Blend::Mip, "MIP"), (Blend::Minip, "MinIP"), (Blend::Average, "average")] {
                if ui.selectable_label(now == blend, word).clicked() {
                    settings.blend = Some(blend);
                }
            }
        });
        doc.scene.transfer = settings;
        let mut act = None;
        ui.horizontal(|ui| {
            for (symbol, word, action) in
                [(icon::DOWNLOAD_SIMPLE, "Import", Action::ImportTransfer), (icon::FLOPPY_DISK, "Export", Action::ExportTransfer)]
            {
                if super::tool_button(ui, symbol, word, false, "As a file").clicked() {
                    act = Some(action);
                }
            }
            if ui.button("Reset").on_hover_text("Use the default preset for this volume").clicked() {
                doc.scene.transfer = TransferSettings::default();
            }
        });
        heading(ui, "Presets");
        self.show_presets(ui, fallback);
        if let Some(action) = act {
            self.perform(&ctx, action);
        }
    }

    fn show_presets(&mut self, ui: &mut Ui, fallback: &str) {
        self.thumbnails.shows_presets = true;
        let columns = ((ui.available_width() + 4.0) / 90.0).floor().max(1.0) as usize;
        let mut chosen = None;
        let now = self.doc.as_ref().and_then(|d| d.scene.transfer.preset.clone()).unwrap_or_else(|| fallback.to_owned());
        egui::Grid::new("presets").num_columns(columns).spacing(vec2(4.0, 4.0)).show(ui, |ui| {
            for (n, preset) in transfer::list().enumerate() {
                let response = gallery_item(ui, self.thumbnails.preset(n), icon::CUBE, preset.name, preset.name == now);
                if response.on_hover_text(format!("{}: {}", preset.name, preset.about)).clicked() {
                    chosen = Some(preset.name);
                }
                if (n + 1).is_multiple_of(columns) {
                    ui.end_row();
                }
            }
        });
        if let (Some(name), Some(doc)) = (chosen, &mut self.doc) {
            self.transfer.choose(&mut doc.scene.transfer, name);
        }
    }
}

fn draw_plot(ui: &Ui, rect: Rect, plot: Rect, heights: &[f32], function: &TransferFunction, x_of: impl Fn(f64) -> f32, y_of: impl Fn(f32) -> f32) {
    let painter = ui.painter().with_clip_rect(rect);
    painter.rect_filled(rect, 4.0, theme::CANVAS);
    let width = plot.width() / heights.len() as f32;
    for (n, h) in heights.iter().enumerate() {
        let x = plot.left() + n as f32 * width;
        let bar = Rect::from_min_max(pos2(x, plot.bottom() - h * plot.height()), pos2(x + width.max(1.0), plot.bottom()));
        painter.rect_filled(bar, 0.0, Color32::from_gray(58));
    }
    let p = &function.points;
    let at = |q: &ControlPoint| pos2(x_of(q.value), y_of(q.opacity));
    let color = |c: [f32; 3], a: f32| {
        let [r, g, b] = c.map(|v| (v * 255.0) as u8);
        Color32::from_rgba_unmultiplied(r, g, b, (a * 255.0) as u8)
    };
    let mut line: Vec<Pos2> = Vec::new();
    if let (Some(first), Some(last)) = (p.first(), p.last()) {
        line.push(pos2(plot.left().min(at(first).x), at(first).y));
        for pair in p.windows(2) {
            // The square root bends a straight rise of opacity.
            const PIECES: usize = 12;
            for n in 0..PIECES {
                let t = n as f32 / PIECES as f32;
                let t2 = (n + 1) as f32 / PIECES as f32;
                let mix = |t: f32| {
                    let value = pair[0].value + (pair[1].value - pair[0].value) * f64::from(t);
                    let c: [f32; 3] = std::array::from_fn(|k| pair[0].color[k] + (pair[1].color[k] - pair[0].color[k]) * t);
                    (pos2(x_of(value), y_of(pair[0].opacity + (pair[1].opacity - pair[0].opacity) * t)), c)
                };
                let ((a, ca), (b, cb)) = (mix(t), mix(t2));
                let mut mesh = egui::Mesh::default();
                mesh.colored_vertex(a, color(ca, 0.55));
                mesh.colored_vertex(b, color(cb, 0.55));
                mesh.colored_vertex(pos2(b.x, plot.bottom()), color(cb, 0.25));
                mesh.colored_vertex(pos2(a.x, plot.bottom()), color(ca, 0.25));
                mesh.add_triangle(0, 1, 2);
                mesh.add_triangle(0, 2, 3);
                painter.add(mesh);
                line.push(a);
            }
        }
        line.push(at(last));
        line.push(pos2(plot.right().max(at(last).x), at(last).y));
    }
    painter.add(Shape::line(line, Stroke::new(1.5, theme::ON_CANVAS)));
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::volume::phantom;

    /// Written out as points, a preset is the same function.
    #[test]
    fn editing_begins_where_the_preset_was() {
        let volume = phantom::from_spec("head-ct:size=24").unwrap();
        for preset in transfer::list() {
            let settings = TransferSettings { preset: Some(preset.name.into()), window: Some(300.0), level: Some(100.0), ..Default::default() };
            let function = settings.resolve(&volume, "grey").unwrap();
            let again = explicit(&function, &settings).resolve(&volume, "grey").unwrap();
            assert_eq!(function, again, "{}", preset.name);
        }
    }
}
