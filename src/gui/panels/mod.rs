//! All interface elements other than the pictures: the toolbar, the panels, the status bar, the
//! empty window.

pub mod compare;
pub mod dialogs;
pub mod editor;
pub mod inspector;
pub mod log;
pub mod measures;
pub mod misplaced;
pub mod palette;
mod rows;
pub mod scene;
pub mod start;
pub mod status;
pub mod toolbar;
pub mod transfer;

use super::theme;
use eframe::egui::{self, Color32, Response, RichText, TextureHandle, Ui, WidgetInfo, WidgetType, vec2};

/// A button with an icon and a word; assistive technology receives the word alone.
pub fn tool_button(ui: &mut Ui, symbol: &str, word: &str, selected: bool, tip: &str) -> Response {
    let text = if symbol.is_empty() {
        word.to_owned()
    } else {
        format!("{symbol} {word}")
    };
    let response = ui.add(egui::Button::selectable(selected, text));
    labelled(&response, word, selected);
    if tip.is_empty() {
        response
    } else {
        response.on_hover_text(tip)
    }
}

/// A button with an icon alone.
pub fn icon_button(ui: &mut Ui, symbol: &str, word: &str) -> Response {
    let response = ui.add(egui::Button::new(symbol).frame(false).min_size(vec2(22.0, 22.0)));
    labelled(&response, word, false);
    response.on_hover_text(word)
}

fn labelled(response: &Response, word: &str, selected: bool) {
    let enabled = response.enabled();
    response.widget_info(|| WidgetInfo::selected(WidgetType::Button, enabled, selected, word));
}

/// A heading within a panel.
pub fn heading(ui: &mut Ui, text: &str) {
    ui.add_space(4.0);
    ui.label(RichText::new(text).strong());
}

/// A picture with a word below it, as a button.
pub fn gallery_item(
    ui: &mut Ui,
    texture: Option<&TextureHandle>,
    symbol: &str,
    word: &str,
    selected: bool,
) -> Response {
    let size = vec2(86.0, 92.0);
    let (rect, response) = ui.allocate_exact_size(size, egui::Sense::click_and_drag());
    response.widget_info(|| WidgetInfo::selected(WidgetType::Button, true, selected, word));
    let visuals = ui.style().interact_selectable(&response, selected);
    let painter = ui.painter();
    painter.rect(
        rect,
        4.0,
        visuals.weak_bg_fill,
        visuals.bg_stroke,
        egui::StrokeKind::Inside,
    );
    let picture = egui::Rect::from_min_size(rect.min + vec2(9.0, 4.0), vec2(68.0, 68.0));
    painter.rect_filled(picture, 3.0, theme::CANVAS);
    match texture {
        Some(texture) => {
            painter.image(
                texture.id(),
                picture,
                egui::Rect::from_min_max(egui::pos2(0.0, 0.0), egui::pos2(1.0, 1.0)),
                Color32::WHITE,
            );
        }
        None => {
            painter.text(
                picture.center(),
                egui::Align2::CENTER_CENTER,
                symbol,
                egui::FontId::proportional(24.0),
                Color32::from_gray(150),
            );
        }
    }
    let font = egui::FontId::proportional(13.0);
    let galley = painter.layout_no_wrap(word.to_owned(), font.clone(), visuals.text_color());
    let text = if galley.size().x > size.x - 6.0 {
        shortened(ui, word, size.x - 6.0)
    } else {
        word.to_owned()
    };
    ui.painter().text(
        egui::pos2(rect.center().x, rect.bottom() - 3.0),
        egui::Align2::CENTER_BOTTOM,
        text,
        font,
        visuals.text_color(),
    );
    response
}

/// A word truncated to a width.
fn shortened(ui: &Ui, word: &str, width: f32) -> String {
    let mut chars: Vec<char> = word.chars().collect();
    while chars.len() > 1 {
        chars.pop();
        let text: String = chars.iter().chain(['…'].iter()).collect();
        let galley =
            ui.painter()
                .layout_no_wrap(text.clone(), egui::FontId::proportional(13.0), Color32::WHITE);
        if galley.size().x <= width {
            return text;
        }
    }
    word.to_owned()
}
