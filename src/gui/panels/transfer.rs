//! The transfer function over the histogram: draggable points, window and level, presets as
//! pictures.

use super::{gallery_item, heading};
use crate::gui::state::Workstation;
use crate::gui::state::action::Action;
use crate::gui::state::panels::{Gallery, Thumbnails, TransferPanel};
use crate::gui::state::request::{Request, Requests};
use crate::gui::theme;
use crate::transfer::{self, Blend, ControlPoint, SuitablePreset, TransferFunction, TransferSettings};
use crate::volume::Volume;
use eframe::egui::{
    self, Color32, DragValue, Pos2, Rect, Response, Sense, Shape, Slider, Stroke, Ui, pos2, vec2,
};
use egui_phosphor::regular as icon;

const HEIGHT: f32 = 118.0;

/// The function as explicit points, for editing.
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

/// The plotted height of an opacity: its square root, which emphasises low opacities.
fn lifted(opacity: f32) -> f32 {
    opacity.clamp(0.0, 1.0).sqrt()
}

/// The axes of the plot.
#[derive(Clone, Copy)]
struct PlotAxes {
    /// The plot's rectangle.
    plot: Rect,
    /// The value at its left edge.
    low: f64,
    /// The range of values over the plot's width.
    span: f64,
}

impl PlotAxes {
    /// The horizontal position of a value.
    fn x_of(&self, value: f64) -> f32 {
        self.plot.left() + ((value - self.low) / self.span) as f32 * self.plot.width()
    }

    /// The value at a horizontal position.
    fn value_of(&self, x: f32) -> f64 {
        self.low + f64::from((x - self.plot.left()) / self.plot.width()) * self.span
    }

    /// The vertical position of an opacity.
    fn y_of(&self, opacity: f32) -> f32 {
        self.plot.bottom() - lifted(opacity) * self.plot.height()
    }

    /// The opacity at a vertical position.
    fn opacity_of(&self, y: f32) -> f32 {
        ((self.plot.bottom() - y) / self.plot.height())
            .clamp(0.0, 1.0)
            .powi(2)
    }
}

/// The plotted function.
struct Curve<'a> {
    function: &'a TransferFunction,
    axes: PlotAxes,
    /// The positions of its points.
    places: Vec<Pos2>,
}

impl<'a> Curve<'a> {
    /// A function plotted along axes.
    fn new(function: &'a TransferFunction, axes: PlotAxes) -> Self {
        let place = |p: &ControlPoint| {
            pos2(axes.x_of(p.value), axes.y_of(p.opacity)).clamp(axes.plot.min, axes.plot.max)
        };
        Self {
            function,
            axes,
            places: function.points.iter().map(place).collect(),
        }
    }

    /// The point at a position.
    fn point_under(&self, pos: Pos2) -> Option<usize> {
        let near = self
            .places
            .iter()
            .enumerate()
            .map(|(n, p)| (n, p.distance(pos)))
            .min_by(|a, b| a.1.total_cmp(&b.1));
        near.filter(|(_, d)| *d < 11.0).map(|(n, _)| n)
    }
}

impl TransferPanel {
    /// Draws the panel.
    pub(in crate::gui) fn ui(&mut self, state: &Workstation, ui: &mut Ui) -> Requests {
        let mut requests = Requests::default();
        let Some(doc) = &state.doc else { return requests };
        if !doc.assets.has_volume {
            ui.label("This scene has no volume");
            return requests;
        }
        let volume = &doc.assets.volume;
        let suitable = doc.scene.suitable_preset(volume);
        let function = match doc.scene.transfer.resolve(volume, suitable.name) {
            Ok(function) => function,
            Err(error) => {
                ui.label(error.to_string());
                if ui.button("Reset to default").clicked() {
                    requests.change(|doc| doc.scene.transfer = TransferSettings::default());
                }
                return requests;
            }
        };
        let mut settings = doc.scene.transfer.clone();
        let span = show_curve(ui, self, volume, &function, &mut settings);
        show_selected_point(ui, self.point, &function, span, &mut settings);
        show_window_and_level(ui, &function, span, &mut settings);
        show_density(ui, &mut settings);
        show_blend(ui, function.blend, &mut settings);
        if let Some(action) = show_file_buttons(ui, &mut settings) {
            requests.perform(action);
        }
        heading(ui, "Presets");
        self.show_presets(ui, &state.thumbnails, &suitable, &mut settings);
        requests.0.push(Request::MakeThumbnails(Gallery::Presets));
        if settings != doc.scene.transfer {
            requests.change(move |doc| doc.scene.transfer = settings);
        }
        requests
    }

    fn show_presets(
        &mut self,
        ui: &mut Ui,
        thumbnails: &Thumbnails,
        suitable: &SuitablePreset,
        settings: &mut TransferSettings,
    ) {
        let columns = ((ui.available_width() + 4.0) / 90.0).floor().max(1.0) as usize;
        let mut chosen = None;
        let now = settings.preset.as_deref().unwrap_or(suitable.name).to_owned();
        egui::Grid::new("presets")
            .num_columns(columns)
            .spacing(vec2(4.0, 4.0))
            .show(ui, |ui| {
                for (n, preset) in transfer::list().enumerate() {
                    let response = gallery_item(
                        ui,
                        thumbnails.preset(n),
                        icon::CUBE,
                        preset.name,
                        preset.name == now,
                    );
                    let mut about = format!("{}: {}", preset.name, preset.about);
                    if preset.name == suitable.name && settings.preset.is_none() {
                        about += &format!("\nChosen because {}", suitable.reason);
                    }
                    if response.on_hover_text(about).clicked() {
                        chosen = Some(preset.name);
                    }
                    if (n + 1).is_multiple_of(columns) {
                        ui.end_row();
                    }
                }
            });
        if let Some(name) = chosen {
            self.choose(settings, name);
        }
    }
}

/// The curve over the histogram, with points to drag; returns the range of values it spans.
fn show_curve(
    ui: &mut Ui,
    panel: &mut TransferPanel,
    volume: &Volume,
    function: &TransferFunction,
    settings: &mut TransferSettings,
) -> f64 {
    let heights = panel.heights(volume);
    let (rect, response) = ui.allocate_exact_size(
        vec2(ui.available_width().max(48.0), HEIGHT),
        Sense::click_and_drag(),
    );
    response
        .widget_info(|| egui::WidgetInfo::labeled(egui::WidgetType::Other, true, "Transfer function curve"));
    let [low, high] = volume.range;
    let axes = PlotAxes {
        plot: rect.shrink2(vec2(6.0, 6.0)),
        low,
        span: (high - low).max(1e-9),
    };
    let curve = Curve::new(function, axes);
    draw_plot(ui, rect, heights, &curve);
    drag_point(ui, &response, &curve, panel, settings);
    click_point(&response, &curve, panel, settings);
    draw_points(ui, &curve, panel.point);
    if let Some(pos) = response.hover_pos() {
        let value = axes.value_of(pos.x);
        response.on_hover_text_at_pointer(format!(
            "{value:.1}\nDrag points; double-click to add, right-click to remove"
        ));
    }
    axes.span
}

/// The position of the pointer while it interacts with the curve or hovers over it.
fn pointer_on(response: &Response) -> Option<Pos2> {
    response.interact_pointer_pos().or_else(|| response.hover_pos())
}

/// Moves the dragged point.
fn drag_point(
    ui: &Ui,
    response: &Response,
    curve: &Curve,
    panel: &mut TransferPanel,
    settings: &mut TransferSettings,
) {
    if response.drag_started()
        && let Some(origin) = ui.input(|i| i.pointer.press_origin())
    {
        panel.point = curve.point_under(origin);
        panel.dragging = panel.point.is_some();
    }
    if panel.dragging
        && response.dragged()
        && let (Some(n), Some(pos)) = (
            panel.point.filter(|n| *n < curve.function.points.len()),
            pointer_on(response),
        )
    {
        let mut next = explicit(curve.function, settings);
        let [before, after] = limits(&next.points, n);
        next.points[n].value = curve.axes.value_of(pos.x).clamp(before, after);
        next.points[n].opacity = (curve.axes.opacity_of(pos.y) * 1000.0).round() / 1000.0;
        *settings = next;
    }
    if response.drag_stopped() {
        panel.dragging = false;
    }
}

/// The values of a point's neighbours, which limit its movement.
fn limits(points: &[ControlPoint], n: usize) -> [f64; 2] {
    let before = n.checked_sub(1).map_or(f64::NEG_INFINITY, |m| points[m].value);
    let after = points.get(n + 1).map_or(f64::INFINITY, |p| p.value);
    [before, after]
}

/// Selects the clicked point; adds one on a double-click, removes one on a right-click.
fn click_point(
    response: &Response,
    curve: &Curve,
    panel: &mut TransferPanel,
    settings: &mut TransferSettings,
) {
    let pointer = pointer_on(response);
    if response.clicked()
        && let Some(pos) = pointer
    {
        panel.point = curve.point_under(pos);
    }
    if response.double_clicked()
        && let Some(pos) = pointer.filter(|p| curve.point_under(*p).is_none())
    {
        let mut next = explicit(curve.function, settings);
        let value = curve.axes.value_of(pos.x);
        let at = next.points.partition_point(|p| p.value <= value);
        let color = next
            .points
            .get(at)
            .or(next.points.last())
            .map_or([1.0; 3], |p| p.color);
        next.points.insert(
            at,
            ControlPoint {
                value,
                color,
                opacity: curve.axes.opacity_of(pos.y),
            },
        );
        panel.point = Some(at);
        *settings = next;
    }
    if response.secondary_clicked()
        && let Some(n) = pointer.and_then(|p| curve.point_under(p))
        && curve.function.points.len() > 1
    {
        let mut next = explicit(curve.function, settings);
        next.points.remove(n);
        panel.point = None;
        *settings = next;
    }
}

/// Draws the points of the curve.
fn draw_points(ui: &Ui, curve: &Curve, selected: Option<usize>) {
    for (n, at) in curve.places.iter().enumerate() {
        let selected = selected == Some(n);
        let [r, g, b] = curve.function.points[n].color.map(|c| (c * 255.0) as u8);
        ui.painter().circle(
            *at,
            if selected { 6.5 } else { 5.0 },
            Color32::from_rgb(r, g, b),
            Stroke::new(
                1.8,
                if selected {
                    theme::SELECTED
                } else {
                    Color32::from_gray(20)
                },
            ),
        );
        if !selected {
            ui.painter()
                .circle_stroke(*at, 6.0, Stroke::new(1.0, Color32::from_gray(190)));
        }
    }
}

/// The selected point, as numbers.
fn show_selected_point(
    ui: &mut Ui,
    selected: Option<usize>,
    function: &TransferFunction,
    span: f64,
    settings: &mut TransferSettings,
) {
    let Some(n) = selected.filter(|n| *n < function.points.len()) else {
        return;
    };
    ui.horizontal(|ui| {
        let mut p = function.points[n];
        let mut changed = ui.color_edit_button_rgb(&mut p.color).changed();
        changed |= ui
            .add(
                DragValue::new(&mut p.value)
                    .speed(span / 500.0)
                    .max_decimals(2)
                    .prefix("at "),
            )
            .changed();
        let mut percent = 100.0 * p.opacity;
        changed |= ui
            .add(
                DragValue::new(&mut percent)
                    .range(0.0..=100.0)
                    .speed(0.5)
                    .suffix(" %")
                    .max_decimals(1),
            )
            .on_hover_text("Opacity of one voxel")
            .changed();
        if changed {
            let mut next = explicit(function, settings);
            let [before, after] = limits(&next.points, n);
            next.points[n] = ControlPoint {
                value: p.value.clamp(before, after),
                opacity: percent / 100.0,
                ..p
            };
            *settings = next;
        }
    });
}

/// Window and level, as numbers.
fn show_window_and_level(
    ui: &mut Ui,
    function: &TransferFunction,
    span: f64,
    settings: &mut TransferSettings,
) {
    ui.horizontal(|ui| {
        let [a, b] = function.domain();
        let (mut width, mut level) = (
            settings.window.unwrap_or(b - a),
            settings.level.unwrap_or(0.5 * (a + b)),
        );
        let speed = span / 500.0;
        ui.label("Window");
        if ui
            .add(
                DragValue::new(&mut width)
                    .speed(speed)
                    .range(span * 1e-4..=span * 20.0)
                    .max_decimals(1),
            )
            .changed()
        {
            settings.window = Some(width);
        }
        ui.label("Level");
        if ui
            .add(DragValue::new(&mut level).speed(speed).max_decimals(1))
            .changed()
        {
            settings.level = Some(level);
        }
    });
}

/// The density slider.
fn show_density(ui: &mut Ui, settings: &mut TransferSettings) {
    ui.horizontal(|ui| {
        ui.spacing_mut().slider_width = (ui.available_width() - 130.0).max(50.0);
        let mut density = settings.density.unwrap_or(1.0);
        if ui
            .add(
                Slider::new(&mut density, 0.02..=20.0)
                    .clamping(egui::SliderClamping::Edits)
                    .logarithmic(true)
                    .text("density")
                    .max_decimals(2),
            )
            .changed()
        {
            settings.density = Some(density);
        }
    });
}

/// The selector of the blend mode.
fn show_blend(ui: &mut Ui, now: Blend, settings: &mut TransferSettings) {
    ui.horizontal(|ui| {
        ui.label("Blend");
        for (blend, word) in [
            (Blend::Composite, "composite"),
            (Blend::Mip, "MIP"),
            (Blend::Minip, "MinIP"),
            (Blend::Average, "average"),
        ] {
            if ui.selectable_label(now == blend, word).clicked() {
                settings.blend = Some(blend);
            }
        }
    });
}

/// Buttons to import, export and reset the function; returns the file action, if any.
fn show_file_buttons(ui: &mut Ui, settings: &mut TransferSettings) -> Option<Action> {
    let mut act = None;
    ui.horizontal(|ui| {
        for (symbol, word, action) in [
            (icon::DOWNLOAD_SIMPLE, "Import", Action::ImportTransfer),
            (icon::FLOPPY_DISK, "Export", Action::ExportTransfer),
        ] {
            if super::tool_button(ui, symbol, word, false, "As a file").clicked() {
                act = Some(action);
            }
        }
        if ui
            .button("Reset")
            .on_hover_text("Use the default preset for this volume")
            .clicked()
        {
            *settings = TransferSettings::default();
        }
    });
    act
}

/// Draws the histogram and the curve over it.
fn draw_plot(ui: &Ui, rect: Rect, heights: &[f32], curve: &Curve) {
    let plot = curve.axes.plot;
    let painter = ui.painter().with_clip_rect(rect);
    painter.rect_filled(rect, 4.0, theme::CANVAS);
    let width = plot.width() / heights.len() as f32;
    for (n, h) in heights.iter().enumerate() {
        let x = plot.left() + n as f32 * width;
        let bar = Rect::from_min_max(
            pos2(x, plot.bottom() - h * plot.height()),
            pos2(x + width.max(1.0), plot.bottom()),
        );
        painter.rect_filled(bar, 0.0, Color32::from_gray(58));
    }
    let p = &curve.function.points;
    let at = |q: &ControlPoint| pos2(curve.axes.x_of(q.value), curve.axes.y_of(q.opacity));
    let color = |c: [f32; 3], a: f32| {
        let [r, g, b] = c.map(|v| (v * 255.0) as u8);
        Color32::from_rgba_unmultiplied(r, g, b, (a * 255.0) as u8)
    };
    let mut line: Vec<Pos2> = Vec::new();
    if let (Some(first), Some(last)) = (p.first(), p.last()) {
        line.push(pos2(plot.left().min(at(first).x), at(first).y));
        for pair in p.windows(2) {
            // The square root bends a linear rise of opacity into a curve.
            const PIECES: usize = 12;
            for n in 0..PIECES {
                let t = n as f32 / PIECES as f32;
                let t2 = (n + 1) as f32 / PIECES as f32;
                let mix = |t: f32| {
                    let value = pair[0].value + (pair[1].value - pair[0].value) * f64::from(t);
                    let c: [f32; 3] =
                        std::array::from_fn(|k| pair[0].color[k] + (pair[1].color[k] - pair[0].color[k]) * t);
                    (
                        pos2(
                            curve.axes.x_of(value),
                            curve
                                .axes
                                .y_of(pair[0].opacity + (pair[1].opacity - pair[0].opacity) * t),
                        ),
                        c,
                    )
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

    /// Written as explicit points, a preset gives the same function.
    #[test]
    fn editing_begins_where_the_preset_was() {
        let volume = phantom::from_spec("head-ct:size=24").unwrap();
        for preset in transfer::list() {
            let settings = TransferSettings {
                preset: Some(preset.name.into()),
                window: Some(300.0),
                level: Some(100.0),
                ..Default::default()
            };
            let function = settings.resolve(&volume, "grey").unwrap();
            let again = explicit(&function, &settings).resolve(&volume, "grey").unwrap();
            assert_eq!(function, again, "{}", preset.name);
        }
    }
}
