//! Selects an adapter and opens it with the features that the renderers can use.

use crate::{Error, Result};
use serde_json::{Value, json};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use wgpu::{DeviceType, Features};

/// Acceptable adapters.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AdapterPreference {
    /// Only a hardware GPU.
    Hardware,
    /// Any adapter, hardware preferred.
    Any,
}

/// An open device.
pub struct Device {
    /// The device.
    pub device: wgpu::Device,
    /// Its queue.
    pub queue: wgpu::Queue,
    /// Information about its adapter.
    pub adapter: wgpu::AdapterInfo,
    /// Whether it runs compute shaders.
    computes: bool,
    /// Set once the device is lost.
    lost: Arc<AtomicBool>,
}

/// Optional features; each has a fallback.
const WISHES: [Features; 4] = [
    Features::TEXTURE_FORMAT_16BIT_NORM,
    Features::FLOAT32_FILTERABLE,
    Features::FLOAT32_BLENDABLE,
    Features::TIMESTAMP_QUERY,
];

impl Device {
    /// Opens the best adapter: discrete, then integrated, then others, then (if accepted) a
    /// software one; Vulkan, Metal and DirectX before OpenGL.
    ///
    /// # Errors
    /// No such adapter, or one that cannot be opened.
    pub fn open(preference: AdapterPreference) -> Result<Self> {
        pollster::block_on(Self::open_async(preference))
    }

    /// Like [`Self::open`], but does not block the thread: a browser does not allow blocking.
    ///
    /// # Errors
    /// As [`Self::open`].
    pub async fn open_async(preference: AdapterPreference) -> Result<Self> {
        let mut adapters = usable_adapters(wgpu::Backends::all() - wgpu::Backends::GL).await;
        let is_hardware = |a: &wgpu::Adapter| a.get_info().device_type != DeviceType::Cpu;
        // OpenGL's drivers look for a display and write to standard error where there is none: they
        // are tried last.
        if !adapters.iter().any(is_hardware) && (adapters.is_empty() || has_display()) {
            adapters.extend(usable_adapters(wgpu::Backends::GL).await);
        }
        adapters.retain(|a| preference == AdapterPreference::Any || is_hardware(a));
        adapters.sort_by_key(|a| {
            let info = a.get_info();
            let kind = match info.device_type {
                DeviceType::DiscreteGpu => 0,
                DeviceType::IntegratedGpu => 1,
                DeviceType::VirtualGpu => 2,
                DeviceType::Other => 3,
                DeviceType::Cpu => 4,
            };
            (kind, info.backend == wgpu::Backend::Gl)
        });
        let adapter = adapters.into_iter().next().ok_or_else(|| {
            Error::Gpu(match preference {
                AdapterPreference::Hardware => "no hardware GPU found".into(),
                AdapterPreference::Any => "no usable graphics driver found; install one (on Debian: mesa-vulkan-drivers) or use --backend cpu".into(),
            })
        })?;
        let features = WISHES
            .into_iter()
            .filter(|f| adapter.features().contains(*f))
            .fold(Features::empty(), |all, f| all | f);
        let descriptor = wgpu::DeviceDescriptor {
            label: Some("incise"),
            required_features: features,
            // The default limits on 3D textures and buffers are far below those of adapters.
            required_limits: adapter.limits(),
            ..Default::default()
        };
        let (device, queue) = adapter
            .request_device(&descriptor)
            .await
            .map_err(|e| Error::Gpu(format!("{}: {e}", adapter.get_info().name)))?;
        let lost = Arc::new(AtomicBool::new(false));
        let lost_flag = lost.clone();
        device.set_device_lost_callback(move |_, _| lost_flag.store(true, Ordering::Relaxed));
        let computes = adapter
            .get_downlevel_capabilities()
            .flags
            .contains(wgpu::DownlevelFlags::COMPUTE_SHADERS);
        Ok(Self {
            device,
            queue,
            adapter: adapter.get_info(),
            computes,
            lost,
        })
    }

    /// Whether the device is lost: the driver was reset, or the device was removed or abandoned.
    pub fn is_lost(&self) -> bool {
        // Polling delivers the loss callback; a device that cannot be polled is lost as well.
        self.device.poll(wgpu::PollType::Poll).is_err() || self.lost.load(Ordering::Relaxed)
    }

    /// Whether it runs compute shaders.
    pub fn computes(&self) -> bool {
        self.computes
    }

    /// Whether it is a software implementation.
    pub fn is_software(&self) -> bool {
        self.adapter.device_type == DeviceType::Cpu
    }

    /// Name for display.
    pub fn info(&self) -> String {
        format!("{} ({:?})", self.adapter.name, self.adapter.backend)
    }

    /// Details, for the report.
    pub fn report(&self) -> Value {
        json!({
            "name": self.adapter.name,
            "api": format!("{:?}", self.adapter.backend),
            "type": format!("{:?}", self.adapter.device_type),
            "driver": self.adapter.driver,
            "driver_info": self.adapter.driver_info,
        })
    }
}

/// The adapters of some backends that meet the renderers' requirements.
async fn usable_adapters(backends: wgpu::Backends) -> Vec<wgpu::Adapter> {
    let descriptor = wgpu::InstanceDescriptor::new_without_display_handle_from_env();
    // The backends selected in the environment (WGPU_BACKEND), out of these.
    let backends = descriptor.backends & backends;
    if backends.is_empty() {
        return Vec::new();
    }
    let instance = wgpu::Instance::new(wgpu::InstanceDescriptor {
        backends,
        ..descriptor
    });
    let mut adapters = instance.enumerate_adapters(backends).await;
    adapters.retain(|a| {
        a.get_downlevel_capabilities()
            .flags
            .contains(wgpu::DownlevelFlags::FRAGMENT_WRITABLE_STORAGE)
    });
    // Surfaces write their distances to such a texture.
    let draws = |a: &wgpu::Adapter, format| {
        a.get_texture_format_features(format)
            .allowed_usages
            .contains(wgpu::TextureUsages::RENDER_ATTACHMENT)
    };
    adapters
        .retain(|a| draws(a, wgpu::TextureFormat::R32Float) && draws(a, wgpu::TextureFormat::Rgba16Float));
    adapters
}

/// Whether the process can reach a display.
fn has_display() -> bool {
    cfg!(not(target_os = "linux"))
        || ["XDG_RUNTIME_DIR", "WAYLAND_DISPLAY", "DISPLAY"]
            .iter()
            .any(|v| std::env::var_os(v).is_some())
}
