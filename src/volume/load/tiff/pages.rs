//! The planes of an image: the page, or the file and the page, that holds each, and their values as
//! one array.

use super::super::image::Layout;
use super::super::planes::{ImageSlice, ImageStack};
use super::super::source::{check_held, with_scalar, zeroed};
use super::codec::Compression;

use super::directory::{Directory, MAX_PAGES, TiffReader, tag};
use super::metadata::{Description, DescriptionKind};
use super::page::{PageFormat, Photometric};
use crate::files::reference::sibling_file;
use crate::volume::StoredValues;
use crate::{ByteProgress, Error, Result, Watch};
use std::collections::BTreeMap;
use std::path::PathBuf;

/// Where a plane is stored.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct PlacedPlane {
    /// Another file that holds it.
    file: Option<PathBuf>,
    page: usize,
    /// Bytes by which its pixels follow those that the page states.
    shift: u64,
}

/// The distribution of planes over slices, channels and times.
pub(super) struct Dimensions {
    /// Slices, channels, times.
    pub extents: [usize; 3],
    /// Which of these varies fastest, then next.
    pub order: [usize; 3],
}

impl Dimensions {
    /// Index of a plane.
    fn plane(&self, at: [usize; 3]) -> usize {
        let [a, b, c] = self.order;
        at[a] + self.extents[a] * (at[b] + self.extents[b] * at[c])
    }

    /// The planes of a time, channel after channel.
    fn of_time(&self, time: usize) -> Vec<usize> {
        let [slices, channels, _] = self.extents;
        (0..channels)
            .flat_map(|c| (0..slices).map(move |s| [s, c, time]))
            .map(|at| self.plane(at))
            .collect()
    }
}

/// Values of one volume.
pub(super) struct Pixels {
    pub voxels: StoredValues,
    pub size: [usize; 3],
    pub components: usize,
    pub layout: Layout,
    pub is_color: bool,
    pub is_inverted: bool,
}

/// The pages that are slices: not thumbnails, levels of a pyramid or masks of transparency, unless
/// all are.
pub(super) fn slice_pages(
    file: &mut TiffReader,
    directories: &[Directory],
    notices: &mut Vec<String>,
) -> Result<Vec<usize>> {
    let mut pages = Vec::new();
    for (n, directory) in directories.iter().enumerate() {
        let kind = file.integer(directory, tag::NEW_SUBFILE_TYPE)?.unwrap_or(0);
        let older = file.integer(directory, tag::SUBFILE_TYPE)?.unwrap_or(0);
        if kind & 5 == 0 && older != 2 {
            pages.push(n);
        }
    }
    if pages.is_empty() {
        return Ok((0..directories.len()).collect());
    }
    let left_out = directories.len() - pages.len();
    if left_out > 0 {
        notices.push(format!(
            "contains {left_out} pages that are thumbnails, reduced copies or masks; they are left out"
        ));
    }
    Ok(pages)
}

/// The place of every plane; none for planes that no file holds.
pub(super) fn planes_of(
    file: &mut TiffReader,
    directories: &[Directory],
    pages: &[usize],
    dimensions: &Dimensions,
    metadata: &mut Description,
) -> Result<Vec<Option<PlacedPlane>>> {
    let count = dimensions
        .extents
        .iter()
        .try_fold(1usize, |n, &d| n.checked_mul(d))
        .filter(|n| *n <= MAX_PAGES)
        .ok_or_else(|| file.error(format!("declares more than {MAX_PAGES} planes; it is damaged")))?;
    let own = |page: usize, shift: u64| PlacedPlane {
        file: None,
        page,
        shift,
    };
    if !metadata.planes.is_empty() {
        return placed_planes(file, directories.len(), dimensions, metadata, count);
    }
    if pages.len() == 1 && count > 1 {
        let step = contiguous_step(file, &directories[pages[0]])?;
        check_held(&file.path, step.saturating_mul(count as u64), file.bytes)?;
        return Ok((0..count as u64)
            .map(|n| Some(own(pages[0], step.saturating_mul(n))))
            .collect());
    }
    Ok((0..count)
        .map(|n| pages.get(n).map(|page| own(*page, 0)))
        .collect())
}

/// Bytes from one plane to the next behind a single directory.
fn contiguous_step(file: &mut TiffReader, directory: &Directory) -> Result<u64> {
    let format = PageFormat::of(file, directory)?;
    let offsets = file.integers(directory, tag::STRIP_OFFSETS)?.unwrap_or_default();
    let lengths = file.integers(directory, tag::STRIP_BYTES)?.unwrap_or_default();
    let is_gapless = offsets
        .windows(2)
        .zip(&lengths)
        .all(|(pair, length)| pair[0].checked_add(*length) == Some(pair[1]));
    if format.compression != Compression::None || offsets.is_empty() || !is_gapless {
        return Err(file.error(
            "has slices behind a single directory that are compressed or not contiguous; export it again",
        ));
    }
    Ok(format.stored_bytes())
}

/// Planes where OME-XML places them.
fn placed_planes(
    file: &mut TiffReader,
    own_pages: usize,
    dimensions: &Dimensions,
    metadata: &mut Description,
    count: usize,
) -> Result<Vec<Option<PlacedPlane>>> {
    let mut planes: Vec<Option<PlacedPlane>> = vec![None; count];
    let mut page_counts: BTreeMap<String, Option<usize>> = BTreeMap::new();
    let mut missing: BTreeMap<String, usize> = BTreeMap::new();
    let own_name = file.path.file_name().map(|n| n.to_string_lossy().into_owned());
    let names: std::collections::BTreeSet<&String> =
        metadata.planes.iter().filter_map(|b| b.file.as_ref()).collect();
    // A file that was renamed is still the only one.
    let is_single = names.len() <= 1 && !metadata.is_of_other_file;
    for block in &metadata.planes {
        let is_own = block.file.is_none()
            || block.file == own_name
            || is_single
            || block.uuid.is_some() && block.uuid == metadata.uuid;
        let name = block.file.clone().unwrap_or_default();
        let (path, pages) = if is_own {
            (None, Some(own_pages))
        } else {
            let path = sibling_file(&file.path, &name)?;
            let pages = match page_counts.get(&name) {
                Some(pages) => *pages,
                None => {
                    let pages = match (path.is_file(), block.count) {
                        (false, _) => None,
                        (true, Some(_)) => Some(usize::MAX),
                        (true, None) => Some(TiffReader::open(&path)?.1.len()),
                    };
                    page_counts.insert(name.clone(), pages);
                    pages
                }
            };
            (Some(path), pages)
        };
        if (0..3).any(|a| block.first[a] >= dimensions.extents[a]) {
            continue;
        }
        let first = dimensions.plane(block.first);
        let held = pages.map(|pages| pages.saturating_sub(block.page));
        let number = block.count.or(held).unwrap_or(count).min(count - first);
        match held {
            Some(held) => {
                for n in 0..number.min(held) {
                    planes[first + n] = Some(PlacedPlane {
                        file: path.clone(),
                        page: block.page + n,
                        shift: 0,
                    });
                }
            }
            None => *missing.entry(name).or_default() += number,
        }
    }
    let named: usize = missing.values().sum();
    if let Some((name, n)) = missing.first_key_value() {
        metadata.notices.push(match missing.len() {
            1 => format!("refers to the file {name}, which is missing; its {n} planes are empty"),
            files => format!(
                "refers to {files} files that are missing ({name} and others); their {named} planes are empty"
            ),
        });
    }
    let holes = planes.iter().filter(|p| p.is_none()).count();
    if holes > named {
        metadata.notices.push(format!(
            "declares {count} planes, of which {} are stored in no file; they are empty",
            holes - named
        ));
    }
    Ok(planes)
}

/// A file whose planes are being read, and the other one that was opened last.
pub(super) struct Pages<'a> {
    pub file: TiffReader,
    pub directories: Vec<Directory>,
    pub other: Option<(PathBuf, TiffReader, Vec<Directory>)>,
    pub watch: &'a Watch<'a>,
}

impl Pages<'_> {
    /// The file and the directory of a plane.
    fn of(&mut self, plane: &PlacedPlane) -> Result<(&mut TiffReader, &Directory)> {
        let (file, directories) = match &plane.file {
            None => (&mut self.file, &self.directories),
            Some(path) => {
                if self.other.as_ref().is_none_or(|(open, ..)| open != path) {
                    let (file, directories) = TiffReader::open(path)?;
                    self.other = Some((path.clone(), file, directories));
                }
                match &mut self.other {
                    Some((_, file, directories)) => (file, &*directories),
                    None => (&mut self.file, &self.directories),
                }
            }
        };
        match directories.get(plane.page) {
            Some(directory) => Ok((file, directory)),
            None => Err(file.error(format!("has no page {}; it is damaged", plane.page + 1))),
        }
    }

    /// Reads the planes of a time.
    pub fn read(
        &mut self,
        dimensions: &Dimensions,
        planes: &[Option<PlacedPlane>],
        time: usize,
        metadata: &mut Description,
    ) -> Result<Pixels> {
        let channels = dimensions.extents[1];
        let wanted: Vec<Option<PlacedPlane>> = dimensions
            .of_time(time)
            .into_iter()
            .map(|n| planes.get(n).cloned().flatten())
            .collect();
        let Some(first) = wanted.iter().flatten().next().cloned() else {
            return Err(self.file.error("holds none of the planes of this time"));
        };
        let (file, directory) = self.of(&first)?;
        let format = PageFormat::of(file, directory)?;
        format.check_held(file, wanted.len() as u64)?;
        metadata.notices.extend(format.notices(file, directory)?);
        let (stack, left_out, opposite) = self.stacked(&wanted, &format)?;
        if opposite > 0 {
            metadata.notices.push(format!(
                "black and white are swapped in {opposite} pages compared with the first; all values are read as stored"
            ));
        }
        if left_out > 0 && channels > 1 {
            return Err(self
                .file
                .error("has channels with different page sizes; export it with a single size"));
        }
        if left_out > 0 {
            metadata.notices.push(format!(
                "{left_out} pages differ in size or type from the first and were skipped"
            ));
        }
        let (size, samples, count) = (stack.size, stack.components, stack.count);
        if samples > 1 && channels > 1 {
            return Err(self.file.error("holds both channels and colours; split them"));
        }
        let voxels = stack.finish().ok_or_else(|| self.file.error("holds no page"))?;
        Ok(Pixels {
            voxels,
            size: [size[0], size[1], count / channels],
            components: samples * channels,
            layout: if samples > 1 {
                Layout::Interleaved
            } else {
                Layout::Planar
            },
            is_color: format.is_color(),
            is_inverted: format.photometric == Photometric::WhiteIsZero,
        })
    }

    /// Planes combined into one array, the number of those left out because they differ from the
    /// first one, and the number of those in which black and white are exchanged.
    fn stacked(
        &mut self,
        wanted: &[Option<PlacedPlane>],
        format: &PageFormat,
    ) -> Result<(ImageStack, usize, usize)> {
        let mut stack = ImageStack::default();
        let meter = ByteProgress::new(self.watch, wanted.len() as u64);
        let (mut left_out, mut opposite) = (0usize, 0usize);
        let is_white_zero = |format: &PageFormat| format.photometric == Photometric::WhiteIsZero;
        for plane in wanted {
            let slice = match plane {
                None => self.empty(format)?,
                Some(plane) => {
                    let (file, directory) = self.of(plane)?;
                    let own = PageFormat::of(file, directory)?;
                    if own.size != format.size {
                        left_out += 1;
                        continue;
                    }
                    opposite += usize::from(is_white_zero(&own) != is_white_zero(format));
                    own.read(file, directory, plane.shift)?
                }
            };
            left_out += usize::from(!stack.push(slice, wanted.len()));
            meter.add(1)?;
        }
        Ok((stack, left_out, opposite))
    }

    /// A plane of zeros.
    fn empty(&self, format: &PageFormat) -> Result<ImageSlice> {
        let count = format.size[0] * format.size[1] * format.retained();
        Ok(ImageSlice {
            size: format.size,
            components: format.retained(),
            values: with_scalar!(format.scalar(), T => zeroed::<T>(&self.file.path, count)?.into()),
        })
    }
}

/// The only page of a file that is one of several.
pub(super) fn single_page(
    file: &mut TiffReader,
    directories: &[Directory],
) -> Result<(usize, PageFormat, ImageSlice)> {
    let pages = slice_pages(file, directories, &mut Vec::new())?;
    match pages[..] {
        [page] => {
            let format = PageFormat::of(file, &directories[page])?;
            let slice = format.read(file, &directories[page], 0)?;
            Ok((page, format, slice))
        }
        _ => Err(Error::file(
            &file.path,
            "has several pages, but several TIFF files form a volume only if each has one page; open one file, or save each page as a file",
        )),
    }
}

/// Whether a description places planes in other files, too.
pub(super) fn spans_files(metadata: &Description) -> bool {
    let mut names = metadata.planes.iter().filter_map(|b| b.file.as_ref());
    let first = names.next();
    metadata.kind == DescriptionKind::Ome && names.any(|name| Some(name) != first)
}
