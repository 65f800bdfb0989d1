//! Deformations that come from a file rather than from a formula, and the settings that each takes.

use super::kinds::{Setting, SettingFormat};

/// Deformations that come from a file rather than from a formula.
pub struct FileKind {
    /// What people type.
    pub name: &'static str,
    /// One line for lists.
    pub about: &'static str,
    /// Names and meanings of its settings.
    pub settings: &'static [Setting],
}

/// The deformations from files.
pub const FILE_KINDS: &[FileKind] = &[
    FileKind {
        name: "field",
        about: "a registration's transform or displacement field; progress=0..1",
        settings: &[
            Setting { name: "path", form: SettingFormat::Files, about: "file, or files that a deformed point goes through in order" },
            Setting { name: "moving", form: SettingFormat::File, about: "the image that is deformed, for FSL's files" },
            Setting { name: "reference", form: SettingFormat::File, about: "the image onto which it was registered, for FSL's files" },
            Setting {
                name: "convention",
                form: SettingFormat::OneOf(&["lps", "ras", "fsl", "fsl-absolute"]),
                about: "of vectors: lps, ras, fsl or fsl-absolute, where the file does not say",
            },
            Setting { name: "invert", form: SettingFormat::Flag, about: "true uses the inverse" },
        ],
    },
    FileKind {
        name: "map",
        about: "a displacement map made by incise map; placed anew where center, size or rotate are given",
        settings: &[Setting { name: "path", form: SettingFormat::File, about: "file" }],
    },
];
