//! How the picture is made: sampling, shading, light, camera.

use super::light::show_light;
use crate::gui::panels::heading;
use crate::gui::panels::rows::{ANTIALIAS, choice, slider};
use crate::gui::state::document::Document;
use crate::gui::state::request::Requests;
use crate::scene::surface::SurfaceSettings;
use crate::scene::{
    BlendFormat, CutFaces, JacobianSource, MapFiltering, Mode, Normals, Projection, RenderSettings, Scene,
    SliceOrder, VolumeFilter,
};
use crate::volume::{GradientFilter, Volume};
use eframe::egui::{self, DragValue, Slider, Ui};

/// How the picture is made: sampling, shading, light, camera.
pub(super) fn show_picture_settings(ui: &mut Ui, doc: &Document, requests: &mut Requests) {
    let volume = &doc.assets.volume;
    let has_volume = doc.assets.has_volume;
    let mut scene = doc.scene.clone();
    ui.spacing_mut().slider_width = (ui.available_width() - 128.0).max(60.0);
    show_sampling(ui, &mut scene.render);
    if has_volume {
        // Greyed, with the reason, where it has no effect.
        let shaded = scene.render.mode != Mode::Surface;
        let shading = ui.add_enabled_ui(shaded, |ui| show_shading(ui, &mut scene.render, volume));
        if !shaded {
            shading
                .response
                .on_hover_text("These act on volumes (mode slice or raycast)");
        }
    }
    if has_volume && scene.render.mode == Mode::Slice {
        show_slices(ui, &mut scene.render);
    }
    if !scene.deformation.is_empty() {
        show_maps(ui, &mut scene.render);
    }
    if scene.render.mode == Mode::Surface && has_volume {
        show_iso_value(ui, &mut scene.surface, volume);
    }
    show_light(ui, &mut scene.light);
    show_camera(ui, &mut scene);
    if scene != doc.scene {
        requests.change(move |doc| doc.scene = scene);
    }
}

/// Step length and antialiasing.
fn show_sampling(ui: &mut Ui, render: &mut RenderSettings) {
    ui.add(
        Slider::new(&mut render.step, 0.1..=4.0)
            .clamping(egui::SliderClamping::Edits)
            .logarithmic(true)
            .text("step")
            .max_decimals(2),
    )
    .on_hover_text("Step length: distance between samples, in voxels");
    choice(ui, "Anti-aliasing", &mut render.antialias, &ANTIALIAS);
}

/// How slices are drawn.
fn show_slices(ui: &mut Ui, render: &mut RenderSettings) {
    ui.horizontal(|ui| {
        ui.label("Slab");
        ui.add(DragValue::new(&mut render.slab).range(1..=64).suffix(" slices"))
            .on_hover_text("Slices composited inside one fragment; 1 draws one polygon per slice");
    });
    choice(
        ui,
        "Slice order",
        &mut render.slice_order,
        &[
            (SliceOrder::BackToFront, "back to front"),
            (SliceOrder::FrontToBack, "front to back"),
        ],
    );
    choice(
        ui,
        "Blend format",
        &mut render.blend_format,
        &[
            (BlendFormat::Float32, "32-bit floats"),
            (BlendFormat::Float16, "16-bit floats"),
        ],
    );
}

/// How displacement maps are sampled.
fn show_maps(ui: &mut Ui, render: &mut RenderSettings) {
    choice(
        ui,
        "Map filter",
        &mut render.map_filter,
        &[
            (None, "automatic"),
            (Some(MapFiltering::Shader), "24-bit weights"),
            (Some(MapFiltering::Hardware), "8-bit weights"),
        ],
    );
    choice(
        ui,
        "Jacobians",
        &mut render.jacobian,
        &[
            (JacobianSource::Differences, "central differences"),
            (JacobianSource::Stored, "stored per texel"),
        ],
    );
}

/// Shading of the volume: normals, gradients, cut faces, iso-surface.
fn show_shading(ui: &mut Ui, render: &mut RenderSettings, volume: &Volume) {
    choice(
        ui,
        "Shading",
        &mut render.normals,
        &[
            (Normals::Blended, "gradients, blended into cut normals"),
            (Normals::Transformed, "transformed gradients"),
            (Normals::Source, "source gradients"),
            (Normals::None, "none (unshaded)"),
        ],
    );
    choice(
        ui,
        "Interpolation",
        &mut render.filter,
        &[(VolumeFilter::Cubic, "cubic"), (VolumeFilter::Linear, "linear")],
    );
    choice(
        ui,
        "Gradients",
        &mut render.gradient,
        &[
            (GradientFilter::Central, "central differences"),
            (GradientFilter::Sobel, "Sobel"),
        ],
    );
    choice(
        ui,
        "Cut faces",
        &mut render.cut_faces,
        &[
            (CutFaces::Lit, "shaded by the transfer function"),
            (CutFaces::Grey, "grey values, unshaded"),
        ],
    );
    let mut iso = render.iso.is_some();
    ui.horizontal(|ui| {
        if ui.checkbox(&mut iso, "Iso-surface at").changed() {
            render.iso = iso.then(|| volume.body_threshold());
        }
        if let Some(v) = &mut render.iso {
            let speed = (volume.range[1] - volume.range[0]) / 400.0;
            ui.add(DragValue::new(v).speed(speed).max_decimals(2));
        }
    });
    ui.checkbox(&mut render.exact_cuts, "Exact cuts")
        .on_hover_text("Cuts at the end of the stack as formulas instead of masks");
}

/// The iso-value of the surface that is shown in place of the volume.
fn show_iso_value(ui: &mut Ui, surface: &mut SurfaceSettings, volume: &Volume) {
    ui.horizontal(|ui| {
        ui.label("Iso-value");
        let mut v = surface.iso.unwrap_or_else(|| volume.body_threshold());
        if ui.add(DragValue::new(&mut v).max_decimals(2)).changed() {
            surface.iso = Some(v);
        }
    });
}

/// Projection, field of view and background.
fn show_camera(ui: &mut Ui, scene: &mut Scene) {
    heading(ui, "Camera");
    choice(
        ui,
        "Projection",
        &mut scene.camera.projection,
        &[
            (Projection::Perspective, "perspective"),
            (Projection::Orthographic, "orthographic"),
        ],
    );
    slider(
        ui,
        &mut scene.camera.field_of_view,
        5.0..=100.0,
        "field of view",
        "Vertical field of view in degrees",
    );
    ui.horizontal(|ui| {
        ui.label("Background");
        let [r, g, b, a] = scene.render.background;
        let mut color = [r, g, b];
        if ui.color_edit_button_rgb(&mut color).changed() {
            scene.render.background = [color[0], color[1], color[2], a];
        }
        let mut clear = a < 1.0;
        if ui.checkbox(&mut clear, "transparent").changed() {
            scene.render.background[3] = if clear { 0.0 } else { 1.0 };
        }
    });
}
