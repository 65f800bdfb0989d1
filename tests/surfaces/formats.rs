//! Mesh files: one mesh in every format, damaged files, files of other programs.

use super::{field, grid_points};
use base64::Engine;
use glam::Vec3;
use incise::mesh::field::FieldSettings;
use incise::mesh::{Mesh, load, shapes};
use std::path::{Path, PathBuf};

/// The vertex indices of a triangle as text, counted from `base`.
fn face(t: &[u32; 3], base: u32) -> String {
    format!("{} {} {}", t[0] + base, t[1] + base, t[2] + base)
}

/// Lines of text, each ending in a newline.
fn lines(items: Vec<String>) -> String {
    items.join("\n") + "\n"
}

/// The coordinates of a point as text.
fn point(p: &Vec3) -> String {
    format!("{} {} {}", p.x, p.y, p.z)
}

/// The coordinates of points as 32-bit floats, little-endian.
fn floats(p: &[Vec3]) -> Vec<u8> {
    p.iter()
        .flat_map(|p| p.to_array())
        .flat_map(f32::to_le_bytes)
        .collect()
}

/// The vertex indices of all triangles as 32-bit integers, little-endian.
fn indices(mesh: &Mesh) -> Vec<u8> {
    mesh.triangles
        .iter()
        .flatten()
        .flat_map(|i| i.to_le_bytes())
        .collect()
}

/// Bytes in base64.
fn encode_base64(bytes: &[u8]) -> String {
    base64::engine::general_purpose::STANDARD.encode(bytes)
}

/// A mesh as binary and as text STL.
fn stl(mesh: &Mesh) -> (Vec<u8>, Vec<u8>) {
    let (v, f) = (&mesh.positions, &mesh.triangles);
    let mut binary_stl = b"solid, but binary".to_vec();
    binary_stl.resize(80, b' ');
    binary_stl.extend((f.len() as u32).to_le_bytes());
    for t in f {
        binary_stl.extend([0u8; 12]);
        binary_stl.extend(floats(&t.map(|i| v[i as usize])));
        binary_stl.extend([0u8; 2]);
    }
    let text_stl = f.iter().map(|t| {
        let corners = t.map(|i| format!("vertex {}", point(&v[i as usize]))).join("\n");
        format!("facet normal 0 0 0\nouter loop\n{corners}\nendloop\nendfacet")
    });
    let text_stl = format!("solid torus\n{}endsolid torus\n", lines(text_stl.collect()));
    (binary_stl, text_stl.into_bytes())
}

/// A mesh as OBJ.
fn obj(mesh: &Mesh) -> String {
    let (v, f) = (&mesh.positions, &mesh.triangles);
    lines(
        v.iter()
            .map(|p| format!("v {}", point(p)))
            .chain(f.iter().map(|t| format!("f {}", face(t, 1))))
            .collect(),
    )
}

/// A mesh as OFF.
fn off(mesh: &Mesh) -> String {
    let (v, f) = (&mesh.positions, &mesh.triangles);
    format!(
        "OFF\n# a torus\n{} {} 0\n{}{}",
        v.len(),
        f.len(),
        lines(v.iter().map(point).collect()),
        lines(f.iter().map(|t| format!("3 {}", face(t, 0))).collect())
    )
}

/// A mesh as text and as binary PLY.
fn ply(mesh: &Mesh) -> (Vec<u8>, Vec<u8>) {
    let (v, f) = (&mesh.positions, &mesh.triangles);
    let ply_head = |format: &str| {
        format!(
            "ply\nformat {format} 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\nelement face {}\nproperty list uchar int vertex_indices\nend_header\n",
            v.len(),
            f.len()
        )
    };
    let text_ply = ply_head("ascii")
        + &lines(v.iter().map(point).collect())
        + &lines(f.iter().map(|t| format!("3 {}", face(t, 0))).collect());
    let mut binary_ply = ply_head("binary_little_endian").into_bytes();
    binary_ply.extend(floats(v));
    for t in f {
        binary_ply.push(3);
        binary_ply.extend(t.iter().flat_map(|i| i.to_le_bytes()));
    }
    (text_ply.into_bytes(), binary_ply)
}

/// A mesh as glTF, stored at half its size and doubled by a node's transform.
fn gltf(mesh: &Mesh) -> String {
    let (v, f) = (&mesh.positions, &mesh.triangles);
    let halved: Vec<Vec3> = v.iter().map(|p| *p * 0.5).collect();
    let indices = indices(mesh);
    let buffer = [floats(&halved), indices.clone()].concat();
    format!(
        r#"{{"asset":{{"version":"2.0"}},"scene":0,"scenes":[{{"nodes":[0]}}],"nodes":[{{"children":[1],"scale":[2,2,2]}},{{"mesh":0}}],"meshes":[{{"primitives":[{{"attributes":{{"POSITION":0}},"indices":1}}]}}],
        "accessors":[{{"bufferView":0,"componentType":5126,"count":{},"type":"VEC3","min":[-6.5,-6.5,-1.5],"max":[6.5,6.5,1.5]}},{{"bufferView":1,"componentType":5125,"count":{},"type":"SCALAR"}}],
        "bufferViews":[{{"buffer":0,"byteOffset":0,"byteLength":{}}},{{"buffer":0,"byteOffset":{},"byteLength":{}}}],"buffers":[{{"byteLength":{},"uri":"data:application/octet-stream;base64,{}"}}]}}"#,
        v.len(),
        3 * f.len(),
        12 * v.len(),
        12 * v.len(),
        indices.len(),
        buffer.len(),
        encode_base64(&buffer)
    )
}

/// A mesh as GIfTI, in RAS: x and y change sign.
fn gifti(mesh: &Mesh, compress: bool) -> String {
    let (v, f) = (&mesh.positions, &mesh.triangles);
    let ras: Vec<Vec3> = v.iter().map(|p| *p * Vec3::new(-1.0, -1.0, 1.0)).collect();
    let pack = |b: &[u8]| {
        if !compress {
            return encode_base64(b);
        }
        let mut z = flate2::write::ZlibEncoder::new(Vec::new(), flate2::Compression::fast());
        std::io::Write::write_all(&mut z, b).unwrap();
        encode_base64(&z.finish().unwrap())
    };
    let array = |intent: &str, kind: &str, rows: usize, bytes: &[u8]| {
        format!(
            r#"<DataArray Intent="{intent}" DataType="{kind}" ArrayIndexingOrder="RowMajorOrder" Dimensionality="2" Dim0="{rows}" Dim1="3" Encoding="{}" Endian="LittleEndian"><Data>{}</Data></DataArray>"#,
            if compress {
                "GZipBase64Binary"
            } else {
                "Base64Binary"
            },
            pack(bytes)
        )
    };
    format!(
        "<?xml version=\"1.0\"?>\n<GIFTI Version=\"1.0\" NumberOfDataArrays=\"2\">{}{}</GIFTI>",
        array(
            "NIFTI_INTENT_POINTSET",
            "NIFTI_TYPE_FLOAT32",
            ras.len(),
            &floats(&ras)
        ),
        array(
            "NIFTI_INTENT_TRIANGLE",
            "NIFTI_TYPE_INT32",
            f.len(),
            &indices(mesh)
        )
    )
}

/// A mesh in every format: name, extension, content.
fn in_every_format(mesh: &Mesh) -> [(&'static str, &'static str, Vec<u8>); 9] {
    let ((binary_stl, text_stl), (text_ply, binary_ply)) = (stl(mesh), ply(mesh));
    [
        ("binary STL", "stl", binary_stl),
        ("text STL", "stl", text_stl),
        ("OBJ", "obj", obj(mesh).into_bytes()),
        ("OFF", "off", off(mesh).into_bytes()),
        ("text PLY", "ply", text_ply),
        ("binary PLY", "ply", binary_ply),
        ("glTF", "gltf", gltf(mesh).into_bytes()),
        ("GIfTI", "gii", gifti(mesh, false).into_bytes()),
        ("GIfTI, compressed", "gii", gifti(mesh, true).into_bytes()),
    ]
}

/// One mesh in every format is read as the same mesh.
pub fn every_format_is_one_mesh() {
    let mesh = shapes::torus(10.0, 3.0, 12);
    let (v, f) = (&mesh.positions, &mesh.triangles);
    let files = in_every_format(&mesh);
    for (name, ending, bytes) in &files {
        let read = load::parse(bytes, ending, None).unwrap_or_else(|e| panic!("{name} {e}"));
        let (a, b) = (read.topology(), mesh.topology());
        assert!(
            a.watertight && a.orientation() == "outward" && a.components == 1,
            "{name}: {a:?}"
        );
        assert_eq!(
            (read.triangles.len(), read.positions.len()),
            (f.len(), v.len()),
            "{name}"
        );
        assert!((a.volume / b.volume - 1.0).abs() < 1e-5, "{name}");
        let (got, want) = (read.bounds(), mesh.bounds());
        assert!(
            got.min.abs_diff_eq(want.min, 1e-4) && got.max.abs_diff_eq(want.max, 1e-4),
            "{name}: {got:?}"
        );
    }
    // A file truncated anywhere, or with a byte changed, is read with a warning or refused.
    let mut refused = 0;
    for (_, ending, bytes) in &files {
        for n in 0..60 {
            let mut broken = bytes[..bytes.len() * n / 60].to_vec();
            refused += usize::from(load::parse(&broken, ending, None).is_err());
            broken = bytes.clone();
            let at = n * 7919 % broken.len();
            broken[at] = broken[at].wrapping_add(1 + n as u8);
            let _read = load::parse(&broken, ending, None);
        }
    }
    assert!(refused > 200, "{refused}");
    check_broken_gltf();
    check_files_of_other_programs();
    check_cube();
    let huge = load::parse(b"OFF\n353535235358 6 0\n0 0 0\n", "off", None).unwrap_err();
    assert!(huge.contains("353535235358"), "{huge}");
    let huge = load::parse(
        b"ply\nformat ascii 1.0\nelement vertex 99999999999\nproperty float x\nend_header\n0\n",
        "ply",
        None,
    )
    .unwrap_err();
    assert!(huge.contains("99999999999"), "{huge}");
}

/// Checks that contradictory glTF files are refused with a message that names the fault.
fn check_broken_gltf() {
    let head = r#"{"asset":{"version":"2.0"},"scene":0,"scenes":[{"nodes":[0]}],"nodes":[{"mesh":0}],"#;
    let data = r#""bufferViews":[{"buffer":0,"byteLength":36}],"buffers":[{"byteLength":36,"uri":"data:application/octet-stream;base64,AAAAAAAAAAAAAAAAAACAPwAAAAAAAAAAAAAAAAAAgD8AAAAA"}]}"#;
    let nodes: Vec<String> = (0..60)
        .map(|n| format!(r#"{{"children":[{},{}]}}"#, n + 1, n + 1))
        .collect();
    for (what, text) in [
        (
            "not there",
            format!(
                r#"{head}"meshes":[{{"primitives":[{{"attributes":{{"POSITION":99}}}}]}}],"accessors":[{{"bufferView":0,"componentType":5126,"count":3,"type":"VEC3"}}],{data}"#
            ),
        ),
        (
            "unsigned",
            format!(
                r#"{head}"meshes":[{{"primitives":[{{"attributes":{{"POSITION":0}},"indices":0}}]}}],"accessors":[{{"bufferView":0,"componentType":5126,"count":3,"type":"VEC3"}}],{data}"#
            ),
        ),
        (
            "more elements",
            format!(
                r#"{head}"meshes":[{{"primitives":[{{"attributes":{{"POSITION":0}}}}]}}],"accessors":[{{"componentType":5126,"count":10000000000,"type":"VEC3"}}],{data}"#
            ),
        ),
        (
            "percent-encoded",
            r#"{"asset":{"version":"2.0"},"scene":0,"scenes":[{"nodes":[]}],"buffers":[{"byteLength":3,"uri":"%FF.bin"}]}"#.to_owned(),
        ),
        ("too often", format!(r#"{{"asset":{{"version":"2.0"}},"scene":0,"scenes":[{{"nodes":[0]}}],"nodes":[{},{{}}]}}"#, nodes.join(","))),
    ] {
        let error = load::parse(text.as_bytes(), "gltf", Some(Path::new("."))).unwrap_err();
        assert!(error.contains(what), "{what}: {error}");
    }
}

/// Checks that files that other programs accept are read: an upper-case STL, a name in Latin-1.
fn check_files_of_other_programs() {
    let upper = "SOLID x\nFACET NORMAL 0 0 1\nOUTER LOOP\nVERTEX 0 0 0\nVERTEX 1 0 0\nVERTEX 0 1 0\nENDLOOP\nENDFACET\nENDSOLID x\n";
    assert_eq!(
        load::parse(upper.as_bytes(), "stl", None)
            .unwrap()
            .triangles
            .len(),
        1
    );
    let latin = b"g K\xf6rper\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n";
    assert_eq!(load::parse(latin, "obj", None).unwrap().triangles.len(), 1);
}

/// Checks the inside of a cube whose face diagonals lie on the grid's lines.
fn check_cube() {
    let cube = field(
        &shapes::cuboid(Vec3::splat(10.0)),
        FieldSettings {
            resolution: 64,
            parity: true,
            ..FieldSettings::default()
        },
    );
    for (p, d) in grid_points(&cube) {
        let want = 10.0 - p.abs().max_element();
        assert!(want.abs() < 0.1 || (d > 0.0) == (want > 0.0), "{p}: {d}");
    }
}

/// Files from other sources, if available.
pub fn shared_meshes_load_or_say_why() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data/meshes");
    if !folder.is_dir() {
        println!("no shared meshes here: nothing was checked");
        return;
    }
    let mut open: Vec<PathBuf> = vec![folder];
    let (mut read, mut refused) = (0, Vec::new());
    while let Some(path) = open.pop() {
        if path.is_dir() {
            open.extend(std::fs::read_dir(&path).unwrap().flatten().map(|e| e.path()));
        } else {
            match load::mesh(&path) {
                Ok(mesh) => {
                    assert!(!mesh.triangles.is_empty());
                    read += 1;
                }
                Err(e) => {
                    let text = e.to_string();
                    let name = path.file_name().unwrap().to_string_lossy().into_owned();
                    assert!(text.contains(&name), "{text}");
                    refused.push(name);
                }
            }
        }
    }
    refused.sort();
    println!("{read} read; refused: {refused:?}");
    assert_eq!(
        refused,
        [
            "OutOfMemory.off",
            "empty.obj",
            "empty.off",
            "empty.ply",
            "empty.stl",
            "invalid.off",
            "malformed.obj"
        ]
    );
}
