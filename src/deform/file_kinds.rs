//! Deformations that come from a file rather than from a formula, with the settings of each.

use super::kinds::{Setting, SettingFormat};

/// Deformations that come from a file rather than from a formula.
pub struct FileKind {
    /// Name as typed.
    pub name: &'static str,
    /// One line for lists.
    pub about: &'static str,
    /// Names and meanings of the settings.
    pub settings: &'static [Setting],
}

/// The deformations from files.
pub const FILE_KINDS: &[FileKind] = &[
    FileKind {
        name: "field",
        about: "a registration transform or displacement field; progress=0..1",
        settings: &[
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
            Setting {
                name: "mapping",
                form: SettingFormat::Choice(&["none", "cylindrical"]),
                about: "none, or cylindrical: x runs around the box's z axis, y along it, z outwards",
            },
            Setting {
                name: "fade",
                form: SettingFormat::Number,
                about: "width over which the displacement fades towards the faces of the box, mm; 0 by default",
            },
            Setting {
                name: "spare",
                form: SettingFormat::Whole,
                about: "labels to protect from cutting and moving",
            },
            Setting {
                name: "labels",
                form: SettingFormat::File,
                about: "file of the label map; by default the volume itself",
            },
        ],
    },
    FileKind {
        name: "map",
        about: "a displacement map made by incise map; center, size or rotate override its placement",
        settings: &[
            Setting {
                name: "path",
                form: SettingFormat::File,
                about: "file",
            },
            Setting {
                name: "mapping",
                form: SettingFormat::Choice(&["none", "cylindrical"]),
                about: "none, or cylindrical: x runs around the box's z axis, y along it, z outwards",
            },
            Setting {
                name: "fade",
                form: SettingFormat::Number,
                about: "width over which the displacement fades towards the faces of the box, mm; 0 by default",
            },
            Setting {
                name: "spare",
                form: SettingFormat::Whole,
                about: "labels to protect from cutting and moving",
            },
            Setting {
                name: "labels",
                form: SettingFormat::File,
                about: "file of the label map; by default the volume itself",
            },
        ],
    },
];
