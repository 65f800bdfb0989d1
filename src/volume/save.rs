//! Writing volumes, label maps and displacement fields: NIfTI (version 2 where version 1 cannot
//! count the voxels), NRRD, MetaImage and VTK XML; volumes also as [`dicom`].
//!
//! A file is a header followed by values in voxel order, hence a large one can be written slab by
//! slab ([`Writer`]). Fields are LPS in NRRD, MetaImage and VTK; in NIfTI they have intent 1007 and
//! LPS vectors, as written by ITK and ANTs. NIfTI stores the components of vectors one after the
//! other, the other formats interleave them ([`Format::planar`]).

pub mod dicom;

use super::load::ScalarType;
use super::{GridGeometry, Rescale};
use crate::{Error, Result};
use flate2::Compression;
use flate2::write::GzEncoder;
use glam::{DAffine3, DMat3, DQuat, DVec3};
use std::fmt::Write as _;
use std::io::Write;
use std::path::Path;

/// The formats for writing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// `.nii`
    Nifti,
    /// `.nii.gz`
    NiftiGz,
    /// `.nrrd`, gzip inside
    Nrrd,
    /// `.mha`, not compressed
    Mha,
    /// `.vti`, appended, not compressed
    Vti,
}

/// The content of the voxels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Content {
    /// One stored value per voxel.
    Scalar(ScalarType, Rescale),
    /// One label per voxel.
    Labels(ScalarType),
    /// Three f32: source minus deformed point, LPS mm.
    Field,
    /// Four f32: as a field, and the mask.
    Map,
}

impl Format {
    /// The format with a file name's extension.
    ///
    /// # Errors
    /// An extension that cannot be written.
    pub fn of(path: &Path) -> Result<Self> {
        let name = path
            .file_name()
            .map(|n| n.to_string_lossy().to_ascii_lowercase())
            .unwrap_or_default();
        let endings = [
            (".nii.gz", Self::NiftiGz),
            (".nii", Self::Nifti),
            (".nrrd", Self::Nrrd),
            (".mha", Self::Mha),
            (".vti", Self::Vti),
        ];
        endings
            .into_iter()
            .find(|(e, _)| name.ends_with(e))
            .map(|(_, f)| f)
            .ok_or_else(|| {
                Error::value(
                    format!("--output {}", path.display()),
                    "does not say its format; name a file that ends in .nii.gz, .nii, .nrrd, .mha or .vti",
                )
            })
    }

    /// Whether the format can store a slope and an intercept.
    pub fn states_rescale(self) -> bool {
        matches!(self, Self::Nifti | Self::NiftiGz)
    }

    /// What other programs may get wrong about a grid in this format: axes that are not
    /// perpendicular.
    pub fn notice(self, grid: &GridGeometry) -> Option<String> {
        let degrees = shear_degrees(&grid.world_from_voxel.matrix3);
        if degrees < SHEARED {
            return None;
        }
        let problem = match self {
            Self::Nifti | Self::NiftiGz => {
                "NIfTI states this in its sform alone; programs that use the qform or only the spacing show it without the shear"
            }
            Self::Nrrd | Self::Mha | Self::Vti => {
                "programs that expect perpendicular axes, such as those built on ITK, refuse the file or show it without the shear"
            }
        };
        Some(format!("its grid is sheared by {degrees:.1} degrees; {problem}"))
    }

    /// Whether the components of vectors are stored as consecutive whole grids.
    pub fn planar(self) -> bool {
        matches!(self, Self::Nifti | Self::NiftiGz)
    }
}

/// Axes are perpendicular up to this deviation, degrees.
const SHEARED: f64 = 0.01;

/// Largest deviation of two axes from a right angle, degrees.
fn shear_degrees(m: &DMat3) -> f64 {
    let [x, y, z] = [m.x_axis, m.y_axis, m.z_axis].map(DVec3::normalize_or_zero);
    [x.dot(y), y.dot(z), z.dot(x)]
        .map(|cos| cos.abs().min(1.0).asin().to_degrees())
        .into_iter()
        .fold(0.0, f64::max)
}

impl Content {
    fn components(self) -> usize {
        match self {
            Self::Scalar(..) | Self::Labels(_) => 1,
            Self::Field => 3,
            Self::Map => 4,
        }
    }

    fn scalar(self) -> ScalarType {
        match self {
            Self::Scalar(t, _) | Self::Labels(t) => t,
            _ => ScalarType::F32,
        }
    }
}

/// A file being written: values are appended in order, as little-endian bytes.
pub struct Writer<W: Write> {
    sink: Sink<W>,
    /// The bytes after the values.
    end: &'static str,
}

enum Sink<W: Write> {
    Plain(W),
    Gzip(Box<GzEncoder<W>>),
}

impl<W: Write> Writer<W> {
    /// Writes the header.
    ///
    /// # Errors
    /// Errors of the destination; a grid that the format cannot represent.
    pub fn new(mut out: W, format: Format, grid: &GridGeometry, content: Content) -> Result<Self, String> {
        let io = |e: std::io::Error| e.to_string();
        let sink = match format {
            Format::Nifti | Format::NiftiGz => {
                let header = nifti_header(grid, content);
                let mut sink = if format == Format::Nifti {
                    Sink::Plain(out)
                } else {
                    Sink::Gzip(Box::new(GzEncoder::new(out, Compression::new(4))))
                };
                sink.write_all(&header).map_err(io)?;
                sink
            }
            Format::Nrrd => {
                out.write_all(nrrd_header(grid, content)?.as_bytes())
                    .map_err(io)?;
                Sink::Gzip(Box::new(GzEncoder::new(out, Compression::new(4))))
            }
            Format::Mha => {
                out.write_all(mha_header(grid, content)?.as_bytes()).map_err(io)?;
                Sink::Plain(out)
            }
            Format::Vti => {
                out.write_all(vti_header(grid, content)?.as_bytes()).map_err(io)?;
                let bytes =
                    grid.size.iter().product::<usize>() * content.components() * content.scalar().bytes();
                out.write_all(&(bytes as u64).to_le_bytes()).map_err(io)?;
                Sink::Plain(out)
            }
        };
        Ok(Self {
            sink,
            end: if format == Format::Vti {
                "\n  </AppendedData>\n</VTKFile>\n"
            } else {
                ""
            },
        })
    }

    /// Appends values.
    ///
    /// # Errors
    /// Errors of the destination.
    pub fn push(&mut self, bytes: &[u8]) -> std::io::Result<()> {
        self.sink.write_all(bytes)
    }

    /// Ends the file.
    ///
    /// # Errors
    /// Errors of the destination.
    pub fn finish(self) -> std::io::Result<W> {
        match self.sink {
            Sink::Plain(mut w) => {
                w.write_all(self.end.as_bytes())?;
                Ok(w)
            }
            Sink::Gzip(g) => g.finish(),
        }
    }
}

impl<W: Write> Write for Sink<W> {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        match self {
            Self::Plain(w) => w.write(bytes),
            Self::Gzip(g) => g.write(bytes),
        }
    }

    fn flush(&mut self) -> std::io::Result<()> {
        match self {
            Self::Plain(w) => w.flush(),
            Self::Gzip(g) => g.flush(),
        }
    }
}

const LPS_FROM_RAS: DMat3 = DMat3::from_diagonal(DVec3::new(-1.0, -1.0, 1.0));

/// The fields common to NIfTI-1 and NIfTI-2: their offsets and number widths.
struct NiftiHeader {
    bytes: Vec<u8>,
    two: bool,
}

impl NiftiHeader {
    fn put(&mut self, at: usize, bytes: &[u8]) {
        self.bytes[at..at + bytes.len()].copy_from_slice(bytes);
    }

    /// A number in single precision, or in double precision in NIfTI-2: the n-th from an offset.
    fn number(&mut self, one: usize, two: usize, n: usize, value: f64) {
        if self.two {
            self.put(two + 8 * n, &value.to_le_bytes());
        } else {
            self.put(one + 4 * n, &(value as f32).to_le_bytes());
        }
    }

    /// A code with 16 bits, or 32 bits in NIfTI-2.
    fn code(&mut self, one: usize, two: usize, value: i16) {
        if self.two {
            self.put(two, &i32::from(value).to_le_bytes());
        } else {
            self.put(one, &value.to_le_bytes());
        }
    }
}

fn nifti_header(grid: &GridGeometry, content: Content) -> Vec<u8> {
    let two = grid.size.iter().any(|&n| n > i16::MAX as usize);
    let length = if two { 540 } else { 348 };
    let mut h = NiftiHeader {
        bytes: vec![0u8; length + 4],
        two,
    };
    h.put(0, &(length as i32).to_le_bytes());
    let components = content.components();
    let dim: [usize; 8] = [
        if components > 1 { 5 } else { 3 },
        grid.size[0],
        grid.size[1],
        grid.size[2],
        1,
        components,
        1,
        1,
    ];
    for (n, d) in dim.into_iter().enumerate() {
        if two {
            h.put(16 + 8 * n, &(d as i64).to_le_bytes());
        } else {
            h.put(40 + 2 * n, &(d as i16).to_le_bytes());
        }
    }
    let (code, bits) = match content.scalar() {
        ScalarType::U8 => (2i16, 8i16),
        ScalarType::I8 => (256, 8),
        ScalarType::I16 => (4, 16),
        ScalarType::U16 => (512, 16),
        ScalarType::I32 => (8, 32),
        ScalarType::U32 => (768, 32),
        ScalarType::F32 => (16, 32),
        ScalarType::I64 => (1024, 64),
        ScalarType::U64 => (1280, 64),
        ScalarType::F64 => (64, 64),
    };
    let [datatype, bits_at] = if two { [12, 14] } else { [70, 72] };
    h.put(datatype, &code.to_le_bytes());
    h.put(bits_at, &bits.to_le_bytes());
    match content {
        Content::Field => h.code(68, 504, 1007),
        Content::Labels(_) => h.code(68, 504, 1002),
        _ => {}
    }
    let ras_from_voxel = DAffine3::from_mat3(LPS_FROM_RAS) * grid.world_from_voxel;
    let m = ras_from_voxel.matrix3;
    let spacing = DVec3::new(m.x_axis.length(), m.y_axis.length(), m.z_axis.length());
    let mut rotation = DMat3::from_cols(m.x_axis / spacing.x, m.y_axis / spacing.y, m.z_axis / spacing.z);
    let handedness = if rotation.determinant() < 0.0 { -1.0 } else { 1.0 };
    rotation.z_axis *= handedness;
    let pixdim = [handedness, spacing.x, spacing.y, spacing.z, 1.0, 1.0, 1.0, 1.0];
    for (n, v) in pixdim.into_iter().enumerate() {
        h.number(76, 104, n, v);
    }
    if two {
        h.put(168, &((length + 4) as i64).to_le_bytes());
    } else {
        h.number(108, 0, 0, (length + 4) as f64);
    }
    let rescale = if let Content::Scalar(_, r) = content {
        r
    } else {
        Rescale::NONE
    };
    h.number(112, 176, 0, rescale.slope);
    h.number(116, 184, 0, rescale.intercept);
    // Millimetres.
    h.put(if two { 500 } else { 123 }, &[2]);
    let t = ras_from_voxel.translation;
    if shear_degrees(&m) < SHEARED {
        let q = DQuat::from_mat3(&rotation).normalize();
        let q = if q.w < 0.0 { -q } else { q };
        h.code(252, 344, 1);
        for (n, v) in [q.x, q.y, q.z, t.x, t.y, t.z].into_iter().enumerate() {
            h.number(256, 352, n, v);
        }
    }
    h.code(254, 348, 1);
    for row in 0..3 {
        for (column, v) in [m.x_axis[row], m.y_axis[row], m.z_axis[row], t[row]]
            .into_iter()
            .enumerate()
        {
            h.number(280, 400, 4 * row + column, v);
        }
    }
    if two {
        h.put(4, b"n+2\0\r\n\x1a\n");
    } else {
        h.put(344, b"n+1\0");
    }
    h.bytes
}

fn nrrd_header(grid: &GridGeometry, content: Content) -> Result<String, String> {
    let type_name = match content.scalar() {
        ScalarType::U8 => "uint8",
        ScalarType::I8 => "int8",
        ScalarType::U16 => "uint16",
        ScalarType::I16 => "int16",
        ScalarType::U32 => "uint32",
        ScalarType::I32 => "int32",
        ScalarType::U64 => "uint64",
        ScalarType::I64 => "int64",
        ScalarType::F32 => "float",
        ScalarType::F64 => "double",
    };
    if let Content::Scalar(_, r) = content
        && r != Rescale::NONE
    {
        return Err("NRRD cannot state a slope and an intercept; write .nii.gz instead".into());
    }
    let [i, j, k] = grid.size;
    let m = grid.world_from_voxel.matrix3;
    let v = |d: DVec3| format!("({},{},{})", d.x, d.y, d.z);
    let directions = format!("{} {} {}", v(m.x_axis), v(m.y_axis), v(m.z_axis));
    let (dimension, sizes, kinds, directions) = match content.components() {
        1 => (
            3,
            format!("{i} {j} {k}"),
            "domain domain domain".to_owned(),
            directions,
        ),
        // Some programs treat an unnamed list of four as a colour.
        n => (
            4,
            format!("{n} {i} {j} {k}"),
            format!("{} domain domain domain", if n == 3 { "vector" } else { "list" }),
            format!("none {directions}"),
        ),
    };
    let mut text = String::from("NRRD0005\n# A volume on a grid in patient space\n");
    let _infallible = write!(
        text,
        "type: {type_name}\ndimension: {dimension}\nspace: left-posterior-superior\nsizes: {sizes}\nspace directions: {directions}\nkinds: {kinds}\nendian: little\nencoding: gzip\nspace origin: {}\n",
        v(grid.world_from_voxel.translation)
    );
    if content == Content::Map {
        text.push_str("incise:=displacement map 1\n");
    }
    text.push('\n');
    Ok(text)
}

fn mha_header(grid: &GridGeometry, content: Content) -> Result<String, String> {
    let type_name = match content.scalar() {
        ScalarType::U8 => "MET_UCHAR",
        ScalarType::I8 => "MET_CHAR",
        ScalarType::U16 => "MET_USHORT",
        ScalarType::I16 => "MET_SHORT",
        ScalarType::U32 => "MET_UINT",
        ScalarType::I32 => "MET_INT",
        ScalarType::U64 => "MET_ULONG_LONG",
        ScalarType::I64 => "MET_LONG_LONG",
        ScalarType::F32 => "MET_FLOAT",
        ScalarType::F64 => "MET_DOUBLE",
    };
    if let Content::Scalar(_, r) = content
        && r != Rescale::NONE
    {
        return Err("MetaImage cannot state a slope and an intercept; write .nii.gz instead".into());
    }
    let m = grid.world_from_voxel.matrix3;
    let spacing = DVec3::new(m.x_axis.length(), m.y_axis.length(), m.z_axis.length());
    let t = grid.world_from_voxel.translation;
    let v = |d: DVec3| format!("{} {} {}", d.x, d.y, d.z);
    Ok(format!(
        "ObjectType = Image\nNDims = 3\nBinaryData = True\nBinaryDataByteOrderMSB = False\nCompressedData = False\nTransformMatrix = {} {} {}\nOffset = {}\nCenterOfRotation = 0 0 0\nElementSpacing = {}\nDimSize = {} {} {}\nElementNumberOfChannels = {}\nElementType = {type_name}\nElementDataFile = LOCAL\n",
        v(m.x_axis / spacing.x),
        v(m.y_axis / spacing.y),
        v(m.z_axis / spacing.z),
        v(t),
        v(spacing),
        grid.size[0],
        grid.size[1],
        grid.size[2],
        content.components()
    ))
}

fn vti_header(grid: &GridGeometry, content: Content) -> Result<String, String> {
    let type_name = match content.scalar() {
        ScalarType::U8 => "UInt8",
        ScalarType::I8 => "Int8",
        ScalarType::U16 => "UInt16",
        ScalarType::I16 => "Int16",
        ScalarType::U32 => "UInt32",
        ScalarType::I32 => "Int32",
        ScalarType::U64 => "UInt64",
        ScalarType::I64 => "Int64",
        ScalarType::F32 => "Float32",
        ScalarType::F64 => "Float64",
    };
    if let Content::Scalar(_, r) = content
        && r != Rescale::NONE
    {
        return Err("VTK cannot state a slope and an intercept; write .nii.gz instead".into());
    }
    let m = grid.world_from_voxel.matrix3;
    let spacing = DVec3::new(m.x_axis.length(), m.y_axis.length(), m.z_axis.length());
    let direction =
        DMat3::from_cols(m.x_axis / spacing.x, m.y_axis / spacing.y, m.z_axis / spacing.z).transpose();
    let list = |v: &[f64]| v.iter().map(f64::to_string).collect::<Vec<_>>().join(" ");
    let extent = format!(
        "0 {} 0 {} 0 {}",
        grid.size[0] - 1,
        grid.size[1] - 1,
        grid.size[2] - 1
    );
    let (name, active, components) = match content {
        Content::Scalar(..) => ("values", "Scalars", 1),
        Content::Labels(_) => ("labels", "Scalars", 1),
        Content::Field => ("displacement", "Vectors", 3),
        Content::Map => {
            return Err("VTK cannot say that a file is a displacement map; write .nrrd instead".into());
        }
    };
    Ok(format!(
        "<?xml version=\"1.0\"?>\n<VTKFile type=\"ImageData\" version=\"1.0\" byte_order=\"LittleEndian\" header_type=\"UInt64\">\n  <ImageData WholeExtent=\"{extent}\" Origin=\"{}\" Spacing=\"{}\" Direction=\"{}\">\n    <Piece Extent=\"{extent}\">\n      <PointData {active}=\"{name}\">\n        <DataArray type=\"{type_name}\" Name=\"{name}\" NumberOfComponents=\"{components}\" format=\"appended\" offset=\"0\"/>\n      </PointData>\n    </Piece>\n  </ImageData>\n  <AppendedData encoding=\"raw\">\n   _",
        list(&grid.world_from_voxel.translation.to_array()),
        list(&spacing.to_array()),
        list(&direction.to_cols_array()),
    ))
}

/// A whole small image of interleaved f32 components as the bytes of its file.
///
/// # Errors
/// A grid that the format cannot represent.
pub fn encode(format: Format, grid: &GridGeometry, content: Content, values: &[f32]) -> Result<Vec<u8>> {
    let fail = |e: String| Error::value("output", e);
    let mut writer = Writer::new(Vec::new(), format, grid, content).map_err(fail)?;
    let c = content.components();
    let bytes: Vec<u8> = if format.planar() && c > 1 {
        (0..c)
            .flat_map(|n| values.iter().skip(n).step_by(c))
            .flat_map(|v| v.to_le_bytes())
            .collect()
    } else {
        values.iter().flat_map(|v| v.to_le_bytes()).collect()
    };
    writer
        .push(&bytes)
        .and_then(|()| writer.finish())
        .map_err(|e| fail(e.to_string()))
}
