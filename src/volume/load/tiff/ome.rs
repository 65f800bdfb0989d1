//! OME-XML: sizes, spacing and channels of the first image, and the place of each of its planes.
//!
//! Source: the OME-TIFF specification 6, "TiffData", "UUID", "BinaryOnly". Lengths without a unit
//! are in micrometres.

use super::metadata::{Description, DescriptionKind, PlaneBlock, mm_of};
use quick_xml::events::{BytesStart, Event};

/// The file whose OME-XML describes a file that has none of its own.
pub(super) fn companion(text: &str) -> Option<String> {
    let mut xml = reader(text);
    loop {
        match xml.read_event() {
            Ok(Event::Start(tag) | Event::Empty(tag)) if tag.local_name().as_ref() == "BinaryOnly" => {
                return attribute(&tag, "MetadataFile");
            }
            Ok(Event::Eof) | Err(_) => return None,
            Ok(_) => {}
        }
    }
}

fn reader(text: &str) -> quick_xml::Reader<&[u8]> {
    let mut xml = quick_xml::Reader::from_str(text);
    xml.config_mut().check_end_names = false;
    xml
}

fn attribute(tag: &BytesStart, name: &str) -> Option<String> {
    let found = tag.attributes().flatten().find(|a| a.key.as_ref() == name)?;
    let value = found.value.into_owned();
    Some(match quick_xml::escape::unescape(&value) {
        Ok(plain) => plain.into_owned(),
        Err(_) => value,
    })
}

/// A whole number in an attribute.
fn number(tag: &BytesStart, name: &str) -> Option<usize> {
    attribute(tag, name)?.trim().parse().ok()
}

/// The first image of OME-XML.
pub(super) fn parse(text: &str) -> Description {
    let mut metadata = Description::new(DescriptionKind::Ome);
    let mut xml = reader(text);
    let (mut images, mut samples, mut in_uuid) = (0usize, 1usize, false);
    loop {
        let (event, is_empty) = match xml.read_event() {
            Ok(Event::Start(tag)) => (tag, false),
            Ok(Event::Empty(tag)) => (tag, true),
            Ok(Event::Text(text)) if in_uuid => {
                let uuid = AsRef::<str>::as_ref(&text).trim().to_owned();
                if let Some(block) = metadata.planes.last_mut().filter(|_| !uuid.is_empty()) {
                    block.uuid = Some(uuid);
                }
                continue;
            }
            Ok(Event::End(tag)) if tag.local_name().as_ref() == "UUID" => {
                in_uuid = false;
                continue;
            }
            Ok(Event::Eof) | Err(_) => break,
            Ok(_) => continue,
        };
        match event.local_name().as_ref() {
            "OME" => metadata.uuid = attribute(&event, "UUID"),
            "Image" => images += 1,
            _ if images > 1 => {}
            "Pixels" => pixels(&event, &mut metadata),
            "Channel" => {
                // Red, green, blue, alpha as one signed number.
                let color = attribute(&event, "Color")
                    .and_then(|v| v.parse::<i32>().ok())
                    .map(|v| v.to_be_bytes());
                metadata
                    .colors
                    .push(color.map(|[r, g, b, _]| [r, g, b]).filter(|c| *c != [255; 3]));
                metadata
                    .channel_names
                    .push(attribute(&event, "Name").unwrap_or_default());
                samples = samples.max(number(&event, "SamplesPerPixel").unwrap_or(1));
            }
            "TiffData" => {
                let page = number(&event, "IFD");
                let count = number(&event, "PlaneCount").or(page.map(|_| 1));
                metadata.planes.push(PlaneBlock {
                    page: page.unwrap_or(0),
                    first: ["FirstZ", "FirstC", "FirstT"].map(|name| number(&event, name).unwrap_or(0)),
                    count,
                    ..PlaneBlock::default()
                });
            }
            "UUID" => {
                in_uuid = !is_empty;
                if let Some(block) = metadata.planes.last_mut() {
                    block.file = attribute(&event, "FileName");
                }
            }
            _ => {}
        }
    }
    // The samples of a channel are stored together in a page.
    if samples > 1 {
        if let Some(extents) = &mut metadata.extents {
            extents[1] = extents[1].div_ceil(samples);
        }
        for block in &mut metadata.planes {
            block.first[1] /= samples;
        }
    }
    if images > 1 {
        metadata.notices.push(format!(
            "holds {images} images; the first is read (save another one to a file of its own to see it)"
        ));
    }
    metadata
}

/// Sizes, order and spacing.
fn pixels(event: &BytesStart, metadata: &mut Description) {
    let extent = |name: &str| number(event, name).filter(|n| *n > 0);
    metadata.extents = extent("SizeZ")
        .zip(extent("SizeC"))
        .zip(extent("SizeT"))
        .map(|((z, c), t)| [z, c, t]);
    let order = attribute(event, "DimensionOrder").unwrap_or_else(|| "XYZCT".into());
    let axes: Vec<usize> = order.chars().filter_map(|c| "ZCT".find(c)).collect();
    metadata.order = axes
        .try_into()
        .ok()
        .filter(|[a, b, c]: &[usize; 3]| a != b && b != c && a != c)
        .unwrap_or([0, 1, 2]);
    for (n, axis) in ["X", "Y", "Z"].into_iter().enumerate() {
        let unit = attribute(event, &format!("PhysicalSize{axis}Unit")).unwrap_or_else(|| "µm".into());
        let Some(length) =
            attribute(event, &format!("PhysicalSize{axis}")).and_then(|v| v.parse::<f64>().ok())
        else {
            continue;
        };
        metadata.spacing[n] = mm_of(&unit).map(|mm| length * mm);
        if metadata.spacing[n].is_none() {
            metadata.notices.push(format!(
                "states its spacing along {} in \"{unit}\", which is not a length",
                axis.to_lowercase()
            ));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn images_and_planes() {
        let metadata = parse(
            r#"<?xml version="1.0"?><OME xmlns="x" UUID="urn:uuid:1"><Image><Pixels DimensionOrder="XYCZT" SizeX="4" SizeY="5" SizeZ="6" SizeC="2" SizeT="1"
            PhysicalSizeX="0.5" PhysicalSizeY="0.5" PhysicalSizeYUnit="&#181;m" PhysicalSizeZ="2" PhysicalSizeZUnit="mm"><Channel Color="-16776961"/><Channel/>
            <TiffData IFD="3" FirstZ="1"><UUID FileName="b.ome.tif">urn:uuid:2</UUID></TiffData><TiffData/></Pixels></Image><Image/></OME>"#,
        );
        assert_eq!((metadata.extents, metadata.order), (Some([6, 2, 1]), [1, 0, 2]));
        assert_eq!(metadata.spacing, [Some(0.0005), Some(0.0005), Some(2.0)]);
        assert_eq!(metadata.colors, [Some([255, 0, 0]), None]);
        let block = PlaneBlock {
            page: 3,
            first: [1, 0, 0],
            count: Some(1),
            file: Some("b.ome.tif".into()),
            uuid: Some("urn:uuid:2".into()),
        };
        assert_eq!(metadata.planes, [block, PlaneBlock::default()]);
        assert_eq!(metadata.notices.len(), 1);
        assert_eq!(
            companion(r#"<OME><BinaryOnly MetadataFile="a.companion.ome" UUID="u"/></OME>"#).as_deref(),
            Some("a.companion.ome")
        );
    }
}
