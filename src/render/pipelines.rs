//! Pipelines of a picture, compiled once per variant.

use super::constants::OwnColors;
use super::context::{Context, lock};
use super::counter::Counter;
use super::target::{Corner, MASK, PROJECTION_FORMAT};
use super::variant::{Variant, overrides};
use super::work::ResourceKind;
use crate::gpu::shaders::Program;
use crate::prepare::Prepared;
use crate::scene::{BlendFormat, MapFiltering, Mode, Normals, SliceOrder};
use crate::transfer::Blend;
use wgpu::TextureFormat;

impl Context {
    pub(super) fn variant(&self, scene: &Prepared, program: Program, counting: bool) -> Variant {
        let march = matches!(
            program,
            Program::Raycast | Program::RaycastCompute | Program::Slice
        );
        Variant {
            program,
            exact: self.strategy.exact_filter,
            exact_maps: self.filters_maps_exactly(scene),
            counting: counting && (march || matches!(program, Program::Surface | Program::SliceSurface)),
            maps: scene.stack.maps().len(),
            precomposed: scene.stack.precomposed().is_some(),
            normals: if scene.is_lit() {
                scene.settings.normals
            } else {
                Normals::None
            },
            blend: scene.volume().blend,
            gradient: scene.gradient_filter(),
            cubic: scene.is_cubic() && march,
            slab: if program == Program::Slice {
                scene.slices_per_slab()
            } else {
                1
            },
            order: scene.slice_order(),
            listed: false,
            masked: false,
            format: self.picture_format(scene),
            cuts: scene.cuts.primitives().len(),
            grey_faces: scene.grey_faces(),
            iso: scene
                .volume()
                .iso
                .filter(|_| scene.volume().blend == Blend::Composite)
                .map(|_| scene.settings.iso_light),
            colors: OwnColors::of(scene.volume().colors),
            function: if march {
                self.function(scene.volume().grid)
            } else {
                None
            },
            preintegrated: scene.preintegrated() && march,
            light_volume: scene.light_volume.is_some(),
            behind: (march
                || matches!(
                    program,
                    Program::SliceSurface | Program::Resolve | Program::SurfacesBehind
                ))
                && scene.has_surfaces_behind(),
        }
    }

    /// Whether shaders interpolate a scene's maps.
    fn filters_maps_exactly(&self, scene: &Prepared) -> bool {
        match scene.settings.map_filter {
            Some(filter) => filter == MapFiltering::Shader,
            None => self.strategy.exact_filter,
        }
    }

    /// Whether a scene's slices are to be blended in 32 bits.
    fn blends_in_32_bits(scene: &Prepared) -> bool {
        scene.settings.mode == Mode::Slice
            && scene.volume().blend == Blend::Composite
            && scene.settings.blend_format == BlendFormat::Float32
    }

    /// Whether the device can blend a scene's slices in the scene's format.
    pub(super) fn can_blend(&self, scene: &Prepared) -> bool {
        let features = self.device.device.features();
        !Self::blends_in_32_bits(scene) || features.contains(wgpu::Features::FLOAT32_BLENDABLE)
    }

    /// The format of a scene's picture: 32 bits only for slices that are blended in them, on a
    /// device that can.
    pub(super) fn picture_format(&self, scene: &Prepared) -> TextureFormat {
        if Self::blends_in_32_bits(scene) && self.can_blend(scene) {
            TextureFormat::Rgba32Float
        } else {
            TextureFormat::Rgba16Float
        }
    }

    pub(super) fn compile(&self, scene: &Prepared, counting: bool) {
        let front_to_back = scene.slice_order() == SliceOrder::FrontToBack;
        let mut programs = match (scene.settings.mode, scene.volume().blend) {
            (Mode::Surface, _) => vec![],
            (Mode::Raycast, _) => vec![self.strategy.rays()],
            (Mode::Slice, Blend::Composite) if front_to_back => vec![Program::Slice, Program::Opaque],
            (Mode::Slice, Blend::Composite) => vec![Program::Slice],
            (Mode::Slice, _) => vec![Program::Slice, Program::Resolve],
        };
        if scene.settings.mode == Mode::Slice
            && scene.volume().blend == Blend::Composite
            && scene.has_surfaces_behind()
        {
            programs.push(Program::SurfacesBehind);
        }
        for program in programs {
            let variant = self.variant(scene, program, counting);
            if program == Program::RaycastCompute {
                self.ray_pipeline(variant);
            } else {
                self.pipeline(variant);
            }
        }
    }

    /// The pipeline of a variant, compiled on first use.
    pub(super) fn pipeline(&self, variant: Variant) -> wgpu::RenderPipeline {
        lock(&self.pipelines)
            .entry(variant)
            .or_insert_with(|| self.compiled(variant))
            .clone()
    }

    /// The shader of a variant.
    pub(super) fn shader_module(&self, variant: &Variant) -> wgpu::ShaderModule {
        self.module_of(variant.program, variant.counting, variant.function)
    }

    /// Compiles the pipeline of a variant.
    fn compiled(&self, variant: Variant) -> wgpu::RenderPipeline {
        self.tally.count(ResourceKind::Pipeline);
        let device = &self.device.device;
        let module = self.shader_module(&variant);
        let constants = overrides(&variant);
        let options = wgpu::PipelineCompilationOptions {
            constants: &constants,
            ..Default::default()
        };
        let has_mask = matches!(
            (variant.program, variant.blend),
            (Program::Slice, Blend::Composite) | (Program::Opaque | Program::Mask, _)
        ) || variant.masked;
        let writes_mask = matches!(variant.program, Program::Opaque | Program::Mask);
        let has_corners = matches!(variant.program, Program::Slice | Program::Opaque);
        let color = [Some(color_target(&variant))];
        let own_layout = match variant.program {
            Program::Resolve | Program::Opaque | Program::Mask => Some(gathered_layout(device)),
            _ if variant.counting => Some(Counter::layout(device)),
            _ => None,
        };
        let layout = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label: None,
            bind_group_layouts: &[Some(&self.shared_layout), own_layout.as_ref()],
            immediate_size: 0,
        });
        let corner = wgpu::VertexBufferLayout {
            array_stride: size_of::<Corner>() as u64,
            step_mode: wgpu::VertexStepMode::Vertex,
            attributes: &wgpu::vertex_attr_array![0 => Float32x4],
        };
        let buffers = [Some(corner)];
        device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
            label: Some(&format!("{:?}", variant.program)),
            layout: Some(&layout),
            vertex: wgpu::VertexState {
                module: &module,
                entry_point: Some("vertex"),
                compilation_options: options.clone(),
                buffers: if has_corners { &buffers } else { &[] },
            },
            primitive: wgpu::PrimitiveState::default(),
            depth_stencil: has_mask.then(|| wgpu::DepthStencilState {
                format: MASK,
                depth_write_enabled: Some(writes_mask),
                // From back to front no opaque pixel is masked.
                depth_compare: Some(if variant.order == SliceOrder::BackToFront && !variant.masked {
                    wgpu::CompareFunction::Always
                } else {
                    wgpu::CompareFunction::Less
                }),
                stencil: wgpu::StencilState::default(),
                bias: wgpu::DepthBiasState::default(),
            }),
            multisample: wgpu::MultisampleState::default(),
            fragment: Some(wgpu::FragmentState {
                module: &module,
                entry_point: Some("fragment"),
                compilation_options: options,
                targets: if writes_mask { &[] } else { &color },
            }),
            multiview_mask: None,
            cache: None,
        })
    }
}

/// The format that a variant draws to, and how it blends.
pub(super) fn color_target(variant: &Variant) -> wgpu::ColorTargetState {
    // New content, premultiplied, is blended over or under the existing content.
    let (src_factor, dst_factor) = match variant.order {
        SliceOrder::BackToFront => (wgpu::BlendFactor::One, wgpu::BlendFactor::OneMinusSrcAlpha),
        SliceOrder::FrontToBack => (wgpu::BlendFactor::OneMinusDstAlpha, wgpu::BlendFactor::One),
    };
    let component = wgpu::BlendComponent {
        src_factor,
        dst_factor,
        operation: wgpu::BlendOperation::Add,
    };
    let composited = wgpu::BlendState {
        color: component,
        alpha: component,
    };
    let gather = |operation| {
        let component = wgpu::BlendComponent {
            src_factor: wgpu::BlendFactor::One,
            dst_factor: wgpu::BlendFactor::One,
            operation,
        };
        wgpu::BlendState {
            color: component,
            alpha: component,
        }
    };
    let (format, blend) = match (variant.program, variant.blend) {
        (Program::Slice | Program::SliceSurface | Program::SurfacesBehind, Blend::Composite) => {
            (variant.format, Some(composited))
        }
        (Program::Slice, Blend::Average) => (PROJECTION_FORMAT, Some(gather(wgpu::BlendOperation::Add))),
        (Program::Slice, _) => (PROJECTION_FORMAT, Some(gather(wgpu::BlendOperation::Max))),
        _ => (TextureFormat::Rgba16Float, None),
    };
    wgpu::ColorTargetState {
        format,
        blend,
        write_mask: wgpu::ColorWrites::ALL,
    }
}

pub(super) fn gathered_layout(device: &wgpu::Device) -> wgpu::BindGroupLayout {
    device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
        label: Some("gathered"),
        entries: &[wgpu::BindGroupLayoutEntry {
            binding: 1,
            visibility: wgpu::ShaderStages::FRAGMENT,
            ty: wgpu::BindingType::Texture {
                sample_type: wgpu::TextureSampleType::Float { filterable: false },
                view_dimension: wgpu::TextureViewDimension::D2,
                multisampled: false,
            },
            count: None,
        }],
    })
}
