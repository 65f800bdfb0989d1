//! The light: presets, a ball to turn the key light, strengths and colours.

use crate::gui::panels::heading;
use crate::gui::panels::rows::slider;
use crate::math::light::LightShares;
use crate::scene::{LIGHT_PRESETS, Light};
use eframe::egui::{self, Color32, Pos2, Rect, Sense, Stroke, Ui, Vec2, vec2};

/// Edge of the ball, points.
const BALL: f32 = 72.0;

/// Where the light comes from, how strong it is, and its colours.
pub(super) fn show_light(ui: &mut Ui, light: &mut Light) {
    heading(ui, "Light");
    ui.horizontal(|ui| {
        ui.label("Preset");
        show_presets(ui, light);
    });
    ui.horizontal(|ui| {
        show_ball(ui, light);
        ui.vertical(|ui| {
            show_color(ui, "Key light", &mut light.key_color);
            show_color(ui, "Sky", &mut light.sky_color);
        });
    });
    let [mut azimuth, mut elevation] = light.angles();
    let before = [azimuth, elevation];
    slider(
        ui,
        &mut azimuth,
        -180.0..=180.0,
        "azimuth",
        "Direction of the key light in degrees; positive: from the right of the picture or, if it is no headlight, from the patient's left",
    );
    slider(
        ui,
        &mut elevation,
        -90.0..=90.0,
        "elevation",
        "Height of the key light in degrees",
    );
    if [azimuth, elevation] != before {
        light.turn_to(azimuth, elevation);
    }
    slider(
        ui,
        &mut light.ambient,
        0.0..=1.0,
        "ambient",
        "Strength of the sky: light from everywhere",
    );
    slider(
        ui,
        &mut light.diffuse,
        0.0..=1.0,
        "diffuse",
        "Strength of the key light",
    );
    slider(
        ui,
        &mut light.specular,
        0.0..=1.0,
        "specular",
        "Strength of the specular highlight",
    );
    slider(
        ui,
        &mut light.shininess,
        1.0..=200.0,
        "shininess",
        "Specular exponent; higher is tighter",
    );
    ui.checkbox(&mut light.shadow, "Shadows")
        .on_hover_text("The key light casts shadows, through every deformation and cut");
    if light.shadow {
        slider(
            ui,
            &mut light.radius,
            0.0..=20.0,
            "radius",
            "Angular radius of the key light in degrees; a larger one casts softer shadows",
        );
    }
    ui.checkbox(&mut light.occlusion, "Ambient occlusion")
        .on_hover_text("The light of the sky is dimmed in hollows");
    ui.checkbox(&mut light.follows_camera, "Headlight (moves with the camera)");
}

/// The presets, and the light of a new scene; the highlight stays.
fn show_presets(ui: &mut Ui, light: &mut Light) {
    let standard = Light {
        specular: light.specular,
        shininess: light.shininess,
        two_sided: light.two_sided,
        ..Light::default()
    };
    let chosen = LIGHT_PRESETS.iter().map(|preset| {
        let mut chosen = light.clone();
        chosen.choose(preset);
        (preset.name, preset.about, chosen)
    });
    let all: Vec<(&str, &str, Light)> = [("default", "the light of a new scene", standard)]
        .into_iter()
        .chain(chosen)
        .collect();
    let now = all.iter().find(|(.., of)| of == light).map(|(name, ..)| *name);
    let mut choice = None;
    let list = egui::ComboBox::from_id_salt("light preset")
        .selected_text(now.unwrap_or("custom"))
        .show_ui(ui, |ui| {
            for (name, about, of) in &all {
                let entry = ui.selectable_label(now == Some(*name), *name);
                if entry.on_hover_text(*about).clicked() {
                    choice = Some(of.clone());
                }
            }
        });
    list.response
        .widget_info(|| egui::WidgetInfo::labeled(egui::WidgetType::ComboBox, true, "Light preset"));
    if let Some(choice) = choice {
        *light = choice;
    }
}

/// A ball under the light; a drag moves its bright side.
fn show_ball(ui: &mut Ui, light: &mut Light) {
    let (rect, response) = ui.allocate_exact_size(Vec2::splat(BALL), Sense::click_and_drag());
    response.widget_info(|| {
        egui::WidgetInfo::labeled(egui::WidgetType::Other, true, "Direction of the key light")
    });
    if let Some(at) = response.interact_pointer_pos() {
        let [azimuth, elevation] = angles_at(rect, at);
        light.turn_to(azimuth, elevation);
    }
    let [azimuth, elevation] = light.angles().map(f32::to_radians);
    let toward = glam::Vec3::new(
        azimuth.sin() * elevation.cos(),
        elevation.sin(),
        azimuth.cos() * elevation.cos(),
    );
    let radius = BALL / 2.0 - 2.0;
    let mut mesh = egui::Mesh::default();
    // Rings of a hemisphere, lit as the scene is.
    const RINGS: u32 = 12;
    const SECTORS: u32 = 36;
    for ring in 0..=RINGS {
        let (sin, cos) = (ring as f32 / RINGS as f32 * std::f32::consts::FRAC_PI_2).sin_cos();
        for sector in 0..SECTORS {
            let (y, x) = (sector as f32 / SECTORS as f32 * std::f32::consts::TAU).sin_cos();
            let normal = glam::Vec3::new(sin * x, sin * y, cos);
            let lit = light
                .blinn_phong()
                .lit(glam::Vec3::splat(0.85), normal.dot(toward), 0.0, LightShares::ALL)
                .clamp(glam::Vec3::ZERO, glam::Vec3::ONE);
            let [r, g, b] = (lit * 255.0).to_array().map(|v| v as u8);
            let at = rect.center() + radius * vec2(normal.x, -normal.y);
            mesh.colored_vertex(at, Color32::from_rgb(r, g, b));
        }
    }
    for ring in 0..RINGS {
        for sector in 0..SECTORS {
            let next = (sector + 1) % SECTORS;
            let [a, b, c, d] = [(ring, sector), (ring, next), (ring + 1, sector), (ring + 1, next)]
                .map(|(ring, sector)| ring * SECTORS + sector);
            mesh.add_triangle(a, b, c);
            mesh.add_triangle(b, c, d);
        }
    }
    ui.painter().add(mesh);
    let mark = rect.center() + radius * vec2(toward.x, -toward.y);
    let stroke = Stroke::new(1.5, ui.visuals().text_color());
    if toward.z >= 0.0 {
        ui.painter().circle(mark, 3.5, Color32::WHITE, stroke);
    } else {
        ui.painter().circle_stroke(mark, 3.5, stroke);
    }
    response.on_hover_text(
        "Drag: the side that the key light shines on. A hollow mark: the light is behind; set azimuth beyond 90 degrees for that.",
    );
}

/// Azimuth and elevation of the light whose brightest point on the ball is at a position, degrees.
fn angles_at(rect: Rect, at: Pos2) -> [f32; 2] {
    let radius = BALL / 2.0 - 2.0;
    let offset = (at - rect.center()) / radius;
    let offset = if offset.length() > 1.0 {
        offset.normalized()
    } else {
        offset
    };
    let depth = (1.0 - offset.length_sq()).max(0.0).sqrt();
    // Whole degrees are enough, and readable.
    [
        offset.x.atan2(depth).to_degrees().round(),
        (-offset.y).asin().to_degrees().round(),
    ]
}

fn show_color(ui: &mut Ui, name: &str, color: &mut [f32; 3]) {
    ui.horizontal(|ui| {
        let label = ui.label(name);
        ui.color_edit_button_rgb(color).labelled_by(label.id);
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_ball_is_dragged_to_the_light() {
        let rect = Rect::from_min_size(Pos2::new(10.0, 20.0), Vec2::splat(BALL));
        let radius = BALL / 2.0 - 2.0;
        for (x, y, angles) in [
            (0.0, 0.0, [0.0, 0.0]),
            (0.5, 0.0, [30.0, 0.0]),
            (-3.0, 0.0, [-90.0, 0.0]),
            (0.0, -0.5, [0.0, 30.0]),
        ] {
            let at = rect.center() + radius * vec2(x, y);
            let found = angles_at(rect, at);
            assert!(
                (found[0] - angles[0]).abs() <= 1.0 && (found[1] - angles[1]).abs() <= 1.0,
                "{x} {y}: {found:?}"
            );
        }
    }
}
