//! Stacking of slices into one array.

use super::super::StoredValues;

/// One slice.
pub(super) struct ImageSlice {
    pub size: [usize; 2],
    pub components: usize,
    pub values: StoredValues,
}

/// One slice, and what its file states of it.
pub(super) struct StatedSlice {
    pub slice: ImageSlice,
    /// Whether its components are red, green, blue and perhaps opacity.
    pub is_color: bool,
    /// Whether low values are bright.
    pub is_inverted: bool,
    /// mm, along x, y, z.
    pub spacing: [Option<f64>; 3],
    /// Sentences about the file.
    pub notices: Vec<String>,
}

/// A stack of slices, stored as one array.
#[derive(Default)]
pub(super) struct ImageStack {
    pub size: [usize; 2],
    pub components: usize,
    pub count: usize,
    values: Option<StoredValues>,
}

impl ImageStack {
    /// Adds a slice; false if its size or type differs from the first one's.
    pub fn push(&mut self, plane: ImageSlice, of: usize) -> bool {
        match &mut self.values {
            None => {
                (self.size, self.components) = (plane.size, plane.components);
                let mut values = plane.values;
                values.reserve(
                    plane.size[0]
                        .saturating_mul(plane.size[1])
                        .saturating_mul(plane.components)
                        .saturating_mul(of.saturating_sub(1)),
                );
                self.values = Some(values);
            }
            Some(values) => {
                if (self.size, self.components) != (plane.size, plane.components)
                    || !values.append(&plane.values)
                {
                    return false;
                }
            }
        }
        self.count += 1;
        true
    }

    /// All values; none if there are no slices.
    pub fn finish(self) -> Option<StoredValues> {
        self.values
    }
}
