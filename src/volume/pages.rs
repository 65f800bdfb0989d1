//! Large arrays in separately mapped memory, on huge pages where the system has them.
//!
//! A renderer reads a volume in random order: on 4 KiB pages the first access to each page costs a
//! fault, and later ones a page-table walk.

use bytemuck::{AnyBitPattern, NoUninit};
use memmap2::MmapMut;
use std::marker::PhantomData;
use std::ops::{Deref, DerefMut};

/// An array, initially zero.
pub struct MappedArray<T> {
    memory: MmapMut,
    of: PhantomData<T>,
}

impl<T: AnyBitPattern + NoUninit> MappedArray<T> {
    /// None if there is not enough memory.
    pub fn zeroed(count: usize) -> Option<Self> {
        let memory = MmapMut::map_anon(count.checked_mul(size_of::<T>())?).ok()?;
        // Systems without huge pages, or with restricted ones, provide ordinary pages.
        #[cfg(target_os = "linux")]
        let _ = memory.advise(memmap2::Advice::HugePage);
        Some(Self {
            memory,
            of: PhantomData,
        })
    }
}

impl<T: AnyBitPattern + NoUninit> Deref for MappedArray<T> {
    type Target = [T];

    fn deref(&self) -> &[T] {
        bytemuck::cast_slice(&self.memory)
    }
}

impl<T: AnyBitPattern + NoUninit> DerefMut for MappedArray<T> {
    fn deref_mut(&mut self) -> &mut [T] {
        bytemuck::cast_slice_mut(&mut self.memory)
    }
}
