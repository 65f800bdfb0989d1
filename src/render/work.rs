//! Work counters of a renderer: a picture that differs little from the previous one should add
//! little.

use std::sync::atomic::{AtomicU32, Ordering};

/// Work of a [`Renderer`](super::Renderer) since its creation.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Work {
    /// Pipelines compiled.
    pub pipelines_compiled: u32,
    /// Textures created.
    pub textures_created: u32,
    /// Buffers created.
    pub buffers_created: u32,
    /// Bind groups created.
    pub bind_groups_created: u32,
    /// Volumes and gradient volumes written to a texture.
    pub volume_uploads: u32,
    /// Displacement maps written to a texture.
    pub map_uploads: u32,
    /// Transfer functions written to the table's texture.
    pub table_uploads: u32,
    /// Macrocells written to their texture.
    pub cell_uploads: u32,
    /// Fields of surfaces written to a texture.
    pub field_uploads: u32,
    /// Light volumes written to their texture.
    pub light_uploads: u32,
}

impl Work {
    /// The work added since an earlier state.
    pub fn since(&self, before: &Self) -> Self {
        Self {
            pipelines_compiled: self.pipelines_compiled.wrapping_sub(before.pipelines_compiled),
            textures_created: self.textures_created.wrapping_sub(before.textures_created),
            buffers_created: self.buffers_created.wrapping_sub(before.buffers_created),
            bind_groups_created: self.bind_groups_created.wrapping_sub(before.bind_groups_created),
            volume_uploads: self.volume_uploads.wrapping_sub(before.volume_uploads),
            map_uploads: self.map_uploads.wrapping_sub(before.map_uploads),
            table_uploads: self.table_uploads.wrapping_sub(before.table_uploads),
            cell_uploads: self.cell_uploads.wrapping_sub(before.cell_uploads),
            field_uploads: self.field_uploads.wrapping_sub(before.field_uploads),
            light_uploads: self.light_uploads.wrapping_sub(before.light_uploads),
        }
    }
}

/// A counted resource, in the order of [`Work`]'s fields.
#[derive(Clone, Copy)]
pub(super) enum ResourceKind {
    Pipeline,
    Texture,
    Buffer,
    BindGroup,
    Volume,
    Map,
    TransferTable,
    Cells,
    Field,
    LightVolume,
}

/// The counters. Atomic because a device also evaluates stacks through a shared reference to the
/// renderer.
#[derive(Default)]
pub(super) struct WorkCounters([AtomicU32; 10]);

impl WorkCounters {
    pub(super) fn count(&self, made: ResourceKind) {
        self.0[made as usize].fetch_add(1, Ordering::Relaxed);
    }

    pub(super) fn work(&self) -> Work {
        let n = |made: ResourceKind| self.0[made as usize].load(Ordering::Relaxed);
        Work {
            pipelines_compiled: n(ResourceKind::Pipeline),
            textures_created: n(ResourceKind::Texture),
            buffers_created: n(ResourceKind::Buffer),
            bind_groups_created: n(ResourceKind::BindGroup),
            volume_uploads: n(ResourceKind::Volume),
            map_uploads: n(ResourceKind::Map),
            table_uploads: n(ResourceKind::TransferTable),
            cell_uploads: n(ResourceKind::Cells),
            field_uploads: n(ResourceKind::Field),
            light_uploads: n(ResourceKind::LightVolume),
        }
    }
}
