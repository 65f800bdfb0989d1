//! Who may name whom: the order in src/lib.rs, held.

use std::path::{Path, PathBuf};

const ORDER: [(&str, &[&str]); 14] = [
    ("files", &[]),
    ("math", &["files"]),
    ("volume", &["files", "math"]),
    ("mesh", &["files", "math", "volume"]),
    ("transfer", &["files", "math", "volume"]),
    ("deform", &["files", "math", "volume"]),
    ("scene", &["files", "math", "volume", "mesh", "transfer", "deform"]),
    ("cpu", &["files", "math", "volume", "mesh", "transfer", "deform", "scene"]),
    ("gpu", &["files", "math"]),
    ("render", &["files", "math", "volume", "mesh", "transfer", "deform", "scene", "gpu"]),
    ("export", &["files", "math", "volume", "deform", "scene"]),
    ("compare", &["files", "math", "volume", "scene", "cpu", "gpu", "render", "export"]),
    ("cli", &["files", "math", "volume", "mesh", "transfer", "deform", "scene", "cpu", "gpu", "render", "export", "compare"]),
    ("gui", &["files", "math", "volume", "mesh", "transfer", "deform", "scene", "cpu", "gpu", "render", "export", "compare"]),
];

fn files(folder: &Path, extension: &str) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).unwrap().flatten() {
        let path = entry.path();
        if path.is_dir() {
            found.extend(files(&path, extension));
        } else if path.extension().is_some_and(|e| e == extension) {
            found.push(path);
        }
    }
    found
}

fn root() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR"))
}

pub fn modules_name_only_those_before_them() {
    let mut names_seen = 0;
    for (module, allowed) in ORDER {
        for file in files(&root().join("src").join(module), "rs") {
            let text = std::fs::read_to_string(&file).unwrap();
            for line in text.lines().filter(|l| !l.trim_start().starts_with("//")) {
                for (at, _) in line.match_indices("crate::") {
                    let rest = &line[at + 7..];
                    let grouped: Vec<&str> = if let Some(inner) = rest.strip_prefix('{') {
                        inner.split([',', '}']).map(|p| p.trim().split(':').next().unwrap_or("")).collect()
                    } else {
                        vec![rest.split(|c: char| !c.is_alphanumeric() && c != '_').next().unwrap_or("")]
                    };
                    for name in grouped.into_iter().filter(|n| ORDER.iter().any(|o| o.0 == *n)) {
                        names_seen += 1;
                        assert!(name == module || allowed.contains(&name), "{}: {module} names {name}: {line}", file.display());
                    }
                }
                assert!(module == "gpu" || module == "render" || !line.contains("wgpu::"), "{}: wgpu outside gpu and render", file.display());
            }
        }
    }
    assert!(names_seen > 40, "the test sees only {names_seen} names");
}

/// Readers open their files, and writers make theirs, in one place: what is promised there holds for all.
pub fn only_one_module_opens_files() {
    const WORDS: [&str; 10] = [
        "File::open",
        "File::create",
        "OpenOptions",
        "fs::read(",
        "fs::read_to_string",
        "fs::write",
        "fs::copy",
        "fs::rename",
        "NamedTempFile",
        "load_gltf",
    ];
    // What is no user's file, and what has its reason beside it.
    const EXCEPTIONS: [(&str, &str); 5] = [
        ("gui/session.rs", "lock"),
        ("gui/session.rs", "File::open(path)"),
        ("gui/panels/editor.rs", "aside"),
        ("export/clip.rs", "folder.path().join(&file)"),
        ("deform/transform/itk.rs", "hdf5_pure::File::open"),
    ];
    let mut exceptions = 0;
    for file in files(&root().join("src"), "rs") {
        let name = file.strip_prefix(root().join("src")).unwrap().to_string_lossy().into_owned();
        if name.starts_with("files/") {
            continue;
        }
        let text = std::fs::read_to_string(&file).unwrap();
        let code = text.split("#[cfg(test)]").next().unwrap();
        for line in code.lines().filter(|l| !l.trim_start().starts_with("//") && WORDS.iter().any(|w| l.contains(w))) {
            let excepted = EXCEPTIONS.iter().any(|(of, word)| name == *of && line.contains(word));
            assert!(excepted, "{name} opens a file itself: {line}");
            exceptions += 1;
        }
    }
    assert!(exceptions >= 5, "{exceptions}");
}

pub fn files_are_of_readable_size() {
    for file in files(&root().join("src"), "rs").into_iter().chain(files(&root().join("shaders"), "wgsl")) {
        let lines = std::fs::read_to_string(&file).unwrap().lines().count();
        assert!(lines <= 800, "{} has {lines} lines", file.display());
    }
}
