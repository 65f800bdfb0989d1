//! What pictures are drawn into.

/// A texture with its view.
#[derive(Clone, PartialEq)]
pub(super) struct RenderTexture {
    pub texture: wgpu::Texture,
    pub view: wgpu::TextureView,
}

impl RenderTexture {
    pub(super) fn new(texture: wgpu::Texture) -> Self {
        let view = texture.create_view(&wgpu::TextureViewDescriptor::default());
        Self { texture, view }
    }
}

/// What surfaces are drawn into.
pub(super) struct Layer {
    /// Colour, premultiplied.
    pub color: wgpu::Texture,
    pub(super) color_view: wgpu::TextureView,
    /// Distance along each pixel's ray, mm.
    pub distance: wgpu::Texture,
    pub(super) distance_view: wgpu::TextureView,
    pub(super) depth_view: wgpu::TextureView,
}

impl Layer {
    pub(super) fn views(&self) -> [&wgpu::TextureView; 2] {
        [&self.color_view, &self.distance_view]
    }
}
