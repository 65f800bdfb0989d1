//! Architecture rules: the allowed dependencies between modules, no cycles between files, files and
//! functions of limited size, files opened in one place.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// The modules of the crate, each with the earlier modules it may depend on, in the order of
/// `src/lib.rs`. `error`, `watch` and `panic_guard` may be used by all.
const ORDER: [(&str, &[&str]); 18] = [
    ("files", &[]),
    ("math", &["files"]),
    ("volume", &["files", "math"]),
    ("picture", &["files", "math", "volume"]),
    ("mesh", &["files", "math", "volume"]),
    ("transfer", &["files", "math", "volume"]),
    ("deform", &["files", "math", "volume"]),
    (
        "scene",
        &["files", "math", "volume", "picture", "mesh", "transfer", "deform"],
    ),
    (
        "prepare",
        &[
            "files", "math", "volume", "picture", "mesh", "transfer", "deform", "scene",
        ],
    ),
    (
        "cpu",
        &[
            "files", "math", "volume", "picture", "mesh", "transfer", "deform", "scene", "prepare",
        ],
    ),
    ("gpu", &["files", "math"]),
    (
        "render",
        &[
            "files", "math", "volume", "picture", "mesh", "transfer", "deform", "scene", "prepare", "gpu",
        ],
    ),
    ("engine", &["scene", "picture", "prepare", "cpu", "gpu", "render"]),
    (
        "export",
        &[
            "files", "math", "volume", "picture", "deform", "scene", "prepare", "engine",
        ],
    ),
    (
        "compare",
        &[
            "files", "math", "volume", "picture", "scene", "prepare", "engine", "export",
        ],
    ),
    (
        "cli",
        &[
            "files", "math", "volume", "picture", "mesh", "transfer", "deform", "scene", "prepare", "engine",
            "export", "compare",
        ],
    ),
    (
        "gui",
        &[
            "files", "math", "volume", "picture", "mesh", "transfer", "deform", "scene", "prepare", "cpu",
            "engine", "export", "compare",
        ],
    ),
    ("model", &[]),
];

/// Maximum length of a file, and of a function of `src` or `shaders`, in lines.
const MAX_FILE_LINES: usize = 700;
const MAX_FUNCTION_LINES: usize = 100;

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
    found.sort();
    found
}

fn root() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR"))
}

/// The code of a file before its tests, with comments removed and strings emptied.
fn code(path: &Path) -> String {
    let text = std::fs::read_to_string(path).unwrap();
    let text = text
        .split("#[cfg(test)]\nmod tests")
        .next()
        .unwrap()
        .split("#[cfg(test)]\npub(super) mod tests")
        .next()
        .unwrap();
    let mut out = String::with_capacity(text.len());
    let mut chars = text.chars().peekable();
    while let Some(c) = chars.next() {
        match c {
            '/' if chars.peek() == Some(&'/') => {
                chars.by_ref().find(|c| *c == '\n');
                out.push('\n');
            }
            '"' => {
                out.push('"');
                while let Some(c) = chars.next() {
                    match c {
                        '\\' => drop(chars.next()),
                        '"' => break,
                        '\n' => out.push('\n'),
                        _ => {}
                    }
                }
                out.push('"');
            }
            // A character literal, not a lifetime: 'x' or '\x'.
            '\'' => {
                let rest: Vec<char> = chars.clone().take(3).collect();
                let skip = match rest[..] {
                    ['\\', _, '\''] => 3,
                    [_, '\'', ..] => 2,
                    _ => 0,
                };
                for _ in 0..skip {
                    chars.next();
                }
                out.push('\'');
            }
            _ => out.push(c),
        }
    }
    out
}

/// All paths in a `use` tree.
fn expanded(tree: &str) -> Vec<String> {
    let tree = tree.trim();
    let Some(open) = tree.find('{') else {
        return vec![tree.split(" as ").next().unwrap().trim().to_owned()];
    };
    let (prefix, inner) = (&tree[..open], &tree[open + 1..tree.rfind('}').unwrap()]);
    let (mut depth, mut part, mut parts) = (0, String::new(), Vec::new());
    for c in inner.chars() {
        match c {
            '{' => depth += 1,
            '}' => depth -= 1,
            ',' if depth == 0 => {
                parts.push(std::mem::take(&mut part));
                continue;
            }
            _ => {}
        }
        part.push(c);
    }
    parts.push(part);
    let named = parts.iter().filter(|p| !p.trim().is_empty());
    named
        .flat_map(|p| expanded(p))
        .map(|p| format!("{prefix}{p}"))
        .collect()
}

/// The source as a graph: files by module, with the paths that each re-exports and uses.
struct House {
    /// Module path, `a::b`, to file.
    files: BTreeMap<String, PathBuf>,
    /// Paths in a module's `use` statements, with whether they are re-exports, and paths in its
    /// code.
    named: BTreeMap<String, Vec<(String, bool)>>,
}

impl House {
    fn new() -> Self {
        let source = root().join("src");
        let (mut all, mut named) = (BTreeMap::new(), BTreeMap::new());
        for path in files(&source, "rs") {
            let relative = path.strip_prefix(&source).unwrap().with_extension("");
            let mut parts: Vec<String> = relative
                .iter()
                .map(|p| p.to_string_lossy().into_owned())
                .collect();
            if parts.last().is_some_and(|p| p == "mod") {
                parts.pop();
            }
            if parts != ["lib"] && parts != ["main"] {
                all.insert(parts.join("::"), path);
            }
        }
        for (module, path) in &all {
            let code = code(path);
            let mut paths = Vec::new();
            let mut rest = code.as_str();
            while let Some(at) = rest.find("use ") {
                let start = at == 0 || rest[..at].ends_with([' ', '\n']);
                let is_public = rest[..at].trim_end_matches(' ').ends_with("pub")
                    || rest[..at].trim_end_matches(' ').ends_with("pub(crate)");
                let tail = &rest[at + 4..];
                let end = tail.find(';').unwrap_or(tail.len());
                if start && !tail[..end].contains('(') {
                    paths.extend(expanded(&tail[..end]).into_iter().map(|p| (p, is_public)));
                    rest = &tail[end..];
                } else {
                    rest = tail;
                }
            }
            for root in ["crate::", "super::"] {
                for (at, _) in code.match_indices(root) {
                    if code[..at].ends_with("::") {
                        continue;
                    }
                    let path: String = code[at..]
                        .chars()
                        .take_while(|c| c.is_alphanumeric() || "_:".contains(*c))
                        .collect();
                    paths.push((path.trim_end_matches(':').to_owned(), false));
                }
            }
            named.insert(module.clone(), paths);
        }
        Self { files: all, named }
    }

    /// The file that defines the item at a path, as seen from a module.
    fn defining(&self, from: &str, path: &str, depth: usize) -> Option<String> {
        let mut at: Vec<&str> = from.split("::").collect();
        let mut parts = path.split("::").map(str::trim).peekable();
        match parts.peek()? {
            &"crate" => {
                parts.next();
                at.clear();
            }
            &"super" => {
                while parts.peek() == Some(&"super") {
                    parts.next();
                    at.pop();
                }
            }
            &"self" => drop(parts.next()),
            first if self.files.contains_key(&format!("{from}::{first}")) => {}
            _ => return None,
        }
        let mut module = at.join("::");
        for part in parts {
            let deeper = if module.is_empty() {
                part.to_owned()
            } else {
                format!("{module}::{part}")
            };
            if self.files.contains_key(&deeper) {
                module = deeper;
                continue;
            }
            // An item that a folder's module re-exports is defined in a file below it.
            let exported = self
                .named
                .get(&module)
                .into_iter()
                .flatten()
                .filter(|(_, public)| *public);
            let found = exported
                .clone()
                .find(|(p, _)| p.rsplit("::").next() == Some(part))
                .and_then(|(p, _)| {
                    if depth < 4 {
                        self.defining(&module, p, depth + 1)
                    } else {
                        None
                    }
                });
            return found.or(Some(module)).filter(|m| !m.is_empty());
        }
        Some(module).filter(|m| !m.is_empty())
    }

    /// The dependencies of each file. A folder's own module and the files below it count as one
    /// unit: its `mod.rs` declares them and they extend it.
    fn arrows(&self) -> BTreeMap<&str, BTreeSet<String>> {
        let of = |(module, paths): (&'_ String, &Vec<(String, bool)>)| -> BTreeSet<String> {
            let targets = paths.iter().filter_map(|(p, _)| self.defining(module, p, 0));
            let is_kin = |t: &String| {
                t == module || module.starts_with(&format!("{t}::")) || t.starts_with(&format!("{module}::"))
            };
            targets.filter(|t| !is_kin(t)).collect()
        };
        self.named
            .iter()
            .map(|entry| (entry.0.as_str(), of(entry)))
            .collect()
    }
}

pub fn modules_name_only_those_before_them() {
    let house = House::new();
    let mut seen = 0;
    for (module, targets) in house.arrows() {
        let top = module.split("::").next().unwrap();
        let Some((_, allowed)) = ORDER.iter().find(|(name, _)| *name == top) else {
            assert!(
                ["error", "watch", "panic_guard"].contains(&top),
                "{module} is in no place of the order"
            );
            continue;
        };
        for target in targets {
            let other = target.split("::").next().unwrap();
            if other != top && ORDER.iter().any(|(name, _)| *name == other) {
                seen += 1;
                assert!(allowed.contains(&other), "{module} names {target}");
            }
        }
    }
    assert!(seen > 300, "the test sees only {seen} arrows");
    for file in files(&root().join("src"), "rs") {
        let name = file
            .strip_prefix(root().join("src"))
            .unwrap()
            .to_string_lossy()
            .into_owned();
        let allowed = name.starts_with("gpu/") || name.starts_with("render/");
        assert!(
            allowed || !code(&file).contains("wgpu::"),
            "{name}: wgpu outside gpu and render"
        );
        let is_window = name.starts_with("gui/");
        assert!(
            is_window || !code(&file).contains("egui"),
            "{name}: egui outside gui"
        );
    }
}

/// Files that depend on each other, directly or through a cycle.
fn circles(arrows: &BTreeMap<&str, BTreeSet<String>>) -> Vec<BTreeSet<String>> {
    let reachable = |from: &str| -> BTreeSet<String> {
        let (mut found, mut open) = (BTreeSet::new(), vec![from.to_owned()]);
        while let Some(next) = open.pop() {
            for target in arrows.get(next.as_str()).into_iter().flatten() {
                if found.insert(target.clone()) {
                    open.push(target.clone());
                }
            }
        }
        found
    };
    let all: BTreeMap<&str, BTreeSet<String>> = arrows.keys().map(|m| (*m, reachable(m))).collect();
    let mut found: Vec<BTreeSet<String>> = Vec::new();
    for (module, reach) in &all {
        if reach.contains(*module) && !found.iter().any(|c| c.contains(*module)) {
            found.push(
                reach
                    .iter()
                    .filter(|other| all.get(other.as_str()).is_some_and(|r| r.contains(*module)))
                    .cloned()
                    .collect(),
            );
        }
    }
    found
}

pub fn no_circles_between_files() {
    let house = House::new();
    let arrows = house.arrows();
    let found = circles(&arrows);
    assert!(found.is_empty(), "files name each other: {found:#?}");
    // Panels and views depend on the window's state, never the reverse.
    const SHOWN: [&str; 5] = ["gui::panels", "gui::views", "gui::app", "gui::edit", "gui::files"];
    for (module, targets) in arrows.iter().filter(|(m, _)| m.starts_with("gui::state")) {
        let shown = targets.iter().find(|t| SHOWN.iter().any(|s| t.starts_with(s)));
        assert!(shown.is_none(), "{module} names {shown:?}");
    }
    // The check detects a cycle.
    let arrow = |to: &str| BTreeSet::from([to.to_owned()]);
    assert_eq!(
        circles(&BTreeMap::from([
            ("a", arrow("b")),
            ("b", arrow("c")),
            ("c", arrow("a")),
            ("d", arrow("a"))
        ]))
        .len(),
        1
    );
}

/// Readers open files, and writers create them, in one place, so that its guarantees hold for all.
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
    // Files that are not user files, and exceptions explained at the call.
    const EXCEPTIONS: [(&str, &str); 5] = [
        ("gui/state/session.rs", "lock"),
        ("gui/state/session.rs", "File::open(path)"),
        ("gui/files.rs", "rename"),
        ("export/clip.rs", "folder.path().join(&file)"),
        ("deform/transform/itk.rs", "hdf5_pure::File::open"),
    ];
    let mut exceptions = 0;
    for file in files(&root().join("src"), "rs") {
        let name = file
            .strip_prefix(root().join("src"))
            .unwrap()
            .to_string_lossy()
            .into_owned();
        if name.starts_with("files/") {
            continue;
        }
        let text = std::fs::read_to_string(&file).unwrap();
        let code = text.split("#[cfg(test)]").next().unwrap();
        for line in code.lines().filter(|l| {
            !l.trim_start().starts_with("//")
                && WORDS.iter().any(|w| l.replace("OutputFile::", "").contains(w))
        }) {
            let excepted = EXCEPTIONS
                .iter()
                .any(|(of, word)| name == *of && line.contains(word));
            assert!(excepted, "{name} opens a file itself: {line}");
            exceptions += 1;
        }
    }
    assert!(exceptions >= 5, "{exceptions}");
}

/// Functions of a file that exceed the limit: name and lines.
fn long_functions(path: &Path) -> Vec<(String, usize)> {
    let code = code(path);
    let lines: Vec<&str> = code.lines().collect();
    let mut found = Vec::new();
    for (n, line) in lines.iter().enumerate() {
        let indent = line.len() - line.trim_start().len();
        let word = [
            "fn ",
            "pub fn ",
            "pub(super) fn ",
            "pub(crate) fn ",
            "pub(in crate::gui) fn ",
        ]
        .iter()
        .find_map(|w| line.trim_start().strip_prefix(w));
        let Some(rest) = word else { continue };
        let end = format!("{}}}", " ".repeat(indent));
        if let Some(length) = lines[n..].iter().position(|l| **l == end)
            && length + 1 > MAX_FUNCTION_LINES
        {
            found.push((rest.split(['(', '<']).next().unwrap().to_owned(), length + 1));
        }
    }
    found
}

pub fn files_and_functions_are_of_readable_size() {
    let (mut long_files, mut functions) = (Vec::new(), Vec::new());
    for (folder, extension) in [
        ("src", "rs"),
        ("shaders", "wgsl"),
        ("tests", "rs"),
        ("benches", "rs"),
    ] {
        for file in files(&root().join(folder), extension) {
            let name = file.strip_prefix(root()).unwrap().to_string_lossy().into_owned();
            let lines = std::fs::read_to_string(&file).unwrap().lines().count();
            if lines > MAX_FILE_LINES {
                long_files.push(format!("{name} ({lines} lines)"));
            }
            // A test or a benchmark may be one long function.
            if matches!(folder, "src" | "shaders") {
                functions.extend(
                    long_functions(&file)
                        .into_iter()
                        .map(|(function, lines)| format!("{name}: {function} ({lines} lines)")),
                );
            }
        }
    }
    assert!(
        long_files.is_empty(),
        "files of more than {MAX_FILE_LINES} lines: {long_files:#?}"
    );
    assert!(
        functions.is_empty(),
        "functions of more than {MAX_FUNCTION_LINES} lines: {functions:#?}"
    );
}

/// Names that say nothing to somebody who knows volume rendering.
const OBSCURE_NAMES: &[&str] = &[
    "Habit", "Again", "Making", "Unaided", "UnderWay", "Looks", "kept", "kept_mm", "said", "tell", "asked",
    "nobody", "matter", "haze", "shades",
];

pub fn names_are_plain() {
    let mut seen = 0;
    let folders = [
        ("src", "rs"),
        ("shaders", "wgsl"),
        ("tests", "rs"),
        ("benches", "rs"),
    ];
    for file in folders
        .iter()
        .flat_map(|(folder, extension)| files(&root().join(folder), extension))
    {
        let name = file.strip_prefix(root()).unwrap().to_string_lossy().into_owned();
        // This file lists the names.
        if name == "tests/architecture.rs" {
            continue;
        }
        for word in code(&file).split(|c: char| !c.is_alphanumeric() && c != '_') {
            seen += 1;
            assert!(!OBSCURE_NAMES.contains(&word), "{name} has the name {word}");
            assert!(
                !word.starts_with("MOST_") && !word.starts_with("LEAST_"),
                "{name}: {word} is a MAX_ or a MIN_"
            );
        }
    }
    assert!(seen > 100_000, "the test sees only {seen} words");
}
