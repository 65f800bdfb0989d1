//! Deformations that come from a file rather than from a formula, with the settings of each.

use super::kinds::{COMMON_SETTINGS, Setting, SettingFormat};

/// Deformations that come from a file rather than from a formula.
pub struct FileKind {
    /// Name as typed.
    pub name: &'static str,
    /// One line for lists.
    pub about: &'static str,
    /// Its own settings.
    pub own_settings: &'static [Setting],
}

impl FileKind {
    /// All settings: its own and those common to every kind.
    pub fn settings(&self) -> impl Iterator<Item = &'static Setting> {
        self.own_settings.iter().chain(COMMON_SETTINGS)
    }
}

/// The deformations from files.
pub const FILE_KINDS: &[FileKind] = &[
    FileKind {
        name: "field",
        about: "a registration transform or displacement field; progress=0..1",
        own_settings: &[
            Setting {
                name: "path",
                form: SettingFormat::Files,
                about: "file, or several files applied in order (from deformed to source)",
            },
            Setting {
                name: "moving",
                form: SettingFormat::File,
                about: "the moving image, for FSL files",
            },
            Setting {
                name: "reference",
                form: SettingFormat::File,
                about: "the reference image of the registration, for FSL files",
            },
            Setting {
                name: "convention",
                form: SettingFormat::OneOf(&["lps", "ras", "fsl", "fsl-absolute"]),
                about: "vector convention (lps, ras, fsl or fsl-absolute) if the file does not state it",
            },
            Setting {
                name: "invert",
                form: SettingFormat::Flag,
                about: "true uses the inverse",
            },
        ],
    },
    FileKind {
        name: "map",
        about: "a displacement map made by incise map; center, size or rotate override its placement",
        own_settings: &[Setting {
            name: "path",
            form: SettingFormat::File,
            about: "file",
        }],
    },
];
