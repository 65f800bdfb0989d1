//! Files of every kind to which a random scene can refer.

use glam::Vec3;
use std::path::Path;

/// Voxels of most of these volumes along each axis.
const EDGE: usize = 24;
/// Total number of voxels of each of these volumes.
const VOXELS: usize = EDGE * EDGE * EDGE;
/// Geometry of these volumes in an NRRD header: voxels of 4 mm, centred on the origin.
const DIRECTIONS: &str = "space directions: (4,0,0) (0,4,0) (0,0,4)\nspace origin: (-46,-46,-46)";

/// Files of every kind to which a scene can refer.
pub(super) struct Files {
    folder: tempfile::TempDir,
    pub(super) volumes: Vec<String>,
    pub(super) meshes: Vec<String>,
    pub(super) labels: Vec<String>,
    pub(super) fields: Vec<String>,
    pub(super) maps: Vec<String>,
    pub(super) points: Vec<String>,
}

impl Files {
    /// Writes all files to a new folder.
    pub(super) fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let f = folder.path();
        let (volumes, labels, fields, meshes) = (volumes(f), labels(f), fields(f), meshes(f));
        let points = vec![
            write_text(
                f,
                "pairs.csv",
                "0,0,40,0,0,60\n30,0,0,45,5,0\n-30,0,0,-30,0,0\n0,30,10,0,20,0\n",
            ),
            write_text(f, "some.csv", "0,0,40\n10,0,40\n20,10,30\n"),
        ];
        let made = std::process::Command::new(env!("CARGO_BIN_EXE_incise"))
            .current_dir(f)
            .args(["map", "twist", "-o", "twist.nrrd", "--resolution", "16"])
            .output()
            .unwrap();
        assert!(made.status.success(), "{}", String::from_utf8_lossy(&made.stderr));
        Self {
            folder,
            volumes,
            meshes,
            labels,
            fields,
            maps: vec!["twist.nrrd".into()],
            points,
        }
    }

    /// The folder that holds the files.
    pub(super) fn path(&self) -> &Path {
        self.folder.path()
    }
}

/// Writes a text file and returns its name.
fn write_text(folder: &Path, name: &str, content: &str) -> String {
    std::fs::write(folder.join(name), content).unwrap();
    name.to_owned()
}

/// Writes an NRRD file and returns its name.
fn write_nrrd(folder: &Path, name: &str, header: &str, values: &[u8]) -> String {
    let mut bytes =
        format!("NRRD0004\nencoding: raw\nspace: left-posterior-superior\n{header}\n\n").into_bytes();
    bytes.extend_from_slice(values);
    std::fs::write(folder.join(name), bytes).unwrap();
    name.to_owned()
}

/// The header of a volume of 8-bit voxels.
fn plain_header() -> String {
    format!("type: uchar\ndimension: 3\nsizes: 24 24 24\n{DIRECTIONS}")
}

/// The position of a voxel relative to the centre, voxels.
fn at(n: usize) -> Vec3 {
    Vec3::new(
        (n % EDGE) as f32,
        (n / EDGE % EDGE) as f32,
        (n / (EDGE * EDGE)) as f32,
    ) - 11.5
}

/// Writes volumes of several types, sizes and places, and returns their names.
fn volumes(folder: &Path) -> Vec<String> {
    let nrrd = |name: &str, header: &str, values: &[u8]| write_nrrd(folder, name, header, values);
    let bytes: Vec<u8> = (0..VOXELS)
        .map(|n| (255.0 - 20.0 * at(n).length()).clamp(0.0, 255.0) as u8)
        .collect();
    let odd: Vec<u8> = (0..VOXELS)
        .flat_map(|n| {
            if n % 7 == 0 {
                f32::NAN
            } else if n % 11 == 0 {
                f32::INFINITY
            } else {
                1e9 * at(n).x
            }
            .to_le_bytes()
        })
        .collect();
    vec![
        nrrd("ball.nrrd", &plain_header(), &bytes),
        nrrd(
            "odd.nrrd",
            &format!("type: float\nendian: little\ndimension: 3\nsizes: 24 24 24\n{DIRECTIONS}"),
            &odd,
        ),
        nrrd(
            "thin.nrrd",
            "type: uchar\ndimension: 3\nsizes: 64 48 1\nspace directions: (1,0.2,0) (0,1,0) (0,0,9)\nspace origin: (0,0,0)",
            &[200; 3072],
        ),
        nrrd(
            "one.nrrd",
            "type: uchar\ndimension: 3\nsizes: 1 1 1\nspace directions: (1,0,0) (0,1,0) (0,0,1)\nspace origin: (0,0,0)",
            &[7],
        ),
        nrrd(
            "flat.nrrd",
            "type: uchar\ndimension: 3\nsizes: 16 16 16\nspace directions: (1,0,0) (0,1,0) (0,0,1)\nspace origin: (5e6,0,0)",
            &[3; 4096],
        ),
        nrrd(
            "colors.nrrd",
            "type: uchar\ndimension: 4\nsizes: 3 16 16 16\nkinds: RGB-color domain domain domain\nspace directions: none (2,0,0) (0,2,0) (0,0,2)\nspace origin: (0,0,0)",
            &bytes[..12_288],
        ),
    ]
}

/// Writes label maps and returns their names and that of a phantom.
fn labels(folder: &Path) -> Vec<String> {
    let nrrd = |name: &str, header: &str, values: &[u8]| write_nrrd(folder, name, header, values);
    let regions: Vec<u8> = (0..VOXELS)
        .map(|n| {
            if at(n).length() < 10.0 {
                1 + u8::from(at(n).x > 0.0) + 2 * u8::from(at(n).z > 3.0)
            } else {
                0
            }
        })
        .collect();
    let plain = plain_header();
    vec![
        nrrd("regions.nrrd", &plain, &regions),
        nrrd("far.nrrd", &plain.replace("(-46,", "(9000,"), &regions),
        "phantom:octants:size=16".into(),
    ]
}

/// Writes a displacement field and an affine transform, and returns their names.
fn fields(folder: &Path) -> Vec<String> {
    let vectors: Vec<u8> = (0..VOXELS)
        .flat_map(|n| {
            [8.0 * (at(n).y * 0.3).sin(), 2.0, 0.5 * at(n).x]
                .into_iter()
                .flat_map(f32::to_le_bytes)
        })
        .collect();
    vec![
        write_nrrd(
            folder,
            "field.nrrd",
            &format!(
                "type: float\nendian: little\ndimension: 4\nsizes: 3 24 24 24\nkinds: vector domain domain domain\n{}",
                DIRECTIONS.replace(": (4", ": none (4")
            ),
            &vectors,
        ),
        write_text(
            folder,
            "affine.tfm",
            "#Insight Transform File V1.0\n#Transform 0\nTransform: AffineTransform_double_3_3\nParameters: 0.9 0.1 0 0 1.1 0 0 0 1 4 0 -3\nFixedParameters: 0 0 0\n",
        ),
    ]
}

/// Writes closed, open, flat and tiny meshes, and returns their names.
fn meshes(folder: &Path) -> Vec<String> {
    let text = |name: &str, content: &str| write_text(folder, name, content);
    vec![
        text(
            "box.obj",
            "v -30 -30 -30\nv 30 -30 -30\nv 30 30 -30\nv -30 30 -30\nv -30 -30 30\nv 30 -30 30\nv 30 30 30\nv -30 30 30\nf 4 3 2 1\nf 5 6 7 8\nf 1 2 6 5\nf 2 3 7 6\nf 3 4 8 7\nf 4 1 5 8\n",
        ),
        text("sheet.obj", "v 0 0 0\nv 40 0 0\nv 40 40 0\nv 0 40 0\nf 1 2 3 4\n"),
        text(
            "open.obj",
            "v -30 -30 -30\nv 30 -30 -30\nv 30 30 -30\nv -30 30 -30\nv 0 0 40\nf 1 2 5\nf 2 3 5\nf 3 4 5\n",
        ),
        text(
            "tiny.obj",
            "v 0 0 0\nv 1e-5 0 0\nv 0 1e-5 0\nv 0 0 1e-5\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n",
        ),
    ]
}
