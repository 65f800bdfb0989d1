//! Safety of user files: no input is overwritten, no file blocks the program, no read is unbounded.
//! Every writer is tested with every kind of destination, every reader with every kind of file that
//! is not regular. Device nodes are created in a scratch folder; no device of the machine is named.
#![cfg(unix)]

use crate::nifti::small;
use rustix::fs::{CWD, FileType, Mode, makedev, mknodat};
use std::ffi::OsString;
use std::io::Read;
use std::path::Path;
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};

mod reading;
mod writing;

pub use reading::*;
pub use writing::*;

/// Far longer than any of these runs takes; a run of this length is considered hung.
const HANGS: Duration = Duration::from_secs(60);

fn command(folder: &Path, arguments: &[OsString]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_incise"));
    command
        .current_dir(folder)
        .args(arguments)
        .env_remove("DISPLAY")
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped());
    command
}

/// Runs the program; a hung run is killed and reported.
fn incise(folder: &Path, arguments: &[OsString]) -> Output {
    let mut child = command(folder, arguments).spawn().unwrap();
    let (mut out, mut err) = (child.stdout.take().unwrap(), child.stderr.take().unwrap());
    let reading = std::thread::spawn(move || {
        let mut bytes = Vec::new();
        out.read_to_end(&mut bytes).unwrap();
        bytes
    });
    let complaining = std::thread::spawn(move || {
        let mut bytes = Vec::new();
        err.read_to_end(&mut bytes).unwrap();
        bytes
    });
    let start = Instant::now();
    let status = loop {
        if let Some(status) = child.try_wait().unwrap() {
            break status;
        }
        if start.elapsed() > HANGS {
            child.kill().unwrap();
            child.wait().unwrap();
            panic!("{arguments:?} hangs");
        }
        std::thread::sleep(Duration::from_millis(2));
    };
    Output {
        status,
        stdout: reading.join().unwrap(),
        stderr: complaining.join().unwrap(),
    }
}

fn words(text: &str) -> Vec<OsString> {
    text.split_whitespace().map(OsString::from).collect()
}

fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// A command that writes a file with an extension, `OUT` in its words, and the files that it reads.
struct Writer {
    words: &'static str,
    ending: &'static str,
    reads: &'static [&'static str],
}

const WRITERS: &[Writer] = &[
    Writer {
        words: "render small.nii -o OUT --backend cpu --size 16x16 -q",
        ending: "png",
        reads: &["small.nii"],
    },
    Writer {
        words: "render detached.nhdr -o picture.png --stats OUT --backend cpu --size 16x16 -q",
        ending: "raw",
        reads: &["detached.nhdr", "values.raw"],
    },
    Writer {
        words: "compare small.nii -o report --stats OUT --backend cpu --size 16x16 -q --no-reference",
        ending: "json",
        reads: &["small.nii"],
    },
    Writer {
        words: "bake pair.hdr -o OUT --deform twist",
        ending: "nii",
        reads: &["pair.hdr", "pair.img"],
    },
    Writer {
        words: "bake detached.mhd -o OUT --deform twist",
        ending: "mha",
        reads: &["detached.mhd", "values.raw"],
    },
    Writer {
        words: "bake listed.nhdr -o OUT --deform twist",
        ending: "nrrd",
        reads: &["listed.nhdr", "slice-1.raw", "slice-2.raw"],
    },
    Writer {
        words: "bake sized.raw -o OUT",
        ending: "vti",
        reads: &["sized.raw", "sized.raw.toml"],
    },
    Writer {
        words: "bake array.zarr -o OUT",
        ending: "nii.gz",
        reads: &["array.zarr/.zarray", "array.zarr/0.0.0"],
    },
    Writer {
        words: "map twist -o OUT --volume small.nii",
        ending: "nrrd",
        reads: &["small.nii"],
    },
    Writer {
        words: "map check affine.tfm --csv OUT --no-inverse",
        ending: "csv",
        reads: &["affine.tfm"],
    },
    Writer {
        words: "map check affine.tfm --picture OUT --no-inverse",
        ending: "png",
        reads: &["affine.tfm"],
    },
    Writer {
        words: "sdf box.obj -o OUT --resolution 8",
        ending: "nrrd",
        reads: &["box.obj"],
    },
];

const BOX: &str = "v 0 0 0\nv 9 0 0\nv 9 9 0\nv 0 9 0\nv 0 0 9\nv 9 0 9\nv 9 9 9\nv 0 9 9\nf 4 3 2 1\nf 5 6 7 8\nf 1 2 6 5\nf 2 3 7 6\nf 3 4 8 7\nf 4 1 5 8\n";

/// Creates the files that the writers read.
fn inputs(folder: &Path) {
    let write = |name: &str, content: &[u8]| {
        let path = folder.join(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, content).unwrap();
    };
    small().write(folder, "small.nii");
    let values: Vec<u8> = (0..8 * 8 * 8u32).map(|n| (n * 37 % 251) as u8).collect();
    write("values.raw", &values);
    write("slice-1.raw", &values[..256]);
    write("slice-2.raw", &values[256..]);
    write("sized.raw", &values);
    write("sized.raw.toml", b"size = [8, 8, 8]\ntype = \"u8\"\n");
    let nrrd = "NRRD0004\ntype: uchar\ndimension: 3\nsizes: 8 8 8\nencoding: raw\n";
    write(
        "detached.nhdr",
        format!("{nrrd}data file: values.raw\n\n").as_bytes(),
    );
    write(
        "listed.nhdr",
        format!("{nrrd}data file: LIST\nslice-1.raw\nslice-2.raw\n").as_bytes(),
    );
    write("detached.mhd", b"ObjectType = Image\nNDims = 3\nDimSize = 8 8 8\nElementType = MET_UCHAR\nElementDataFile = values.raw\n");
    // A pair is a NIfTI whose header and values are in two files.
    let whole = std::fs::read(folder.join("small.nii")).unwrap();
    let mut header = whole[..348].to_vec();
    header[344..348].copy_from_slice(b"ni1\0");
    // The values start at offset 0 of their own file.
    header[108..112].fill(0);
    write("pair.hdr", &header);
    write("pair.img", &whole[352..]);
    write(
        "array.zarr/.zarray",
        br#"{"zarr_format":2,"shape":[8,8,8],"chunks":[8,8,8],"dtype":"|u1","compressor":null,"fill_value":0,"order":"C","filters":null}"#,
    );
    write("array.zarr/0.0.0", &values);
    write("affine.tfm", b"#Insight Transform File V1.0\n#Transform 0\nTransform: AffineTransform_double_3_3\nParameters: 1 0 0 0 1 0 0 0 1 2 0 0\nFixedParameters: 0 0 0\n");
    write("box.obj", BOX.as_bytes());
}

fn node(path: &Path, kind: FileType, device: (u32, u32)) -> bool {
    mknodat(
        CWD,
        path,
        kind,
        Mode::from_raw_mode(0o666),
        makedev(device.0, device.1),
    )
    .is_ok()
}

/// A command that reads `IN`, a file with any of these extensions.
struct Reader {
    words: &'static str,
    endings: &'static [&'static str],
}

const READERS: &[Reader] = &[
    Reader {
        words: "info IN",
        endings: &[
            "nii", "nii.gz", "hdr", "img", "nrrd", "nhdr", "mha", "mhd", "vti", "vtk", "tif", "png", "jpg",
            "npy", "npz", "dcm", "zip", "unknown",
        ],
    },
    Reader {
        words: "info IN --raw 5000x5000x5000:u8",
        endings: &["raw", "raw.gz"],
    },
    Reader {
        words: "info IN",
        endings: &[
            "stl", "obj", "obj.gz", "ply", "off", "gltf", "glb", "gii", "gii.gz",
        ],
    },
    Reader {
        words: "render IN -o out.png",
        endings: &["toml"],
    },
    Reader {
        words: "info IN",
        endings: &["toml"],
    },
    Reader {
        words: "map IN -o out.nii.gz",
        endings: &["tfm", "mat", "lta", "1D", "txt", "nii.gz"],
    },
    Reader {
        words: "map check IN",
        endings: &["tfm", "nrrd"],
    },
    Reader {
        words: "sdf IN -o out.nrrd",
        endings: &["stl"],
    },
    Reader {
        words: "render small.nii -q -o out.png --inside IN",
        endings: &["obj"],
    },
    Reader {
        words: "render small.nii -q -o out.png --deform points:pairs=IN",
        endings: &["csv", "mrk.json", "fcsv"],
    },
    Reader {
        words: "render small.nii -q -o out.png --deform field:path=IN",
        endings: &["nii", "tfm"],
    },
    Reader {
        words: "render small.nii -q -o out.png --deform map:path=IN",
        endings: &["nrrd"],
    },
    Reader {
        words: "render small.nii -q -o out.png --deform twist:spare=1,labels=IN",
        endings: &["nii.gz"],
    },
    Reader {
        words: "render small.nii -q -o out.png --deform lift:mask=IN",
        endings: &["nii"],
    },
    Reader {
        words: "render labelled.toml -q -o out.png",
        endings: &["IN"],
    },
    Reader {
        words: "render sidecar.raw -q -o out.png",
        endings: &["IN"],
    },
];
