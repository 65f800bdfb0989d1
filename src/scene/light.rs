//! The `[light]` section: a key light and the light of the sky, Blinn-Phong.

use super::camera::View;
use crate::math::light::BlinnPhong;
use crate::{Error, Result};
use glam::{DVec3, Vec3};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The `[light]` section: a directional key light, and the even light of the sky.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Light {
    /// Strength of the sky: light from everywhere, 0..1.
    pub ambient: f32,
    /// Strength of the key light, 0..1.
    pub diffuse: f32,
    /// Specular coefficient (strength of the key light's highlight), 0..1.
    pub specular: f32,
    /// Specular exponent.
    pub shininess: f32,
    /// Direction towards the key light: right, up and towards the viewer for a headlight, otherwise
    /// L, P, S.
    pub direction: [f32; 3],
    /// The same as an angle, degrees, instead of `direction`: for a headlight from the viewer
    /// towards the right of the picture, otherwise from anterior towards the patient's left.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub azimuth: Option<f32>,
    /// Degrees above the viewer or, if it is no headlight, above the axial plane, -90..90.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub elevation: Option<f32>,
    /// Colour of the key light and of its highlight, 0..1.
    pub key_color: [f32; 3],
    /// Colour of the sky, 0..1.
    pub sky_color: [f32; 3],
    /// Angular radius of the key light, degrees: 0 casts sharp shadows, 5 to 10 those of a soft box.
    pub radius: f32,
    /// Whether the key light casts shadows.
    pub shadow: bool,
    /// Whether the light of the sky is dimmed in hollows.
    pub occlusion: bool,
    /// How far away material dims the light of the sky, mm; 15 % of the longest edge of what is
    /// visible if not stated.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub occlusion_mm: Option<f32>,
    /// How exactly shadows and occlusion are computed.
    pub quality: LightQuality,
    /// Whether the key light moves with the camera: a headlight.
    pub follows_camera: bool,
    /// Two-sided lighting, as scalar volumes need (their gradients have no outside).
    pub two_sided: bool,
}

impl Default for Light {
    fn default() -> Self {
        Self {
            ambient: 0.3,
            diffuse: 0.7,
            specular: 0.15,
            shininess: 24.0,
            direction: [-0.3, 0.5, 1.0],
            azimuth: None,
            elevation: None,
            key_color: [1.0; 3],
            sky_color: [1.0; 3],
            radius: 0.0,
            shadow: false,
            occlusion: false,
            occlusion_mm: None,
            quality: LightQuality::Fast,
            follows_camera: true,
            two_sided: true,
        }
    }
}

/// How exactly shadows and occlusion are computed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum LightQuality {
    /// From a light volume.
    #[default]
    Fast,
    /// By 256 rays for each sample, on the CPU.
    Reference,
}

/// A named light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LightPreset {
    /// Its name.
    pub name: &'static str,
    /// What it is for, one phrase.
    pub about: &'static str,
    ambient: f32,
    diffuse: f32,
    azimuth: f32,
    elevation: f32,
    key_color: [f32; 3],
    sky_color: [f32; 3],
}

/// The largest angular radius of a key light, degrees.
const MAX_RADIUS: f32 = 45.0;
/// The farthest reach of occlusion, mm.
const MAX_OCCLUSION_MM: f32 = 1e6;

const WHITE: [f32; 3] = [1.0; 3];

/// The named lights. All move with the camera.
pub const LIGHT_PRESETS: [LightPreset; 5] = [
    LightPreset {
        name: "headlight",
        about: "from the viewer: no side is dark",
        ambient: 0.3,
        diffuse: 0.7,
        azimuth: 0.0,
        elevation: 0.0,
        key_color: WHITE,
        sky_color: WHITE,
    },
    LightPreset {
        name: "studio",
        about: "a warm key light from the upper left, a cool sky",
        ambient: 0.35,
        diffuse: 0.75,
        azimuth: -40.0,
        elevation: 35.0,
        key_color: [1.0, 0.96, 0.9],
        sky_color: [0.86, 0.92, 1.0],
    },
    LightPreset {
        name: "operating-lamp",
        about: "strong and white from above the viewer",
        ambient: 0.25,
        diffuse: 0.85,
        azimuth: 0.0,
        elevation: 42.0,
        key_color: WHITE,
        sky_color: [0.9, 0.95, 1.0],
    },
    LightPreset {
        name: "raking",
        about: "from the left, nearly along the surface: relief",
        ambient: 0.2,
        diffuse: 0.9,
        azimuth: -66.0,
        elevation: 15.0,
        key_color: WHITE,
        sky_color: WHITE,
    },
    LightPreset {
        name: "back-light",
        about: "from behind: bright rims",
        ambient: 0.45,
        diffuse: 1.0,
        azimuth: 120.0,
        elevation: 35.0,
        key_color: [1.0, 0.97, 0.92],
        sky_color: [0.9, 0.94, 1.0],
    },
];

impl Light {
    /// Sets the direction, strengths and colours of a preset; keeps the highlight.
    pub fn choose(&mut self, preset: &LightPreset) {
        (self.ambient, self.diffuse) = (preset.ambient, preset.diffuse);
        (self.key_color, self.sky_color) = (preset.key_color, preset.sky_color);
        self.turn_to(preset.azimuth, preset.elevation);
        self.follows_camera = true;
    }

    /// Places the key light by angles, degrees.
    pub fn turn_to(&mut self, azimuth: f32, elevation: f32) {
        self.direction = Self::default().direction;
        (self.azimuth, self.elevation) = (Some(azimuth), Some(elevation));
    }

    /// Applies the text of `--light`: the name of a preset, settings `key=value`, or both.
    ///
    /// # Errors
    /// An unknown name, or a value that cannot be read.
    pub fn apply(&mut self, text: &str) -> Result<()> {
        for (n, part) in text.split(',').map(str::trim).enumerate() {
            let Some((key, value)) = part.split_once('=') else {
                let preset = LIGHT_PRESETS.iter().find(|p| n == 0 && p.name == part);
                self.choose(preset.ok_or_else(|| unknown(part))?);
                continue;
            };
            let number = || {
                let read = value.trim().parse::<f32>().ok().filter(|v| v.is_finite());
                read.ok_or_else(|| Error::value("--light", format!("{key}={value} is not a number")))
            };
            let switch = || match value.trim() {
                "on" => Ok(true),
                "off" => Ok(false),
                _ => Err(Error::value(
                    "--light",
                    format!("{key}={value} is not known; use on or off"),
                )),
            };
            match key.trim() {
                "azimuth" => self.turn_to(number()?, self.angles()[1]),
                "elevation" => self.turn_to(self.angles()[0], number()?),
                "radius" => self.radius = number()?,
                "key" => self.diffuse = number()?,
                "sky" => self.ambient = number()?,
                "shadow" => self.shadow = switch()?,
                "occlusion" => self.occlusion = switch()?,
                "quality" => {
                    self.quality = match value.trim() {
                        "fast" => LightQuality::Fast,
                        "reference" => LightQuality::Reference,
                        _ => {
                            let problem = format!("{key}={value} is not known; use fast or reference");
                            return Err(Error::value("--light", problem));
                        }
                    }
                }
                _ => return Err(unknown(part)),
            }
        }
        Ok(())
    }

    /// Azimuth and elevation of the key light, degrees.
    pub fn angles(&self) -> [f32; 2] {
        if self.azimuth.is_some() || self.elevation.is_some() {
            return [self.azimuth.unwrap_or(0.0), self.elevation.unwrap_or(0.0)];
        }
        let d = Vec3::from(self.direction).normalize_or(Vec3::Z);
        if self.follows_camera {
            [d.x.atan2(d.z).to_degrees(), d.y.asin().to_degrees()]
        } else {
            [d.x.atan2(-d.y).to_degrees(), d.z.asin().to_degrees()]
        }
    }

    /// The direction towards the key light: right, up and towards the viewer for a headlight,
    /// otherwise L, P, S. Not normalised.
    pub fn toward(&self) -> Vec3 {
        if self.azimuth.is_none() && self.elevation.is_none() {
            return Vec3::from(self.direction);
        }
        let [azimuth_deg, elevation_deg] = self.angles();
        let patient = View {
            azimuth_deg,
            elevation_deg,
        }
        .toward_eye();
        if self.follows_camera {
            // In front of the picture as the camera is in front of the patient.
            Vec3::new(patient.x, patient.z, -patient.y)
        } else {
            patient
        }
    }

    /// The Blinn-Phong coefficients.
    pub fn blinn_phong(&self) -> BlinnPhong {
        BlinnPhong {
            ambient: self.sky_color.map(|c| self.ambient * c),
            diffuse: self.key_color.map(|c| self.diffuse * c),
            specular: self.specular,
            shininess: self.shininess,
            highlight_color: self.key_color,
        }
    }

    /// Checks the values.
    ///
    /// # Errors
    /// The first setting outside its range.
    pub(super) fn check(&self) -> Result<()> {
        let unit = [
            ("ambient", [self.ambient; 3]),
            ("diffuse", [self.diffuse; 3]),
            ("specular", [self.specular; 3]),
            ("key_color", self.key_color),
            ("sky_color", self.sky_color),
        ];
        for (name, values) in unit {
            if let Some(value) = values.iter().find(|v| !(0.0..=1.0).contains(*v)) {
                return Err(Error::value(
                    format!("light.{name}"),
                    format!("{value} is outside 0 to 1"),
                ));
            }
        }
        if !(1.0..=10_000.0).contains(&self.shininess) {
            return Err(Error::value(
                "light.shininess",
                format!("{} is outside 1 to 10000", self.shininess),
            ));
        }
        if !(0.0..=MAX_RADIUS).contains(&self.radius) {
            return Err(Error::value(
                "light.radius",
                format!("{} is outside 0 to {MAX_RADIUS} degrees", self.radius),
            ));
        }
        if self
            .occlusion_mm
            .is_some_and(|mm| !(mm > 0.0 && mm <= MAX_OCCLUSION_MM))
        {
            return Err(Error::value(
                "light.occlusion_mm",
                format!("must be above 0 and at most {MAX_OCCLUSION_MM} mm"),
            ));
        }
        let direction = DVec3::from(self.direction.map(f64::from));
        if !(direction.is_finite() && direction.length() > 1e-6) {
            return Err(Error::value(
                "light.direction",
                "must be a direction: finite and not zero",
            ));
        }
        for (name, angle, most) in [
            ("azimuth", self.azimuth, 360.0),
            ("elevation", self.elevation, 90.0),
        ] {
            let Some(angle) = angle else { continue };
            // Not a number is outside as well.
            if !(-most..=most).contains(&angle) {
                return Err(Error::value(
                    format!("light.{name}"),
                    format!("{angle} is outside -{most} to {most} degrees"),
                ));
            }
            if self.direction != Self::default().direction {
                return Err(Error::value(
                    format!("light.{name}"),
                    "is stated with light.direction; state one of them",
                ));
            }
        }
        Ok(())
    }
}

fn unknown(part: &str) -> Error {
    Error::value(
        "--light",
        format!(
            "\"{part}\" is not known; give one of {} first, and then azimuth=, elevation=, radius= (degrees), key=, sky= (0 to 1), shadow=, occlusion= (on or off) or quality= (fast or reference)",
            LIGHT_PRESETS.map(|p| p.name).join(", ")
        ),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    fn close(a: Vec3, b: Vec3) -> bool {
        a.normalize().distance(b) < 1e-6
    }

    #[test]
    fn angles_are_those_of_the_picture_or_the_patient() {
        let mut light = Light::default();
        for (azimuth, elevation, headlight, patient) in [
            (0.0, 0.0, Vec3::Z, Vec3::NEG_Y),
            (90.0, 0.0, Vec3::X, Vec3::X),
            (-90.0, 0.0, Vec3::NEG_X, Vec3::NEG_X),
            (30.0, 90.0, Vec3::Y, Vec3::Z),
            (180.0, 0.0, Vec3::NEG_Z, Vec3::Y),
        ] {
            light.turn_to(azimuth, elevation);
            light.follows_camera = true;
            assert!(close(light.toward(), headlight), "{azimuth} {elevation}");
            light.follows_camera = false;
            assert!(close(light.toward(), patient), "{azimuth} {elevation}");
        }
    }

    #[test]
    fn angles_of_a_direction_lead_back_to_it() {
        for follows_camera in [true, false] {
            let mut light = Light {
                direction: [0.4, -0.7, 0.2],
                follows_camera,
                ..Light::default()
            };
            let before = light.toward().normalize();
            let [azimuth, elevation] = light.angles();
            light.turn_to(azimuth, elevation);
            assert!(close(light.toward(), before), "{follows_camera}");
        }
    }

    #[test]
    fn the_option_names_presets_and_values() {
        let mut light = Light::default();
        light.apply("raking,key=0.5, elevation=30").unwrap();
        assert_eq!((light.diffuse, light.ambient), (0.5, 0.2));
        assert_eq!(light.angles(), [-66.0, 30.0]);
        light.check().unwrap();
        for wrong in [
            "",
            "disco",
            "key=bright",
            "key=0.5,raking",
            "radius",
            "shadow=yes",
            "quality=best",
        ] {
            let error = Light::default().apply(wrong).unwrap_err().to_string();
            assert!(error.contains("--light"), "{wrong}: {error}");
        }
        for preset in LIGHT_PRESETS {
            let mut light = Light::default();
            light.choose(&preset);
            light.check().unwrap();
        }
    }

    #[test]
    fn a_direction_is_stated_once() {
        let mut light = Light::default();
        light.turn_to(10.0, 20.0);
        light.direction = [0.0, 1.0, 0.0];
        assert!(light.check().unwrap_err().to_string().contains("light.azimuth"));
        light.turn_to(10.0, 91.0);
        assert!(light.check().unwrap_err().to_string().contains("light.elevation"));
    }
}
