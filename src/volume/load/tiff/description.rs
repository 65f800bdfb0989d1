//! What a TIFF says of itself beyond its pages: OME-XML, ImageJ's description, tifffile's shape,
//! Zeiss' LSM and MetaMorph's STK.
//!
//! Source: OME-TIFF specification 6; ImageJ's `TiffEncoder` and `TiffDecoder` (`images=`,
//! `slices=`, `spacing=`, `unit=`, in Java's `\u` escapes); the JSON of tifffile (`shape`, `axes`);
//! CZ_LSMINFO; UIC2Tag.
//!
//! The resolution of a plain TIFF is that of printing, or that of a camera's plane, and says
//! nothing of the distance of slices. It is quoted in a notice and not used.

use super::directory::{Directory, TiffReader, tag};
use super::metadata::{Description, DescriptionKind, mm_of};
use super::ome;
use super::page::PageFormat;
use crate::Result;
use crate::files::input;
use crate::files::reference::sibling_file;
use crate::volume::Rescale;
use serde_json::Value;

/// Maximum size of a file of OME-XML, bytes.
const MAX_XML_BYTES: u64 = 256 << 20;

/// The description in the first page, which applies to all.
pub(super) fn described(file: &mut TiffReader, directories: &[Directory]) -> Result<Description> {
    let Some(first) = directories.first() else {
        return Ok(Description::default());
    };
    let text = file.text(first, tag::DESCRIPTION)?;
    Ok(if text.contains("<OME") {
        of_ome(file, &text)?
    } else if text.starts_with("ImageJ=") {
        of_imagej(file, first, &text)?
    } else if first.has(tag::LSM) {
        of_lsm(file, first)?
    } else if first.has(tag::STK_PLANES) {
        let mut metadata = Description::new(DescriptionKind::Stk);
        metadata.extents = Some([first.count(tag::STK_PLANES) as usize, 1, 1]);
        metadata
    } else {
        let mut metadata = match shape_of(&text) {
            Some((shape, axes)) => of_shape(file, first, &shape, axes.as_deref())?,
            None => Description::new(DescriptionKind::Plain),
        };
        metadata.unused_resolution = unused_resolution(file, first)?;
        metadata
    })
}

/// OME-XML, in the file or in the one that it names: a file of its own, or another TIFF.
fn of_ome(file: &TiffReader, text: &str) -> Result<Description> {
    let Some(name) = ome::companion(text) else {
        return Ok(ome::parse(text));
    };
    let path = sibling_file(&file.path, &name)?;
    let is_file = path.is_file();
    if is_file && TiffReader::is_tiff(&path)? {
        let (mut other, directories) = TiffReader::open(&path)?;
        let first = directories.first().map(|d| other.text(d, tag::DESCRIPTION));
        let mut metadata = ome::parse(&first.transpose()?.unwrap_or_default());
        // Planes without a file lie in the one that describes them.
        for block in metadata.planes.iter_mut().filter(|b| b.file.is_none()) {
            block.file = Some(name.clone());
        }
        (metadata.uuid, metadata.is_of_other_file) = (ome::parse(text).uuid, true);
        return Ok(metadata);
    }
    if is_file {
        return Ok(ome::parse(&input::text(&path, MAX_XML_BYTES, "OME-XML")?));
    }
    let mut metadata = Description::new(DescriptionKind::Ome);
    metadata.notices.push(format!(
        "has its description in {name}, which is missing; its pages are read as slices"
    ));
    Ok(metadata)
}

/// Pixels per unit, as the length of a pixel.
fn pixel_length(file: &mut TiffReader, directory: &Directory, tag: u16) -> Result<Option<f64>> {
    let per_unit = file.reals(directory, tag)?.and_then(|v| v.first().copied());
    Ok(per_unit.filter(|n| n.is_finite() && *n > 0.0).map(|n| 1.0 / n))
}

/// The resolution of a plain file.
fn unused_resolution(file: &mut TiffReader, directory: &Directory) -> Result<Option<String>> {
    let (unit, mm) = match file.integer(directory, tag::RESOLUTION_UNIT)? {
        // An inch unless it is stated.
        None | Some(2) => ("inch", 25.4),
        Some(3) => ("centimetre", 10.0),
        _ => return Ok(None),
    };
    let (x, y) = (
        pixel_length(file, directory, tag::X_RESOLUTION)?,
        pixel_length(file, directory, tag::Y_RESOLUTION)?,
    );
    Ok(x.zip(y).filter(|(x, y)| *x != 1.0 && *y != 1.0).map(|(x, y)| {
        let [across, down, width, height] =
            [1.0 / x, 1.0 / y, x * mm, y * mm].map(|v| (v * 1e6).round() / 1e6);
        format!(
            "states {across} x {down} pixels per {unit} (pixels of {width} x {height} mm), which does not give the distance of slices and is not used"
        )
    }))
}

/// ImageJ's description: `name=value` lines.
fn of_imagej(file: &mut TiffReader, directory: &Directory, text: &str) -> Result<Description> {
    let (mut metadata, units) = imagej(text);
    let mut units = units.map(|u| u.map(|u| unescaped(&u)));
    // As in ImageJ, the unit of the tag is used if the description has none; 72 per inch is the
    // resolution of a screen.
    let [x, y] = [tag::X_RESOLUTION, tag::Y_RESOLUTION];
    let (x, y) = (
        pixel_length(file, directory, x)?,
        pixel_length(file, directory, y)?,
    );
    if units[0].is_none() {
        units[0] = match file.integer(directory, tag::RESOLUTION_UNIT)? {
            Some(2) if x.is_none_or(|x| (x - 1.0 / 72.0).abs() > 1e-6) => Some("inch".into()),
            Some(3) => Some("cm".into()),
            _ => None,
        };
    }
    let lengths = [x, y, metadata.spacing[2]];
    let is_length = |unit: &String| mm_of(unit).is_some();
    if units[0].as_ref().is_some_and(is_length) {
        let is_stack = metadata.extents.is_some_and(|e| e[0] > 1);
        if lengths[2].is_none() && is_stack {
            // ImageJ does not write a distance of 1.
            let unit = units[2].as_ref().or(units[0].as_ref()).map_or("", String::as_str);
            metadata.notices.push(format!(
                "does not state the distance of its slices; as in ImageJ, it is 1 {unit}"
            ));
            metadata.spacing[2] = mm_of(unit);
        }
    } else if lengths.iter().any(Option::is_some) {
        metadata.notices.push(match units[0].as_deref() {
            None | Some("") => "states its spacing without a unit; mm is assumed".into(),
            Some(unit) => format!("states its spacing in \"{unit}\", which is not a length; mm is assumed"),
        });
    }
    for axis in 0..3 {
        let unit = units[axis].as_ref().or(units[0].as_ref());
        let mm = unit.and_then(|u| mm_of(u)).unwrap_or(1.0);
        if let Some(length) = lengths[axis] {
            metadata.spacing[axis] = Some(length * mm);
        }
    }
    Ok(metadata)
}

/// Sizes and distance of slices (in its unit) of ImageJ's description, and the units of x, y, z.
fn imagej(text: &str) -> (Description, [Option<String>; 3]) {
    let mut metadata = Description::new(DescriptionKind::ImageJ);
    metadata.order = [1, 0, 2];
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
    calibrate(&mut metadata, &get);
    metadata.spacing[2] = get("spacing")
        .and_then(|v| v.parse().ok())
        .map(f64::abs)
        .filter(|v| *v > 0.0);
    let units = ["unit", "yunit", "zunit"].map(|name| get(name).map(str::to_owned));
    (metadata, units)
}

/// ImageJ's calibration of values: `cf=0` is a straight line, as of images of signed integers,
/// which ImageJ stores with an offset of 32768. tifffile and SimpleITK read the stored values.
fn calibrate<'a>(metadata: &mut Description, get: &dyn Fn(&str) -> Option<&'a str>) {
    let number = |name: &str| {
        get(name)
            .and_then(|v| v.parse::<f64>().ok())
            .filter(|v| v.is_finite())
    };
    match get("cf") {
        Some("0") => {
            let (intercept, slope) = (number("c0").unwrap_or(0.0), number("c1").unwrap_or(1.0));
            if slope != 0.0 && (slope, intercept) != (1.0, 0.0) {
                metadata.rescale = Some(Rescale { slope, intercept });
                metadata.notices.push(format!(
                    "has an ImageJ calibration (value = {slope} x stored {} {}), which is applied",
                    if intercept < 0.0 { '-' } else { '+' },
                    intercept.abs()
                ));
            }
        }
        Some(_) => metadata.notices.push(
            "has an ImageJ calibration that is not a straight line; its values are read as stored".into(),
        ),
        None => {}
    }
}

/// Text without Java's escapes of characters.
fn unescaped(text: &str) -> String {
    let mut parts = text.split("\\u");
    let mut plain = parts.next().unwrap_or("").to_owned();
    for part in parts {
        let code = part
            .get(..4)
            .and_then(|hex| u32::from_str_radix(hex, 16).ok())
            .and_then(char::from_u32);
        match code {
            Some(character) => {
                plain.push(character);
                plain.push_str(&part[4..]);
            }
            None => plain.push_str(part),
        }
    }
    plain
}

/// Shape and names of axes in tifffile's description: JSON, or `shape=(3, 4, 5)` of older versions.
fn shape_of(text: &str) -> Option<(Vec<usize>, Option<String>)> {
    let whole = |n: &Value| n.as_u64().and_then(|n| usize::try_from(n).ok());
    if let Some(list) = text.strip_prefix("shape=(") {
        let numbers = list.split(')').next()?.split(',').map(str::trim);
        let shape = numbers.filter(|w| !w.is_empty()).map(|w| w.parse().ok());
        return Some((shape.collect::<Option<_>>()?, None));
    }
    if !text.starts_with('{') {
        return None;
    }
    let json: Value = serde_json::from_str(text).ok()?;
    let shape = json["shape"]
        .as_array()?
        .iter()
        .map(whole)
        .collect::<Option<_>>()?;
    Some((shape, json["axes"].as_str().map(str::to_owned)))
}

/// The extents of an array that tifffile has written.
fn of_shape(
    file: &mut TiffReader,
    directory: &Directory,
    shape: &[usize],
    axes: Option<&str>,
) -> Result<Description> {
    let mut metadata = Description::new(DescriptionKind::Shaped);
    let format = PageFormat::of(file, directory)?;
    let [width, height] = format.size;
    let samples = format.samples;
    let tails: [&[usize]; 4] = [
        &[height, width, samples],
        &[samples, height, width],
        &[height, width],
        &[width],
    ];
    let Some(tail) = tails
        .iter()
        .find(|t| shape.ends_with(t) && (samples == 1 || t.len() == 3))
    else {
        return Ok(metadata);
    };
    let leading = &shape[..shape.len() - tail.len()];
    let names: Vec<char> = match axes.filter(|a| a.chars().count() == shape.len()) {
        Some(names) => names.chars().take(leading.len()).collect(),
        None => Vec::new(),
    };
    let long: Vec<(usize, Option<char>)> = leading
        .iter()
        .enumerate()
        .filter(|(_, n)| **n != 1)
        .map(|(a, n)| (*n, names.get(a).copied()))
        .collect();
    // Slowest first; without names, times and slices.
    let Some(places) = axis_places(&long) else {
        metadata.notices.push(format!(
            "is an array of {} whose axes are not all known; its pages are read as slices",
            shape.iter().map(usize::to_string).collect::<Vec<_>>().join(" x ")
        ));
        return Ok(metadata);
    };
    let mut extents = [1; 3];
    let mut order: Vec<usize> = Vec::new();
    for ((n, _), place) in long.iter().zip(&places).rev() {
        extents[*place] = *n;
        order.push(*place);
    }
    order.extend((0..3).filter(|p| !places.contains(p)));
    metadata.order = order.try_into().unwrap_or([0, 1, 2]);
    metadata.extents = Some(extents);
    Ok(metadata)
}

/// Which of slices, channels and times each axis is; none if that is not clear.
fn axis_places(axes: &[(usize, Option<char>)]) -> Option<Vec<usize>> {
    if axes.iter().all(|(_, name)| name.is_none()) {
        return match axes.len() {
            0 => Some(vec![]),
            1 => Some(vec![0]),
            2 => Some(vec![2, 0]),
            _ => None,
        };
    }
    let mut places = Vec::new();
    for (_, name) in axes {
        let place = match name {
            Some('Z' | 'I' | 'Q') => 0,
            Some('C') => 1,
            Some('T') => 2,
            _ => return None,
        };
        if places.contains(&place) {
            return None;
        }
        places.push(place);
    }
    Some(places)
}

/// Zeiss LSM: sizes as 32-bit and lengths in metres as 64-bit numbers.
fn of_lsm(file: &mut TiffReader, directory: &Directory) -> Result<Description> {
    let mut metadata = Description::new(DescriptionKind::Lsm);
    let bytes = file.bytes_of_tag(directory, tag::LSM)?.unwrap_or_default();
    let number =
        |file: &TiffReader, at: usize, length: usize| bytes.get(at..at + length).map(|b| file.number_in(b));
    let extent = |file: &TiffReader, at| number(file, at, 4).map(|n| (n as usize).max(1));
    if let (Some(slices), Some(times)) = (extent(file, 16), extent(file, 24)) {
        metadata.extents = Some([slices, 1, times]);
    }
    for axis in 0..3 {
        metadata.spacing[axis] = number(file, 40 + 8 * axis, 8).map(|bits| f64::from_bits(bits) * 1000.0);
    }
    Ok(metadata)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn descriptions_of_imagej() {
        let (metadata, units) =
            imagej("ImageJ=1.53t\nimages=12\nchannels=2\nslices=3\nframes=2\nunit=micron\nspacing=2.5\n");
        assert_eq!(
            (metadata.extents, metadata.spacing[2], metadata.order),
            (Some([3, 2, 2]), Some(2.5), [1, 0, 2])
        );
        assert_eq!(units[0].as_deref(), Some("micron"));
        assert_eq!(mm_of(&unescaped("\\u00B5m")), Some(1e-3));
        assert_eq!(mm_of("pixel"), None);
    }

    #[test]
    fn shapes_of_tifffile() {
        assert_eq!(shape_of(r#"{"shape": [2, 3, 4]}"#), Some((vec![2, 3, 4], None)));
        assert_eq!(shape_of("shape=(2, 3, 4)"), Some((vec![2, 3, 4], None)));
        assert_eq!(shape_of("a plain text"), None);
        assert_eq!(axis_places(&[(3, Some('Z')), (2, Some('C'))]), Some(vec![0, 1]));
        assert_eq!(axis_places(&[(3, None), (2, None)]), Some(vec![2, 0]));
        assert_eq!(axis_places(&[(3, None), (2, None), (2, None)]), None);
    }
}
