//! The error type: every message names the file or option, states what is wrong and what to do.

use std::path::{Path, PathBuf};

/// What can go wrong between a user's input and a picture.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// A file could not be opened, read or written.
    #[error("{}: {doing} failed: {source}{hint}", shown(path))]
    Io {
        /// The file.
        path: PathBuf,
        /// The operation that failed, e.g. `reading`.
        doing: &'static str,
        /// The operating system's error.
        source: std::io::Error,
        /// What to do, starting with `; ` (or empty).
        hint: &'static str,
    },
    /// A file was read but its content is unusable.
    #[error("{}: {problem}", shown(path))]
    File {
        /// The file.
        path: PathBuf,
        /// What is wrong with it and what to do.
        problem: String,
    },
    /// An option, key or parameter has an unusable value.
    #[error("{name}: {problem}")]
    Value {
        /// The option or key as the user typed it.
        name: String,
        /// What is wrong with it and what to do.
        problem: String,
    },
    /// The work was cancelled.
    #[error("cancelled")]
    Cancelled,
    /// No graphics adapter, or one that failed.
    #[error("GPU: {0}")]
    Gpu(String),
    /// The scene exceeds a limit of a working graphics adapter; the CPU can render it.
    #[error("GPU: {0}")]
    GpuLimit(String),
}

/// A result with this crate's [`Error`].
pub type Result<T, E = Error> = std::result::Result<T, E>;

/// A path as shown in a message: file names may hold control characters, which can move a
/// terminal's cursor.
fn shown(path: &Path) -> String {
    path.to_string_lossy().replace(char::is_control, "\u{fffd}")
}

impl Error {
    /// An [`Error::Io`] with a hint for the most common causes.
    pub fn io(path: &Path, doing: &'static str, source: std::io::Error) -> Self {
        use std::io::ErrorKind as K;
        let hint = match source.kind() {
            K::NotFound => "; check the path",
            K::PermissionDenied | K::ReadOnlyFilesystem => {
                "; choose a place that can be written, or change the permissions"
            }
            _ => "",
        };
        Self::Io {
            path: path.to_owned(),
            doing,
            source,
            hint,
        }
    }

    /// An [`Error::File`].
    pub fn file(path: &Path, problem: impl Into<String>) -> Self {
        Self::File {
            path: path.to_owned(),
            problem: problem.into(),
        }
    }

    /// The same error inside a named part: `peel: radius: ...`.
    #[must_use]
    pub fn within(self, part: &str) -> Self {
        match self {
            Self::Value { name, problem } => Self::Value {
                name: format!("{part}: {name}"),
                problem,
            },
            other => other,
        }
    }

    /// The same without line breaks and other control characters, which quoted text from a damaged
    /// file may contain.
    pub fn printable(self) -> Self {
        let plain = |text: String| {
            if text.contains(char::is_control) {
                text.replace(char::is_control, " ")
            } else {
                text
            }
        };
        match self {
            Self::File { path, problem } => Self::File {
                path,
                problem: plain(problem),
            },
            Self::Value { name, problem } => Self::Value {
                name,
                problem: plain(problem),
            },
            other => other,
        }
    }

    /// An [`Error::Value`].
    pub fn value(name: impl Into<String>, problem: impl Into<String>) -> Self {
        Self::Value {
            name: name.into(),
            problem: problem.into(),
        }
    }
}

/// `; did you mean "peel"?` for the closest of `valid_names`, or the list of them if none is close.
pub(crate) fn suggestion<'a>(word: &str, valid_names: impl IntoIterator<Item = &'a str>) -> String {
    let valid_names: Vec<&str> = valid_names.into_iter().collect();
    let closest = valid_names
        .iter()
        .map(|k| (strsim::normalized_damerau_levenshtein(word, k), k))
        .max_by(|a, b| a.0.total_cmp(&b.0));
    match closest {
        Some((score, k)) if score >= 0.4 => format!("did you mean \"{k}\"?"),
        _ => format!("known: {}", valid_names.join(", ")),
    }
}
