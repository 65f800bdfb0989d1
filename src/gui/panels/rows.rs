//! Rows of the inspector and of dialogs: names, numbers, choices.

use crate::scene::Antialias;
use eframe::egui::{self, DragValue, Ui};

/// A name whose double-click resets its value to the default.
pub(super) fn label(ui: &mut Ui, text: &str, about: &str) -> egui::Response {
    let label = ui.add(egui::Label::new(text).sense(egui::Sense::click()));
    label.on_hover_text(format!("{about}\nDouble-click: back to the default"))
}

/// The same; returns whether the reset was requested.
pub(super) fn name(ui: &mut Ui, text: &str, about: &str) -> bool {
    label(ui, text, about).double_clicked()
}

/// A row of three numbers.
pub(super) fn three(ui: &mut Ui, values: &mut [f32; 3], speed: f32, suffix: &str, label: &str) -> bool {
    let mut changed = false;
    ui.horizontal(|ui| {
        ui.spacing_mut().item_spacing.x = 3.0;
        for (axis, v) in ["x", "y", "z"].into_iter().zip(values) {
            let response = ui.add(
                DragValue::new(v)
                    .speed(speed)
                    .max_decimals(2)
                    .suffix(suffix)
                    .range(-1e5..=1e5)
                    .clamp_existing_to_range(false),
            );
            response.widget_info(|| {
                egui::WidgetInfo::labeled(egui::WidgetType::DragValue, true, format!("{label} {axis}"))
            });
            changed |= response.changed();
        }
    });
    changed
}

/// A labelled drop-down list of values.
pub(super) fn choice<T: PartialEq + Copy>(ui: &mut Ui, word: &str, value: &mut T, all: &[(T, &str)]) {
    ui.horizontal(|ui| {
        ui.label(word);
        drop_down(ui, word, value, all);
    });
}

/// A slider with a label and a tooltip.
pub(super) fn slider(ui: &mut Ui, v: &mut f32, range: std::ops::RangeInclusive<f32>, word: &str, tip: &str) {
    ui.add(
        egui::Slider::new(v, range)
            .clamping(egui::SliderClamping::Edits)
            .text(word)
            .max_decimals(2),
    )
    .on_hover_text(tip);
}

/// The list alone, of which `word` is the name for assistive technology.
pub(super) fn drop_down<T: PartialEq + Copy>(ui: &mut Ui, word: &str, value: &mut T, all: &[(T, &str)]) {
    let now = all.iter().find(|(v, _)| v == value).map_or("", |(_, w)| w);
    let combo = egui::ComboBox::from_id_salt(word)
        .selected_text(now)
        .show_ui(ui, |ui| {
            for (v, w) in all {
                ui.selectable_value(value, *v, *w);
            }
        });
    combo
        .response
        .widget_info(|| egui::WidgetInfo::labeled(egui::WidgetType::ComboBox, true, word));
}

/// The choices of antialiasing.
pub(super) const ANTIALIAS: [(Antialias, &str); 5] = [
    (Antialias::Adaptive, "Adaptive"),
    (Antialias::OFF, "Off"),
    (Antialias::Grid(2), "2 × 2"),
    (Antialias::Grid(3), "3 × 3"),
    (Antialias::Grid(4), "4 × 4"),
];
