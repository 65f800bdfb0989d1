//! Settings that have no effect on a picture, and why: a scene's are named in a notice, an option's
//! are refused.

use super::objects::Stage;
use super::prepared::Prepared;
use crate::deform::kinds;
use crate::scene::surface::{Steps, SurfaceSettings};
use crate::scene::{Camera, Light, Mode, Normals, Projection, RenderSettings, Scene, SliceOrder};
use crate::transfer::{Blend, Preset, TransferSettings, preset};
use serde::Serialize;
use toml::Value;

/// A setting without effect.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct IdleSetting {
    /// Its section and key, as in a scene file.
    pub key: &'static str,
    /// Why it has no effect here, as the end of a sentence.
    pub reason: &'static str,
}

impl IdleSetting {
    /// A notice for the user.
    pub fn notice(&self) -> String {
        format!("{} has no effect here: {}", self.key, self.reason)
    }
}

const NO_VOLUME: &str = "it applies only to volumes (mode slice or raycast)";
const NO_SURFACE: &str = "no surface is shown";
const NO_RAYS: &str = "no surface is shown by rays through a distance field";
const NOT_SLICES: &str = "it applies only in mode slice";
const PROJECTION: &str = "MIP, MinIP and average are neither shaded nor composited";

/// Every setting that has no effect on a picture, whatever its value.
pub fn idle_settings(prepared: &Prepared, scene: &Scene) -> Vec<IdleSetting> {
    let settings = &prepared.settings;
    let mut all = Vec::new();
    let mut unless = |acts: bool, keys: &[&'static str], reason: &'static str| {
        if !acts {
            all.extend(keys.iter().map(|key| IdleSetting { key, reason }));
        }
    };
    let volume = settings.mode != Mode::Surface && prepared.volume().is_present;
    let composite = prepared.volume().blend == Blend::Composite;
    let surfaces = !prepared.surfaces.objects.is_empty();
    let rays = prepared.surfaces.objects.iter().any(|o| o.implicit.is_some());
    unless(
        volume,
        &[
            "render.normals",
            "render.filter",
            "render.gradient",
            "render.cut_faces",
            "render.iso",
            "render.iso_light",
            "render.preintegrated",
            "render.jitter",
            "render.early_termination",
            "light.two_sided",
            "light.specular",
            "light.shininess",
            "transfer.preset",
            "transfer.relative_to",
            "transfer.points",
            "transfer.window",
            "transfer.level",
            "transfer.blend",
            "transfer.density",
            "transfer.gradient_opacity",
            "transfer.own_colors",
        ],
        NO_VOLUME,
    );
    if volume {
        unless(
            composite,
            &[
                "render.normals",
                "render.filter",
                "render.gradient",
                "render.cut_faces",
                "render.iso",
                "render.iso_light",
                "render.preintegrated",
                "render.early_termination",
                "transfer.gradient_opacity",
            ],
            PROJECTION,
        );
        volume_settings(prepared, composite, &mut unless);
        let transfer = &scene.transfer;
        let named = transfer.preset.as_deref().and_then(preset);
        unless(
            transfer.points.is_empty() && named.is_none_or(Preset::depends_on_volume),
            &["transfer.relative_to"],
            "the transfer function states data values",
        );
    }
    slice_settings(prepared, &mut unless);
    light_settings(scene, volume && prepared.is_lit() || surfaces, &mut unless);
    unless(
        volume || rays,
        &["render.empty_space_skipping"],
        "nothing is sampled along rays",
    );
    unless(
        prepared.frame.view.projection == Projection::Perspective,
        &["camera.field_of_view"],
        "it applies only to a perspective view",
    );
    map_settings(prepared, scene, volume, rays, &mut unless);
    surface_settings(prepared, scene, surfaces, rays, &mut unless);
    all
}

/// What depends on slices.
fn slice_settings(prepared: &Prepared, unless: &mut impl FnMut(bool, &[&'static str], &'static str)) {
    let settings = &prepared.settings;
    unless(
        settings.mode == Mode::Slice,
        &["render.slab", "render.slice_order", "render.blend_format"],
        NOT_SLICES,
    );
    unless(
        settings.mode != Mode::Slice || prepared.has_slices(),
        &["render.slab", "render.slice_order", "render.blend_format"],
        "there is nothing to slice",
    );
    unless(
        prepared.slice_order() == settings.slice_order,
        &["render.slice_order"],
        "several surfaces are drawn back to front",
    );
}

/// What depends on deformations and cuts.
fn map_settings(
    prepared: &Prepared,
    scene: &Scene,
    volume: bool,
    rays: bool,
    unless: &mut impl FnMut(bool, &[&'static str], &'static str),
) {
    let settings = &prepared.settings;
    unless(
        prepared.stack.maps().len() > 1,
        &["render.precompose"],
        "it combines displacement maps, and the scene has fewer than two",
    );
    unless(
        scene
            .deformation
            .iter()
            .any(|d| d.enabled && kinds::kind(&d.kind).is_ok_and(|k| k.shape.is_some())),
        &["render.exact_cuts"],
        "the scene has no cut by a simple shape",
    );
    let differentiates =
        volume && prepared.is_lit() && matches!(settings.normals, Normals::Transformed | Normals::Blended)
            || rays;
    unless(
        prepared
            .stack
            .maps()
            .iter()
            .any(|map| map.map.has_displacement() || map.map.has_cuts())
            && differentiates,
        &["render.jacobian"],
        "no normal is transformed by a displacement map",
    );
    unless(
        !prepared.stack.is_empty(),
        &["render.map_filter"],
        "the scene has no displacement map",
    );
}

/// Settings of the light.
fn light_settings(
    scene: &Scene,
    is_shaded: bool,
    unless: &mut impl FnMut(bool, &[&'static str], &'static str),
) {
    unless(
        is_shaded,
        &[
            "light.follows_camera",
            "light.direction",
            "light.azimuth",
            "light.elevation",
            "light.ambient",
            "light.diffuse",
            "light.key_color",
            "light.sky_color",
            "light.shadow",
            "light.occlusion",
            "light.radius",
            "light.occlusion_mm",
            "light.quality",
        ],
        "nothing is shaded",
    );
    if !is_shaded {
        return;
    }
    let light = &scene.light;
    unless(
        light.shadow,
        &["light.radius"],
        "the key light casts no shadows (light.shadow)",
    );
    unless(
        light.occlusion,
        &["light.occlusion_mm"],
        "the light of the sky is not dimmed (light.occlusion)",
    );
    let casts_any = light.shadow || light.occlusion;
    unless(
        casts_any,
        &["light.quality"],
        "there are no shadows and no occlusion (light.shadow, light.occlusion)",
    );
    unless(
        !casts_any,
        &["light.two_sided"],
        "with shadows or occlusion, the light is that on the side that is seen",
    );
}

/// What depends on how a volume is shown.
fn volume_settings(
    prepared: &Prepared,
    composite: bool,
    unless: &mut impl FnMut(bool, &[&'static str], &'static str),
) {
    let settings = &prepared.settings;
    let is_iso = prepared.volume().iso.is_some();
    if composite {
        unless(
            settings.mode != Mode::Slice || prepared.slice_order() == SliceOrder::FrontToBack,
            &["render.early_termination"],
            "slices drawn back to front cannot terminate early",
        );
        unless(
            prepared.is_lit() || prepared.uses_gradient_opacity(),
            &["render.gradient"],
            "no gradient is needed without shading",
        );
        unless(
            !prepared.is_cubic(),
            &["render.gradient"],
            "cubic interpolation has gradients of its own",
        );
        unless(
            prepared.volume().grid.function.is_none(),
            &["render.filter"],
            "a function is not interpolated",
        );
        unless(
            prepared.is_lit(),
            &["light.two_sided", "light.specular", "light.shininess"],
            "the volume is not shaded",
        );
        unless(
            !prepared.cuts.is_empty() || !prepared.stack.is_empty(),
            &["render.cut_faces"],
            "nothing is cut",
        );
        unless(
            is_iso,
            &["render.iso_light"],
            "it applies only to the iso-surface of render.iso",
        );
        unless(
            !is_iso,
            &["render.preintegrated", "transfer.gradient_opacity"],
            "the iso-surface of render.iso is opaque",
        );
    } else {
        unless(
            false,
            &[
                "light.two_sided",
                "light.specular",
                "light.shininess",
                "render.blend_format",
                "render.slice_order",
            ],
            PROJECTION,
        );
    }
    unless(
        prepared.volume().grid.colors.is_some(),
        &["transfer.own_colors"],
        "the volume has no colours of its own",
    );
}

/// What depends on which surfaces are shown, and how.
fn surface_settings(
    prepared: &Prepared,
    scene: &Scene,
    surfaces: bool,
    rays: bool,
    unless: &mut impl FnMut(bool, &[&'static str], &'static str),
) {
    unless(
        surfaces,
        &[
            "surface.look",
            "surface.color",
            "surface.inside_color",
            "surface.cut_color",
            "surface.model",
            "surface.thickness",
            "surface.resolution",
        ],
        NO_SURFACE,
    );
    unless(rays, &["surface.steps", "surface.cut_skipping"], NO_RAYS);
    unless(
        rays && prepared.surfaces.steps == Steps::Threshold,
        &["surface.threshold"],
        "it applies only with steps = \"threshold\"",
    );
    unless(
        prepared.sliced_surfaces().next().is_none(),
        &[
            "surface.two_stage",
            "surface.steps",
            "surface.threshold",
            "render.slab",
        ],
        "slices sample surfaces themselves, one slice at a time",
    );
    let in_two_stages = prepared
        .surfaces
        .objects
        .iter()
        .any(|o| matches!(o.stage, Stage::Both(_)));
    unless(
        in_two_stages || !rays && surfaces,
        &["surface.two_stage"],
        "it needs a mesh file (not thick, not a depth map) that overlaps the box of a deformation",
    );
    unless(
        in_two_stages,
        &["surface.seam"],
        "nothing is rendered in two stages (surface.two_stage)",
    );
    unless(
        prepared.settings.mode == Mode::Surface && scene.volume.is_some(),
        &["surface.iso"],
        "it applies only in mode surface, to a scene with a volume",
    );
}

/// The settings of a scene that differ from their defaults, by section and key.
fn changed(scene: &Scene) -> Vec<String> {
    fn of<T: Serialize>(section: &str, own: &T, default: &T) -> Vec<String> {
        let table = |v: &T| match Value::try_from(v) {
            Ok(Value::Table(table)) => table,
            _ => toml::Table::new(),
        };
        let default = table(default);
        table(own)
            .into_iter()
            .filter(|(key, value)| default.get(key) != Some(value))
            .map(|(key, _)| format!("{section}.{key}"))
            .collect()
    }
    let mut all = of("render", &scene.render, &RenderSettings::default());
    // Scenes of version 1 refuse splines and segments without saying so, and where there are none
    // to be had, that asks for nothing else.
    let refuses = |key: &str| key == "render.preintegrated" && scene.render.preintegrated == Some(false);
    all.retain(|key| key != "render.filter" && !refuses(key));
    all.extend(of("light", &scene.light, &Light::default()));
    all.extend(of("surface", &scene.surface, &SurfaceSettings::default()));
    all.extend(of("camera", &scene.camera, &Camera::default()));
    all.extend(of("transfer", &scene.transfer, &TransferSettings::default()));
    if scene.volume.as_ref().is_some_and(|v| v.inside.is_some()) {
        all.push("volume.inside".into());
    }
    all
}

/// The settings that a scene states and that have no effect on its picture.
pub(super) fn ineffective_settings(prepared: &Prepared, scene: &Scene) -> Vec<IdleSetting> {
    let changed = changed(scene);
    let mut found: Vec<IdleSetting> = Vec::new();
    for idle in idle_settings(prepared, scene) {
        if changed.iter().any(|key| key == idle.key) && !found.iter().any(|f| f.key == idle.key) {
            found.push(idle);
        }
    }
    found
}
