//! Scenes of earlier versions of the format. What later versions do by default an earlier scene
//! then refuses explicitly, so that it looks as it did.

use crate::transfer::preset;
use toml::{Table, Value};

/// The first version.
pub(super) const OLDEST_VERSION: u32 = 1;

/// Brings the table of a scene of version 1 to version 2: pictures without antialiasing, linear
/// interpolation, transfer functions that are not pre-integrated, presets relative to all values,
/// and deformations without numbers in the middle of the volume.
pub(super) fn from_version_1(table: &mut Table) {
    table.insert("incise".into(), Value::Integer(2));
    state(section(table, "render"), "antialias", Value::Integer(1));
    state(section(table, "render"), "filter", Value::String("linear".into()));
    state(section(table, "render"), "preintegrated", Value::Boolean(false));
    for deformation in table
        .get_mut("deformation")
        .and_then(Value::as_array_mut)
        .into_iter()
        .flatten()
    {
        let states = |key: &str| deformation.get(key).is_some();
        // A file has a placement of its own.
        let is_file = matches!(
            deformation.get("kind").and_then(Value::as_str),
            Some("field" | "map")
        );
        let is_placed = states("matrix") || states("center") && states("size");
        if !(is_file || is_placed) {
            state(deformation, "placement", Value::String("volume".into()));
        }
    }
    let states_values = |transfer: &Value| {
        let named = transfer.get("preset").and_then(Value::as_str).and_then(preset);
        transfer.get("points").is_some() || named.is_some_and(|p| !p.depends_on_volume())
    };
    if table.contains_key("volume") && !table.get("transfer").is_some_and(states_values) {
        state(
            section(table, "transfer"),
            "relative_to",
            Value::String("range".into()),
        );
    }
}

/// A section, created if the scene has none.
fn section<'a>(table: &'a mut Table, name: &str) -> &'a mut Value {
    table.entry(name).or_insert_with(|| Value::Table(Table::new()))
}

/// States a setting that the scene leaves to its default.
fn state(section: &mut Value, key: &str, value: Value) {
    if let Some(section) = section.as_table_mut() {
        section.entry(key).or_insert(value);
    }
}
