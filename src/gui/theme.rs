//! Colours, sizes and fonts: neutral greys behind pictures, one accent, no distinction of red from
//! green.

use eframe::egui::{
    self, Color32, CornerRadius, FontFamily, FontId, Stroke, TextStyle, Theme, Visuals, vec2,
};

/// The accent in the dark and in the light theme.
const ACCENT_DARK: Color32 = Color32::from_rgb(92, 170, 240);
const ACCENT_LIGHT: Color32 = Color32::from_rgb(20, 92, 170);

/// Background of pictures.
pub const CANVAS: Color32 = Color32::from_rgb(20, 22, 26);
/// Lines and text on pictures.
pub const ON_CANVAS: Color32 = Color32::from_rgb(226, 229, 233);
/// Handles: one colour per axis, distinguishable with any colour vision (orange, sky blue,
/// yellowish).
pub const AXES: [Color32; 3] = [
    Color32::from_rgb(240, 140, 60),
    Color32::from_rgb(110, 190, 245),
    Color32::from_rgb(240, 215, 110),
];
/// The selection on a picture.
pub const SELECTED: Color32 = Color32::from_rgb(120, 195, 255);

/// The accent of the current theme.
pub fn accent(ui: &egui::Ui) -> Color32 {
    if ui.visuals().dark_mode {
        ACCENT_DARK
    } else {
        ACCENT_LIGHT
    }
}

/// Installs the fonts and both themes.
pub fn install(ctx: &egui::Context) {
    let mut fonts = egui::FontDefinitions::default();
    egui_phosphor::add_to_fonts(&mut fonts, egui_phosphor::Variant::Regular);
    ctx.set_fonts(fonts);
    for theme in [Theme::Dark, Theme::Light] {
        ctx.set_visuals_of(theme, visuals(theme));
    }
    ctx.all_styles_mut(|style| {
        style.text_styles = [
            (TextStyle::Heading, FontId::new(16.0, FontFamily::Proportional)),
            (TextStyle::Body, FontId::new(13.5, FontFamily::Proportional)),
            (TextStyle::Button, FontId::new(13.5, FontFamily::Proportional)),
            (TextStyle::Small, FontId::new(13.0, FontFamily::Proportional)),
            (TextStyle::Monospace, FontId::new(13.0, FontFamily::Monospace)),
        ]
        .into();
        style.spacing.item_spacing = vec2(6.0, 5.0);
        style.spacing.button_padding = vec2(7.0, 3.0);
        style.spacing.interact_size.y = 22.0;
        style.interaction.tooltip_delay = 0.35;
    });
}

fn visuals(theme: Theme) -> Visuals {
    let dark = theme == Theme::Dark;
    let mut v = if dark { Visuals::dark() } else { Visuals::light() };
    let grey = |d: u8, l: u8| Color32::from_gray(if dark { d } else { l });
    let accent = if dark { ACCENT_DARK } else { ACCENT_LIGHT };
    v.panel_fill = grey(32, 243);
    v.window_fill = grey(38, 250);
    v.extreme_bg_color = grey(22, 255);
    v.faint_bg_color = grey(38, 236);
    v.weak_text_color = Some(grey(168, 92));
    v.widgets.noninteractive.fg_stroke = Stroke::new(1.0, grey(222, 28));
    v.widgets.noninteractive.bg_stroke = Stroke::new(1.0, grey(52, 214));
    v.widgets.inactive.fg_stroke = Stroke::new(1.0, grey(226, 28));
    v.widgets.inactive.weak_bg_fill = grey(50, 228);
    v.widgets.inactive.bg_fill = grey(62, 210);
    v.widgets.hovered.weak_bg_fill = grey(64, 216);
    v.widgets.hovered.bg_fill = grey(74, 200);
    v.widgets.hovered.bg_stroke = Stroke::new(1.0, grey(96, 170));
    v.widgets.active.weak_bg_fill = grey(76, 200);
    v.widgets.open.weak_bg_fill = grey(58, 220);
    v.selection.bg_fill = if dark {
        Color32::from_rgb(38, 84, 130)
    } else {
        Color32::from_rgb(176, 208, 242)
    };
    v.selection.stroke = Stroke::new(
        1.0,
        if dark {
            Color32::WHITE
        } else {
            Color32::from_rgb(10, 40, 80)
        },
    );
    v.hyperlink_color = accent;
    v.warn_fg_color = if dark {
        Color32::from_rgb(245, 185, 90)
    } else {
        Color32::from_rgb(140, 80, 0)
    };
    v.error_fg_color = if dark {
        Color32::from_rgb(255, 150, 120)
    } else {
        Color32::from_rgb(165, 40, 10)
    };
    v.slider_trailing_fill = true;
    let round = CornerRadius::same(4);
    for w in [
        &mut v.widgets.noninteractive,
        &mut v.widgets.inactive,
        &mut v.widgets.hovered,
        &mut v.widgets.active,
        &mut v.widgets.open,
    ] {
        w.corner_radius = round;
        w.expansion = 0.0;
    }
    v.window_corner_radius = CornerRadius::same(6);
    v
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Relative luminance, WCAG 2.1.
    fn luminance(c: Color32) -> f64 {
        let linear = |v: u8| {
            let v = f64::from(v) / 255.0;
            if v <= 0.03928 {
                v / 12.92
            } else {
                ((v + 0.055) / 1.055).powf(2.4)
            }
        };
        0.2126 * linear(c.r()) + 0.7152 * linear(c.g()) + 0.0722 * linear(c.b())
    }

    fn contrast(a: Color32, b: Color32) -> f64 {
        let (a, b) = (luminance(a), luminance(b));
        (a.max(b) + 0.05) / (a.min(b) + 0.05)
    }

    #[test]
    fn text_can_be_read() {
        for theme in [Theme::Dark, Theme::Light] {
            let v = visuals(theme);
            let texts = [
                v.widgets.noninteractive.fg_stroke.color,
                v.warn_fg_color,
                v.error_fg_color,
                v.hyperlink_color,
                v.weak_text_color(),
            ];
            for (n, text) in texts.into_iter().enumerate() {
                for back in [v.panel_fill, v.window_fill, v.faint_bg_color] {
                    assert!(
                        contrast(text, back) >= 4.5,
                        "{theme:?} {n}: {}",
                        contrast(text, back)
                    );
                }
            }
            assert!(
                contrast(
                    v.widgets.inactive.fg_stroke.color,
                    v.widgets.inactive.weak_bg_fill
                ) >= 4.5
            );
            assert!(contrast(v.selection.stroke.color, v.selection.bg_fill) >= 4.5);
        }
        assert!(AXES.iter().all(|c| contrast(*c, CANVAS) >= 4.5) && contrast(ON_CANVAS, CANVAS) >= 4.5);
    }
}
