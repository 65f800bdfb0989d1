//! Parsing of argument values.

use crate::deform::file_kinds::FILE_KINDS;
use crate::deform::{Argument, Storage};
use crate::scene::{DefaultPlacement, Deformation, Scene, Size};
use crate::volume::load::{RawLayout, ReadOptions};
use crate::{Error, Result};
use clap::Args;

/// Options that select the part of a volume's file to load.
#[derive(Args, Clone, Debug)]
pub struct VolumeArguments {
    /// DICOM series to load: its number from incise info, its UID, part of its description, or its
    /// modality; the largest by default.
    #[arg(long, value_name = "N|UID|TEXT")]
    series: Option<String>,
    /// Time point to load, counted from 1.
    #[arg(long, value_name = "N")]
    time: Option<usize>,
    /// Channel to load as a scalar volume, counted from 1.
    #[arg(long, value_name = "N")]
    channel: Option<usize>,
    /// Resolution level of a multiscale image (OME-Zarr); 0 is full resolution.
    #[arg(long, value_name = "N")]
    resolution: Option<usize>,
    /// Voxel spacing along i, j, k in mm, instead of the file's.
    #[arg(long, value_name = "X,Y,Z", value_parser = spacing)]
    spacing: Option<[f64; 3]>,
    /// Resample unevenly spaced slices onto a regular grid.
    #[arg(long)]
    resample: bool,
    /// Layout of a raw file, e.g. 256x256x128:u16[:be][:skip=BYTES][:components=N].
    #[arg(long, value_name = "WxHxD:TYPE", value_parser = RawLayout::parse)]
    raw: Option<RawLayout>,
}

impl VolumeArguments {
    /// These choices where given, else those of `before`.
    pub fn over(&self, before: &ReadOptions) -> ReadOptions {
        ReadOptions {
            series: self.series.clone().or_else(|| before.series.clone()),
            time: self.time.or(before.time),
            channel: self.channel.or(before.channel),
            level: self.resolution.or(before.level),
            spacing: self.spacing.or(before.spacing),
            resample: self.resample || before.resample,
            raw: self.raw.clone().or_else(|| before.raw.clone()),
        }
    }

    /// Applies these choices to a scene.
    ///
    /// # Errors
    /// A choice for a scene without a volume.
    pub fn apply(&self, scene: &mut Scene) -> Result<()> {
        let chosen = self.over(&ReadOptions::default());
        match &mut scene.volume {
            Some(volume) => volume.choice = self.over(&volume.choice),
            None if chosen.is_default() => {}
            None => {
                return Err(Error::value(
                    "--series, --time, --channel, --resolution, --spacing, --resample, --raw",
                    "apply to volumes, but this input has none",
                ));
            }
        }
        Ok(())
    }
}

/// Three positive numbers, or one for all.
fn spacing(text: &str) -> Result<[f64; 3], String> {
    let numbers: Vec<f64> = text
        .split(',')
        .map_while(|p| p.trim().parse().ok())
        .filter(|v: &f64| v.is_finite() && *v > 0.0)
        .collect();
    match numbers[..] {
        [s] if !text.contains(',') => Ok([s; 3]),
        [x, y, z] if text.split(',').count() == 3 => Ok([x, y, z]),
        _ => Err(format!(
            "\"{text}\" is not a spacing; write X,Y,Z in mm, e.g. 0.5,0.5,2"
        )),
    }
}

/// `512x512`.
pub fn picture_size(text: &str) -> Result<[u32; 2], String> {
    let parsed = text
        .split_once('x')
        .and_then(|(w, h)| Some([w.trim().parse().ok()?, h.trim().parse().ok()?]));
    parsed.ok_or_else(|| format!("\"{text}\" is not a size; write WIDTHxHEIGHT, e.g. 512x512"))
}

/// `R,G,B[,A]`: fractions of 1, or of 255 if any is above 1; `#rrggbb[aa]`; `transparent`.
pub fn background(text: &str) -> Result<[f32; 4], String> {
    if text == "transparent" {
        return Ok([0.0; 4]);
    }
    if let Some(hex) = text
        .strip_prefix('#')
        .filter(|h| (h.len() == 6 || h.len() == 8) && h.is_ascii())
    {
        let byte = |n: usize| {
            u8::from_str_radix(hex.get(2 * n..2 * n + 2).unwrap_or("ff"), 16).map(|b| f32::from(b) / 255.0)
        };
        if let (Ok(r), Ok(g), Ok(b), Ok(a)) = (byte(0), byte(1), byte(2), byte(3)) {
            return Ok([r, g, b, a]);
        }
    }
    let parts: Vec<f32> = text
        .split(',')
        .map_while(|p| p.trim().parse().ok())
        .filter(|v: &f32| *v >= 0.0 && *v <= 255.0)
        .collect();
    if parts.len() == text.split(',').count() && (3..=4).contains(&parts.len()) {
        let scale = if parts.iter().any(|&v| v > 1.0) {
            255.0
        } else {
            1.0
        };
        return Ok([
            parts[0] / scale,
            parts[1] / scale,
            parts[2] / scale,
            parts.get(3).map_or(1.0, |a| a / scale),
        ]);
    }
    Err(format!(
        "\"{text}\" is not a colour; write R,G,B or R,G,B,A (each 0..1, or each 0..255), #rrggbb, or transparent"
    ))
}

/// `KIND[:name=value,...]`, a value being one number or word, or several separated by commas.
///
/// # Errors
/// An unknown kind or name, a value that is not a number where one is required, too many or too few
/// of them.
pub fn deformation(text: &str) -> Result<Deformation> {
    let option = |problem: String| Error::value(format!("--deform {text}"), problem);
    let (kind, rest) = text.split_once(':').unwrap_or((text, ""));
    if !FILE_KINDS.iter().any(|k| k.name == kind) {
        crate::deform::kinds::kind(kind)?;
    }
    let mut deformation = Deformation::new(kind);
    // A part without "=" continues the value before it: center=90,110,160.
    let mut entries: Vec<(&str, Vec<&str>)> = Vec::new();
    for part in rest.split(',').filter(|_| !rest.is_empty()) {
        match (part.split_once('='), entries.last_mut()) {
            (Some((name, value)), _) => entries.push((name.trim(), vec![value.trim()])),
            (None, Some(last)) => last.1.push(part.trim()),
            (None, None) => return Err(option(format!("\"{part}\" has no name; write name=value"))),
        }
    }
    for (name, values) in entries {
        let numbers: Vec<f32> = values
            .iter()
            .map_while(|v| v.parse().ok())
            .filter(|v: &f32| v.is_finite())
            .collect();
        let all_numbers = numbers.len() == values.len();
        let need_numbers = || {
            if all_numbers {
                Ok(())
            } else {
                Err(option(format!("{name}={} is not a number", values.join(","))))
            }
        };
        let three = || {
            need_numbers().and_then(|()| {
                <[f32; 3]>::try_from(&numbers[..])
                    .map_err(|_| option(format!("{name} needs three numbers, x,y,z")))
            })
        };
        let one = || {
            need_numbers().and_then(|()| {
                if numbers.len() == 1 {
                    Ok(numbers[0])
                } else {
                    Err(option(format!("{name} needs one number")))
                }
            })
        };
        match name {
            "storage" => {
                deformation.storage = Some(match values[..] {
                    ["f16"] => Storage::F16,
                    ["snorm16"] => Storage::Snorm16,
                    ["snorm8"] => Storage::Snorm8,
                    ["f32"] => Storage::F32,
                    _ => return Err(option("storage is one of f16, snorm16, snorm8, f32".into())),
                });
            }
            "placement" => {
                deformation.placement = match values[..] {
                    ["visible"] => DefaultPlacement::Visible,
                    ["volume"] => DefaultPlacement::Volume,
                    _ => return Err(option("placement is visible or volume".into())),
                };
            }
            "center" => deformation.center = Some(three()?),
            "rotate" => deformation.rotate = Some(three()?),
            "size" if numbers.len() == 1 => deformation.size = Some(Size::Cube(one()?)),
            "size" => deformation.size = Some(Size::Box(three()?)),
            "progress" => deformation.progress = Some(one()?),
            "resolution" => deformation.resolution = Some(one()? as usize),
            "add" if matches!(values[..], ["true" | "false"]) => deformation.add = values[0] == "true",
            _ => {
                let argument = match (&values[..], &numbers[..]) {
                    (["true"], _) => Argument::Flag(true),
                    (["false"], _) => Argument::Flag(false),
                    ([_], [v]) => Argument::Number(*v),
                    (_, v) if all_numbers => Argument::Numbers(v.to_vec()),
                    ([word], _) => Argument::Text((*word).to_owned()),
                    (words, _) => Argument::Texts(words.iter().map(|w| (*w).to_owned()).collect()),
                };
                // An invalid number is rejected here, so that the message can quote the input.
                let numeric = crate::deform::kinds::kind(kind)
                    .is_ok_and(|k| k.parameters.iter().any(|p| p.name == name));
                if numeric {
                    one()?;
                }
                deformation.parameters.insert(name, argument);
            }
        }
    }
    Ok(deformation)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn deformations_as_in_the_manual() {
        let d = deformation("peel:center=90,110,160,size=80,progress=0.7,depth=9")
            .unwrap_or_else(|e| panic!("{e}"));
        assert_eq!(d.center, Some([90.0, 110.0, 160.0]));
        assert_eq!((d.size, d.progress), (Some(Size::Cube(80.0)), Some(0.7)));
        assert_eq!(d.parameters.number("depth").ok().flatten(), Some(9.0));
        assert!(deformation("pull").is_ok());
        let chain =
            deformation("field:path=warp.nii.gz,affine.mat,invert=true").unwrap_or_else(|e| panic!("{e}"));
        assert_eq!(
            chain.parameters.texts("path").ok().flatten(),
            Some(vec!["warp.nii.gz".to_owned(), "affine.mat".to_owned()])
        );
        assert_eq!(chain.parameters.flag("invert").ok(), Some(true));
        for bad in [
            "peal",
            "peel:3",
            "peel:center=1,2",
            "peel:depth=a",
            "peel:size=1,2",
            "peel:storage=u8",
        ] {
            assert!(deformation(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn colours_and_sizes() {
        assert_eq!(background("255,255,255"), Ok([1.0; 4]));
        assert_eq!(background("1,1,1,0"), Ok([1.0, 1.0, 1.0, 0.0]));
        assert_eq!(background("#ff0000"), Ok([1.0, 0.0, 0.0, 1.0]));
        assert_eq!(background("transparent"), Ok([0.0; 4]));
        for bad in ["", "1,2", "red", "#12", "1,2,3,4,5", "-1,0,0"] {
            assert!(background(bad).is_err(), "{bad}");
        }
        assert_eq!(picture_size("640x480"), Ok([640, 480]));
        assert!(picture_size("640").is_err() && picture_size("-1x3").is_err());
    }
}
