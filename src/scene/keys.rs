//! Checks a scene's text against the schema of the format. An unknown key is reported with the
//! closest known one, a value of the wrong type with the expected type. The parser alone reports
//! only the table in which an error is, not the key.

use crate::deform::file_kinds::FILE_KINDS;
use crate::deform::kinds;
use crate::error::suggestion;
use serde_json::Value as Schema;
use toml::Value;

/// Checks a scene's table.
///
/// # Errors
/// The first key that is unknown, missing or of a wrong type, as a sentence without the file's
/// name.
pub(super) fn check(root: &Schema, table: &toml::Table) -> Result<(), String> {
    Checker { root }.value(root, &Value::Table(table.clone()), "")
}

struct Checker<'a> {
    root: &'a Schema,
}

/// Names of a kind's parameters and settings; none if the kind is unknown.
fn parameters(kind: &str) -> Option<Vec<&'static str>> {
    if let Some(file) = FILE_KINDS.iter().find(|k| k.name == kind) {
        return Some(file.settings().map(|s| s.name).collect());
    }
    let kind = kinds::kind(kind).ok()?;
    Some(
        kind.parameters
            .iter()
            .map(|p| p.name)
            .chain(kind.settings().map(|s| s.name))
            .collect(),
    )
}

/// A value in words, truncated.
fn shown(value: &Value) -> String {
    match value {
        Value::String(text) => format!("the string \"{}\"", text.chars().take(40).collect::<String>()),
        Value::Boolean(b) => b.to_string(),
        Value::Integer(n) => n.to_string(),
        Value::Float(v) => v.to_string(),
        Value::Array(items) => format!("a list of length {}", items.len()),
        Value::Table(_) => "a section".into(),
        Value::Datetime(d) => format!("the date {d}"),
    }
}

impl<'a> Checker<'a> {
    /// Follows `$ref`.
    fn resolved(&self, schema: &'a Schema) -> &'a Schema {
        match schema.get("$ref").and_then(Schema::as_str) {
            Some(reference) => self
                .root
                .pointer(reference.trim_start_matches('#'))
                .map_or(schema, |s| self.resolved(s)),
            None => schema,
        }
    }

    /// The alternative schemas of a value, without `null`, which TOML does not have.
    fn ways(&self, schema: &'a Schema) -> Vec<&'a Schema> {
        let schema = self.resolved(schema);
        match schema.get("anyOf").and_then(Schema::as_array) {
            Some(all) => all
                .iter()
                .filter(|s| s.get("type").and_then(Schema::as_str) != Some("null"))
                .flat_map(|s| self.ways(s))
                .collect(),
            None => vec![schema],
        }
    }

    fn value(&self, schema: &'a Schema, value: &Value, path: &str) -> Result<(), String> {
        let ways = self.ways(schema);
        let fitting = ways.iter().find(|way| self.fits(way, value));
        let Some(way) = fitting else {
            let mut lists = ways.iter().filter(|way| has_length(way, value));
            if let (Value::Array(items), Some(list), None) = (value, lists.next(), lists.next())
                && let Some(of_items) = list.get("items")
            {
                // Only the items can be of a wrong type.
                items
                    .iter()
                    .try_for_each(|item| self.value(of_items, item, path))?;
            }
            let needed: Vec<String> = ways.iter().map(|way| self.needed(way)).collect();
            return Err(format!(
                "has {} for \"{path}\", which must be {}",
                shown(value),
                needed.join(" or ")
            ));
        };
        match value {
            Value::Array(items) => {
                let Some(of_items) = way.get("items") else {
                    return Ok(());
                };
                let numbered = items.first().is_some_and(Value::is_table) && items.len() > 1;
                items.iter().enumerate().try_for_each(|(n, item)| {
                    let path = if numbered {
                        format!("{path} {}", n + 1)
                    } else {
                        path.to_owned()
                    };
                    self.value(of_items, item, &path)
                })
            }
            Value::Table(entries) => self.table(way, entries, path),
            _ => Ok(()),
        }
    }

    fn table(&self, schema: &'a Schema, entries: &toml::Table, path: &str) -> Result<(), String> {
        let Some(properties) = schema.get("properties").and_then(Schema::as_object) else {
            return Ok(());
        };
        let within = |key: &str| {
            if path.is_empty() {
                key.to_owned()
            } else {
                format!("{path}.{key}")
            }
        };
        let section = path.split(' ').next().unwrap_or_default();
        for (key, entry) in entries {
            if let Some(of_key) = properties.get(key) {
                self.value(of_key, entry, &within(key))?;
                continue;
            }
            let mut valid_names: Vec<&str> = properties.keys().map(String::as_str).collect();
            if path.contains(".deformer") {
                // A deformer's numbers are checked by its kind when it is built.
                match entry {
                    Value::Float(_) | Value::Integer(_) => continue,
                    other
                        if matches!(
                            key.as_str(),
                            "angle" | "factor" | "amount" | "width" | "amplitude" | "length" | "phase"
                        ) =>
                    {
                        return Err(format!(
                            "has {} for \"{}\", which must be a number",
                            shown(other),
                            within(key)
                        ));
                    }
                    _ => {}
                }
            }
            if section == "deformation" {
                // A deformation's remaining keys are its kind's parameters.
                let Some(own) = entries.get("kind").and_then(Value::as_str).and_then(parameters) else {
                    continue;
                };
                if own.contains(&key.as_str()) {
                    argument(entry, &within(key))?;
                    continue;
                }
                valid_names.extend(own);
            }
            return Err(format!(
                "has the unknown key \"{}\"; {}",
                within(key),
                suggestion(key, valid_names)
            ));
        }
        let required = schema
            .get("required")
            .and_then(Schema::as_array)
            .into_iter()
            .flatten()
            .filter_map(Schema::as_str);
        match required.into_iter().find(|key| !entries.contains_key(*key)) {
            Some(missing) if path.is_empty() => Err(format!("lacks the key \"{missing}\"")),
            Some(missing) => Err(format!("lacks the key \"{missing}\" in \"{path}\"")),
            None => Ok(()),
        }
    }

    /// Whether a value is of a schema's type. Its contents are checked separately, so that the
    /// offending item is named.
    fn fits(&self, schema: &'a Schema, value: &Value) -> bool {
        if let Some(choices) = choices(schema) {
            return value.as_str().is_some_and(|v| choices.contains(&v));
        }
        let bound = |name: &str| schema.get(name).and_then(Schema::as_f64);
        types(schema).iter().any(|t| match (*t, value) {
            ("string", Value::String(_))
            | ("boolean", Value::Boolean(_))
            | ("object", Value::Table(_))
            | ("number", Value::Float(_) | Value::Integer(_)) => true,
            ("integer", Value::Integer(n)) => {
                bound("minimum").is_none_or(|m| *n as f64 >= m)
                    && bound("maximum").is_none_or(|m| *n as f64 <= m)
            }
            ("array", Value::Array(items)) => {
                // Of several schemas for a list, the one whose items have this type.
                let first = schema
                    .get("items")
                    .zip(items.first())
                    .is_none_or(|(s, i)| self.ways(s).into_iter().any(|way| self.fits(way, i)));
                first && has_length(schema, value)
            }
            _ => false,
        })
    }

    /// What a schema requires, in words.
    fn needed(&self, schema: &'a Schema) -> String {
        if let Some(choices) = choices(schema) {
            if let [only] = choices[..] {
                return format!("\"{only}\"");
            }
            return format!(
                "one of {}",
                choices
                    .iter()
                    .map(|c| format!("\"{c}\""))
                    .collect::<Vec<_>>()
                    .join(", ")
            );
        }
        let whole = |name: &str| schema.get(name).and_then(Schema::as_u64);
        match types(schema).first().copied() {
            Some("string") => "a string in quotes".into(),
            Some("boolean") => "true or false".into(),
            Some("number") => "a number".into(),
            Some("integer") => match whole("maximum") {
                Some(most) => format!("a whole number from {} to {most}", whole("minimum").unwrap_or(0)),
                None => "a whole number, 0 or more".into(),
            },
            Some("array") => {
                let of = schema.get("items").map_or("values", |items| {
                    match types(self.resolved(items)).first().copied().unwrap_or("") {
                        "number" | "integer" => "numbers",
                        "string" => "strings",
                        "array" => "rows of numbers",
                        "object" => "sections",
                        _ => "values",
                    }
                });
                match (whole("minItems"), whole("maxItems")) {
                    (Some(n), Some(m)) if n == m => format!("a list of {n} {of}"),
                    _ => format!("a list of {of}"),
                }
            }
            Some("object") => "a section".into(),
            _ => "something else".into(),
        }
    }
}

/// Whether a list has a length that the schema allows.
fn has_length(schema: &Schema, value: &Value) -> bool {
    let bound = |name: &str| schema.get(name).and_then(Schema::as_u64);
    let Some(n) = value.as_array().map(|items| items.len() as u64) else {
        return false;
    };
    types(schema).contains(&"array")
        && bound("minItems").is_none_or(|m| n >= m)
        && bound("maxItems").is_none_or(|m| n <= m)
}

/// The types of a schema, without `null`.
fn types(schema: &Schema) -> Vec<&str> {
    match schema.get("type") {
        Some(Schema::String(one)) => vec![one],
        Some(Schema::Array(all)) => all
            .iter()
            .filter_map(Schema::as_str)
            .filter(|t| *t != "null")
            .collect(),
        _ => Vec::new(),
    }
}

/// The strings that a schema allows, if it is an enumeration.
fn choices(schema: &Schema) -> Option<Vec<&str>> {
    let one = |s: &'_ Schema| s.get("const").and_then(Schema::as_str).is_some();
    if let Some(all) = schema.get("enum").and_then(Schema::as_array) {
        return Some(all.iter().filter_map(Schema::as_str).collect());
    }
    let all = schema
        .get("oneOf")
        .and_then(Schema::as_array)
        .filter(|all| all.iter().all(|s| one(s) || s.get("enum").is_some()))?;
    Some(
        all.iter()
            .flat_map(|s| {
                s.get("const")
                    .into_iter()
                    .chain(s.get("enum").and_then(Schema::as_array).into_iter().flatten())
            })
            .filter_map(Schema::as_str)
            .collect(),
    )
}

/// Checks a value of a deformation's parameter: a boolean, number or string, or a list of numbers,
/// strings or rows of numbers.
fn argument(value: &Value, path: &str) -> Result<(), String> {
    let is_number = |v: &Value| matches!(v, Value::Float(_) | Value::Integer(_));
    let is_row = |v: &Value| v.as_array().is_some_and(|row| row.iter().all(is_number));
    let fits = match value {
        Value::Array(items) => {
            items.iter().all(is_number) || items.iter().all(Value::is_str) || items.iter().all(is_row)
        }
        Value::Table(_) | Value::Datetime(_) => false,
        _ => true,
    };
    if fits {
        Ok(())
    } else {
        Err(format!(
            "has {} for \"{path}\", which must be a number, a string, true or false, or a list of numbers or strings",
            shown(value)
        ))
    }
}
