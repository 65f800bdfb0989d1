//! Large arrays in memory of their own, on huge pages where the system has them.
//!
//! A renderer reads a volume in no order: on pages of 4 KiB the first touch of each costs a fault, and later ones a walk through the page table.

use bytemuck::{AnyBitPattern, NoUninit};
use memmap2::MmapMut;
use std::marker::PhantomData;
use std::ops::{Deref, DerefMut};

/// An array of zeros at first.
pub struct MappedArray<T> {
    memory: MmapMut,
    of: PhantomData<T>,
}

impl<T: AnyBitPattern + NoUninit> MappedArray<T> {
    /// None if there is no memory for so many.
    pub fn zeroed(count: usize) -> Option<Self> {
        let memory = MmapMut::map_anon(count.checked_mul(size_of::<T>())?).ok()?;
        // Systems without huge pages, or that keep them for others, give pages as ever.
        #[cfg(target_os = "linux")]
        let _ = memory.advise(memmap2::Advice::HugePage);
        Some(Self { memory, of: PhantomData })
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
