//! What a TIFF says of itself: OME-XML, or ImageJ's description.

use super::super::image::{Channel, Meaning};
use super::pages::TiffDecoder;
use quick_xml::events::Event;
use tiff::tags::Tag;

/// A description of the pages.
#[derive(Debug, Default, PartialEq)]
pub(super) struct Description {
    /// Slices, channels, times.
    pub extents: Option<[usize; 3]>,
    /// Which of slices (0), channels (1) and times (2) varies fastest, then next.
    pub order: [usize; 3],
    /// mm, along x, y, z.
    pub spacing: [Option<f64>; 3],
    pub colors: Vec<Option<[u8; 3]>>,
    pub imagej: bool,
    pub has_unit: bool,
    pub ome: bool,
}

/// The description in the first page, which applies to all.
pub(super) fn described(pages: &mut TiffDecoder, file_bytes: u64) -> Description {
    // The decoder writes to the terminal if a description is longer than the file.
    let described = pages
        .image_ifd()
        .find_entry(Tag::ImageDescription)
        .is_some_and(|e| e.count() <= file_bytes);
    let text = described
        .then(|| pages.find_tag(Tag::ImageDescription))
        .and_then(Result::ok)
        .flatten()
        .and_then(|v| v.into_string().ok())
        .unwrap_or_default();
    let mut metadata = if text.contains("<OME") {
        ome(&text)
    } else {
        imagej(&text)
    };
    let resolution = |pages: &mut TiffDecoder, tag| -> Option<f64> {
        let per_unit = match pages.find_tag(tag).ok()?? {
            tiff::decoder::ifd::Value::Rational(a, b) => f64::from(a) / f64::from(b),
            other => f64::from(other.into_f32().ok()?),
        };
        (per_unit.is_finite() && per_unit > 0.0).then(|| 1.0 / per_unit)
    };
    if metadata.imagej {
        let unit = unit_of_imagej(&text);
        metadata.has_unit = unit.is_some();
        let mm = unit.unwrap_or(1.0);
        // In the unit given by the description; the tag's own unit is "none".
        metadata.spacing[0] = resolution(pages, Tag::XResolution).map(|s| s * mm);
        metadata.spacing[1] = resolution(pages, Tag::YResolution).map(|s| s * mm);
        metadata.spacing[2] = metadata.spacing[2].map(|s| s * mm);
    }
    metadata
}

impl Description {
    /// Slices, channels and times of `total` pages: the declared ones if they fit, else slices
    /// only.
    pub fn extents_of(&self, total: usize, warnings: &mut Vec<String>) -> [usize; 3] {
        match self.extents {
            Some(e)
                if e.iter().try_fold(1usize, |n, &d| n.checked_mul(d)) == Some(total)
                    || (self.imagej && total == 1) =>
            {
                e
            }
            Some(e) => {
                warnings.push(format!(
                    "contains {total} pages, not the {} x {} x {} it declares; they are read as slices",
                    e[0], e[1], e[2]
                ));
                [total, 1, 1]
            }
            None => [total, 1, 1],
        }
    }

    /// Name of the format.
    pub fn format(&self) -> &'static str {
        if self.ome {
            "OME-TIFF"
        } else if self.imagej {
            "ImageJ TIFF"
        } else {
            "TIFF"
        }
    }

    /// The meaning of the values with these channels and components.
    pub fn meaning(&self, channels: usize, components: usize) -> Meaning {
        if channels > 1 {
            let color = |c: usize| {
                self.colors
                    .get(c)
                    .copied()
                    .flatten()
                    .unwrap_or(super::super::super::colors::CHANNELS[c % 4])
            };
            Meaning::Channels(
                (0..channels)
                    .map(|c| Channel {
                        color: color(c),
                        window: None,
                    })
                    .collect(),
            )
        } else if components > 2 {
            Meaning::Color
        } else {
            Meaning::Unstated
        }
    }
}

/// ImageJ's description: `name=value` lines.
fn imagej(text: &str) -> Description {
    let mut metadata = Description {
        order: [1, 0, 2],
        ..Description::default()
    };
    if !text.starts_with("ImageJ=") {
        return metadata;
    }
    metadata.imagej = true;
    let get = |name: &str| {
        text.lines()
            .find_map(|l| l.strip_prefix(name)?.strip_prefix('=').map(str::trim))
    };
    let whole = |name: &str| get(name).and_then(|v| v.parse::<usize>().ok()).filter(|n| *n > 0);
    let images = whole("images").unwrap_or(1);
    let (channels, times) = (whole("channels").unwrap_or(1), whole("frames").unwrap_or(1));
    let slices = whole("slices").or_else(|| {
        images
            .checked_div(channels.saturating_mul(times))
            .filter(|n| *n > 0)
    });
    metadata.extents = slices.map(|s| [s, channels, times]);
    metadata.spacing[2] = get("spacing").and_then(|v| v.parse().ok()).map(f64::abs);
    metadata
}

/// Millimetres per unit of ImageJ's description; none for pixels.
fn unit_of_imagej(text: &str) -> Option<f64> {
    let unit = text
        .lines()
        .find_map(|l| l.strip_prefix("unit="))
        .map(str::trim)
        .unwrap_or("");
    mm_of(if unit == "\\u00B5m" { "um" } else { unit })
}

/// Millimetres per unit of length.
pub(in crate::volume::load) fn mm_of(unit: &str) -> Option<f64> {
    Some(match unit.to_lowercase().as_str() {
        "m" | "meter" | "metre" => 1000.0,
        "cm" | "centimeter" | "centimetre" => 10.0,
        "mm" | "millimeter" | "millimetre" => 1.0,
        "um" | "µm" | "μm" | "micron" | "microns" | "micrometer" | "micrometre" => 1e-3,
        "nm" | "nanometer" | "nanometre" => 1e-6,
        "angstrom" | "å" => 1e-7,
        "inch" | "in" => 25.4,
        _ => return None,
    })
}

/// The first image of OME-XML.
fn ome(text: &str) -> Description {
    let mut metadata = Description {
        ome: true,
        ..Description::default()
    };
    let mut xml = quick_xml::Reader::from_str(text.trim_end_matches('\0'));
    xml.config_mut().check_end_names = false;
    let mut seen = false;
    loop {
        let event = match xml.read_event() {
            Ok(Event::Start(tag) | Event::Empty(tag)) => tag,
            Ok(Event::End(tag)) if tag.local_name().as_ref() == "Pixels" => break,
            Ok(Event::Eof) | Err(_) => break,
            Ok(_) => continue,
        };
        let get = |name: &str| {
            event
                .attributes()
                .flatten()
                .find(|a| a.key.as_ref() == name)
                .map(|a| a.value.into_owned())
        };
        match event.local_name().as_ref() {
            "Pixels" if !seen => {
                seen = true;
                let extent = |name: &str| get(name).and_then(|v| v.parse::<usize>().ok()).filter(|n| *n > 0);
                metadata.extents = extent("SizeZ")
                    .zip(extent("SizeC"))
                    .zip(extent("SizeT"))
                    .map(|((z, c), t)| [z, c, t]);
                let order = get("DimensionOrder").unwrap_or_else(|| "XYZCT".into());
                let axes: Vec<usize> = order.chars().filter_map(|c| "ZCT".find(c)).collect();
                metadata.order = axes
                    .try_into()
                    .ok()
                    .filter(|[a, b, c]: &[usize; 3]| a != b && b != c && a != c)
                    .unwrap_or([0, 1, 2]);
                for (n, axis) in ["X", "Y", "Z"].into_iter().enumerate() {
                    let unit = get(&format!("PhysicalSize{axis}Unit")).map_or(Some(1e-3), |u| mm_of(&u));
                    metadata.spacing[n] = get(&format!("PhysicalSize{axis}"))
                        .and_then(|v| v.parse::<f64>().ok())
                        .zip(unit)
                        .map(|(v, mm)| v * mm);
                }
            }
            "Channel" => {
                // Red, green, blue, alpha as one signed number.
                let color = get("Color")
                    .and_then(|v| v.parse::<i32>().ok())
                    .map(|v| v.to_be_bytes());
                metadata
                    .colors
                    .push(color.map(|[r, g, b, _]| [r, g, b]).filter(|c| *c != [255; 3]));
                // A channel may have several samples, which are then stored together in a page.
                if get("SamplesPerPixel")
                    .and_then(|v| v.parse::<usize>().ok())
                    .is_some_and(|n| n > 1)
                    && let Some(extents) = &mut metadata.extents
                {
                    extents[1] = 1;
                }
            }
            _ => {}
        }
    }
    metadata
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn descriptions() {
        let metadata =
            imagej("ImageJ=1.53t\nimages=12\nchannels=2\nslices=3\nframes=2\nunit=micron\nspacing=2.5\n");
        assert_eq!(
            (metadata.extents, metadata.spacing[2], metadata.order),
            (Some([3, 2, 2]), Some(2.5), [1, 0, 2])
        );
        assert_eq!(unit_of_imagej("unit=\\u00B5m\n"), Some(1e-3));
        let metadata = ome(
            r#"<?xml version="1.0"?><OME xmlns="x"><Image><Pixels DimensionOrder="XYCZT" SizeX="4" SizeY="5" SizeZ="6" SizeC="2" SizeT="1"
            PhysicalSizeX="0.5" PhysicalSizeY="0.5" PhysicalSizeZ="2" PhysicalSizeZUnit="mm"><Channel Color="-16776961"/><Channel/></Pixels></Image></OME>"#,
        );
        assert_eq!((metadata.extents, metadata.order), (Some([6, 2, 1]), [1, 0, 2]));
        assert_eq!(metadata.spacing, [Some(0.0005), Some(0.0005), Some(2.0)]);
        assert_eq!(metadata.colors, [Some([255, 0, 0]), None]);
    }
}
