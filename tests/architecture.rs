//! Who may name whom: the order in src/lib.rs, held.

use std::path::{Path, PathBuf};

const ORDER: [(&str, &[&str]); 13] = [
    ("math", &[]),
    ("volume", &["math"]),
    ("mesh", &["math", "volume"]),
    ("transfer", &["math", "volume"]),
    ("deform", &["math", "volume"]),
    ("scene", &["math", "volume", "mesh", "transfer", "deform"]),
    ("cpu", &["math", "volume", "mesh", "transfer", "deform", "scene"]),
    ("gpu", &["math"]),
    ("render", &["math", "volume", "mesh", "transfer", "deform", "scene", "gpu"]),
    ("export", &["math", "volume", "deform", "scene"]),
    ("compare", &["math", "volume", "scene", "cpu", "gpu", "render", "export"]),
    ("cli", &["math", "volume", "mesh", "transfer", "deform", "scene", "cpu", "gpu", "render", "export", "compare"]),
    ("gui", &["math", "volume", "mesh", "transfer", "deform", "scene", "cpu", "gpu", "render", "export", "compare"]),
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

pub fn files_are_of_readable_size() {
    for file in files(&root().join("src"), "rs").into_iter().chain(files(&root().join("shaders"), "wgsl")) {
        let lines = std::fs::read_to_string(&file).unwrap().lines().count();
        assert!(lines <= 800, "{} has {lines} lines", file.display());
    }
}
